"""fminsearch against what MATLAB documents, and the heuristic that searches pairs of unknowns."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from support.case_tables import run_cases

from bayesdrill.inference import Coordinates
from bayesdrill.sampling import Task
from studies.paper.optimisers import ORDER, Pairwise, TracedOptimum, circle, fminsearch

Array = NDArray[np.float64]


def task(names: str, density: Callable[[Array], Array]) -> Task:
    """A task for unknowns of one letter each."""
    return Task(
        names=tuple(names),
        density=density,
        coordinates=Coordinates((False,) * len(names)),
        covariance=lambda theta: np.eye(len(names)),
    )


def valley(x: Array) -> Array:
    """Rosenbrock's, with unequal scales; its maximum, zero, is at (6, 0.02)."""
    a, b = x[:, 0] / 3 - 1, x[:, 1] * 50
    return np.asarray(-100 * (b - a**2) ** 2 - (1 - a) ** 2)


WAYS = {
    "fminsearch": fminsearch,
    "pairwise": Pairwise(pairs=[["b", "a"], ["a", "b"]], steady=1e-6),
}


def searched(way: str, evaluations: int) -> tuple[TracedOptimum, list[tuple[float, ...]]]:
    """In the valley; and every point that was asked for, with its value."""
    asked: list[tuple[float, ...]] = []

    def density(x: Array) -> Array:
        values = valley(x)
        asked.append((*map(float, x[0]), float(values[0])))
        return values

    (found,) = WAYS[way](task("ab", density), np.array([[-3.0, 0.05]]), evaluations)
    return found, asked


@run_cases("way", WAYS)
def test_a_search_finds_the_maximum_and_what_it_may_spend_only_cuts_it_short(way: str) -> None:
    whole, asked = searched(way, 8000)
    assert whole.theta == pytest.approx([6.0, 0.02], rel=0.02)
    assert whole.history[-1] == pytest.approx(whole.value)
    for most in (*range(1, 101), len(asked) - 1, len(asked), len(asked) + 1):
        found, made = searched(way, most)
        assert made == asked[:most], most
        assert found.evaluations == len(made), most
        assert found.value == max(value for *_, value in made), most
        assert found.value == valley(found.theta[None])[0], most
        assert found.settled == (most > len(asked)), most
        assert found.history[:-1] == whole.history[: max(len(found.history) - 1, 0)], most
        assert list(found.history) == sorted(found.history), most


def test_fminsearch_stops_at_tolerances_that_are_absolute() -> None:
    """The same hill in other units: of an unknown of 1e-4 it finds no digit.  MATLAB's defaults."""

    def hill(x: Array, unit: float) -> Array:
        return -1e-4 * (x[:, 0] / unit - 3.0) ** 2

    (fine,) = fminsearch(task("a", lambda x: hill(x, 1.0)), np.array([[2.0]]), 8000)
    (coarse,) = fminsearch(task("a", lambda x: hill(x, 1e-4)), np.array([[2e-4]]), 8000)
    assert fine.theta[0] == pytest.approx(3.0, rel=1e-3)
    assert abs(coarse.theta[0] / 3e-4 - 1) > 0.05
    assert coarse.settled


@run_cases("n", [1, 2, 4])
def test_fminsearch_gives_up_where_matlab_documents_it(n: int) -> None:
    """On a slope without end: MaxFunEvals and MaxIter are 200 times the number of unknowns."""
    endless = task("abcd"[:n], lambda theta: np.asarray(theta.sum(axis=-1)))
    (found,) = fminsearch(endless, np.ones((1, n)), 100_000)
    assert not found.settled
    assert max(found.evaluations, len(found.history)) == 200 * n
    assert fminsearch(endless, np.ones((1, n)), 50)[0].evaluations == 50


def test_pairs_are_the_papers_for_its_nine_and_a_circle_for_fewer() -> None:
    printed = "t_f j_m, j_m c_m, c_m k_e, k_e k_T, k_T r_m, r_m l_m, l_m k_s, k_s j_1, j_1 t_f"
    assert circle(ORDER) == tuple(tuple(pair.split()) for pair in printed.split(", "))
    assert circle(("k_s", "own", "c_m")) == (("c_m", "k_s"), ("k_s", "own"), ("own", "c_m"))
    assert circle(("k_e", "c_m")) == (("c_m", "k_e"),)


def test_pairwise_moves_two_unknowns_at_a_time_in_the_order_given() -> None:
    seen: list[Array] = []

    def bowl(x: Array) -> Array:
        seen.append(x[0].copy())
        return np.asarray(-((x - np.array([1.0, 2.0, 3.0])) ** 2).sum(axis=1))

    start = np.array([2.0, 3.0, 4.0])
    pairs = [["c", "a"], ["b", "c"]]
    (found,) = Pairwise(pairs, iterations=5, steady=1e-8)(task("abc", bowl), start[None], 8000)
    assert found.settled
    assert found.theta == pytest.approx([1.0, 2.0, 3.0], abs=0.03)
    first = next(k for k, x in enumerate(seen) if x[1] != start[1])
    assert all(x[1] == start[1] for x in seen[:first])  # the first pair has no b
    assert first >= 5
    held = seen[first][0]
    again = next(k for k, x in enumerate(seen) if k > first and x[0] != held)
    assert all(x[0] == held for x in seen[first:again])  # the second has no a
    assert list(found.history) == sorted(found.history)
    (once,) = Pairwise(pairs, iterations=5, steady=1e8)(task("abc", bowl), start[None], 8000)
    assert once.settled
    assert len(once.history) == 2 * (5 - 1)  # to set up the simplex counts as one
