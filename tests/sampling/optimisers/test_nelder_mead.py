"""Simplices: the points of SciPy's, in any number at once, and cut short only by what they may spend."""

from functools import partial

import numpy as np
from scipy.optimize import minimize
from support.case_tables import run_cases

from bayesdrill.sampling.optimisers.nelder_mead import in_lock_step, nelder_mead


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
    assert [run.is_converged for run in runs] == [end.status == 0 for end in ends]
