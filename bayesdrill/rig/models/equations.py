"""Derive the equations of a rig from its parts, by Newton's law for inertias that turn as one.

    J w' = sum of (n^2 / n_b) T_b,  J = sum of (n / n_b)^2 j_b    for inertias j_b that turn as one
    l i' = u - (r + r_s) i - k_e w_b                              for each motor with an inductance
    u = supply duty (k_p (goal - theta_b) - k_d w_b)              for a servo (see `servo`)

An inertia j_b has the angle theta_b, the speed w_b, the `reduction` n_b and the torque T_b.  The state
w is the speed behind the gear, w = n_b w_b for all b.  J is referred to the first of these inertias,
which has the reduction n.  A shaft or a damper acts on both of its ends, except on the ground and on
an end with an imposed motion.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Literal

from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.friction import (
    BackwardDamping,
    BitRock,
    CombinedLaw,
    Coulomb,
    Friction,
    GearLoss,
    Gravity,
    Law,
    LoadSpring,
    Named,
    QuadraticDrag,
    Stribeck,
)
from bayesdrill.rig.models.linear import Linear, Model
from bayesdrill.rig.models.roles import GROUND, InertiaRoles, MotorRoles, ShaftRoles
from bayesdrill.rig.models.servo import Saturation

CONSTANT = ""  # stands for a column: the entry belongs to the constant forcing `c`
Entry = tuple[str, str, Any]  # (row, column of A or B or `CONSTANT`, value)


class PartsModel(Model):
    """A parts model is a rig whose equations follow from its roles."""

    declares: ClassVar[tuple[Symbol, ...]] = ()

    @property
    def stribeck(self) -> Literal[1, 2]:
        """Return the power of the speed in Stribeck's law; most rigs make it a field."""
        return 1

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """Return the dry frictions at inertias, then the voltage drops of motors."""
        parts = _parts(self)
        return (*(friction for _, friction in parts.dry_frictions()), *parts.voltage_drops())

    @property
    def gravities(self) -> tuple[Gravity, ...]:
        """Return the pendulums among the inertias."""
        return tuple(_parts(self).pendulums())

    @property
    def saturation(self) -> Saturation | None:
        """See `Model.saturation`."""
        return next(_parts(self).saturations(), None)

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        return _parts(self).linear(p)


def coordinate_inertia(model: PartsModel, speed: str, p: Named) -> Any:
    """Return the sum of the inertias that turn with a `speed`, referred to the first of them."""
    return _parts(model).inertia(speed, p)


def _times(factor: float, number: Any) -> Any:
    """Multiply, but not by 1 or -1, as kernels should contain no superfluous operation."""
    if factor == 1.0:
        return number
    return -number if factor == -1.0 else factor * number


class _Parts:
    """The class writes the equations of all parts whose parameters the rig `model` has.

    `moving` maps each speed that is a state to the inertias that turn with it.
    """

    def __init__(self, model: PartsModel) -> None:
        self.model, self.roles, self.inputs = model, model.roles, model.inputs
        self.names, self.states = {*model.parameters}, model.states
        self.moving = self.roles.moving(self.states, self.names)

    # Inertias, and factors of torques in the equations.

    def inertia(self, speed: str, p: Named) -> Any:
        """See `coordinate_inertia`."""
        first, *others = self.moving[speed]
        total: Any = p[first.inertia]
        for other in others:
            square = (first.reduction / other.reduction) ** 2
            total = total + _times(square, p[other.inertia])
        return total

    def torque_factor(self, inertia: InertiaRoles) -> float:
        """Return the factor n^2 / n_b of a torque on the inertia, see the module's first equation."""
        first = self.moving[inertia.speed][0]
        if inertia.reduction == first.reduction:
            return first.reduction
        return first.reduction**2 / inertia.reduction

    def _has(self, *names: str) -> bool:
        return self.names.issuperset(names)

    def _ends(self, shaft: ShaftRoles) -> list[tuple[InertiaRoles, InertiaRoles | None]]:
        """Return (near, far) for each end of a shaft whose speed is a state; far is None for ground."""
        first, second = (
            None if name == GROUND else self.roles.inertia(name) for name in shaft.ends
        )
        return [
            (near, far)
            for near, far in ((first, second), (second, first))
            if near is not None and near.speed in self.states
        ]

    # Equations.

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        totals = {speed: self.inertia(speed, p) for speed in self.moving}
        entries: dict[tuple[str, str], Any] = {}
        for row, column, value in self._entries(p, totals):
            key = (row, column)
            entries[key] = entries[key] + value if key in entries else value
        order = {name: k for k, name in enumerate((*self.states, *self.inputs))}
        where = lambda item: (order[item[0][0]], order.get(item[0][1], len(order)))  # noqa: E731
        rows = sorted(entries.items(), key=where)
        return Linear(
            A={key: value for key, value in rows if key[1] in self.states},
            B={key: value for key, value in rows if key[1] not in (*self.states, CONSTANT)},
            c={row: value for (row, column), value in rows if column == CONSTANT},
        )

    def _entries(self, p: Named, totals: Named) -> Iterator[Entry]:
        for angle, speed in self.roles.speeds.items():
            if angle in self.states:
                yield angle, speed, 1.0
        for inertia in self.roles.inertias:
            if inertia.speed in totals:
                yield from self._at_inertia(inertia, p, totals[inertia.speed])
        for shaft in self.roles.shafts:
            for near, far in self._ends(shaft):
                yield from self._at_end(shaft, near, far, p, totals[near.speed])
        for motor in self.roles.motors:
            yield from self._of_motor(motor, p, totals)
        for inertia, friction in self.dry_frictions():
            row = friction.against
            yield row, friction.name, -abs(self.torque_factor(inertia)) / totals[row]

    def _at_inertia(self, inertia: InertiaRoles, p: Named, total: Any) -> Iterator[Entry]:
        factor = self.torque_factor(inertia)
        if self._has(inertia.friction):
            yield inertia.speed, CONSTANT, _times(-factor, p[inertia.friction]) / total
        if self._has(inertia.damping):
            times = factor / inertia.reduction
            yield inertia.speed, inertia.speed, _times(-times, p[inertia.damping]) / total
        if self._has(inertia.weight):
            times = factor / inertia.reduction
            yield inertia.speed, inertia.angle, _times(-times, p[inertia.weight]) / total
            yield inertia.speed, f"gravity_{inertia.name}", -factor / total
        if inertia.torque in self.inputs:
            yield inertia.speed, inertia.torque, factor / total
        if inertia.load in self.inputs:
            yield inertia.speed, inertia.load, -factor / total

    def _at_end(
        self, shaft: ShaftRoles, near: InertiaRoles, far: InertiaRoles | None, p: Named, total: Any
    ) -> Iterator[Entry]:
        factor = self.torque_factor(near)
        for name, moved in ((shaft.stiffness, "angle"), (shaft.damping, "speed")):
            if not self._has(name):
                continue
            values: dict[float, Any] = {}  # one division serves both ends
            for end, sign in ((near, -1.0), (far, 1.0)):
                if end is not None:
                    column = end.angle if moved == "angle" else end.speed
                    times = factor / end.reduction
                    if times not in values:
                        values[times] = _times(times, p[name]) / total
                    yield near.speed, column, _times(sign, values[times])

    def _of_motor(self, motor: MotorRoles, p: Named, totals: Named) -> Iterator[Entry]:
        model, torque = self.model, None
        inertia = self.roles.inertia(motor.inertia)
        if inertia.speed in totals and self._has(motor.torque_constant):
            factor = self.torque_factor(inertia)
            torque = _times(factor, p[motor.torque_constant]) / totals[inertia.speed]
            if motor.current in (*model.states, *model.inputs):
                yield inertia.speed, motor.current, torque
        if not self._has(motor.resistance):
            return
        resistance = p[motor.resistance]
        if self._has(motor.series):
            resistance = resistance + p[motor.series]
        if motor.current in model.states:
            inductance = p[motor.inductance]
            if self._has(motor.back_emf):
                turned = _times(inertia.reduction, inductance)
                yield motor.current, inertia.speed, -p[motor.back_emf] / turned
            yield motor.current, motor.current, -resistance / inductance
            yield from self._volts(motor, inertia, motor.current, 1.0 / inductance, p)
            for drop in self.voltage_drops():
                if drop.against == motor.current:
                    yield motor.current, drop.name, -1.0 / inductance
        elif torque is not None:
            yield from self._volts(motor, inertia, inertia.speed, torque / resistance, p)
            if self._has(motor.back_emf):
                braked = p[motor.back_emf] / _times(inertia.reduction, resistance)
                yield inertia.speed, inertia.speed, -torque * braked

    def _volts(
        self, motor: MotorRoles, inertia: InertiaRoles, row: str, volt: Any, p: Named
    ) -> Iterator[Entry]:
        """Yield the entries of a row due to a motor's voltage; `volt` is the entry for one volt."""
        if not motor.goal:
            yield row, motor.voltage, volt
            return
        turned = volt * (motor.usual_supply or p[motor.supply]) * p[motor.duty]
        error = turned * p[motor.proportional] if self._has(motor.proportional) else turned
        yield row, motor.goal, error
        yield row, inertia.angle, -error / inertia.reduction
        if self._has(motor.derivative):
            yield row, inertia.speed, -turned * p[motor.derivative] / inertia.reduction
        if motor.is_limited(self.names):
            yield row, f"servo_{motor.inertia}", volt

    # Gravity, frictions and servos.

    def saturations(self) -> Iterator[Saturation]:
        """Yield the servos that a linear closed loop does not describe, for example with saturation."""
        for motor in self.roles.motors:
            if motor.is_limited(self.names):
                turns = self.roles.inertia(motor.inertia).speed
                yield Saturation(
                    name=f"servo_{motor.inertia}",
                    row=motor.current if motor.current in self.states else turns,
                    duty=motor.duty,
                    supply=motor.supply,
                    usual_supply=motor.usual_supply,
                    goal=motor.goal,
                    proportional=motor.proportional if self._has(motor.proportional) else "",
                    limit=motor.limit if self._has(motor.limit) else "",
                    band=motor.band if self._has(motor.band) else "",
                    speed=motor.goal_speed if self._has(motor.goal_speed) else "",
                )

    def pendulums(self) -> Iterator[Gravity]:
        """Yield the effect of gravity at each inertia with a weight."""
        for inertia in self.roles.inertias:
            if self._has(inertia.weight) and inertia.speed in self.states:
                yield Gravity(
                    name=f"gravity_{inertia.name}",
                    angle=inertia.angle,
                    speed=inertia.speed,
                    reduction=inertia.reduction,
                    weight=inertia.weight,
                    tilt=inertia.tilt if self._has(inertia.tilt) else None,
                )

    def dry_frictions(self) -> Iterator[tuple[InertiaRoles, Friction]]:
        """Yield each inertia with dry friction, and its friction."""
        for inertia in self.roles.inertias:
            laws = self._laws(inertia) if inertia.speed in self.states else []
            if laws:
                friction = Friction(
                    name=effort_name(inertia.effort, f"friction_{inertia.name}"),
                    against=inertia.speed,
                    law=functools.reduce(CombinedLaw, laws),
                    holds=inertia.angle,
                    where=inertia.at,
                    symbol=inertia.effort,
                )
                yield inertia, friction

    def _laws(self, inertia: InertiaRoles) -> list[Law]:
        laws, times = list[Law](), 1 / inertia.reduction

        def by_direction(forward: str, backward: str) -> tuple[str, str]:
            """Return the names for the directions of the state; the second is empty if unused."""
            if not self._has(backward):
                return forward, ""
            return (forward, backward) if times > 0 else (backward, forward)

        sliding = by_direction(inertia.sliding, inertia.sliding_back)
        static = by_direction(inertia.static, inertia.static_back)
        if self._has(inertia.sliding, inertia.static, inertia.fading):
            scale, power, backward = inertia.fading, self.model.stribeck, (sliding[1], static[1])
            laws.append(Stribeck(sliding[0], static[0], scale, power, abs(times), backward))
        elif self._has(inertia.sliding):
            laws.append(Coulomb(*sliding))
        if self._has(inertia.damping, inertia.damping_back):
            laws.append(BackwardDamping(inertia.damping, inertia.damping_back, times))
        if self._has(inertia.drag):
            laws.append(QuadraticDrag(inertia.drag, times))
        if self._has(inertia.efficiency):
            driven = inertia.efficiency_back if self._has(inertia.efficiency_back) else ""
            loads = self._loads(inertia)
            laws.append(GearLoss(inertia.efficiency, loads, abs(inertia.reduction), driven))
        if inertia.cutting and self._has(*inertia.cutting):
            factor, stiff, hump, width = inertia.cutting
            laws.append(BitRock(factor, stiff, hump, width, inertia.bit_weight))
        return laws

    def _loads(self, inertia: InertiaRoles) -> tuple[LoadSpring | Gravity, ...]:
        """Return the springs and weights to which an inertia transmits torque through its gear."""
        springs = (
            LoadSpring(
                shaft.stiffness,
                (near.angle, near.reduction),
                None if far is None else (far.angle, far.reduction),
            )
            for shaft in self.roles.shafts
            for near, far in self._ends(shaft)
            if near.speed == inertia.speed
            and near.name != inertia.name
            and self._has(shaft.stiffness)
        )
        weights = (
            gravity
            for gravity in self.pendulums()
            if gravity.speed == inertia.speed and gravity.name != f"gravity_{inertia.name}"
        )
        return (*springs, *weights)

    def voltage_drops(self) -> Iterator[Friction]:
        """Yield the voltage drop of each motor that has such a parameter."""
        for motor in self.roles.motors:
            if self._has(motor.drop) and motor.current in self.states:
                yield Friction(
                    name=effort_name(motor.effort, f"drop_{motor.inertia}"),
                    against=motor.current,
                    law=Coulomb(motor.drop),
                    where="of the current",
                    symbol=motor.effort,
                )


def effort_name(symbol: Symbol | None, name: str) -> str:
    """Return the name of an effort's `symbol`, or `name` if there is no symbol."""
    return symbol.name if symbol else name


_parts: Callable[[PartsModel], _Parts] = functools.lru_cache(maxsize=256)(_Parts)
