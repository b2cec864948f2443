"""Where the energy of a rig goes, by its equations: to losses or into store.

Inertias, shafts and circuits store it, as forms x' S x / 2 of the states, and pendulums by their
height.  Each input gives a power; resistances, dampings and frictions take one.  What else the rate
x' S (A x + B u + c) has is `converted`.  Of which rows an inertia is, the roles of the rig say; how
much there is of it in all, how much its rows change with it.

Over a step with constant efforts and straight inputs all of it is exact: integrals of squares of
exponentials, by doubling.  Where a speed changes its sign within a step, the effort is the mean
over it, and the sum closes to the order of the step; `Energies.open` says by how much it does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.exponential import AugmentedMatrix, with_slopes
from bayesdrill.rig.models.friction import Gravity
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import GROUND, InertiaRoles, MotorRoles, ShaftRoles
from bayesdrill.rig.simulators.contract import Simulator, Steps

Whole = NDArray[np.intp]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
SHORT = 0.25  # of the fastest motion: a span over which quadrature is exact to rounding


@dataclass(frozen=True, slots=True, kw_only=True)
class Energies:
    """The energy balance of a rig [J], from the first of the times `t (N,)` on.

    `given` by inputs; `lost`, to parameters and frictions by name; `converted`: what a motor gives
    beyond what it takes, where k_T is not k_e; `stored`: at each time.
    """

    t: Array
    given: Mapping[str, Array]
    lost: Mapping[str, Array]
    converted: Array
    stored: Array

    @property
    def open(self) -> Array:
        """What is not accounted for `(N,)`: zero, but for steps in which a speed changes its sign."""
        came = sum(self.given.values(), self.converted) + self.stored[0]
        return np.asarray(came - sum(self.lost.values(), self.stored))


def can_balance(model: Model) -> bool:
    """Tell whether it is known of every state of the rig what it stores."""
    roles, p = model.roles, {*model.parameters}
    weighed = {i.speed for i in roles.inertias if i.inertia in p}
    weighed |= {motor.current for motor in roles.motors if motor.inductance in p}
    turned = {*model.angles}
    return {*model.states} - turned <= weighed and turned <= roles.states


def energies(rig: Simulator, full: Array) -> Energies:
    """Return the energies of one walker, `full (P,)`, at each of the rig's steps."""
    model = rig.model
    steps = rig.steps(full[None])
    p = {name: float(x) for name, x in zip(model.parameters, full, strict=False)}
    z, powers = _extended(model, steps, p), _Powers(model, p)
    forms = powers.forms()
    x = len(model.states)
    step_energy = np.zeros((len(forms), len(z)))
    for rows, fixed_states in _patterns(model, z[:, :x]):
        generator = _generator(model, p, fixed_states)
        over = _over_step(generator, np.stack([*forms.values()]), steps.span)
        step_energy[:, rows] = np.einsum("nz,fzy,ny->fn", z[rows], over, z[rows], optimize=True)
    whole = np.cumsum(np.pad(step_energy, ((0, 0), (1, 0)))[:, :-1], axis=1)
    named = dict(zip(forms, whole, strict=True))
    given = {name: named.pop(name) for name in model.inputs if name in named}
    converted = named.pop("")
    states = z[:, :x]
    stored = 0.5 * np.einsum("nx,xy,ny->n", states, powers.stored, states, optimize=True)
    heights = (_height(model, gravity, p, states) for gravity in model.gravities)
    stored = stored + sum(heights, np.zeros(len(z)))
    return Energies(t=steps.t, given=given, lost=named, converted=converted, stored=stored)


class _Powers:
    """Powers of a rig at parameters `p`, as forms of (states, 1, inputs, slopes, efforts).

    `rates`: how these change with time; `stored`: twice the stored energy, as a form of states.
    """

    def __init__(self, model: Model, p: Mapping[str, float]) -> None:
        self.model, self.roles, self.p, self.places = model, model.roles, p, _places(model)
        self.rates = _generator(model, p, ())
        self.stored = self._stored()

    def forms(self) -> dict[str, Array]:
        """Return what inputs give, frictions and parameters take, and, named by nothing, the rest."""
        x = len(self.model.states)
        rest = np.zeros_like(self.rates)
        rest[:x] = self.stored @ self.rates[:x]
        given = {name: self._given(name) for name in self.model.inputs}
        taken = {friction.name: -self._column(friction.name) for friction in self.model.frictions}
        taken |= {n: self.p[n] * np.outer(*rows) for n, *rows in self._losses() if n in self.p}
        lifted = sum(self._column(gravity.name) for gravity in self.model.gravities)
        rest += sum(taken.values(), np.zeros_like(rest)) - sum(given.values()) - lifted
        return {**{name: form for name, form in given.items() if form.any()}, **taken, "": rest}

    def _stored(self) -> Array:
        """Return the form of inertias, springs (a pendulum is nearly one) and inductances."""
        x = len(self.model.states)
        weights = {m.current: self.p.get(m.inductance, 0.0) for m in self.roles.motors}
        weights |= {i.speed: self._inertia(i) for i in self.roles.inertias if i.inertia in self.p}
        stored = np.diag([weights.get(name, 0.0) for name in self.model.states])
        for shaft in self.roles.shafts:
            twist = self._twist(shaft, "angle")[:x]
            stored += self.p.get(shaft.stiffness, 0.0) * np.outer(twist, twist)
        for inertia in self.roles.inertias:
            turned = self._motion(inertia.name, "angle")[:x]
            stored += self.p.get(inertia.weight, 0.0) * np.outer(turned, turned)
        return stored

    def _inertia(self, inertia: InertiaRoles) -> float:
        """Return the inertia of all that turns with its speed, as that state has it."""
        name = inertia.inertia
        varied: dict[str, Any] = {**self.p, name: Dual(self.p[name], 1.0)}
        linear = self.model.linear(varied)
        items = [(row, x) for (row, _), x in (*linear.A.items(), *linear.B.items())]
        entries = (dual(x) for row, x in (*items, *linear.c.items()) if row == inertia.speed)
        each = [x for x in entries if x.slope]
        return float(-each[0].value / each[0].slope / inertia.reduction**2) if each else 0.0

    def _row(self, name: str) -> Array:
        """Return the row that picks a state or an input; zeros for what is neither."""
        row = np.zeros(len(self.rates))
        if name in self.places:
            row[self.places[name]] = 1.0
        return row

    def _motion(self, name: str, kind: str) -> Array:
        """Return the row of the `angle` or `speed` of an inertia itself; zeros for the ground."""
        if name == GROUND:
            return self._row("")
        inertia = self.roles.inertia(name)
        state = inertia.angle if kind == "angle" else inertia.speed
        return self._row(state) / inertia.reduction

    def _twist(self, shaft: ShaftRoles, kind: str) -> Array:
        return np.asarray(self._motion(shaft.ends[0], kind) - self._motion(shaft.ends[1], kind))

    def _current(self, motor: MotorRoles) -> Array:
        """Return the row of a current; where no inductance delays it, by Ohm's law."""
        if motor.current in self.places or motor.resistance not in self.p:
            return self._row(motor.current)
        turned = self.p.get(motor.back_emf, 0.0) * self._motion(motor.inertia, "speed")
        resistance = self.p[motor.resistance] + self.p.get(motor.series, 0.0)
        return np.asarray((self._row(motor.voltage) - turned) / resistance)

    def _column(self, name: str) -> Array:
        """Return the power of a column of B."""
        x, k = len(self.model.states), self.places[name]
        form = np.zeros_like(self.rates)
        form[:x, k] = self.stored @ self.rates[:x, k]
        return form

    def _given(self, name: str) -> Array:
        """Return the power of an input: of a voltage by its current, of a speed by what it moves."""
        for motor in self.roles.motors:
            if motor.voltage == name:
                return np.outer(self._row(name), self._current(motor))
        moved = [inertia for inertia in self.roles.inertias if inertia.speed == name]
        return sum(map(self._imposed, moved)) if moved else self._column(name)

    def _imposed(self, inertia: InertiaRoles) -> Any:
        """Return the power that moves an inertia against its shafts, its damping and its motor."""
        torque = self.p.get(inertia.damping, 0.0) * self._motion(inertia.name, "speed")
        if motor := self.roles.motor(inertia.name):
            torque = torque - self.p.get(motor.torque_constant, 0.0) * self._current(motor)
        for shaft in self.roles.shafts:
            if inertia.name in shaft.ends:
                sign = 1.0 if shaft.ends[0] == inertia.name else -1.0
                spring = self.p.get(shaft.stiffness, 0.0) * self._twist(shaft, "angle")
                damper = self.p.get(shaft.damping, 0.0) * self._twist(shaft, "speed")
                torque = torque + sign * (spring + damper)
        return np.outer(self._motion(inertia.name, "speed"), torque)

    def _losses(self) -> Iterator[tuple[str, Array, Array]]:
        """Yield parameters that take power, each with the rows whose product it is times."""
        motors, driven = self.roles.motors, {motor.inertia for motor in self.roles.motors}
        for motor in motors:
            for name in (motor.resistance, motor.series):
                yield name, self._current(motor), self._current(motor)
        speeds = {i: self._motion(i.name, "speed") for i in self.roles.inertias}
        yield from ((i.damping, w, w) for i, w in speeds.items() if i.name in driven)
        for shaft in self.roles.shafts:
            yield shaft.damping, self._twist(shaft, "speed"), self._twist(shaft, "speed")
        yield from ((i.damping, w, w) for i, w in speeds.items() if i.name not in driven)
        unit = np.eye(len(self.rates))[len(self.model.states)]
        yield from ((i.friction, w, unit) for i, w in speeds.items())


def _height(model: Model, gravity: Gravity, p: Mapping[str, float], states: Array) -> Array:
    """Return what a pendulum stores `(N,)` beyond a spring."""
    turned = states[:, model.states.index(gravity.angle)] / gravity.reduction
    tilt = p[gravity.tilt] if gravity.tilt else 0.0
    return np.asarray(p[gravity.weight] * (1.0 - np.cos(turned + tilt) - 0.5 * turned**2))


def _extended(model: Model, steps: Steps, p: Mapping[str, float]) -> Array:
    """Return `(N, Z)` of one walker: states, 1, inputs and their slopes, efforts."""
    n = len(steps.t)
    felt = [steps.felt[name][0] for name in model.inputs]
    slopes = [steps.slopes[name][0] for name in model.inputs]
    driven = np.stack([*felt, *slopes], axis=1) if felt else np.empty((n, 0))
    motion, named = steps.motion, dict(zip(model.states, steps.motion.states[0].T, strict=True))
    weights = [
        gravity.torque(p, named[gravity.angle] + 0.5 * steps.span * named[gravity.speed])
        for gravity in model.gravities
    ]
    efforts = np.column_stack([motion.efforts[0], *weights])
    return np.concatenate([motion.states[0], np.ones((n, 1)), driven, efforts], axis=1)


def _driven(model: Model) -> tuple[str, ...]:
    """Return the columns of that after the one."""
    rubbing = (friction.name for friction in model.frictions)
    lifted = (gravity.name for gravity in model.gravities)
    return (*with_slopes(model.inputs, first_order=True), *rubbing, *lifted)


def _places(model: Model) -> dict[str | None, int]:
    """Return the indices of states, inputs and efforts in that."""
    return {name: k for k, name in enumerate((*model.states, None, *_driven(model)))}


def _generator(model: Model, p: Mapping[str, float], fixed_states: Sequence[str]) -> Array:
    """Return how what `_extended` has changes with time, where some states do not."""
    driven = _driven(model)
    generator = np.zeros((len(model.states) + 1 + len(driven),) * 2)
    entries = AugmentedMatrix(model, driven, constant=())([p[n] for n in model.parameters])
    for row, column, value in entries:
        generator[row, column] += value
    generator[[model.states.index(name) for name in fixed_states]] = 0.0
    return generator


def _patterns(model: Model, states: Array) -> Iterator[tuple[Whole, tuple[str, ...]]]:
    """Yield steps `(N,)` with the same fixed states, by frictions that stick through all of them."""
    frictions = model.frictions
    still = np.zeros((len(states), len(frictions)), dtype=bool)
    for e, friction in enumerate(frictions):
        zero = states[:, model.states.index(friction.against)] == 0.0
        still[:-1, e] = zero[:-1] & zero[1:]
    for pattern in np.unique(still, axis=0):
        stuck = [friction for friction, on in zip(frictions, pattern, strict=True) if on]
        pairs = ((friction.against, friction.holds) for friction in stuck)
        fixed_states = tuple(name for pair in pairs for name in pair if name is not None)
        yield np.flatnonzero((still == pattern).all(axis=1)), fixed_states


def _over_step(generator: Array, forms: Array, span: float) -> Array:
    """Return integrals over a step of z' F z for `forms (f, Z, Z)`, as forms of z at its beginning.

    Over a short span by quadrature; then twice as long at a time.
    """
    fastest = max(float(np.abs(np.linalg.eigvals(generator)).max()) * span, 1e-300)
    doublings = max(0, int(np.ceil(np.log2(fastest / SHORT))))
    short = span / 2**doublings
    at = scipy.linalg.expm(generator * (0.5 * short * (NODES + 1.0))[:, None, None])
    whole = np.einsum("k,kxz,fxy,kyw->fzw", 0.5 * short * WEIGHTS, at, forms, at, optimize=True)
    once = scipy.linalg.expm(generator * short)
    for _ in range(doublings):
        whole = whole + once.T @ whole @ once
        once = once @ once
    return np.asarray(whole)
