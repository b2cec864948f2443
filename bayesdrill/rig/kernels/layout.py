"""What the kernels are specialised for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Entries = Callable[[Sequence[Any]], Sequence[tuple[int, int, Any]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """One rig in one experiment.

    `entries(parameters)`: (row, column, value) of the augmented N x N matrix, whose columns are
    X states, one constant input, `n_series` sampled inputs and, with a first-order hold, their
    increments; a place may come more than once.  `dt`: the sampling step.  `lead`: from the start
    `x0 (X,)` to the first sample, with constant inputs.  `channels`: weights `(K, X)`.
    """

    n_parameters: int
    n_states: int
    n_series: int
    first_order: bool
    entries: Entries
    dt: float
    lead: float
    x0: tuple[float, ...]
    channels: tuple[tuple[float, ...], ...]

    @property
    def size(self) -> int:
        return self.n_states + 1 + self.n_series * (2 if self.first_order else 1)

    @property
    def reach(self) -> tuple[tuple[bool, ...], ...]:
        """Entries of the exponential that can differ from zero."""
        return reach_of(self._pattern)

    @property
    def idle(self) -> tuple[bool, ...]:
        """Columns of zeros: on that nothing depends, and its own entry of the exponential is one."""
        return tuple(not column for column in self._pattern.any(axis=0))

    @property
    def _pattern(self) -> NDArray[np.bool_]:
        pattern = np.zeros((self.size, self.size), dtype=bool)
        for row, column, _ in self.entries([1.0] * self.n_parameters):
            pattern[row, column] = True
        return pattern


def reach_of(pattern: NDArray[np.bool_]) -> tuple[tuple[bool, ...], ...]:
    """Entries of exp(M) that can differ from zero, for M with the `pattern (N, N)`."""
    reach = pattern | np.eye(len(pattern), dtype=bool)
    for _ in range(len(pattern)):
        reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
    return tuple(tuple(bool(entry) for entry in row) for row in reach)
