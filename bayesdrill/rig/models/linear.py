"""The contract of a model: linear dynamics with named states, inputs and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol

Array = NDArray[np.float64]
Named = Mapping[str, Array | float]


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


def driven(
    linear: Linear, states: tuple[str, ...], n: int, inputs: Mapping[str, Array | float]
) -> Array:
    """`B u + c`, `(n, X)`, with `inputs` that are numbers or `(n,)`; what is not named is zero."""
    index = {name: k for k, name in enumerate(states)}
    out = np.zeros((n, len(states)))
    for row, value in linear.c.items():
        out[:, index[row]] += value
    for (row, name), value in linear.B.items():
        out[:, index[row]] += value * inputs.get(name, 0.0)
    return out


class Model(Protocol):
    """A rig: a frozen dataclass whose annotated fields are its constants, entries of `model:`.

    Names are those of `basics.symbols`, or of `declares`: symbols of parameters and states of its own.
    A rig that rubs has `frictions` as well, each a column of `B` (`models.friction`); one that takes
    more physics where it is named `offers` it, and has what is `added` (`models.composed`).
    """

    @property
    def declares(self) -> tuple[Symbol, ...]: ...

    @property
    def name(self) -> str: ...

    @property
    def parameters(self) -> tuple[str, ...]: ...

    @property
    def states(self) -> tuple[str, ...]: ...

    @property
    def inputs(self) -> tuple[str, ...]: ...

    def linear(self, p: Named) -> Linear:
        """The dynamics at parameters `p`: numbers, arrays of one batch shape, numbers with slopes, or
        registers of a kernel: so they can be added, multiplied, divided and raised to whole powers,
        and nothing else.
        """
        ...


def inner_of(model: Any) -> tuple[str, ...]:
    """States that no start names and no sensor sees: within a part, zero where nothing moves it."""
    found: tuple[str, ...] = getattr(model, "inner", ())
    return found


def outer_of(model: Model) -> tuple[str, ...]:
    """All others."""
    return tuple(name for name in model.states if name not in inner_of(model))
