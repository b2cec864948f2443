"""Rigs of many states: the response, its slopes and its sums against SciPy's exponential.

Mutants killed: channels of a block in the wrong order; inputs of the second half in the first; a
norm without balance; a slope of the left factor alone; a missing sample that counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from together import for_each

from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.models.linear import DOT, Tangent, constant_forcing, dynamics
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.chains import ChainResponse
from bayesdrill.rig.simulators.contract import in_groups
from bayesdrill.rig.simulators.exact import Response
from bayesdrill.rig.simulators.sensors import ObservationModel, ObservedWalkers

STEP = 0.002
PERFECT = ObservationModel()


@dataclass(frozen=True)
class Case:
    """A chain of `count` inertias, and what is done with it; `ground`: the last is held by a shaft."""

    count: int
    ground: bool = False
    damped: bool = True
    series: tuple[str, ...] = ("t_d0",)
    constant: dict[str, float] = field(default_factory=dict)
    first_order: bool = False
    moving: bool = False
    lead: float = 0.0
    samples: int = 203
    rig: dict[str, Any] = field(default_factory=dict)

    @property
    def model(self) -> Train:
        names = [f"d{k}" for k in range(self.count)]
        geared = {end for gear in self.rig.get("gears", {}).values() for end in gear["between"]}
        ends = [
            (one, other)
            for one, other in zip(names, [*names[1:], *["ground"] * self.ground], strict=False)
            if not {one, other} <= geared
        ]
        shafts = {f"s{k}": pair for k, pair in enumerate(ends)}
        added = (*(f"c_s{k}" for k in range(len(ends))), "c_d0") if self.damped else ()
        kinds = {"inertias": names, "shafts": shafts, "drives": {"d0": "torque"}, "added": added}
        return Train(**(kinds | self.rig))

    @property
    def walkers(self) -> np.ndarray:
        rng = np.random.default_rng(self.count)
        usual = {"j": 0.01, "m": 0.01, "k": 30.0, "c": 0.02, "l": 2e-3, "r": 0.5}
        mid = np.array([usual[name[0]] for name in self.model.parameters])
        return mid * rng.uniform(0.5, 2.0, (11, len(mid)))

    @property
    def experiment(self) -> Experiment:
        rng, states = np.random.default_rng(3), self.model.states
        rows = rng.normal(0, 1, (3, len(states))) * (rng.uniform(size=(3, len(states))) < 0.2)
        rows[0, 0] = rows[1, -1] = rows[2, len(states) // 2] = 1.0
        channels = tuple(
            Channel(name=f"y{k}", weights=dict(zip(states, row, strict=True)), unit="1", latex="y",
                    latex_unit="1")
            for k, row in enumerate(rows)
        )  # fmt: skip
        t = 1.0 + STEP * np.arange(self.samples)
        return Experiment(
            t=t,
            y=rng.normal(0, 1, (len(t), 3)),
            channels=channels,
            constant=self.constant,
            series={name: rng.normal(1, 1, len(t)) for name in self.series},
            first_order=self.first_order,
            start={name: rng.normal() for name in states} if self.moving else {},
            t_start=1.0 - self.lead,
        )


CASES = {
    "free, held inputs": Case(6),
    "free start": Case(6, moving=True, series=(), constant={"t_d0": 0.7}),
    "grounded, straight inputs, a line": Case(
        12, ground=True, first_order=True, series=("f_d0", "f_d5"), moving=True,
        rig={"motion": "linear", "drives": {"d0": "torque", "d5": "torque"}},
    ),
    "undamped, of 20": Case(20, damped=False, moving=True),
    "of 20, held, one input constant": Case(
        20, ground=True, constant={"t_d7": -0.4},
        rig={"drives": {"d0": "torque", "d7": "torque"}},
    ),
    "gears and a current": Case(
        12, series=("u_d0",), first_order=True, moving=True,
        rig={
            "drives": {"d0": "voltage"},
            "gears": {"box": {"between": ["d3", "d4"], "ratio": -0.07}},
            "added": ("l_d0", "c_s0", "c_s7"),
        },
    ),
    "late": Case(6, moving=True, lead=0.137, series=(), constant={"t_d0": 1.0}),
    "two samples": Case(6, samples=2, moving=True),
    "a block": Case(6, samples=8, first_order=True, moving=True),
    "a stretch and one": Case(6, samples=65, moving=True),
}  # fmt: skip


def exact(model, experiment: Experiment, row: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """Channels (T, K) of weights (K, X), by SciPy's exponential."""
    p = dict(zip(model.parameters, row, strict=True))
    linear, x, names = model.linear(p), len(model.states), [*experiment.series]
    s = len(names)
    m = np.zeros((x + 1 + 2 * s, x + 1 + 2 * s))
    m[:x, :x] = dynamics(linear, model.states, 1)[0]
    m[:x, x] = constant_forcing(linear, model.states, 1, experiment.constant)[0]
    for (state, name), value in linear.B.items():
        if name in names:
            m[model.states.index(state), x + 1 + names.index(name)] += value
    m[x + 1 : x + 1 + s, x + 1 + s :] = np.eye(s)
    u = np.array([experiment.series[name] for name in names]).reshape(s, len(experiment.t)).T
    z = np.zeros(len(m))
    z[:x], z[x] = [experiment.start.get(name, 0.0) for name in model.states], 1.0
    z = scipy.linalg.expm(m * (experiment.t[0] - experiment.t_start)) @ z
    step, out = scipy.linalg.expm(m * STEP), []
    for k in range(len(experiment.t)):
        if s:
            following = u[min(k + 1, len(u) - 1)] if experiment.first_order else u[k]
            z[x + 1 :] = [*u[k], *(following - u[k]) / STEP]
        out.append(channels @ z[:x])
        z = step @ z
    return np.array(out)


def relative_error(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.max(np.abs(found - true) / np.abs(true).max(axis=0)))


def test_its_response_is_that_of_scipys_exponential() -> None:
    def check(case: Case) -> None:
        model, experiment, walkers = case.model, case.experiment, case.walkers
        response = simulator(model, experiment, PERFECT)
        assert type(response) is ChainResponse
        found = response.signals(walkers)
        for row in (0, 10):
            true = exact(model, experiment, walkers[row], experiment.weights(model.states))
            assert relative_error(found[row], true) < 1e-10
        squares = ((experiment.y - found) ** 2).sum(axis=1)
        assert response.squares(walkers) == pytest.approx(squares, rel=1e-12)
        assert response.signals(walkers[3:4])[0].tobytes() == found[3].tobytes()

    for_each({name: (case,) for name, case in CASES.items()}, check)


def test_its_slopes_are_those_of_scipys_exponential() -> None:
    def check(name: str) -> None:
        case = CASES[name]
        model, experiment, walkers = case.model, case.experiment, case.walkers[:2]
        along = walkers[:, None] * np.random.default_rng(9).normal(0, 1, (2, 5, walkers.shape[1]))
        response = simulator(model, experiment, PERFECT)
        signals, slopes = response.course(walkers, along)
        assert signals == pytest.approx(response.signals(walkers), rel=1e-12)
        tangent = Tangent(model)
        weights = np.hstack(
            [0 * experiment.weights(model.states), experiment.weights(model.states)]
        )
        assert tangent.states[len(model.states)].endswith(DOT)
        for w, q in ((0, 0), (1, 4)):
            both = np.append(walkers[w], along[w, q])
            true = exact(tangent, experiment, both, weights)
            assert relative_error(slopes[w, q], true) < 1e-9
        h = 1e-6
        ahead = response.signals(walkers + h * along[:, 1])
        back = response.signals(walkers - h * along[:, 1])
        assert relative_error(slopes[0, 1], ((ahead - back) / (2 * h))[0]) < 1e-6

    for_each({name: (name,) for name in CASES if name != "a block"}, check)


def test_sensors_missing_samples_and_unknown_starts() -> None:
    case = Case(6, first_order=True, moving=True, constant={"t_d3": 0.4},
                rig={"drives": {"d0": "torque", "d3": "torque"}})  # fmt: skip
    model, experiment, walkers = case.model, case.experiment, case.walkers
    rng = np.random.default_rng(4)
    y = np.where(rng.uniform(size=experiment.y.shape) < 0.2, np.nan, experiment.y)
    record = replace(experiment, y=y)
    sensing = ObservationModel(
        gains={"y0": "gain"}, offsets={"y1": "offset"}, input_gains={"t_d0": "felt"},
        input_offsets={"t_d3": "bias"}, states={"theta_d2": "begin"},
    )  # fmt: skip
    response = simulator(model, record, sensing)
    assert type(response) is ChainResponse
    more = dict(zip(response.parameters[len(model.parameters) :], range(5), strict=True))
    assert [*more] == ["gain", "offset", "felt", "bias", "begin"]
    full = np.hstack([walkers, rng.normal(1, 0.2, (len(walkers), 5))])
    found = response.signals(full)
    for row in (1, 9):
        gain, offset, felt, bias, begin = full[row, -5:]
        alike = replace(
            experiment,
            series={"t_d0": felt * experiment.series["t_d0"]},
            constant={"t_d3": 0.4 + bias},
            start={**experiment.start, "theta_d2": begin},
        )
        true = exact(model, alike, walkers[row], experiment.weights(model.states))
        assert relative_error(found[row], true * [gain, 1, 1] + [0, offset, 0]) < 1e-10
    left = np.where(np.isnan(y), 0.0, y - found)
    assert response.squares(full) == pytest.approx((left**2).sum(axis=1), rel=1e-12)
    weights = rng.uniform(0.5, 2.0, (len(full), 3))
    logs = np.log1p(weights[:, None] * left**2).sum(axis=1)
    assert response.logs(full, weights) == pytest.approx(logs, rel=1e-12)
    steps = [
        (np.diff((y - one)[~np.isnan(y[:, k]), k]) ** 2).sum() for one in found for k in range(3)
    ]
    assert response.neighbours(full)[..., 1].ravel() == pytest.approx(steps, rel=1e-12)
    along = rng.normal(0, 1, (len(full), 4, full.shape[1])) * full[:, None]
    slopes = response.sensitivities(full, along)
    h = 1e-6
    ahead, back = (response.signals(full + sign * h * along[:, 2]) for sign in (1, -1))
    assert relative_error(slopes[0, 2], ((ahead - back) / (2 * h))[0]) < 1e-6
    scales = rng.uniform(0.5, 2.0, (len(full), 3, 1))
    squares, gradient, products = response.normal(full, along, scales)
    shown = np.where(np.isnan(y), 0.0, slopes) * np.sqrt(scales[:, None, None, :, 0])
    assert squares == pytest.approx((left**2).sum(axis=1) * scales[..., 0], rel=1e-12)
    assert products == pytest.approx(np.einsum("wqtk,wptk->wqp", shown, shown), rel=1e-10)
    rest = left * np.sqrt(scales[:, None, :, 0])
    assert gradient == pytest.approx(np.einsum("wqtk,wtk->wq", shown, rest), rel=1e-8, abs=1e-8)


def test_few_states_have_kernels_written_out() -> None:
    few = Case(5)
    assert type(simulator(few.model, few.experiment, PERFECT)) is Response
    delayed = ObservationModel(delay="t_0")
    assert (
        type(simulator(CASES["late"].model, CASES["late"].experiment, delayed)) is not ChainResponse
    )


def test_a_walker_that_overflows_spoils_no_other() -> None:
    case = CASES["free, held inputs"]
    model, experiment, walkers = case.model, case.experiment, case.walkers
    response, wild = simulator(model, experiment, PERFECT), walkers.copy()
    wild[4, -1] = -1e8  # a damping that drives
    found, true = response.signals(wild), response.signals(walkers)
    assert not np.isfinite(found[4]).all()
    kept = [0, 1, 2, 3, 5, 6, 7]
    assert found[kept].tobytes() == true[kept].tobytes()


def test_nothing_is_computed_of_what_lay_in_memory() -> None:
    """Numbers below the normal range make each product a hundred times as slow.

    Mutant killed: panels are as wide as what they hold, and hold what was there.
    """
    case = Case(6)
    response = simulator(case.model, case.experiment, PERFECT)
    assert isinstance(response, ChainResponse)
    scratch = np.full((response._shape.scratch(1), LANES), 5e-310)
    groups = in_groups(ObservedWalkers(response.sensors, case.walkers).numbers)
    out = np.empty((len(groups), *case.experiment.y.shape, LANES))
    given = {"groups": len(groups), "samples": len(case.experiment.t), **response._blocks}
    given |= {"parameters": groups, "out": out, "scratch": scratch}
    response._kernel("signals").call("signals", given)
    sizes = np.abs(scratch)
    assert not ((sizes > 0.0) & (sizes < np.finfo(float).tiny)).any()
    assert sizes.any()


def test_a_current_that_is_far_faster_than_all_else_costs_no_digits() -> None:
    """Many squarings.  Mutant killed: a one beside what is squared (1e-5 off)."""
    rig = {"drives": {"d0": "voltage"}, "added": ("l_d0", "c_s0")}
    case = Case(6, series=("u_d0",), samples=64, rig=rig)
    model, walkers = case.model, case.walkers[:2].copy()
    walkers[:, model.parameters.index("l_d0")] = [1e-13, 1e-14]
    walkers[1, : len(model.parameters) - 2] = walkers[0, : len(model.parameters) - 2]
    walkers[1, -1] = walkers[0, -1]
    names = ("theta_d0", "w_d0", "theta_d5")
    channels = tuple(
        replace(channel, weights={name: 1.0})
        for name, channel in zip(names, case.experiment.channels, strict=True)
    )
    record = replace(case.experiment, channels=channels)
    fast, faster = simulator(model, record, PERFECT).signals(walkers)
    assert relative_error(fast, faster) < 1e-10
