"""The contract of a model: linear dynamics with named states, inputs and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.friction import Friction
from bayesdrill.rig.models.friction import Named as Named
from bayesdrill.rig.models.roles import USUAL, Roles

Array = NDArray[np.float64]
Offers = Mapping[str, tuple[str, ...]]
NOTHING: Offers = MappingProxyType({})


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
    """A rig: a frozen dataclass that derives from this; its annotated fields are its constants, entries
    of `model:`.

    Names are those of `basics.symbols`, or of `declares`: symbols of parameters and states of its own.
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

    # What a rig may have beside that.

    @property
    def roles(self) -> Roles:
        """What it calls its speeds, its friction, ...; the usual names, where it does not say."""
        return USUAL

    @property
    def offers(self) -> Offers:
        """Physics that it takes where it is named: see `composed`."""
        return NOTHING

    @property
    def added(self) -> tuple[str, ...]:
        """Of what it offers, the names that it has: a field."""
        return ()

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """Each a column of `B`."""
        return ()

    @property
    def inner(self) -> tuple[str, ...]:
        """States that no start names and no sensor sees: within a part, zero where nothing moves it."""
        return ()

    @property
    def outer(self) -> tuple[str, ...]:
        """All others."""
        return tuple(name for name in self.states if name not in self.inner)

    @property
    def gear_ratio(self) -> float:
        """The shaft turns so many times as fast as the motor: 1 without a gear."""
        return float(getattr(self, self.roles.gear)) if self.geared else 1.0

    @property
    def geared(self) -> bool:
        """Whether one of its constants is that."""
        return hasattr(self, self.roles.gear)


@dataclass(frozen=True, slots=True)
class Around(Model):
    """`rig`, and more: all that is not said otherwise is the rig's; it offers nothing."""

    rig: Model

    @property
    def declares(self) -> tuple[Symbol, ...]:
        return self.rig.declares

    @property
    def name(self) -> str:
        return self.rig.name

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.rig.parameters

    @property
    def states(self) -> tuple[str, ...]:
        return self.rig.states

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.rig.inputs

    @property
    def frictions(self) -> tuple[Friction, ...]:
        return self.rig.frictions

    @property
    def inner(self) -> tuple[str, ...]:
        return self.rig.inner

    @property
    def roles(self) -> Roles:
        return self.rig.roles

    @property
    def gear_ratio(self) -> float:
        return self.rig.gear_ratio

    @property
    def geared(self) -> bool:
        return self.rig.geared
