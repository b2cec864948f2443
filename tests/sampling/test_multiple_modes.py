"""Several maxima: which points belong to one, aliases of frequencies, and branches that can swap."""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from support.case_tables import run_cases
from support.closed_form_densities import Walled, altered, humps, ridged, without_density
from support.linear_oracle import ExactMotion
from support.scipy_oracles import NOMINAL, matrices
from support.small_problems import experiment, posterior, vector, with_priors
from support.state_records import record_of_states

import bayesdrill as bd
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.sampling import multiple_modes
from bayesdrill.sampling.multiple_modes import distinct_modes, joined_by_ridge, twin_starts
from benchmarks.modes import collection


@run_cases("n_loose, n_tight", [(1, 1), (1, 3), (2, 1), (2, 3)])
def test_points_of_one_long_bent_ridge_are_one_maximum(n_loose: int, n_tight: int) -> None:
    """They are hundreds of standard deviations apart, and what lies between them is off the ridge."""
    surface = ridged(n_loose, n_tight)
    psi = np.random.default_rng(3).uniform(-0.4, 0.8, (12, n_loose))
    points = surface.at(psi, np.zeros((12, n_tight)))
    between = surface.parts(points[0] + 0.5 * (points[1:] - points[0]))[1]
    assert np.linalg.norm(between, axis=1).max() > 10.0
    assert distinct_modes(surface, points, -1e-3 * np.arange(12.0)) == [0]


@run_cases("rise, kept", [(0.0, 0), (1e-7, 0), (0.01, 1)])
def test_a_higher_new_point_replaces_the_known_one_of_its_ridge(rise: float, kept: int) -> None:
    surface = ridged(1, 2)
    points = surface.at(np.array([[-0.3], [0.5]]), np.zeros((2, 2)))
    assert distinct_modes(surface, points, np.array([0.0, rise]), n_known=1) == [kept]


@run_cases("d", [1, 2, 5])
def test_two_humps_are_two_maxima_the_highest_first(d: int) -> None:
    surface = humps(d, (0.1, 0.9), (1.0, 1.0), 20.0)
    noise = np.random.default_rng(4).standard_normal((10, d))
    points = surface.means[np.arange(10) % 2] + 1e-4 * noise
    values = surface.value(points)
    modes = distinct_modes(surface, points, values)
    first_hump = np.where(np.arange(10) % 2, -1e9, values)
    assert modes == [int(np.argmax(values)), int(np.argmax(first_hump))]
    assert list(surface.belongs(points[modes])) == [1, 0]


@run_cases("apart, count", [(10.0, 2), (1.0, 1)])
def test_a_valley_parts_humps_so_wide_that_nothing_is_tight(apart: float, count: int) -> None:
    surface = humps(1, (0.6, 0.4), (3.0, 3.0), apart)
    values = surface.value(surface.means)
    modes = distinct_modes(surface, surface.means, values)
    assert modes == [*np.argsort(-values)[:count]]


def test_a_long_row_of_maxima_has_valleys_between_all_of_them() -> None:
    """As those of a lag under a periodic input; even distances would all fall on maxima."""
    hump, count = humps(1, (1.0,), (0.1,), 0.0), 60
    means = np.linspace(hump.low[0] + 1.0, hump.high[0] - 1.0, count)[:, None]
    roots = np.repeat(hump.roots, count, axis=0)
    row = dataclasses.replace(hump, weights=np.ones(count), means=means, roots=roots)
    assert len(distinct_modes(row, means, row.value(means))) == count


def test_a_maximum_that_is_much_lower_is_left_out() -> None:
    surface = humps(2, (1.0, 1e-9, 1e-13), (1.0, 1.0, 1.0), 20.0)
    assert distinct_modes(surface, surface.means, surface.value(surface.means)) == [0, 1]


def test_a_second_ridge_beside_the_first_is_another_maximum() -> None:
    """Both are long and bent: points of either are joined to their own only."""
    ridge = ridged(1, 2)
    shift = ridge.mixing @ np.array([0.0, 0.6, 0.6])

    def log_density(self: Walled, u: np.ndarray) -> np.ndarray:
        return np.maximum(ridge.log_density(u), ridge.log_density(u - shift))

    def derivatives(self: Walled, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first = ridge.log_density(u) >= ridge.log_density(u - shift)
        return ridge.derivatives(np.where(first[:, None], u, u - shift))

    both = altered(ridge, log_density=log_density, derivatives=derivatives)
    on = ridge.at(np.array([[-0.3], [0.1], [0.5]]), np.zeros((3, 2)))
    points = np.concatenate([on, on + shift])
    joined = joined_by_ridge(both, points[0], points[1:])
    assert list(joined) == [True, True, False, False, False]
    assert distinct_modes(both, points, -1e-3 * np.arange(6.0)) == [0, 3]


def test_searches_from_all_over_the_prior_end_on_both_humps() -> None:
    surface = humps(2, (0.5, 0.5), (1.0, 1.0), 20.0)
    starts = np.random.default_rng(5).uniform(surface.low, surface.high, (24, 2))
    points, values = multiple_modes.best_ends(surface, starts)
    assert values == pytest.approx(surface.value(points))
    assert set(surface.belongs(points)) == {0, 1}
    off = np.linalg.norm(points - surface.means[surface.belongs(points)], axis=1)
    assert (off < 1e-3).sum() >= len(points) - 1
    assert len(distinct_modes(surface, points, values)) == 2
    points, values = multiple_modes.best_ends(without_density(surface), surface.means)
    assert (points.shape, len(values)) == ((0, 2), 0)


# --- aliases: frequencies that the samples of a record cannot distinguish --------------------------

DT = 1.0  # s, about half of a period
TRUE = 0.26  # N m / rad


def frequency(**changes: float) -> float:
    """Angular frequency of the torsion, from the equations of motion."""
    return float(np.abs(np.linalg.eigvals(matrices({**NOMINAL, **changes})[0]).imag).max())


@cache
def speed_of_the_rotor() -> Response:
    """Twelve samples at 1 Hz."""
    return Response(MotorShaft(), experiment(12, DT, measures={"w_1": {"w_1": 1.0}}))


def aliased(free: tuple[str, ...], k_s: float = TRUE) -> Posterior:
    """From a rig of this stiffness; every unknown in a uniform box."""
    clean = speed_of_the_rotor().signals(vector({**NOMINAL, "k_s": k_s})[None])[0]
    noise = 0.3 * np.random.default_rng(2).standard_normal(clean.shape)
    response = speed_of_the_rotor().with_record(clean + noise)
    boxes = {name: Uniform(0.5 * NOMINAL[name], 1.6 * NOMINAL[name]) for name in free}
    sigma = np.array([0.3])
    return posterior(response.experiment, sigma, free=free, priors=boxes, response=response)


def coordinates(target: Posterior, **changes: float) -> np.ndarray:
    theta = target.space.vector({**NOMINAL, **changes})
    return target.coordinates.from_physical(theta[None])[0]


def alias_points(target: Posterior, u: np.ndarray) -> np.ndarray:
    starts = multiple_modes.alias_starts(LogDensity(target, physical=True), u)
    return np.concatenate([each.u for each in starts])


@run_cases("free", [("k_s",), ("k_s", "j_1"), ("k_s", "j_1", "t_f")])
@run_cases("from_the_truth", [True, False])
def test_the_other_stiffness_of_a_torsion_near_half_the_sampling_rate(
    free: tuple[str, ...], from_the_truth: bool
) -> None:
    """From either one the other is proposed, and a search from there ends where SciPy's poles say."""
    folded = 2.0 * np.pi / DT - frequency(k_s=TRUE)
    alias = brentq(lambda k_s: frequency(k_s=k_s) - folded, 0.05, 5.0, xtol=1e-12)
    start, other = (TRUE, alias) if from_the_truth else (alias, TRUE)
    target = aliased(free, start)
    u = coordinates(target, k_s=start)
    points = alias_points(target, u)

    def named(u: np.ndarray) -> list[dict[str, float]]:
        theta = target.coordinates.to_physical(u)
        return [dict(zip(target.space.free, row, strict=True)) for row in theta]

    off = [abs(frequency(**values) - frequency(k_s=other)) for values in named(points)]
    assert min(off) < 1.0 / 11.0  # a radian over the record
    assert LogDensity(target).in_support(points).all()
    surface = LogDensity(target, physical=True)
    ends, values = multiple_modes.best_ends(surface, np.vstack([u, points]))
    modes = named(ends[distinct_modes(surface, ends, values)])
    ratios = sorted(p["k_s"] / p.get("j_1", NOMINAL["j_1"]) for p in modes)
    assert ratios == pytest.approx([k / NOMINAL["j_1"] for k in sorted((TRUE, alias))], rel=0.05)


def test_no_alias_is_proposed_outside_the_priors_or_out_of_reach() -> None:
    target = aliased(("k_s",))
    narrow = with_priors(target.space, {"k_s": Uniform(0.25, 0.27)})
    target = dataclasses.replace(target, space=narrow)
    assert alias_points(target, coordinates(target)).shape == (0, 1)
    still = aliased(("r_m", "t_f"))  # neither moves the pole as far
    assert alias_points(still, coordinates(still)).shape == (0, 2)
    priors = dict(aliased(("k_s", "j_1")).space.priors)
    record = experiment(200, 0.05, measures={"w_1": {"w_1": 1.0}})
    dense = posterior(record, np.array([0.3]), free=("k_s", "j_1"), priors=priors)
    assert len(alias_points(dense, coordinates(dense))) == 0


def test_aliases_that_the_prior_rules_out_are_not_missed(tmp_path: Path) -> None:
    """Of 230 the 96 that are kept hold all, but for a prior to which all are alike."""
    puzzle = collection.chosen(["twenty"])[0]
    target = puzzle.load(tmp_path).job.problem.posterior
    flat = with_priors(target.space, {"k_s": Uniform(1e-3, 1e5)})
    missed = []
    for each in (target, dataclasses.replace(target, space=flat)):
        u = each.coordinates.from_physical(np.array([[68.217]]))[0]
        (starts,) = multiple_modes.alias_starts(LogDensity(each, physical=True), u)
        assert len(starts.u) == multiple_modes.MAX_ALIASES
        missed.append(starts.missed_share)
    assert missed[0] < 1e-3
    assert missed[1] > 0.2


def test_the_window_of_two_bursts_peaks_at_multiples_of_the_inverse_gap() -> None:
    """Against its sum, and two bursts of one sample each, whose window is a cosine."""
    t = np.concatenate([np.arange(20) * 0.05, 7.0 + np.arange(20) * 0.05])
    delta, height = multiple_modes.window_peaks(t, 12.0)
    exact = np.abs(np.exp(1j * delta[:, None] * t).sum(axis=1)) / len(t)
    assert height == pytest.approx(exact, abs=0.03)
    assert delta[1:4] == pytest.approx(2.0 * np.pi / 7.0 * np.arange(2, 5), rel=0.06)
    delta, height = multiple_modes.window_peaks(np.array([0.0, 2.0]), 20.0)
    assert delta == pytest.approx(np.pi * np.arange(1, 7), rel=0.02)
    assert height == pytest.approx(np.ones(6), abs=0.03)


def test_maxima_along_a_line_are_those_with_valleys_between() -> None:
    """Ends among them, and places of no density; ripples are none."""
    x = np.linspace(0.0, 1.0, 401)
    value = 5.0 * np.cos(10.0 * np.pi * x) + 0.45 * np.cos(160 * np.pi * x)
    assert (np.diff(value[:20]) > 0).any()
    value[x > 0.8] = -np.inf
    assert x[multiple_modes.peaks(value, 1.0)] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])
    assert multiple_modes.peaks(np.full(5, -np.inf), 1.0) == []
    assert multiple_modes.peaks(np.zeros(5), 1.0) == [0]


# --- branches of a train that no channel distinguishes ---------------------------------------------

T = 0.01 * np.arange(400)
TORQUE = 0.5 * np.sign(np.sin(3.0 * T)) + 0.3 * np.sin(11.0 * T)
TRUTH = {"j_hub": 0.01, "j_left": 0.005, "j_right": 0.002, "k_a": 1.0, "k_b": 2.0, "c_hub": 0.02}
HELD = {"c_a": 0.0035, "c_b": 0.0035}


def around(value: float) -> dict[str, object]:
    return {"prior": "log_uniform", "low": value / 10, "high": value * 10}


def two_branches(sign: int = 1, **priors: object) -> bd.Case:
    """Two discs on shafts at a hub that a torque turns; measured: sum or difference of their speeds."""
    rig = bd.Train(
        inertias=("hub", "left", "right"),
        shafts={"a": ["hub", "left"], "b": ["hub", "right"]},
        drives={"hub": "torque"},
        added=("c_a", "c_b", "c_hub"),
    )
    values = [(TRUTH | HELD)[name] for name in rig.parameters]
    states = ExactMotion(rig, record_of_states(rig, T, {"t_hub": TORQUE}), values).signals()
    left, right = (states[:, rig.states.index(name)] for name in ("w_left", "w_right"))
    y, both = (left + sign * right).astype(float), f"w_left {'+' if sign > 0 else '-'} w_right"
    noisy = y + 0.05 * np.random.default_rng(1).standard_normal(len(T))
    free = dict(
        zip(("j_left", "j_right", "k_a", "k_b"), map(around, (3e-3, 3e-3, 1.4, 1.4)), strict=True)
    )
    return bd.case(
        T,
        {"speeds": bd.Channel(noisy, "rad/s", 0.05, measures=both)},
        {"t_hub": bd.Input(TORQUE, "N*m")},
        TRUTH | HELD | free | priors,
        rig=rig,
        map={"starts": 1},
        sampler={"ess": 200, "walkers": 32},
    )


def twins_of_the_truth(case: bd.Case) -> list[dict[str, float]]:
    target = case.job.problem.posterior
    u = target.coordinates.from_physical(
        target.space.vector({name: TRUTH[name] for name in target.space.free})[None]
    )[0]
    points = [start.u[0] for start in twin_starts(LogDensity(target, physical=True), u)]
    physical = [target.coordinates.to_physical(point[None])[0] for point in points]
    return [dict(zip(target.space.free, map(float, theta), strict=True)) for theta in physical]


def test_branches_that_nothing_distinguishes_are_exchanged() -> None:
    (twin,) = twins_of_the_truth(two_branches())
    expected = {"j_left": 0.002, "j_right": 0.005, "k_a": 2.0, "k_b": 1.0}
    assert twin == pytest.approx(expected, rel=1e-9)


@run_cases(
    "sign, priors",
    [
        (-1, {}),
        (1, {"k_a": {"prior": "log_normal", "median": 1.0, "sd_log": 0.5}}),
        (1, {"j_left": 0.005}),
    ],
    ["a channel", "a prior", "a number"],
)
def test_branches_that_a_channel_or_a_prior_distinguishes_have_no_twin(
    sign: int, priors: dict[str, object]
) -> None:
    assert twins_of_the_truth(two_branches(sign, **priors)) == []
