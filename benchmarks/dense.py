"""What times that are not uniform and shifted channels cost, beside the plain response in the same run.

`python -m benchmarks.dense` prints microseconds for one evaluation in a batch of 64, one core.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from benchmarks import problem
from benchmarks.likelihood import BATCH, best_of

STEP = 0.01
NAMES = ("theta_1", "theta_2", "w_1", "w_2")


def times(n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    even = STEP * np.arange(n)
    left_out = np.sort(rng.choice(n + n // 20, n, replace=False))
    return {
        "uniform": even,
        "jitter of 30 %": even + 0.3 * STEP * rng.uniform(-1, 1, n),
        "5 % left out": STEP * left_out,
    }


def delays(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Delays `(BATCH, channels)` as walkers of a posterior have them, and as those of a prior."""
    near = STEP * (np.array([0.3, 1.2, 1.7, 2.2]) + rng.normal(0, 2e-3, (BATCH, 4)))
    return {
        "": near[:, :0],
        ", one delay": near[:, 1:2],
        ", four delays": near,
        ", four delays, wide": STEP * rng.uniform(0.1, 3, (BATCH, 4)),
    }


def main() -> None:
    job, rng = problem.load(), np.random.default_rng(1)
    space, model = (
        job.problem.posterior.space,
        job.problem.posterior.likelihood.only_observation.response.model,
    )
    theta = space.full(space.vector(job.problem.nominal) * rng.uniform(0.9, 1.1, (BATCH, 1)))
    channels = tuple(
        Channel(name=name, weights={name: 1.0}, unit="1", latex=name, latex_unit="1")
        for name in NAMES
    )
    for n in (1001, 100_000):
        repeats = 100 if n < 10_000 else 5
        y, series = rng.normal(0, 1, (n, 4)), {"v": rng.normal(6, 1, n)}
        record = Experiment(
            t=STEP * np.arange(n), y=y, channels=channels, constant={"t_1": 0.0}, series=series,
            first_order=False, start={}, t_start=0.0,
        )  # fmt: skip
        plain = Response(model, record)
        base = best_of(lambda p=plain: p.squares(theta), repeats)
        print(f"{n} samples of 4 channels, measured voltage: plain {1e6 * base / BATCH:.1f} us")
        for how, t in times(n, rng).items():
            for of, late in delays(rng).items():
                names = NAMES[: late.shape[1]]
                sensing = ObservationModel(lags={name: f"lag_{name}" for name in names})
                uneven = Response(model, dataclasses.replace(record, t=t), sensing)
                full = np.hstack([theta, late])
                taken = best_of(lambda r=uneven, p=full: r.squares(p), repeats)
                print(f"  {how + of:36s} {1e6 * taken / BATCH:9.1f} us {taken / base:6.1f}")


if __name__ == "__main__":
    main()
