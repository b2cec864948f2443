"""The contract of an optimiser."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The best point found from one start, in the coordinates of the search."""

    z: Array
    value: float
    evaluations: int
    settled: bool


class Optimiser(Protocol):
    def __call__(
        self,
        target: Callable[[Array], Array],
        start: Array,
        scale: Callable[[Array], Array],
        evaluations: int,
    ) -> Optimum:
        """Maximise `target((W, D)) -> (W,)` (-inf outside its support) from `start (D,)`.

        `scale(z)` gives the `(D, D)` covariance that makes unit steps sensible at z;
        `evaluations` is the most it may spend.
        """
        ...
