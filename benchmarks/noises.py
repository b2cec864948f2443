"""What noises cost, beside white noise in the same run.

`python -m benchmarks.noises` prints microseconds for one log likelihood of 1001 samples of four
channels in a batch of 64, one core, of a linear rig and of one that rubs; sizes and all else of the
noise are unknown, steps are four sigma.
"""

from __future__ import annotations

import numpy as np

from bayesdrill.inference.noise import NOISES
from bayesdrill.inference.noise.contract import NoisyChannel, SimulatorResiduals
from bayesdrill.inference.priors import LogUniform
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped
from benchmarks import problem
from benchmarks.likelihood import BATCH, best_of

NAMES = ("theta_1", "theta_2", "w_1", "w_2")
KINDS = ("white", "ar1", "student_t", "quantised")
SIGMA, REPEATS = 0.1, 100
NEAR = 1e-4  # of the truth: walkers are where the record fits


def record(rng: np.random.Generator) -> Experiment:
    t = 0.01 * np.arange(1001)
    channels = tuple(
        Channel(name=name, weights={name: 1.0}, unit="1", latex=name, latex_unit="1")
        for name in NAMES
    )
    return Experiment(
        t=t, y=rng.normal(0, 1, (len(t), 4)), channels=channels, constant={"t_1": 0.0, "v": 8.0},
        series={}, first_order=False, start={}, t_start=0.0,
    )  # fmt: skip


def main() -> None:
    job, rng = problem.load(), np.random.default_rng(1)
    one = record(rng)
    rigs = {
        "linear": Response(MotorShaft(), one),
        "rubs": Stepped(MotorShaft(added=("t_cm", "t_c1")), one, ObservationModel()),
    }
    values = {**job.problem.nominal, "t_f": 0.0, "t_cm": 0.05, "t_c1": 0.25}
    for name, rig in rigs.items():
        full = np.array([[values[p] for p in rig.parameters]])
        fresh = rng.normal(0.0, SIGMA, rig.experiment.y.shape)
        rig = rig.with_record(rig.signals(full)[0] + fresh)
        full = full * rng.uniform(1.0 - NEAR, 1.0 + NEAR, (BATCH, full.shape[1]))
        base = 0.0
        for kind in KINDS:
            taken = _taken(rig, full, kind, rng)
            base = base or taken
            print(
                f"{name:6s} {kind:9s} {1e6 * taken / BATCH:7.2f} us {taken / base:6.2f} times white"
            )


def _taken(rig: Simulator, full: np.ndarray, kind: str, rng: np.random.Generator) -> float:
    prior = LogUniform(0.1 * SIGMA, 10 * SIGMA)
    channels = [
        NoisyChannel(channel=c, sigma=prior, start=SIGMA, entries={"step": 4 * SIGMA})
        for c in rig.experiment.channels
    ]
    noise = NOISES[kind].from_channels(channels, len(rig.experiment.t))
    share = rng.uniform(0.3, 0.7, (BATCH, len(noise.unknowns)))
    own = np.stack([u.prior.quantile(share[:, k]) for k, u in enumerate(noise.unknowns)], axis=-1)
    return best_of(lambda: noise.log_likelihood(SimulatorResiduals(rig, full), own), REPEATS)


if __name__ == "__main__":
    main()
