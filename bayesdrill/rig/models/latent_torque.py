"""A torque that a rig's equations are without: a stationary Gaussian process that acts on one inertia.

    1/2    <d(t) d(t')> = s^2 exp(-r)                r = |t - t'| / tau
    3/2    <d(t) d(t')> = s^2 (1 + a) exp(-a)        a = sqrt(3) r

as states that white noise drives (Matern): d has one, or with its rate two.  A torque `d` is
positive where it pushes its inertia towards positive angles; dry friction comes out with the sign
against the speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bayesdrill.basics.arrays import Array
from bayesdrill.rig import models, steady_state
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Around, Linear, Model, dynamics

At = Literal["motor", "rotor_1"]
Smoothness = Literal["1/2", "3/2"]

SIZE, TIME = "s_d", "tau_d"
TORQUE, RATE = "torque", "torque_rate"  # states, over `SIZE`, and over `SIZE` times the rate's own


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingTorque:
    """Where it acts, and how smooth it is: how often it can be differentiated, and a half."""

    at: At = "rotor_1"
    smoothness: Smoothness = "3/2"

    @property
    def states(self) -> tuple[str, ...]:
        return (TORQUE,) if self.smoothness == "1/2" else (TORQUE, RATE)

    def rate(self, time: Any) -> Any:
        """At which it is forgotten."""
        return (1.0 if self.smoothness == "1/2" else math.sqrt(3.0)) / time

    def driven(self, time: Any) -> Any:
        """Intensity of the white noise that drives the last of its states."""
        return self.rate(time) * (2.0 if self.smoothness == "1/2" else 4.0)

    def linear(self, time: Any) -> dict[tuple[str, str], Any]:
        """Its states each have unit variance, and no covariance at one time."""
        rate = self.rate(time)
        if self.smoothness == "1/2":
            return {(TORQUE, TORQUE): -rate}
        return {(TORQUE, RATE): rate, (RATE, TORQUE): -rate, (RATE, RATE): -2.0 * rate}


def pushes(model: Model, torque: MissingTorque, p: Named, linear: Linear) -> Any:
    """What one N m more does to the speed of its inertia, at the motor on its own side of the gear.

    Raises `ValueError` where the rig has no such inertia.
    """
    row, motor = model.roles.at(torque.at).speed, model.roles.motor
    if torque.at == "rotor_1":
        found = linear.B.get((row, model.roles.rotor.load))
        if found is not None:
            return -found
    elif (row, motor.torque) in linear.B:
        return linear.B[row, motor.torque]
    elif (row, motor.current) in linear.A and motor.torque_constant in p:
        return linear.A[row, motor.current] / p[motor.torque_constant]
    raise ValueError(
        f"the model {model.name} has no inertia at {torque.at.replace('_', ' ')} that a torque could "
        "act on"
    )


@dataclass(frozen=True, slots=True)
class Pushed(Around):
    """`rig` with the states of its missing torque behind its own, and its size and time as parameters.

    `free`: to turn, so that nothing depends on how far; its angles are those relative to the last of
    them, which is left out where nothing `tells` of it.
    """

    torque: MissingTorque
    free: bool = False
    tells: bool = True

    @property
    def frictions(self) -> tuple[()]:
        """None: it moves as if no friction changed its sign."""
        return ()

    @property
    def parameters(self) -> tuple[str, ...]:
        return (*self.rig.parameters, SIZE, TIME)

    @property
    def states(self) -> tuple[str, ...]:
        return (*self.of_rig, *self.torque.states)

    @property
    def of_rig(self) -> tuple[str, ...]:
        """States that are the rig's."""
        left_out = None if self.tells else self._last
        return tuple(name for name in self.rig.states if name != left_out)

    @property
    def _last(self) -> str:
        return angles(self.rig)[-1]

    def linear(self, p: Named) -> Linear:
        found = self.rig.linear(p)
        a, b, c = dict(found.A), dict(found.B), dict(found.c)
        if self.free:
            a, b, c = (self._relative(each) for each in (a, b, c))
        push = pushes(self.rig, self.torque, p, found)
        a |= self.torque.linear(p[TIME])
        a[self.roles.at(self.torque.at).speed, TORQUE] = push * p[SIZE]
        return Linear(A=a, B=b, c=c)

    def _relative(self, entries: Mapping[Any, Any]) -> dict[Any, Any]:
        """Rows of angles less that of the last, of which nothing depends."""
        found: dict[Any, Any] = {}
        for key, value in entries.items():
            row, column = key if isinstance(key, tuple) else (key, None)
            rows = [(row, value)]
            if row == self._last:
                rows = [(name, -value) for name in self._others] + rows * self.tells
            for name, entry in rows if column != self._last else []:
                place = (name, column) if isinstance(key, tuple) else name
                found[place] = found[place] + entry if place in found else entry
        return found

    @property
    def _others(self) -> list[str]:
        return [name for name in angles(self.rig) if name != self._last]

    def shown(self, weights: Mapping[str, float]) -> tuple[float, ...]:
        """Of a channel: the weights of `states`, by those of the rig's."""
        own = dict(weights)
        if self.free:
            own[self._last] = sum(weights.get(name, 0.0) for name in angles(self.rig))
        return tuple(float(own.get(name, 0.0)) for name in self.states)

    def begun(self, start: Mapping[str, float]) -> tuple[float, ...]:
        """Of the rig's states at the start, those of `states`."""
        own = dict(start)
        if self.free:
            last = start.get(self._last, 0.0)
            own |= {name: start.get(name, 0.0) - last for name in self._others}
        return tuple(float(own.get(name, 0.0)) for name in self.states)

    def of_states(self, found: Array) -> dict[str, Array]:
        """The rig's, of `states (..., n)`, but for angles of which nothing tells."""
        own = {name: found[..., self.states.index(name)] for name in self.of_rig}
        if not self.free:
            return own
        if not self.tells:
            return {name: x for name, x in own.items() if name not in self._others}
        return own | {name: own[name] + own[self._last] for name in self._others}


@dataclass(frozen=True, slots=True)
class Loaded(Around):
    """`rig` with the torque as one more input, `TORQUE`: as if it had been measured."""

    torque: MissingTorque

    @property
    def inputs(self) -> tuple[str, ...]:
        return (*self.rig.inputs, TORQUE)

    def linear(self, p: Named) -> Linear:
        found = self.rig.linear(p)
        push = pushes(self.rig, self.torque, p, found)
        b = {**found.B, (self.roles.at(self.torque.at).speed, TORQUE): push}
        return Linear(A=found.A, B=b, c=found.c)


def angles(model: Model) -> tuple[str, ...]:
    return tuple(name for name in model.states if models.STATES[name].unit == "rad")


def pushed(rig: Model, torque: MissingTorque, weights: Sequence[Mapping[str, float]]) -> Pushed:
    """`weights` of the channels, by state: whether one tells of an angle by itself."""
    own = angles(rig)
    # No two alike: where all are one, a rig may turn freely that does not elsewhere.
    apart = {name: 1.0 + math.sqrt(k + 2) % 1 for k, name in enumerate(rig.parameters)}
    matrix = dynamics(rig.linear(apart), rig.states, 1)
    free = len(own) > 1 and steady_state.turns(matrix, [rig.states.index(name) for name in own])
    alone = any(sum(each.get(name, 0.0) for name in own) != 0.0 for each in weights)
    return Pushed(rig, torque, free, alone or not free)
