"""Frequencies that the samples of a record cannot tell apart, and the unknowns that have them."""

from __future__ import annotations

import dataclasses
import warnings
from functools import cache

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, matrices
from support.small_problems import experiment, posterior, vector, with_priors

import bayesdrill as bd
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.sampling import multiple_modes

DT = 1.0  # s, about half of a swing


def rig(**changed: float) -> dict[str, float]:
    return {**NOMINAL, **changed}


def swing(p: dict[str, float]) -> float:
    """Angular frequency of the torsion, from the equations of motion."""
    return float(np.abs(np.linalg.eigvals(matrices(p)[0]).imag).max())


def stiffness(omega: float) -> float:
    """That makes the nominal rig swing so fast."""
    low, high = 0.01, 10.0
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if swing(rig(k_s=middle)) < omega else (low, middle)
    return float(low)


@cache
def rotor() -> Response:
    """Its speed alone, twelve samples at 1 Hz."""
    return Response(MotorShaft(), experiment(12, DT, measures={"w_1": {"w_1": 1.0}}))


def aliased(free: tuple[str, ...], k_s: float, sigma: float = 0.3) -> Posterior:
    """From a rig of this stiffness; every unknown in a uniform box."""
    clean = rotor().signals(vector(rig(k_s=k_s))[None])[0]
    noise = sigma * np.random.default_rng(2).standard_normal(clean.shape)
    known = rotor().with_record(clean + noise)
    boxes = {name: Uniform(0.5 * NOMINAL[name], 1.6 * NOMINAL[name]) for name in free}
    sigmas = np.array([sigma])
    return posterior(known.experiment, sigmas, free=free, priors=boxes, response=known)


def at(target: Posterior, k_s: float) -> np.ndarray:
    theta = target.space.vector({**NOMINAL, "k_s": k_s})
    return target.coordinates.from_physical(theta[None])[0]


def swings(target: Posterior, u: np.ndarray) -> np.ndarray:
    found = multiple_modes.alias_starts(LogDensity(target, physical=True), u)
    return np.concatenate([starts.u for starts in found])


def test_frequencies_are_those_of_the_equations_of_motion() -> None:
    target = aliased(("k_s", "j_1"), 0.26)
    u = np.stack([at(target, k_s) for k_s in (0.15, 0.26, 0.4)])
    found = multiple_modes.frequencies(target, u)
    assert found[:, 0] == pytest.approx([swing(rig(k_s=k)) for k in (0.15, 0.26, 0.4)], rel=1e-9)
    assert np.array_equal(found[:, 1], np.zeros(3))  # all other poles decay without a swing


@run_cases(
    "free, nominal",
    [
        (free, nominal)
        for free in [("k_s",), ("k_s", "j_1"), ("k_s", "j_1", "t_f")]
        for nominal in [True, False]
    ],
)
def test_the_other_stiffness_of_a_torsion_near_half_the_sampling_rate(
    free: tuple[str, ...], nominal: bool
) -> None:
    """From either one the other is found, and a search from there ends where SciPy's poles say.

    Mutant killed: more swings between two samples, but no fewer.
    """
    true = 0.26
    other = stiffness(2.0 * np.pi / DT - swing(rig(k_s=true)))
    one, another = (true, other) if nominal else (other, true)
    target = aliased(free, one)
    found = swings(target, at(target, one))
    theta = target.coordinates.to_physical(found)
    names = target.space.free
    speeds = [swing(rig(**dict(zip(names, row, strict=True)))) for row in theta]
    wanted = swing(rig(k_s=another))
    assert min(abs(speed - wanted) for speed in speeds) < 1.0 / 11.0  # a radian over the record
    assert LogDensity(target).inside(found).all()
    surface = LogDensity(target, physical=True)
    points, values = multiple_modes.best_ends(surface, np.vstack([at(target, one), found]))
    ends = target.coordinates.to_physical(
        points[multiple_modes.distinct_modes(surface, points, values)]
    )
    named = [rig(**dict(zip(names, row, strict=True))) for row in ends]
    ratios = sorted(p["k_s"] / p["j_1"] for p in named)
    assert ratios == pytest.approx([k / NOMINAL["j_1"] for k in sorted((true, other))], rel=0.05)


def test_an_alias_outside_the_priors_is_not_looked_for() -> None:
    """Nor one of a rig that does not swing."""
    target = aliased(("k_s",), 0.26)
    narrow = dataclasses.replace(
        target, space=with_priors(target.space, {"k_s": Uniform(0.25, 0.27)})
    )
    assert swings(narrow, at(narrow, 0.26)).shape == (0, 1)
    still = aliased(("r_m", "t_f"), 0.26)
    u = still.coordinates.from_physical(still.space.vector(NOMINAL)[None])[0]
    assert swings(still, u).shape == (0, 2)  # neither moves the pole as far


def test_with_many_samples_in_a_swing_the_others_are_out_of_reach() -> None:
    target = aliased(("k_s", "j_1"), 0.26)
    fine = experiment(200, 0.05, measures={"w_1": {"w_1": 1.0}})
    priors = dict(target.space.priors)
    dense = posterior(fine, np.array([0.3]), free=("k_s", "j_1"), priors=priors)
    assert len(swings(dense, at(dense, 0.26))) == 0


def test_a_way_through_points_at_which_nothing_swings_warns_of_nothing() -> None:
    """A pendulum of springs that is damped aperiodically there has no frequency to go on from."""
    t, ways = np.arange(200) * 0.05, 0
    priors = {
        "j_load": {"prior": "log_uniform", "low": 1e-3, "high": 1e3},
        "k_spring": {"prior": "log_uniform", "low": 1e-3, "high": 1e4},
        "c_load": {"prior": "log_uniform", "low": 1e-4, "high": 1e3},
    }
    swung = bd.Channel(np.exp(-0.3 * t) * np.cos(7.0 * t), "rad", sigma=0.01)
    rig = bd.Train(inertias=("load",), shafts={"spring": ("load", "ground")}, added=("c_load",))
    case = bd.case(t, {"theta_load": swung}, {}, priors, rig=rig, initial={"theta_load": 1.0})
    target = case.job.problem.posterior
    surface = LogDensity(target)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for theta in target.space.draw(40, np.random.default_rng(5)):
            u = target.coordinates.from_physical(theta[None])[0]
            ways += sum(len(starts.u) for starts in multiple_modes.alias_starts(surface, u))
    assert ways > 0


def test_the_window_of_two_bursts_peaks_at_swings_over_the_gap() -> None:
    """Against its sum, and two bursts of one sample each, whose window is a cosine.

    Mutant killed: the step between samples instead of the gap.
    """
    t = np.concatenate([np.arange(20) * 0.05, 7.0 + np.arange(20) * 0.05])
    delta, height = multiple_modes.window_peaks(t, 12.0)
    exact = np.abs(np.exp(1j * delta[:, None] * t).sum(axis=1)) / len(t)
    assert height == pytest.approx(exact, abs=0.03)
    assert delta[1:4] == pytest.approx(2.0 * np.pi / 7.0 * np.arange(2, 5), rel=0.06)
    delta, height = multiple_modes.window_peaks(np.array([0.0, 2.0]), 20.0)
    assert delta == pytest.approx(np.pi * np.arange(1, 7), rel=0.02)
    assert height == pytest.approx(np.ones(6), abs=0.03)


def test_maxima_along_a_line_are_those_with_valleys_between() -> None:
    """Ends among them, and places of no density; ripples of slopes, too, that go down now and then.

    Mutant killed: every ripple is one.
    """
    x = np.linspace(0.0, 1.0, 401)
    value = 5.0 * np.cos(10.0 * np.pi * x) + 0.45 * np.cos(160 * np.pi * x)
    assert (np.diff(value[:20]) > 0).any()
    value[x > 0.8] = -np.inf
    assert x[multiple_modes.peaks(value, 1.0)] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])
    assert multiple_modes.peaks(np.full(5, -np.inf), 1.0) == []
    assert multiple_modes.peaks(np.zeros(5), 1.0) == [0]
