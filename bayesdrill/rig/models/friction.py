"""Friction that is dry, and the physics that a rig takes where its parameter is named.

    at' = ... - (entry of B) * T         T = sgn(at) size   while it moves,
                                         |T| <= size        while it sticks

`Friction` names an effort of a rig and its law.  Its effort is a column of the rig's `B`, whose entry in
the row that it is `against` is negative.  Laws give sizes, never signs: they see how fast it moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.duals import exp, size
from bayesdrill.basics.symbols import Symbol

Named = Mapping[str, NDArray[np.float64] | float]


class Law(Protocol):
    """Frozen: kernels are kept by the rigs that they were made of.

    `parameters` that it names; `seen`: states and inputs that it names beside the speed; `steady`:
    whether its size is that of the parameters alone.
    """

    @property
    def parameters(self) -> tuple[str, ...]: ...

    @property
    def seen(self) -> tuple[str, ...]: ...

    @property
    def steady(self) -> bool: ...

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """At a `speed` that is not negative."""
        ...


@runtime_checkable
class SettlingLaw(Law, Protocol):
    """A law whose size comes down to a steady one at high speed."""

    def spent(self, p: Named, speed: Any) -> tuple[Any, Any]:
        """That size, and how far it has come: the exponent of what is left above it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """`name`: its column of `B`; `against`: a state; `holds`: the angle that stays where it is while it
    sticks; `where`: in words, such as `at rotor 1`; `symbol`: what figures call its effort.
    """

    name: str
    against: str
    law: Law
    holds: str | None = None
    where: str = ""
    symbol: Symbol | None = None


Place = tuple[Symbol, str, Law | None, str | None, str]


def frictions_at(*places: Place) -> tuple[Friction, ...]:
    """Of symbol, state that it is against, law, what it holds and where: those that have a law."""
    return tuple(
        Friction(name=own.name, against=against, law=law, holds=holds, where=where, symbol=own)
        for own, against, law, holds, where in places
        if law is not None
    )


@dataclass(frozen=True, slots=True)
class Coulomb:
    """As much as the parameter `sliding`, at any speed."""

    sliding: str

    seen: ClassVar[tuple[str, ...]] = ()
    steady: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[str, ...]:
        return (self.sliding,)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        return p[self.sliding]


@dataclass(frozen=True, slots=True)
class Stribeck:
    """`sliding + (static - sliding) exp(-(|w|/scale)^power)`, `times`: w for one of the state."""

    sliding: str
    static: str
    scale: str
    power: int = 1
    times: float = 1.0

    seen: ClassVar[tuple[str, ...]] = ()
    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        return (self.sliding, self.static, self.scale)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        sliding: Any = p[self.sliding]
        return sliding + (p[self.static] - sliding) * exp(-self._fallen(p, speed))

    def spent(self, p: Named, speed: Any) -> tuple[Any, Any]:
        return p[self.sliding], self._fallen(p, speed)

    def _fallen(self, p: Named, speed: Any) -> Any:
        scale: Any = p[self.scale]
        return ((self.times / scale) * speed) ** self.power


@dataclass(frozen=True, slots=True)
class BitRock:
    """`W b_0 (tanh(b_1 |w|) + b_2 |w| / (1 + b_3 w^2))` under the weight W on the bit.

    It vanishes with the speed, so that nothing sticks.  The law of a drill-string code of LAVI,
    COPPE/UFRJ, with W the weight on bit [N].
    """

    factor: str
    stiff: str
    hump: str
    width: str
    weight: str

    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        return (self.factor, self.stiff, self.hump, self.width)

    @property
    def seen(self) -> tuple[str, ...]:
        return (self.weight,)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        decay = exp(-2.0 * (p[self.stiff] * speed))
        rising = (1.0 - decay) / (1.0 + decay)
        hump = p[self.hump] * speed / (1.0 + p[self.width] * speed**2)
        return seen[self.weight] * p[self.factor] * (rising + hump)


@dataclass(frozen=True, slots=True)
class Both:
    """One and another at the same place."""

    one: Law
    other: Law

    @property
    def parameters(self) -> tuple[str, ...]:
        return (*self.one.parameters, *self.other.parameters)

    @property
    def seen(self) -> tuple[str, ...]:
        return (*self.one.seen, *self.other.seen)

    @property
    def steady(self) -> bool:
        return self.one.steady and self.other.steady

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        return self.one.size(p, speed, seen) + self.other.size(p, speed, seen)


@dataclass(frozen=True, slots=True)
class Losing:
    """`law`, None for nothing, and (1/eta - 1) of the torque that a gear with an efficiency passes on.

    That torque, on the side of the friction, is `factor k (angle_2 - angle_1)` with the parameter
    `stiffness` for k.  Where the load drives, the gear's efficiency is 2 - 1/eta.
    """

    law: Law | None
    efficiency: str
    stiffness: str
    angles: tuple[str, str]
    factor: float

    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        own = (self.efficiency, self.stiffness)
        return own if self.law is None else (*self.law.parameters, *own)

    @property
    def seen(self) -> tuple[str, ...]:
        return self.angles if self.law is None else (*self.law.seen, *self.angles)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        first, second = self.angles
        passed = size(p[self.stiffness] * (seen[second] - seen[first])) * self.factor
        lost = (1.0 / p[self.efficiency] - 1.0) * passed
        return lost if self.law is None else self.law.size(p, speed, seen) + lost
