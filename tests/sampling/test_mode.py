"""The Gaussian approximation and the search for the MAP, on a problem with a known answer."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import noisy_step, posterior, replace_only, vector, with_start

from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import TAIL_MASS
from bayesdrill.inference.priors import HalfNormal, LogNormal, Uniform
from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.sampling import mode_search
from bayesdrill.sampling.optimisers.contract import Optimum, Task
from bayesdrill.sampling.optimisers.nelder_mead import NelderMead, in_lock_step, nelder_mead

CONFIGS = Path(__file__).parents[2] / "configs"
SIGMA = np.array([0.02, 0.03, 0.05, 0.04])
RECORD = noisy_step(SIGMA, n=200)
TWO = ("k_e", "k_s")


def test_undetermined_directions_have_the_width_of_the_prior() -> None:
    target = posterior(RECORD, 10 * SIGMA)
    cov = laplace.covariance(target, vector(NOMINAL))
    assert np.sqrt(cov[1, 1]) == pytest.approx(0.31, abs=0.02)  # log of uniform 0.5 to 1.5
    assert np.linalg.eigvalsh(cov).min() > 0


def valley(x: np.ndarray) -> np.ndarray:
    """Rosenbrock's, with unequal scales; its maximum, zero, is at (6, 0.02), off the origin."""
    a, b = x[:, 0] / 3 - 1, x[:, 1] * 50
    return -100 * (b - a**2) ** 2 - (1 - a) ** 2


def task(names: tuple[str, ...], density: Callable[[np.ndarray], np.ndarray]) -> Task:
    return Task(
        names=names,
        density=density,
        coordinates=Coordinates((False,) * len(names)),
        covariance=lambda theta: np.diag([0.3, 0.002, 0.01][: len(theta)]) ** 2,
    )


# Goes to the very maximum without any slopes.
THOROUGH = NelderMead(enough=1e-3, per_unknown=math.inf)


def searched(evaluations: int) -> tuple[Optimum, list[tuple[float, ...]]]:
    """In the valley; and every point that was asked for, with its value."""
    asked: list[tuple[float, ...]] = []

    def density(x: np.ndarray) -> np.ndarray:
        values = valley(x)
        asked.extend((*map(float, row), float(value)) for row, value in zip(x, values, strict=True))
        return values

    start = np.array([-3.0, 0.05])
    (found,) = THOROUGH(task(("a", "b"), density), start[None], evaluations)
    assert start == pytest.approx([-3.0, 0.05])  # untouched
    return found, asked


def test_a_simplex_finds_a_curved_skewed_maximum() -> None:
    found, asked = searched(8000)
    assert found.settled
    assert found.theta == pytest.approx([6.0, 0.02], rel=0.02)
    assert found.value == pytest.approx(valley(found.theta[None])[0])
    assert found.evaluations == len(asked) <= 8000


def test_what_a_search_may_spend_only_cuts_it_short() -> None:
    """Wherever it is cut: the same points as without a limit, and the best of them.

    Mutants killed: settled because nothing was gained before the end; a limit of each descent, not
    of all; a start that is not counted; the best point lost with the iteration that was cut.
    """
    _, asked = searched(8000)
    for most in (*range(1, 201), len(asked) - 1, len(asked), len(asked) + 1):
        found, made = searched(most)
        assert made == asked[:most], most
        assert found.evaluations == len(made), most
        assert found.value == max(value for *_, value in made), most
        assert found.value == valley(found.theta[None])[0], most
        assert found.settled == (most > len(asked)), most


def test_simplices_in_lock_step_ask_for_the_points_of_scipy() -> None:
    """Hills with ripples, some of them with a wall; also where the last evaluation is in the middle.

    Mutants killed: a point inside taken for one outside, a shrunken simplex about its worst point,
    values of one search given to another.
    """
    rng = np.random.default_rng(0)
    asked: list[list[np.ndarray]] = []

    def hill(k: int, x: np.ndarray) -> float:
        asked[k].append(x.copy())
        walled = k % 4 == 0 and x[0] < -2
        return (
            np.inf
            if walled
            else float(((x - 1) ** 2 * np.arange(1, n + 1)).sum() + np.sin(k * x).sum())
        )

    for n in (1, 2, 3, 9):
        simplices = [
            rng.normal(0, 3, n) + np.vstack([np.zeros(n), np.eye(n) * rng.uniform(0.1, 2)])
            for _ in range(12)
        ]
        most = rng.integers(1, 100 * n, 12)
        asked[:] = [[] for _ in simplices]
        with np.errstate(invalid="ignore"):
            ends = [
                minimize(
                    partial(hill, k),
                    simplex[0],
                    method="Nelder-Mead",
                    options={
                        "initial_simplex": simplex,
                        "maxfev": most[k],
                        "xatol": 1e-2,
                        "fatol": 0.1,
                        "adaptive": n > 2,
                    },
                )
                for k, simplex in enumerate(simplices)
            ]
        expected, asked[:] = [*asked], [[] for _ in simplices]
        searches = [
            nelder_mead(simplex, int(most[k]), 1e-2, 0.1, partial(_numbered, k))
            for k, simplex in enumerate(simplices)
        ]
        runs = in_lock_step(searches, lambda x: np.array([hill(int(row[0]), row[1:]) for row in x]))
        for own, others in zip(asked, expected, strict=True):
            assert np.array_equal(own, others)
        assert [run.stopped for run in runs] == [end.status == 0 for end in ends]


def _numbered(k: int, x: np.ndarray) -> np.ndarray:
    """A point with a first number that says whose it is."""
    return np.append(k, x)


def test_searches_agree_where_the_record_determines_everything() -> None:
    target = posterior(RECORD, SIGMA, free=TWO)
    points = mode_search.starts(target, 4, np.random.default_rng(9))
    found = mode_search.summarise(
        target, tuple(mode_search.search(target, THOROUGH, 4000, point) for point in points)
    )
    assert len(found.highest) >= 2
    assert found.wandering == ()
    assert found.gain < 1e-6
    assert found.at_bound == ()
    assert found.others == ()
    assert found.values["k_e"] == pytest.approx(NOMINAL["k_e"], rel=2e-3)
    assert max(abs(s) for s in found.slope.values()) < 1e-3


def test_nine_parameters_wander_along_the_symmetries_and_that_is_said() -> None:
    target = posterior(RECORD, SIGMA)
    points = mode_search.starts(target, 4, np.random.default_rng(2))
    found = mode_search.summarise(
        target, tuple(mode_search.search(target, THOROUGH, 8000, point) for point in points)
    )
    assert found.log_posterior >= target.density(vector(NOMINAL)[None])[0]
    assert found.gain < 1e-6
    assert len(found.highest) >= 2
    assert len(found.wandering) >= 3


def test_searches_that_end_in_another_maximum_do_not_wander() -> None:
    """Mutant killed: a second maximum, as high as the first, taken for a flat posterior."""

    def search(k_e: float, k_s: float) -> mode_search.Search:
        end = {"k_e": k_e, "k_s": k_s}
        return mode_search.Search(
            start=end, end=end, log_posterior=5.0, evaluations=1, settled=True
        )

    here, there, astray = search(0.06, 0.26), search(0.08, 0.26), search(0.06, 0.3)
    one = mode_search.Mode(
        values=here.end, log_posterior=5.0, slope={}, gain=0.0, at_bound=(), searches=(here, there)
    )  # fmt: skip
    assert one.wandering == ("k_e",)
    two = dataclasses.replace(
        one, others=(mode_search.LocalMaximum(values=there.end, log_posterior=5.0),)
    )
    assert two.wandering == ()
    assert [top.values["k_e"] for top in two.maxima] == [0.06, 0.08]
    three = dataclasses.replace(two, searches=(here, there, astray))
    assert three.wandering == ("k_s",)
    assert len(three.highest) == 3


def test_starts_begin_with_the_configured_one() -> None:
    target = posterior(RECORD, SIGMA, free=TWO)
    target = with_start(target, {"k_e": 0.05, "k_s": 0.3})
    points = mode_search.starts(target, 3, np.random.default_rng(1))
    assert points[0] == pytest.approx([0.05, 0.3])
    assert np.isfinite(target.density(points)).all()


def test_gradient_at_a_slope_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the way to the maximum was cut short the report says so."""
    target = posterior(RECORD, SIGMA, free=TWO)
    off = target.space.vector({**NOMINAL, "k_e": NOMINAL["k_e"] * 1.01})
    search = mode_search.search(target, THOROUGH, 1, off)
    start = {name: float(x) for name, x in zip(target.space.free, off, strict=True)}
    stuck = dataclasses.replace(search, end=start, log_posterior=target.density(off[None])[0])
    assert mode_search.summarise(target, (stuck,)).gain < 1e-6
    monkeypatch.setattr(mode_search, "POLISH_STEPS", 0)
    found = mode_search.summarise(target, (stuck,))
    assert found.values == pytest.approx(start)
    assert found.gain > 1.0
    assert abs(found.slope["k_e"]) > 1.0


def test_a_search_cut_short_is_polished_to_the_very_maximum() -> None:
    """Mutant killed: no steps of Gauss and Newton after the simplex."""
    target = posterior(RECORD, SIGMA, free=TWO)
    start = target.space.vector({**NOMINAL, "k_e": NOMINAL["k_e"] * 1.02})
    (rough,) = THOROUGH(mode_search.task(target), start[None], 6)
    fine = mode_search.search(target, THOROUGH, 6, start)
    top = mode_search.search(target, THOROUGH, 4000, target.space.vector(NOMINAL))
    assert rough.value < top.log_posterior - 1.0
    assert not rough.settled
    assert fine.settled
    assert fine.log_posterior == pytest.approx(top.log_posterior, abs=1e-7)
    assert fine.end == pytest.approx(top.end, rel=1e-5)
    assert rough.evaluations == fine.evaluations == 6


def test_a_log_normal_has_no_bound_to_be_at() -> None:
    """A record that draws the MAP into its last thousandth.  Mutant killed: zero taken for an end."""
    prior = LogNormal(15.0 * NOMINAL["k_s"], 0.5)
    target = posterior(RECORD, SIGMA, free=TWO, priors={"k_s": prior})
    start = target.space.vector(NOMINAL)
    found = mode_search.summarise(target, (mode_search.search(target, THOROUGH, 4000, start),))
    assert found.values["k_s"] < prior.quantile(np.array(1e-3))
    assert found.at_bound == ()


def test_a_maximum_on_the_bound_is_named() -> None:
    """A prior that ends before the best k_s: the maximum is there, and inside of it no slope is left.

    Mutant killed: a maximum at the end of a prior called a slope.
    """
    end = 0.9 * NOMINAL["k_s"]
    target = posterior(RECORD, SIGMA, free=TWO, priors={"k_s": Uniform(0.1, end)})
    start = target.space.vector({**NOMINAL, "k_s": 0.2})
    found = mode_search.summarise(target, (mode_search.search(target, THOROUGH, 4000, start),))
    assert found.at_bound == ("k_s",)
    assert 1 - 1e-6 < found.values["k_s"] / end <= 1
    assert found.slope["k_s"] == 0.0
    assert abs(found.slope["k_e"]) < 1e-2
    assert found.gain < 1e-4


@run_cases("logs", [True, None], ["log", "linear"])
def test_a_search_for_a_zero_ends_where_its_prior_does(logs: bool | None) -> None:
    """The record is of a rig with negative damping, so the less c_m the better, down to nothing."""
    prior = HalfNormal(2 * NOMINAL["c_m"])
    rig = posterior(RECORD, SIGMA, free=("c_m", "k_s"), priors={"c_m": prior}, logs=logs)
    assert rig.coordinates.logs == (bool(logs), True)
    y = rig.likelihood.signals(np.array([[-2e-3, NOMINAL["k_s"]]]))[0]
    likelihood = replace_only(
        rig.likelihood, response=rig.likelihood.only_observation.response.with_record(y)
    )
    target = dataclasses.replace(rig, likelihood=likelihood)
    start = target.space.vector(NOMINAL)
    found = mode_search.search(target, THOROUGH, 4000, start)
    least = float(prior.quantile(np.array(TAIL_MASS)))
    assert least <= found.end["c_m"] < 1e-3 * NOMINAL["c_m"]
    assert found.settled
    best = mode_search.summarise(target, (found,))
    assert best.at_bound == ("c_m",)
    assert np.isfinite(best.gain)
