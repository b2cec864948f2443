"""What holds of every optimiser: it climbs, counts what it spends, and gives the best it has seen.

Slopes go the rest of the way: so it has to come near, no more.
"""

from __future__ import annotations

import numpy as np
from support.case_tables import run_cases

from bayesdrill.basics.entries import build_member, entries_of
from bayesdrill.config.schema.config import MapSpec
from bayesdrill.inference.unknowns import Coordinates
from bayesdrill.sampling.optimisers import OPTIMISERS
from bayesdrill.sampling.optimisers.contract import Task

TOP, SD = np.array([6.0, 0.02]), np.array([0.5, 0.003])  # unequal, off the origin
START = np.array([3.5, 0.035])


def hill(x: np.ndarray) -> np.ndarray:
    """Skewed, and nothing below zero."""
    a, b = ((x - TOP) / SD).T
    value = -0.5 * (a**2 + (b - 0.3 * a) ** 2)
    return np.where((x > 0).all(axis=1), value, -np.inf)


def searched(name: str, evaluations: int) -> tuple[object, list[float]]:
    seen: list[float] = []

    def density(x: np.ndarray) -> np.ndarray:
        values = hill(x)
        seen.extend(map(float, values))
        return values

    task = Task(
        names=("a", "b"),
        density=density,
        coordinates=Coordinates((True, False)),
        covariance=lambda theta: np.diag([0.1, 0.003]) ** 2,
    )
    start = START.copy()
    (found,) = OPTIMISERS[name]()(task, start[None], evaluations)
    assert np.array_equal(start, START)  # untouched
    return found, seen


@run_cases("name", OPTIMISERS)
def test_it_comes_near_the_top(name: str) -> None:
    found, seen = searched(name, 4000)
    assert found.settled
    assert found.value == max(seen) == hill(found.theta[None])[0]
    assert found.value > -1.0


@run_cases("name", OPTIMISERS)
@run_cases("most", [1, 7, 30])
def test_what_it_may_spend_is_all_it_spends(name: str, most: int) -> None:
    found, seen = searched(name, most)
    assert found.evaluations == len(seen) <= most
    assert found.value == max(seen)
    assert not found.settled


@run_cases("name", OPTIMISERS)
def test_a_start_finds_the_same_alone_and_beside_others(name: str) -> None:
    """Mutant killed: what one search asked for handed to another."""
    task = Task(
        names=("a", "b"),
        density=hill,
        coordinates=Coordinates((True, False)),
        covariance=lambda theta: np.diag([0.1, 0.003]) ** 2,
    )
    starts = START * np.array([[1.0, 1.0], [0.7, 1.3], [1.2, 0.9]])
    beside = OPTIMISERS[name]()(task, starts, 4000)
    for start, found in zip(starts, beside, strict=True):
        (alone,) = OPTIMISERS[name]()(task, start[None], 4000)
        assert np.array_equal(found.theta, alone.theta)
        assert found.evaluations == alone.evaluations


@run_cases("name", OPTIMISERS)
def test_a_config_gives_it_its_entries(name: str) -> None:
    kind = OPTIMISERS[name]
    assert {*entries_of(kind)} <= {*MapSpec.model_fields}
    assert build_member(kind, MapSpec(method=name)) == kind()
    kind().check(("a", "b"))
