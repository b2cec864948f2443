"""Every optimiser comes near the maximum, counts its evaluations, and returns the best point of them.

Steps with derivatives go the rest of the way, so it need not come nearer.
"""

from collections.abc import Callable

import numpy as np
from support.case_tables import run_cases

from bayesdrill.basics.entries import build_member, entries_of
from bayesdrill.config.schema.config import MapSpec
from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Optimum, Task

TOP, SD = np.array([6.0, 0.02]), np.array([0.5, 0.003])  # unequal, off the origin
START = np.array([3.5, 0.035])


def hill(x: np.ndarray) -> np.ndarray:
    """Skewed, and nothing below zero."""
    a, b = ((x - TOP) / SD).T
    value = -0.5 * (a**2 + (b - 0.3 * a) ** 2)
    return np.where((x > 0).all(axis=1), value, -np.inf)


def task_of(density: Callable[[np.ndarray], np.ndarray]) -> Task:
    return Task(
        names=("a", "b"),
        density=density,
        coordinates=Coordinates((True, False)),
        covariance=lambda theta: np.diag([0.1, 0.003]) ** 2,
    )


def search(name: str, evaluations: int) -> tuple[Optimum, list[float]]:
    """Return where one search ends, and all values that it has seen."""
    seen: list[float] = []

    def density(x: np.ndarray) -> np.ndarray:
        values = hill(x)
        seen.extend(map(float, values))
        return values

    start = START.copy()
    (optimum,) = OPTIMISERS[name]()(task_of(density), start[None], evaluations)
    assert np.array_equal(start, START)  # untouched
    return optimum, seen


@run_cases("name", OPTIMISERS)
def test_it_comes_near_the_top(name: str) -> None:
    optimum, seen = search(name, 4000)
    assert optimum.settled
    assert optimum.value == max(seen) == hill(optimum.theta[None])[0]
    assert optimum.value > -1.0


@run_cases("name", OPTIMISERS)
@run_cases("most", [1, 3, 7, 30])
def test_it_spends_no_more_evaluations_than_it_may(name: str, most: int) -> None:
    optimum, seen = search(name, most)
    assert optimum.evaluations == len(seen) <= most
    assert optimum.value == max(seen)
    assert not optimum.settled


@run_cases("name", OPTIMISERS)
def test_a_start_ends_in_the_same_place_alone_and_beside_others(name: str) -> None:
    starts = START * np.array([[1.0, 1.0], [0.7, 1.3], [1.2, 0.9]])
    task, optimiser = task_of(hill), OPTIMISERS[name]()
    for start, optimum in zip(starts, optimiser(task, starts, 4000), strict=True):
        (alone,) = optimiser(task, start[None], 4000)
        assert np.array_equal(optimum.theta, alone.theta)
        assert optimum.evaluations == alone.evaluations


@run_cases("name", OPTIMISERS)
def test_a_config_gives_it_its_entries(name: str) -> None:
    kind = OPTIMISERS[name]
    assert {*entries_of(kind)} <= {*MapSpec.model_fields}
    assert build_member(kind, MapSpec(method=name)) == kind()
    kind().check(("a", "b"))
