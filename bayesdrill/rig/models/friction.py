"""Define dry friction, and the laws of its size.

    w' = ... + b T,  b < 0               T = sgn(w) size    while it moves,
                                         |T| <= size        while it sticks

`Friction` names an effort T (a torque, or a voltage drop), its law, and the speed (or current) w that T
opposes.  The effort has a column of the rig's `B`, with b in the row of w.  Laws give sizes, never
signs.  Their argument is the magnitude of the speed.  A law that differs by direction also receives
`DIRECTION`, which is 1 forwards and -1 backwards.
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
DIRECTION = "direction"  # key of the speed's sign in the argument `seen` of a law


class Law(Protocol):
    """A law gives the size of a friction as a function of the speed; laws are immutable, like rigs."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters that the law needs."""

    @property
    def seen(self) -> tuple[str, ...]:
        """Return the states and inputs that the law needs in addition to the speed.

        `DIRECTION` is among them if the size differs by direction.
        """

    @property
    def steady(self) -> bool:
        """Return whether the size depends only on the parameters and the direction."""

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """Return the size at a `speed` that is not negative."""


@runtime_checkable
class SettlingLaw(Law, Protocol):
    """A settling law has a size that decays to a constant at high speed."""

    def decay_terms(self, p: Named, speed: Any) -> tuple[Any, Any]:
        """Return (c, x) for the size c + a exp(-x): the constant c, and the exponent x at `speed`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """A friction is a single dry friction of a rig.

    `name` is its column of `B`. The friction opposes the speed (or current) `against`. `holds` is the
    angle that stays constant while the friction sticks. `where` is its location in words, such as
    `at rotor 1`. `symbol` is the symbol of its effort in figures.
    """

    name: str
    against: str
    law: Law
    holds: str | None = None
    where: str = ""
    symbol: Symbol | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Gravity:
    """Gravity on a pendulum is a linear spring plus the effort `weight (sin(a + tilt) - a)`.

    The spring has the stiffness `weight` and is in the rig's `A`. The effort is the column `name` of
    `B`. The states `angle` and `speed` are `reduction` times the pendulum's own angle a and speed.
    `tilt` is None for a pendulum without a tilt.
    """

    name: str
    angle: str
    speed: str
    reduction: float
    weight: str
    tilt: str | None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the weight and the tilt."""
        return (self.weight,) if self.tilt is None else (self.weight, self.tilt)

    @property
    def angles(self) -> tuple[str, ...]:
        """Return the state on which the effort depends."""
        return (self.angle,)

    def torque(self, p: Named, angle: Any) -> Any:
        """Return the effort at the state `angle`; a positive effort pushes backwards."""
        turned = _before_gear(angle, self.reduction)
        return p[self.weight] * (self._sine(p, turned) - turned)

    def load(self, p: Named, seen: Mapping[str, Any]) -> Any:
        """Return the total torque of gravity, which is the effort plus the torque of the spring."""
        return p[self.weight] * self._sine(p, _before_gear(seen[self.angle], self.reduction))

    def _sine(self, p: Named, turned: Any) -> Any:
        """Return the sine of the pendulum's angle from its lowest position, `turned` + tilt."""
        return sin(turned if self.tilt is None else turned + p[self.tilt])


@dataclass(frozen=True, slots=True)
class Coulomb:
    """Coulomb friction has the size `sliding` or, in backward motion, `backward` (if named)."""

    sliding: str
    backward: str = ""

    steady: ClassVar[bool] = True

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the name of the sliding friction, then that of the backward one if it differs."""
        return (self.sliding, *filter(None, [self.backward]))

    @property
    def seen(self) -> tuple[str, ...]:
        """Return `DIRECTION` if the size differs by direction."""
        return (DIRECTION,) if self.backward else ()

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        return _by_direction(p, seen, self.sliding, self.backward)


@dataclass(frozen=True, slots=True)
class Stribeck:
    """Stribeck's law is `sliding + (static - sliding) exp(-(|w|/scale)^power)`.

    The speed w is the state multiplied by `times`. `backward` has the names of sliding and static
    friction in backward motion; a name is empty if that friction is the same in both directions.
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
        """Return the names of sliding friction, static friction, and the speed scale of its decay."""
        return (self.sliding, self.static, self.scale, *filter(None, self.backward))

    @property
    def seen(self) -> tuple[str, ...]:
        """Return `DIRECTION` if the size differs by direction."""
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
    """Quadratic drag is `drag (times w)^2`: it vanishes at rest, so it never sticks."""

    drag: str
    times: float = 1.0

    seen: ClassVar[tuple[str, ...]] = ()
    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the name of the drag coefficient."""
        return (self.drag,)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        return p[self.drag] * (self.times * speed) ** 2


@dataclass(frozen=True, slots=True)
class BackwardDamping:
    """In backward motion, viscous friction is larger by `(backward - forward) |w|`.

    The rig's matrix `A` has the friction `forward |w|` in both directions. The speed w is the state
    multiplied by `times`, which is negative behind a gear that reverses the motion.
    """

    forward: str
    backward: str
    times: float = 1.0

    seen: ClassVar[tuple[str, ...]] = (DIRECTION,)
    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of both coefficients."""
        return (self.forward, self.backward)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        more: Any = p[self.backward] - p[self.forward]
        back = below(seen[DIRECTION] * self.times, 0.0)
        return where(back, more, 0.0) * (abs(self.times) * speed)


@dataclass(frozen=True, slots=True)
class BitRock:
    """The torque is `W b_0 (tanh(b_1 |w|) + b_2 |w| / (1 + b_3 w^2))` under the weight W on the bit.

    The torque vanishes at rest, so the bit never sticks. W is in N. The law is taken from a
    drill-string code of LAVI, COPPE/UFRJ.
    """

    factor: str
    stiff: str
    hump: str
    width: str
    weight: str

    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the four coefficients."""
        return (self.factor, self.stiff, self.hump, self.width)

    @property
    def seen(self) -> tuple[str, ...]:
        """Return the input that the law needs: the weight on the bit."""
        return (self.weight,)

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        decay = exp(-2.0 * (p[self.stiff] * speed))
        rising = (1.0 - decay) / (1.0 + decay)
        hump = p[self.hump] * speed / (1.0 + p[self.width] * speed**2)
        return seen[self.weight] * p[self.factor] * (rising + hump)


@dataclass(frozen=True, slots=True)
class CombinedLaw:
    """A combined law is the sum of two laws of friction at the same inertia."""

    first: Law
    second: Law

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of both laws' parameters."""
        return (*self.first.parameters, *self.second.parameters)

    @property
    def seen(self) -> tuple[str, ...]:
        """Return the states and inputs that the two laws need."""
        return (*self.first.seen, *self.second.seen)

    @property
    def steady(self) -> bool:
        """Return whether both laws are steady."""
        return self.first.steady and self.second.steady

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        return self.first.size(p, speed, seen) + self.second.size(p, speed, seen)


@dataclass(frozen=True, slots=True)
class LoadSpring:
    """A load spring is behind a gear, between `near_end` and `far_end` (None for the ground).

    Each end is (state, reduction): the state is `reduction` times the angle of that end.
    """

    stiffness: str
    near_end: tuple[str, float]
    far_end: tuple[str, float] | None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the name of the stiffness."""
        return (self.stiffness,)

    @property
    def angles(self) -> tuple[str, ...]:
        """Return the states on which the torque depends, the far one first."""
        return (self.near_end[0],) if self.far_end is None else (self.far_end[0], self.near_end[0])

    @property
    def reduction(self) -> float:
        """Return the reduction of the near end."""
        return self.near_end[1]

    def load(self, p: Named, seen: Mapping[str, Any]) -> Any:
        """Return the torque of the spring at its near end."""
        (near, reduction), far = self.near_end, self.far_end
        twist = _before_gear(seen[near], reduction)
        if far is not None:
            twist = twist - _before_gear(seen[far[0]], far[1])
        return p[self.stiffness] * twist


def _before_gear(angle: Any, reduction: float) -> Any:
    return angle if reduction == 1.0 else angle / reduction


@dataclass(frozen=True, slots=True)
class GearLoss:
    """The loss is (1/eta - 1) times the torque that a gear of efficiency eta transmits to `loads`.

    `factor` refers a torque on the state's side to the side of the gear where the friction acts. While
    the load drives, the efficiency is `driven_back`, or 2 - 1/eta if no `driven_back` is named.
    """

    efficiency: str
    loads: tuple[LoadSpring | Gravity, ...]
    factor: float
    driven_back: str = ""

    steady: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the efficiencies, and of stiffnesses and weights of the loads."""
        back = filter(None, [self.driven_back])
        return (self.efficiency, *back, *(n for load in self.loads for n in load.parameters))

    @property
    def seen(self) -> tuple[str, ...]:
        """Return the angles of the loads, and the direction if it matters which side drives."""
        angles = dict.fromkeys(name for load in self.loads for name in load.angles)
        return (*angles, *((DIRECTION,) if self.driven_back else ()))

    def size(self, p: Named, speed: Any, seen: Mapping[str, Any]) -> Any:
        """See `Law.size`."""
        torques = [_before_gear(load.load(p, seen), load.reduction) for load in self.loads]
        first, *others = torques
        total, lost = sum(others, first), 1.0 / p[self.efficiency] - 1.0
        if self.driven_back:
            drives = below(total * seen[DIRECTION], 0.0)  # the load accelerates the motion
            lost = where(drives, 1.0 - p[self.driven_back], lost)
        return lost * (size(total) * self.factor)


def _by_direction(p: Named, seen: Mapping[str, Any], forward: str, backward: str) -> Any:
    """Return the parameter `forward` or, in backward motion, `backward` if it is named."""
    if not backward:
        return p[forward]
    return where(below(seen[DIRECTION], 0.0), p[backward], p[forward])
