"""Where the energy of a rig goes, by its equations: to losses or into store.

Losses are resistance, damping and friction.  Of a rig of a motor, a shaft and rotor 1 every entry
of x' = A x + B u + c is a power once it is known what its rows weigh: j_1 by the load `t_1`, the
inertia at the gearbox by the shaft, which acts at both of its ends alike, l_m by the voltage `v`.
What a parameter takes is what is missing where it is zero.

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
from bayesdrill.rig.models.linear import STATES, Model, dynamics
from bayesdrill.rig.simulators.contract import Simulator, Steps

Whole = NDArray[np.intp]

# Roles of parameters that take power, where they are named.
LOSSES = (
    *("motor.resistance", "motor.series", "motor.damping"),
    *("shaft.damping", "rotor.damping", "motor.friction"),
)
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
    """Tell whether rows of the rig can be weighed."""
    p = dict.fromkeys(model.parameters, 1.0)
    if not {*model.states} <= {model.roles[role] for role in STATES}:
        return False
    try:
        _weights(model, p)
    except (KeyError, ZeroDivisionError):
        return False
    return True


def energies(rig: Simulator, full: Array) -> Energies:
    """Return the energies of one walker, `full (P,)`, at each of the rig's steps."""
    model = rig.model
    steps = rig.steps(full[None])
    p = {name: float(x) for name, x in zip(model.parameters, full, strict=False)}
    z = _extended(model, steps)
    forms, stored = _forms(model, p)
    x = len(model.states)
    step_energy = np.zeros((len(forms), len(z)))
    for rows, fixed_states in _patterns(model, z[:, :x]):
        over = _over_step(
            _generator(model, p, fixed_states), np.stack([*forms.values()]), steps.span
        )
        step_energy[:, rows] = np.einsum("nz,fzy,ny->fn", z[rows], over, z[rows], optimize=True)
    whole = np.concatenate(
        [np.zeros((len(forms), 1)), np.cumsum(step_energy, axis=1)[:, :-1]], axis=1
    )
    named = dict(zip(forms, whole, strict=True))
    given = {name: named.pop(name) for name in model.inputs if name in named}
    converted = named.pop("")
    states = z[:, :x]
    return Energies(
        t=steps.t,
        given=given,
        lost={name: -some for name, some in named.items()},
        converted=converted,
        stored=0.5 * np.einsum("nx,xy,ny->n", states, stored, states, optimize=True),
    )


def _weights(model: Model, p: Mapping[str, float]) -> dict[str, float]:
    """Return the weights of rows: the inertias as the shaft has them, and the inductance."""
    linear: Any = model.linear(p)
    motor, rotor = model.roles.motor, model.roles.rotor
    inertia = -1.0 / linear.B[rotor.speed, rotor.load]
    stiffness = inertia * linear.A[rotor.speed, motor.angle]
    return {
        rotor.speed: inertia,
        motor.speed: stiffness / linear.A[motor.speed, rotor.angle],
        motor.current: 1.0 / linear.B[motor.current, motor.voltage],
    }


def _forms(model: Model, p: Mapping[str, float]) -> tuple[dict[str, Array], Array]:
    """Return powers into the rig as forms of (states, 1, inputs, slopes, efforts).

    They are of inputs, parameters, frictions, and, named by nothing, of the rest; with twice the
    stored energy as a form of states.
    """
    linear, places, weights = model.linear(p), _places(model), _weights(model, p)
    n = len(model.states) + 1 + 2 * len(model.inputs) + len(model.frictions)
    stored = np.diag([weights.get(name, 0.0) for name in model.states])
    motor, rotor = model.roles.motor, model.roles.rotor
    ends = [model.states.index(name) for name in (rotor.angle, motor.angle)]
    spring = weights[rotor.speed] * float(np.asarray(linear.A[rotor.speed, motor.angle]))
    stored[np.ix_(ends, ends)] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    forms: dict[str, Array] = {}
    for (row, name), value in linear.B.items():
        form = forms.setdefault(name, np.zeros((n, n)))
        form[model.states.index(row), places[name]] += weights[row] * float(np.asarray(value))
    whole = _autonomous(model, p, stored, n)
    remainder = whole.copy()
    for name in (model.roles[role] for role in LOSSES):
        if name in model.parameters:
            forms[name] = whole - _autonomous(model, {**p, name: 0.0}, stored, n)
            remainder -= forms[name]
    return {**forms, "": remainder}, stored


def _autonomous(model: Model, p: Mapping[str, float], stored: Array, n: int) -> Array:
    """Return the form x' S (A x + c)."""
    linear, x = model.linear(p), len(model.states)
    form = np.zeros((n, n))
    form[:x, :x] = stored @ dynamics(linear, model.states, 1)[0]
    for row, value in linear.c.items():
        form[:x, x] += stored[:, model.states.index(row)] * float(np.asarray(value))
    return form


def _extended(model: Model, steps: Steps) -> Array:
    """Return `(N, Z)` of one walker: states, 1, inputs and their slopes, efforts."""
    n = len(steps.t)
    felt = [steps.felt[name][0] for name in model.inputs]
    slopes = [steps.slopes[name][0] for name in model.inputs]
    driven = np.stack([*felt, *slopes], axis=1) if felt else np.empty((n, 0))
    motion = steps.motion
    return np.concatenate([motion.states[0], np.ones((n, 1)), driven, motion.efforts[0]], axis=1)


def _places(model: Model) -> dict[str, int]:
    """Return the indices of inputs and efforts in that."""
    x, frictions = len(model.states), model.frictions
    first = x + 1 + 2 * len(model.inputs)
    places = {name: x + 1 + k for k, name in enumerate(model.inputs)}
    return places | {friction.name: first + k for k, friction in enumerate(frictions)}


def _generator(model: Model, p: Mapping[str, float], fixed_states: Sequence[str]) -> Array:
    """Return how what `_extended` has changes with time, where some states do not."""
    linear, x, places = model.linear(p), len(model.states), _places(model)
    u = len(model.inputs)
    n = x + 1 + 2 * u + len(model.frictions)
    generator = np.zeros((n, n))
    generator[:x, :x] = dynamics(linear, model.states, 1)[0]
    for row, value in linear.c.items():
        generator[model.states.index(row), x] = np.asarray(value).item()
    for (row, name), value in linear.B.items():
        generator[model.states.index(row), places[name]] += np.asarray(value).item()
    generator[range(x + 1, x + 1 + u), range(x + 1 + u, x + 1 + 2 * u)] = 1.0
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
        names = [
            (friction.against, friction.holds)
            for friction, on in zip(frictions, pattern, strict=True)
            if on
        ]
        fixed_states = tuple(name for pair in names for name in pair if name is not None)
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
