"""Describe a torque that the equations of a rig lack, as a Gaussian process on one inertia.

    1/2    <d(t) d(t')> = s^2 exp(-r)                r = |t - t'| / tau
    3/2    <d(t) d(t')> = s^2 (1 + a) exp(-a)        a = sqrt(3) r

This Matern process has a state-space form that white noise drives (Hartikainen and Sarkka 2010).  Its
states are d and, for smoothness 3/2, the rate of d.  A positive d pushes its inertia towards positive
angles, so a d that represents dry friction has the sign opposite to the speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from bayesdrill.basics.arrays import Array
from bayesdrill.rig import steady_state
from bayesdrill.rig.models.friction import Named
from bayesdrill.rig.models.linear import Linear, Model, WrappedModel, dynamics

TorqueLocation = str  # the name of an inertia
Smoothness = Literal["1/2", "3/2"]

SIZE, TIME = "s_d", "tau_d"
TORQUE, RATE = "torque", "torque_rate"  # names of the states, which have unit variance


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingTorque:
    """A missing torque acts on the inertia `at`, and has Matern's `smoothness` nu."""

    at: TorqueLocation = "rotor_1"
    smoothness: Smoothness = "3/2"

    @property
    def states(self) -> tuple[str, ...]:
        """Return the names of the torque's states, which have unit variance."""
        return (TORQUE,) if self.smoothness == "1/2" else (TORQUE, RATE)

    def rate(self, time: Any) -> Any:
        """Return the rate [1/s] of the exponential in the covariance, for a correlation time [s]."""
        return (1.0 if self.smoothness == "1/2" else math.sqrt(3.0)) / time

    def intensity(self, time: Any) -> Any:
        """Return the intensity of the white noise that drives the last state of the torque."""
        return self.rate(time) * (2.0 if self.smoothness == "1/2" else 4.0)

    def linear(self, time: Any) -> dict[tuple[str, str], Any]:
        """Return the entries of A for the torque's states, which are uncorrelated at equal times."""
        rate = self.rate(time)
        if self.smoothness == "1/2":
            return {(TORQUE, TORQUE): -rate}
        return {(TORQUE, RATE): rate, (RATE, TORQUE): -rate, (RATE, RATE): -2.0 * rate}


def torque_gain(model: Model, torque: MissingTorque, p: Named, linear: Linear) -> Any:
    """Return the rate of change of the inertia's speed state per unit of torque.

    If the inertia is before a gear, the torque acts on the inertia's side of the gear.

    Raises `ValueError` if the rig has no such inertia.
    """
    here = next((i for i in model.roles.inertias if i.name == torque.at), None)
    if here is not None and here.speed in model.states:
        row, motor = here.speed, model.roles.motor(here.name)
        if (row, here.load) in linear.B:
            return -linear.B[row, here.load]
        if (row, here.torque) in linear.B:
            return linear.B[row, here.torque]
        if motor is not None and (row, motor.current) in linear.A and motor.torque_constant in p:
            return linear.A[row, motor.current] / p[motor.torque_constant]
        turning = [i for i in model.roles.inertias if i.speed == row and i.inertia in p]
        each: list[Any] = [p[i.inertia] / i.reduction**2 for i in turning]
        if each:
            return 1.0 / (sum(each[1:], each[0]) * here.reduction)
    raise ValueError(
        f"the model {model.name} has no inertia at {torque.at.replace('_', ' ')} that a torque could "
        "act on"
    )


@dataclass(frozen=True, slots=True)
class AugmentedModel(WrappedModel):
    """The augmented model has the states of a `rig`, then those of a missing torque.

    The size and the correlation time of the torque are further parameters. An unrestrained rig can
    turn as a whole without any restoring torque. Its last angle is then a state only if it is
    `observable`, and all other angles are relative to the last.
    """

    torque: MissingTorque
    is_unrestrained: bool = False
    observable: bool = True

    frictions: ClassVar[tuple[()]] = ()  # no friction changes its sign in this model

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the rig's parameters, then size and correlation time of the torque."""
        return (*self.rig.parameters, SIZE, TIME)

    @property
    def states(self) -> tuple[str, ...]:
        """Return the rig's states, then those of the torque."""
        return (*self.rig_states, *self.torque.states)

    @property
    def rig_states(self) -> tuple[str, ...]:
        """Return the states that belong to the rig."""
        left_out = None if self.observable else self._last
        return tuple(name for name in self.rig.states if name != left_out)

    @property
    def _last(self) -> str:
        return self.rig.angles[-1]

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        linear = self.rig.linear(p)
        a, b, c = dict(linear.A), dict(linear.B), dict(linear.c)
        if self.is_unrestrained:
            a, b = self._relative(a), self._relative(b)
            constant = self._relative({(row, ""): value for row, value in c.items()})
            c = {row: value for (row, _), value in constant.items()}
        push = torque_gain(self.rig, self.torque, p, linear)
        a |= self.torque.linear(p[TIME])
        a[self.roles.inertia(self.torque.at).speed, TORQUE] = push * p[SIZE]
        return Linear(A=a, B=b, c=c)

    def _relative(self, entries: Mapping[tuple[str, str], Any]) -> dict[tuple[str, str], Any]:
        """Subtract the last angle's row from the rows of all other angles, and drop its column."""
        relative: dict[tuple[str, str], Any] = {}
        for (row, column), value in entries.items():
            rows = [(row, value)]
            if row == self._last:
                rows = [(name, -value) for name in self._others] + rows * self.observable
            for name, entry in rows if column != self._last else []:
                index = (name, column)
                relative[index] = relative[index] + entry if index in relative else entry
        return relative

    @property
    def _others(self) -> list[str]:
        return [name for name in self.rig.angles if name != self._last]

    def channel_weights(self, weights: Mapping[str, float]) -> tuple[float, ...]:
        """Convert a channel's weights of the rig's states to weights of the augmented `states`."""
        by_state = dict(weights)
        if self.is_unrestrained:
            by_state[self._last] = sum(weights.get(name, 0.0) for name in self.rig.angles)
        return tuple(float(by_state.get(name, 0.0)) for name in self.states)

    def initial_state(self, start: Mapping[str, float]) -> tuple[float, ...]:
        """Convert the rig's start values, by state, to values of the augmented `states`."""
        by_state = dict(start)
        if self.is_unrestrained:
            last = start.get(self._last, 0.0)
            by_state |= {name: start.get(name, 0.0) - last for name in self._others}
        return tuple(float(by_state.get(name, 0.0)) for name in self.states)

    def to_rig_states(self, states: Array) -> dict[str, Array]:
        """Return the observable states of the rig by name, from augmented `states (..., n)`."""
        by_state = {name: states[..., self.states.index(name)] for name in self.rig_states}
        if not self.is_unrestrained:
            return by_state
        if not self.observable:
            return {name: x for name, x in by_state.items() if name not in self._others}
        return by_state | {name: by_state[name] + by_state[self._last] for name in self._others}


@dataclass(frozen=True, slots=True)
class LoadedModel(WrappedModel):
    """The loaded model takes the missing torque as a measured input, `TORQUE`."""

    torque: MissingTorque

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the rig's inputs, then the torque."""
        return (*self.rig.inputs, TORQUE)

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        linear = self.rig.linear(p)
        push = torque_gain(self.rig, self.torque, p, linear)
        b = {**linear.B, (self.roles.inertia(self.torque.at).speed, TORQUE): push}
        return Linear(A=linear.A, B=b, c=linear.c)


def augment(
    rig: Model, torque: MissingTorque, weights: Sequence[Mapping[str, float]]
) -> AugmentedModel:
    """Return the rig with its missing torque; `weights` has each channel's weights by state.

    The weights decide whether any channel shows a rotation of the rig as a whole.
    """
    angle_names = rig.angles
    # With equal values of all parameters, torques might cancel by coincidence.
    distinct = {name: 1.0 + math.sqrt(k + 2) % 1 for k, name in enumerate(rig.parameters)}
    matrix = dynamics(rig.linear(distinct), rig.states, 1)
    free = len(angle_names) > 1 and steady_state.rotates_freely(
        matrix, [rig.states.index(name) for name in angle_names]
    )
    shown = any(sum(each.get(name, 0.0) for name in angle_names) != 0.0 for each in weights)
    return AugmentedModel(rig, torque, free, shown or not free)
