"""The contract of an optimiser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.unknowns import Coordinates


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A density over the physical unknowns `names` that is to be maximised.

    `density((W, D)) -> (W,)`, -inf outside its support.  `covariance(theta (D,)) -> (D, D)` in
    `coordinates`: what makes steps of one in its principal directions sensible there.
    """

    names: tuple[str, ...]
    density: Callable[[Array], Array]
    coordinates: Coordinates
    covariance: Callable[[Array], Array]

    def at(self, theta: Array) -> float:
        """Return the log density at one point `(D,)`."""
        return float(self.density(theta[None])[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The best point reached from one start, physical: `theta (D,)`.

    `value`: the highest seen; `evaluations`: all that were made.  `settled`: the search stopped by
    itself, before its evaluations ran out.
    """

    theta: Array
    value: float
    evaluations: int
    settled: bool


class Optimiser(Protocol):
    """A frozen dataclass whose annotated fields are its entries of `map:`.

    It has to come near a maximum, no more: Gauss-Newton goes the rest of the way.
    """

    def check(self, unknown: Sequence[str]) -> None:
        """Check that it can search these unknowns; raises `ValueError` otherwise."""

    def __call__(self, task: Task, starts: Array, evaluations: int) -> Sequence[Optimum]:
        """Search from each of the physical `starts (S, D)`, with `evaluations` at most for each.

        What is found from one start does not depend on the others.
        """
