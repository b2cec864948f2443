"""Dry friction, and the laws of its size.

    at' = ... - (entry of B) * T         T = sgn(at) size   while it moves,
                                         |T| <= size        while it sticks

`Friction` names an effort of a rig and its law.  Its effort is a column of the rig's `B`, whose
entry in the row that it is `against` is negative.  Laws give sizes, never signs: they see how fast
it moves, and a law that differs by direction sees `DIRECTION` too, 1 forwards and -1 backwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.duals import below, exp, sin, size, where
from bayesdrill.basics.symbols import Symbol

Named = Mapping[str, NDArray[np.float64] | float]
DIRECTION = "direction"  # what a law sees of the sign of the speed, among states and inputs


class Law(Protocol):
    """A law of friction, its size as a function of the speed; frozen, as rigs are."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it needs."""

    @property
    def seen(self) -> tuple[str, ...]:
        """States and inputs that it needs beside the speed, and `DIRECTION` if it differs by that."""

    @property
    def steady(self) -> bool:
        """Whether its size is that of the parameters alone, in each direction."""

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """Return the size at a `speed` that is not negative."""


@runtime_checkable
class SettlingLaw(Law, Protocol):
    """A law whose size comes down to a steady one at high speed."""

    def decay_terms(self, p: Named, speed: Any) -> tuple[Any, Any]:
        """Return that size, and the exponent of what is left above it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """A dry friction of a rig.

    `name`: its column of `B`; `against`: the speed (or current) that it opposes; `holds`: the angle
    that stays where it is while it sticks; `where`: in words, such as `at rotor 1`; `symbol`: what
    figures call its effort.
    """

    name: str
    against: str
    law: Law
    holds: str | None = None
    where: str = ""
    symbol: Symbol | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Gravity:
    """What gravity does to a pendulum beyond a spring: `weight (sin(angle + tilt) - angle)`.

    The spring, of the stiffness `weight`, stands in the rig's `A`, and this effort in the column
    `name` of `B`.  `angle`, `speed`: states, `reduction` times those of the pendulum.  `tilt`: None
    where there is none.
    """

    name: str
    angle: str
    speed: str
    reduction: float
    weight: str
    tilt: str | None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its weight and its tilt."""
        return (self.weight,) if self.tilt is None else (self.weight, self.tilt)

    @property
    def angles(self) -> tuple[str, ...]:
        """The state that it sees."""
        return (self.angle,)

    def torque(self, p: Named, angle: Any) -> Any:
        """Return the torque at the state `angle`, against it."""
        turned = _before_gear(angle, self.reduction)
        return p[self.weight] * (self._sine(p, turned) - turned)

    def load(self, p: Named, seen: Mapping[str, Any]) -> Any:
        """Return the torque that turns it, the spring among it."""
        return p[self.weight] * self._sine(p, _before_gear(seen[self.angle], self.reduction))

    def _sine(self, p: Named, turned: Any) -> Any:
        """Return the sine of how far the pendulum has `turned`, from where it hangs."""
        return sin(turned if self.tilt is None else turned + p[self.tilt])


@dataclass(frozen=True, slots=True)
class Coulomb:
    """Coulomb friction: as much as the parameter `sliding` at any speed, or `backward` (if named)."""

    sliding: str
    backward: str = ""

    steady: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[str, ...]:
        """The name of the sliding friction, and that backwards."""
        return (self.sliding, *filter(None, [self.backward]))

    @property
    def seen(self) -> tuple[str, ...]:
        """The direction, if it differs by that."""
        return (DIRECTION,) if self.backward else ()

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        return _by_direction(p, seen, self.sliding, self.backward)


@dataclass(frozen=True, slots=True)
class Stribeck:
    """Stribeck's law, `sliding + (static - sliding) exp(-(|w|/scale)^power)`.

    `times`: w for one of the state.  `backward`: names of sliding and static friction backwards,
    empty where they do not differ by direction.
    """

    sliding: str
    static: str
    scale: str
    power: int = 1
    times: float = 1.0
    backward: tuple[str, str] = ("", "")

    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of sliding friction, static friction, and the speed over which that is lost."""
        return (self.sliding, self.static, self.scale, *filter(None, self.backward))

    @property
    def seen(self) -> tuple[str, ...]:
        """The direction, if it differs by that."""
        return (DIRECTION,) if any(self.backward) else ()

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        sliding = _by_direction(p, seen, self.sliding, self.backward[0])
        static = _by_direction(p, seen, self.static, self.backward[1])
        return sliding + (static - sliding) * exp(-self._exponent(p, speed))

    def decay_terms(self, p: Named, speed: Any) -> tuple[Any, Any]:
        """See `SettlingLaw.decay_terms`."""
        return p[self.sliding], self._exponent(p, speed)

    def _exponent(self, p: Named, speed: Any) -> Any:
        scale: Any = p[self.scale]
        return ((self.times / scale) * speed) ** self.power


@dataclass(frozen=True, slots=True)
class QuadraticDrag:
    """Drag that grows with the square of the speed, `drag (times w)^2`, so that nothing sticks."""

    drag: str
    times: float = 1.0

    seen: ClassVar[tuple[str, ...]] = ()
    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """The name of its coefficient."""
        return (self.drag,)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        return p[self.drag] * (self.times * speed) ** 2


@dataclass(frozen=True, slots=True)
class BackwardDamping:
    """What viscous friction `backward` has beyond that forwards, `(backward - forward) |w|`.

    That forwards stands in the rig's `A`, for both directions.  `times`: w for one of the state.
    """

    forward: str
    backward: str
    times: float = 1.0

    seen: ClassVar[tuple[str, ...]] = (DIRECTION,)
    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of both coefficients."""
        return (self.forward, self.backward)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        more: Any = p[self.backward] - p[self.forward]
        return where(below(seen[DIRECTION], 0.0), more, 0.0) * (self.times * speed)


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
        """Names of the four coefficients."""
        return (self.factor, self.stiff, self.hump, self.width)

    @property
    def seen(self) -> tuple[str, ...]:
        """The input that it needs: the weight on the bit."""
        return (self.weight,)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        decay = exp(-2.0 * (p[self.stiff] * speed))
        rising = (1.0 - decay) / (1.0 + decay)
        hump = p[self.hump] * speed / (1.0 + p[self.width] * speed**2)
        return seen[self.weight] * p[self.factor] * (rising + hump)


@dataclass(frozen=True, slots=True)
class CombinedLaw:
    """The sum of two laws at the same place."""

    first: Law
    second: Law

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of both laws' parameters."""
        return (*self.first.parameters, *self.second.parameters)

    @property
    def seen(self) -> tuple[str, ...]:
        """States and inputs that either law needs."""
        return (*self.first.seen, *self.second.seen)

    @property
    def steady(self) -> bool:
        """Whether both are."""
        return self.first.steady and self.second.steady

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        return self.first.size(p, speed, seen) + self.second.size(p, speed, seen)


@dataclass(frozen=True, slots=True)
class LoadSpring:
    """A spring behind a gear: its `near` end, and its `far` one (None: the ground).

    Each is a state and the reduction factor by which that is the angle of the spring's end.
    """

    stiffness: str
    near: tuple[str, float]
    far: tuple[str, float] | None

    @property
    def parameters(self) -> tuple[str, ...]:
        """The name of its stiffness."""
        return (self.stiffness,)

    @property
    def angles(self) -> tuple[str, ...]:
        """The states that it sees, the far one first."""
        return (self.near[0],) if self.far is None else (self.far[0], self.near[0])

    def load(self, p: Named, seen: Mapping[str, Any]) -> Any:
        """Return the torque that turns it at its near end."""
        (near, reduction), far = self.near, self.far
        twist = _before_gear(seen[near], reduction)
        if far is not None:
            twist = twist - _before_gear(seen[far[0]], far[1])
        return p[self.stiffness] * twist


def _before_gear(angle: Any, reduction: float) -> Any:
    return angle if reduction == 1.0 else angle / reduction


@dataclass(frozen=True, slots=True)
class GearLoss:
    """The loss of a gear with an efficiency: (1/eta - 1) of the torque that it passes on to `loads`.

    On the side of the friction that torque is `factor` times theirs.  Where the load drives, the
    gear's efficiency is the one called `driven_back`, else 2 - 1/eta.
    """

    efficiency: str
    loads: tuple[LoadSpring | Gravity, ...]
    factor: float
    driven_back: str = ""

    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the efficiency, of stiffnesses and weights."""
        back = filter(None, [self.driven_back])
        return (self.efficiency, *back, *(n for load in self.loads for n in load.parameters))

    @property
    def seen(self) -> tuple[str, ...]:
        """The angles of the loads, and the direction where it matters which side drives."""
        angles = dict.fromkeys(name for load in self.loads for name in load.angles)
        return (*angles, *((DIRECTION,) if self.driven_back else ()))

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        first, *others = (load.load(p, seen) for load in self.loads)
        total, lost = sum(others, first), 1.0 / p[self.efficiency] - 1.0
        if self.driven_back:
            drives = below(total * seen[DIRECTION], 0.0)  # the load pushes where it moves
            lost = where(drives, 1.0 - p[self.driven_back], lost)
        return lost * (size(total) * self.factor)


def _by_direction(p: Named, seen: Mapping[str, Any], forward: str, backward: str) -> Any:
    """Return the parameter `forward`, or in the other direction `backward` where that is named."""
    if not backward:
        return p[forward]
    return where(below(seen[DIRECTION], 0.0), p[backward], p[forward])
