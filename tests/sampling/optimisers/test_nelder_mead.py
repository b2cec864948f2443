"""Simplices: the points of SciPy's, in any number at once, and cut short only by what they may spend."""

import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize
from support.case_tables import run_cases

from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.sampling.optimisers.contract import Optimum, Task
from bayesdrill.sampling.optimisers.nelder_mead import NelderMead, in_lock_step, nelder_mead


def valley(x: np.ndarray) -> np.ndarray:
    """Rosenbrock's, with unequal scales; its maximum, zero, is at (6, 0.02), off the origin."""
    a, b = x[:, 0] / 3 - 1, x[:, 1] * 50
    return -100 * (b - a**2) ** 2 - (1 - a) ** 2


def search(evaluations: int) -> tuple[Optimum, list[tuple[float, ...]]]:
    """In the valley; and every point that was evaluated, with its value."""
    evaluated: list[tuple[float, ...]] = []

    def density(x: np.ndarray) -> np.ndarray:
        values = valley(x)
        evaluated.extend((*row, value) for row, value in zip(x, values, strict=True))
        return values

    task = Task(
        names=("a", "b"),
        density=density,
        coordinates=Coordinates((False, False)),
        covariance=lambda theta: np.diag([0.3, 0.002]) ** 2,
    )
    start = np.array([-3.0, 0.05])
    (optimum,) = NelderMead(enough=1e-3, per_unknown=math.inf)(task, start[None], evaluations)
    assert start == pytest.approx([-3.0, 0.05])  # untouched
    return optimum, evaluated


def test_the_maximum_of_a_curved_skewed_valley_is_reached() -> None:
    optimum, evaluated = search(8000)
    assert optimum.settled
    assert optimum.theta == pytest.approx([6.0, 0.02], rel=0.02)
    assert optimum.value == pytest.approx(valley(optimum.theta[None])[0])
    assert optimum.evaluations == len(evaluated) <= 8000


def test_a_limit_of_evaluations_only_cuts_a_search_short() -> None:
    """Wherever it is cut: the same points as without a limit, and the best of them."""
    _, whole = search(8000)
    for limit in (*range(1, 60), *range(60, 201, 7), len(whole) - 1, len(whole), len(whole) + 1):
        optimum, evaluated = search(limit)
        assert evaluated == whole[:limit], limit
        assert optimum.evaluations == len(evaluated), limit
        assert optimum.value == max(value for *_, value in evaluated), limit
        assert optimum.value == valley(optimum.theta[None])[0], limit
        assert optimum.settled == (limit > len(whole)), limit


@run_cases("n", [1, 2, 3, 9])
def test_simplices_in_lock_step_evaluate_the_points_of_scipy(n: int) -> None:
    """Hills with ripples, some of them with a wall; the last evaluation may be within a step."""
    rng = np.random.default_rng(n)
    starts = rng.normal(0, 3, (12, n))
    simplices = [
        start + np.vstack([np.zeros(n), np.eye(n) * rng.uniform(0.1, 2)]) for start in starts
    ]
    limits = rng.integers(1, 100 * n, 12).tolist()
    evaluated: list[list[np.ndarray]] = [[] for _ in simplices]

    def hill(k: int, x: np.ndarray) -> float:
        evaluated[k].append(x.copy())
        if k % 4 == 0 and x[0] < -2:
            return np.inf
        return float(((x - 1) ** 2 * np.arange(1, n + 1)).sum() + np.sin(k * x).sum())

    options = {"xatol": 1e-2, "fatol": 0.1, "adaptive": n > 2}
    with np.errstate(invalid="ignore"):
        ends = [
            minimize(
                partial(hill, k),
                simplex[0],
                method="Nelder-Mead",
                options={**options, "initial_simplex": simplex, "maxfev": limits[k]},
            )
            for k, simplex in enumerate(simplices)
        ]
    expected, evaluated = evaluated, [[] for _ in simplices]
    # Each point has a first number that says whose it is.
    searches = [
        nelder_mead(simplex, limits[k], 1e-2, 0.1, partial(np.append, k))
        for k, simplex in enumerate(simplices)
    ]
    runs = in_lock_step(searches, lambda x: np.array([hill(int(row[0]), row[1:]) for row in x]))
    for own, of_scipy in zip(evaluated, expected, strict=True):
        assert np.array_equal(own, of_scipy)
    assert [run.stopped for run in runs] == [end.status == 0 for end in ends]
