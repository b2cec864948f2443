"""Define the contract of an optimiser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.unknowns import Coordinates


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A task is to maximise a log density over physical points, which are unknowns in SI.

    Attributes
    ----------
    names : tuple of str
        The unknowns.
    density : callable
        Maps physical points `(W, D)` to log densities `(W,)`, which are -inf outside the support.
    coordinates : Coordinates
        Maps physical points to the coordinates of the samplers and back.
    covariance : callable
        Maps a physical point `(D,)` to the covariance `(D, D)` of the local Gaussian approximation, in
        `coordinates`.  Its principal axes are sensible first steps of a search.

    Examples
    --------
    >>> import numpy as np
    >>> from bayesdrill.inference.unknowns import Coordinates
    >>> task = Task(
    ...     names=("a",),
    ...     density=lambda theta: -0.5 * theta[:, 0] ** 2,
    ...     coordinates=Coordinates(logs=(False,)),
    ...     covariance=lambda theta: np.eye(1),
    ... )
    >>> task.at(np.array([2.0]))
    -2.0
    """

    names: tuple[str, ...]
    density: Callable[[Array], Array]
    coordinates: Coordinates
    covariance: Callable[[Array], Array]

    def at(self, theta: Array) -> float:
        """Return the log density at one physical point `(D,)`."""
        return float(self.density(theta[None])[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """An optimum is the best point that a search has reached from one start.

    Attributes
    ----------
    theta : array, shape (D,)
        The physical point.
    value : float
        The highest log density of all evaluations.
    evaluations : int
        The number of evaluations.
    settled : bool
        Whether the search met its tolerances before its evaluations ran out.
    """

    theta: Array
    value: float
    evaluations: int
    settled: bool


class Optimiser(Protocol):
    """An optimiser is a frozen dataclass, whose annotated fields are its entries of `map:`.

    It only has to come near a maximum, to which Gauss-Newton then converges.
    """

    def check(self, unknown: Sequence[str]) -> None:
        """Check whether the optimiser can search over these unknowns.

        Parameters
        ----------
        unknown : sequence of str
            The names of the unknowns.

        Raises
        ------
        ValueError
            If it cannot; the message is for the user.
        """

    def __call__(self, task: Task, starts: Array, evaluations: int) -> Sequence[Optimum]:
        """Search for a maximum from each start.

        Parameters
        ----------
        task : Task
            The log density and its unknowns.
        starts : array, shape (S, D)
            Physical points.
        evaluations : int
            The largest number of evaluations for each start.

        Returns
        -------
        sequence of Optimum
            One optimum for each start, which must not depend on the other starts.
        """
