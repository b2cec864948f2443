"""The contract of a model: linear dynamics with named states, inputs and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.formulas import Monomial

Array = NDArray[np.float64]
Named = Mapping[str, Array | float]

NO_RELATIONS: Mapping[str, Monomial] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Linear:
    """`x' = A x + B u + c`, as the entries that are not zero.

    `A` maps (row state, column state), `B` (row state, input) and `c` (row state) to values of
    any one batch shape, or to plain numbers.  The keys are the structure: kernels skip the rest.
    """

    A: Mapping[tuple[str, str], Array | float]
    B: Mapping[tuple[str, str], Array | float]
    c: Mapping[str, Array | float]


def dynamics(linear: Linear, states: tuple[str, ...], n: int) -> Array:
    """`A (n, X, X)` in the order of `states`, for `linear` of n parameter vectors."""
    index = {name: k for k, name in enumerate(states)}
    matrix = np.zeros((n, len(states), len(states)))
    for (row, column), value in linear.A.items():
        matrix[:, index[row], index[column]] = value
    return matrix


class Chart(Protocol):
    """A change of the logs of the unknowns (but noise levels) that straightens the posterior.

    `straighten`: logs to coordinates, `(W, m) -> (W, m)`.  `bend`: back, with
    log |d logs / d z| `(W,)`; NaN where coordinates belong to no positive parameters.
    """

    @property
    def labels(self) -> tuple[str, ...]: ...

    def straighten(self, logs: Array) -> Array: ...

    def bend(self, z: Array) -> tuple[Array, Array]: ...


class Model(Protocol):
    """A rig. All parameters are positive; names are those of `symbols`."""

    @property
    def name(self) -> str: ...

    @property
    def parameters(self) -> tuple[str, ...]: ...

    @property
    def states(self) -> tuple[str, ...]: ...

    @property
    def inputs(self) -> tuple[str, ...]: ...

    def linear(self, p: Named) -> Linear:
        """The dynamics at parameters `p` (each a number or an array of one batch shape)."""
        ...

    def chart(
        self,
        v: float,
        free: tuple[str, ...],
        fixed: Mapping[str, float],
        relations: Mapping[str, Monomial] = NO_RELATIONS,
    ) -> Chart | None:
        """Coordinates the model brings, for a supply of about `v` volt; None if it has none.

        `free` and `fixed` may name quantities that are no parameters; `relations` give the
        parameters that are neither by those.
        """
        ...
