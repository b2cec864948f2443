"""What dry friction costs, beside the linear rig in the same run.

`python -m benchmarks.rubbing` prints microseconds for one evaluation of 1001 samples of four channels in
a batch of 64, one core, with parameters within 10 %, and (`close`) within 0.5 %, as in a posterior,
where speeds turn in the same steps; and how far so many pieces, and parts (`turns`) of one in which
something turns, are from 256: the most, in rad/s.
"""

from __future__ import annotations

import numpy as np

from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped
from benchmarks import problem
from benchmarks.likelihood import BATCH, best_of

NAMES = ("theta_1", "theta_2", "w_1", "w_2")
COULOMB = {"t_cm": 0.05, "t_c1": 0.25}
STRIBECK = {**COULOMB, "t_sm": 0.1, "w_sm": 2.0, "t_s1": 0.5, "w_s1": 0.5}
REPEATS = 100
WIDE, CLOSE = 0.1, 0.005


def voltages(t: np.ndarray) -> dict[str, np.ndarray]:
    square = 8 * np.sign(np.sin(0.4 * np.pi * t + 0.3)) * np.minimum(1.0, t)
    return {"one way": np.full(len(t), 8.0), "reversing": square, "sticking": 2.0 * np.sin(t)}


def main() -> None:
    job, rng = problem.load(), np.random.default_rng(1)
    nominal = {**job.problem.nominal, "t_f": 0.0}
    t = 0.01 * np.arange(1001)
    channels = tuple(
        Channel(name=name, weights={name: 1.0}, unit="1", latex=name, latex_unit="1")
        for name in NAMES
    )
    for how, v in voltages(t).items():
        record = Experiment(
            t=t, y=rng.normal(0, 1, (len(t), 4)), channels=channels, constant={"t_1": 0.0},
            series={"v": v}, first_order=False, start={}, t_start=0.0,
        )  # fmt: skip
        plain = Response(MotorShaft(), record)
        linear = _points(plain.parameters, nominal, rng, WIDE)
        base = best_of(lambda p=plain, x=linear: p.squares(x), REPEATS)
        print(f"{how}: linear {1e6 * base / BATCH:.2f} us")
        for law, own in (("Coulomb", COULOMB), ("Stribeck", STRIBECK)):
            rig = Stepped(MotorShaft(added=tuple(own)), record, ObservationModel())
            full = _points(rig.parameters, nominal | own, rng, WIDE)
            near = _points(rig.parameters, nominal | own, rng, CLOSE)
            truth = rig.with_substeps(256).signals(full[:1])
            for pieces, turns in (
                (1, 1),
                (1, REVERSAL_SUBSTEPS),
                (2, REVERSAL_SUBSTEPS),
                (4, REVERSAL_SUBSTEPS),
            ):
                tried = rig.with_substeps(pieces, turns)
                taken = best_of(lambda r=tried, x=full: r.squares(x), REPEATS)
                close = best_of(lambda r=tried, x=near: r.squares(x), REPEATS)
                off = np.abs(tried.signals(full[:1]) - truth)[:, :, 2:].max()
                print(
                    f"  {law:8s} at both ends, pieces {pieces}, turns {turns}: "
                    f"{1e6 * taken / BATCH:6.2f} us {taken / base:5.2f} times, "
                    f"close {close / base:5.2f}, off {off:.1e}"
                )


def _points(
    names: tuple[str, ...], values: dict[str, float], rng: np.random.Generator, spread: float
) -> np.ndarray:
    around = rng.uniform(1 - spread, 1 + spread, (BATCH, len(names)))
    return np.array([values[name] for name in names]) * around


if __name__ == "__main__":
    main()
