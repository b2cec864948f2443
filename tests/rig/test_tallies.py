"""What kernels add up beside squares, against the same of the samples that they would have kept.

Mutants killed: neighbours across a gap that count as none, the first sample taken for the last, a
channel's weight exchanged, a power of two lost, walkers whose lanes see other samples than the first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from oracles import NOMINAL
from rigs import experiment, vector
from rubbing_cases import CASES
from scipy.special import log_ndtr
from stepping import experiment_of, parameters, stepped
from together import for_each

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.irregular import IrregularSimulator
from bayesdrill.rig.simulators.sensors import ObservationModel

W = 11
MEASURES = {"alpha": {"theta_1": 1.0, "theta_2": -1.0}, "w_2": {"w_2": 8.0}, "i": {"i": 1.0}}
LATE = ObservationModel(
    lags={"alpha": "lag_alpha", "i": "lag_i"}, input_lags={}, gains={"w_2": "gain_w_2"}
)


def record(*, even: bool = True, gaps: bool = False, n: int = 60) -> Experiment:
    made = experiment(n, 0.01, measures=MEASURES, start={"w_1": 3.0, "w_2": 2.0})
    rng = np.random.default_rng(3)
    y = rng.normal(size=made.y.shape)
    if gaps:
        y[0, 0] = y[-1, 1] = y[20:30, 2] = y[::2, 0] = np.nan
    t = made.t if even else made.t + 0.003 * rng.uniform(0, 1, n) * (np.arange(n) > 0)
    return replace(made, t=t, y=y)


def linear(full: int) -> np.ndarray:
    rng = np.random.default_rng(6)
    return np.asarray(vector(NOMINAL) * np.exp(rng.normal(0, 0.2, (W, full))))


def measured(**kind: bool) -> tuple[Simulator, np.ndarray]:
    return IrregularSimulator(MotorShaft(), record(**kind), ObservationModel()), linear(9)


def late(**kind: bool) -> tuple[Simulator, np.ndarray]:
    """Each walker by its own lags, into the past and the future."""
    rng = np.random.default_rng(7)
    rig = IrregularSimulator(MotorShaft(), record(**kind), LATE)
    told = np.column_stack([rng.uniform(0.9, 1.1, W), rng.normal(0, 0.02, (W, 2))])
    return rig, np.hstack([linear(9), told])


def rubbing(
    *, gaps: bool = False, sensing: ObservationModel | None = None
) -> tuple[Simulator, np.ndarray]:
    case = CASES["static"]
    one = experiment_of(case)
    y = np.random.default_rng(3).normal(size=one.y.shape)
    if gaps:
        y[::3, 0] = y[5:9, 1] = np.nan
    rig = stepped(case, 2, sensing, record=replace(one, y=y))
    told = {"lag": 0.013} if sensing else {}
    rng = np.random.default_rng(9)
    full = np.repeat(parameters(case, told), W, axis=0)
    full[:, :4] *= np.exp(rng.normal(0, 0.1, (W, 4)))
    if sensing:
        full[:, -1] = rng.normal(0, 0.02, W)
    return rig, full


RIGS: dict[str, Callable[[], tuple[Simulator, np.ndarray]]] = {
    "plain": lambda: (Response(MotorShaft(), record()), linear(9)),
    "gaps": lambda: measured(gaps=True),
    "uneven": lambda: measured(even=False),
    "uneven with gaps": lambda: measured(even=False, gaps=True),
    "late": lambda: late(),
    "late with gaps": lambda: late(gaps=True),
    "late, uneven with gaps": lambda: late(even=False, gaps=True),
    "rubs": lambda: rubbing(),
    "rubs with gaps": lambda: rubbing(gaps=True),
    "rubs, late with gaps": lambda: rubbing(
        gaps=True, sensing=ObservationModel(lags={"w_1": "lag"})
    ),
}


def test_tallies_are_those_of_the_samples() -> None:
    def check(name: str) -> None:
        rig, full = RIGS[name]()
        y, seen = rig.experiment.y, rig.experiment.seen
        left = y - rig.signals(full)
        found = rig.neighbours(full)
        weights = np.exp(np.random.default_rng(1).normal(0, 3, (len(full), y.shape[1])))
        logs = np.log1p(weights[:, None] * np.where(seen, left, 0.0) ** 2).sum(axis=1)
        assert rig.logs(full, weights) == pytest.approx(logs, rel=1e-9)
        over = np.exp(np.random.default_rng(2).uniform(-1, 4, (len(full), y.shape[1])))
        half = np.exp(np.random.default_rng(3).uniform(np.log(0.2), 3, over.shape))
        middle, widths = np.where(seen, np.abs(left), 0.0) * over[:, None], half[:, None]
        near, far = log_ndtr(widths - middle), log_ndtr(-widths - middle)
        masses = np.where(seen, near + np.log(-np.expm1(far - near)), 0.0).sum(axis=1)
        assert rig.intervals(full, over, half) == pytest.approx(masses, rel=1e-8, abs=1e-6)
        for k in range(y.shape[1]):
            own = left[:, seen[:, k], k]
            squares, size = (own**2).sum(axis=1), np.abs(own).max()
            assert found[:, k, 0] == pytest.approx(squares, rel=1e-9)
            steps = (np.diff(own, axis=1) ** 2).sum(axis=1)
            assert found[:, k, 1] == pytest.approx(steps, abs=1e-9 * squares.max())
            ends = (own[:, [0, -1]] ** 2).sum(axis=1)
            assert found[:, k, 2] == pytest.approx(ends, abs=1e-8 * size**2)

    for_each({str(name): (name,) for name in RIGS}, check)


def test_a_walker_that_overflows_harms_no_other() -> None:
    def check(name: str) -> None:
        rig, full = RIGS[name]()
        weights = np.ones((len(full), rig.experiment.y.shape[1]))
        sick = full.copy()
        sick[4, :5] = np.nan
        others = np.delete(np.arange(len(full)), 4)
        for found, true in (
            (rig.neighbours(sick), rig.neighbours(full)),
            (rig.logs(sick, weights), rig.logs(full, weights)),
            (rig.intervals(sick, weights, weights), rig.intervals(full, weights, weights)),
        ):
            assert np.array_equal(found[others], true[others])
            assert np.isnan(found[4].reshape(found.shape[1], -1)[:, 0]).all()

    for_each({name: (name,) for name in ["plain", "late, uneven with gaps", "rubs"]}, check)


def test_logs_of_what_is_far_off_neither_overflow_nor_lose_digits() -> None:
    """10^6 samples would leave the range of numbers, were powers of two not kept apart."""
    one = record()
    rig = Response(MotorShaft(), replace(one, y=one.y * 1e60))
    full = linear(9)
    left = rig.experiment.y - rig.signals(full)
    weights = np.full((W, 3), 1e-3)
    true = np.log1p(weights[:, None] * left**2).sum(axis=1)
    assert rig.logs(full, weights) == pytest.approx(true, rel=1e-12)
    lost = rig.with_record(np.full_like(one.y, 1e120))
    assert np.isnan(lost.logs(full, weights)).all()
