"""Change a posterior: add optional effects to its rig model, or change the gear ratio."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.formulas import expression
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.priors import Uniform
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.models.friction import DIRECTION
from bayesdrill.rig.models.linear import Linear, Model, with_named
from bayesdrill.rig.models.roles import GEAR_POWERS, Roles

ZERO = np.zeros(1)


@dataclass(frozen=True, slots=True)
class Lack:
    """A lack is an effect that may be missing; `dry` friction changes its sign with the speed."""

    name: str
    parameter: str
    description: str
    dry: bool


def lacks(roles: Roles) -> tuple[Lack, ...]:
    """Return effects that may be missing; inertias with the same speed share one dry friction."""
    inertias, several = roles.inertias, len(roles.motors) > 1
    rubs = {i.speed: i for i in reversed(inertias) if i.sliding}.values()
    drop = "voltage_drop", "a voltage drop of driver and brushes"
    dry = [(f"friction_{i.name}", i.sliding, f"dry friction {i.at}") for i in inertias if i in rubs]
    for m in roles.motors:
        name, words = (f"_{m.inertia}", f" of {m.words}") if several else ("", "")
        dry.append((f"{drop[0]}{name}", m.drop, f"{drop[1]}{words}"))
    dry += [(f"drag_{i.name}", i.drag, f"quadratic drag {i.at}") for i in inertias]
    damped = [(f"damping_{i.name}", i.damping, f"viscous damping {i.at}") for i in inertias]
    damped += [(f"damping_{s.name}", s.damping, f"damping of {s.words}") for s in roles.shafts]
    effects = (effect for effect in (*dry, *damped) if effect[1])
    return tuple(Lack(*effect, dry=effect in dry) for effect in effects)


def rig_candidates(
    observations: Sequence[Observation], full: Array, *, measured: bool = False
) -> dict[str, float]:
    """Return parameters of optional effects that the rig does not have yet, with upper limits.

    The limits follow from states at the parameters `full (1, P)`: simulated states or, if `measured`,
    states that channels show.
    """
    model = observations[0].response.model
    has, taken = {*model.parameters}, set[str]()
    for i, other in itertools.permutations(model.roles.inertias, 2):
        if i.speed == other.speed:
            # Inertias with the same speed state share one friction and one damping.
            taken |= {other.sliding} if {i.sliding, i.efficiency} & has else set()
            taken |= {other.damping} if i.damping in has else set()
    offered = {name for name, needs in model.offers.items() if {*needs} <= has} - has - taken
    names = [lack.parameter for lack in lacks(model.roles) if lack.parameter in offered]
    if not names:
        return {}
    motion = measured_motion if measured else state_motion
    motions = [(rig_parameters(each, full), motion(each, full)) for each in observations]
    sizes = {
        name: max(_size(with_named(model, (name,)), name, p, states) for p, states in motions)
        for name in names
    }
    return {name: size for name, size in sizes.items() if size > 0}


def rig_parameters(observation: Observation, full: Array) -> dict[str, float]:
    """Return the rig's parameters by name, taken from all parameters `full (1, P)`."""
    return {name: float(x[0]) for name, x in observation.rig_parameters(full).items()}


def state_motion(observation: Observation, full: Array) -> Array:
    """Return all states `(T, X)` at the times of samples, simulated with parameters `full (1, P)`."""
    return np.asarray(observation.states(full)[0])


def measured_motion(observation: Observation, full: Array) -> Array:
    """Return states `(T, X)` from channels if these show all angles; missing values are simulated."""
    experiment, model = observation.experiment, observation.response.model
    simulated = state_motion(observation, full)
    shown = dict(zip(experiment.names, experiment.y.T, strict=True))
    if not {*model.angles} <= {*shown}:
        return simulated
    pairs = zip(model.states, simulated.T, strict=True)
    measured = np.stack([shown.get(name, motion) for name, motion in pairs], axis=1)
    return np.where(np.isnan(measured), simulated, measured)


def _size(model: Model, name: str, p: Mapping[str, float], states: Array) -> float:
    """Return the value at which a parameter acts as strongly as all other terms on a state."""
    without, alone = (model.linear({**p, name: value}) for value in (0.0, 1.0))
    named = dict(zip(model.states, states.T, strict=True))
    sizes = [0.0]
    for row in model.states:
        acting = _rates(without, row, named, model.angles)
        changed = [(k, x) for k, x in alone.A.items() if k[0] == row and x != without.A.get(k, 0.0)]
        added = sum((np.asarray(x - without.A.get(k, 0.0)) * named[k[1]] for k, x in changed), ZERO)
        for friction in model.frictions:
            if name in friction.law.parameters and (row, friction.name) in alone.B:
                push, speed = np.asarray(alone.B[row, friction.name]), named[friction.against]
                seen = {state: named.get(state, ZERO) for state in friction.law.seen}
                seen[DIRECTION] = np.sign(speed)
                law = friction.law.size
                none, unit = (law({**p, name: x}, np.abs(speed), seen) for x in (0.0, 1.0))
                added = added + push * np.sign(speed) * (unit - none)
        if (size := float(np.sqrt(np.mean(added**2)))) > 0:
            sizes.append(acting / size)
    return max(sizes)


def _rates(linear: Linear, row: str, named: Mapping[str, Array], angles: tuple[str, ...]) -> float:
    """Return the root mean square of the summed magnitudes of all terms that act on the state `row`.

    Springs act by differences of angles, so the terms of angles are summed before taking magnitudes.
    """
    terms = [(k[1], x * named[k[1]]) for k, x in linear.A.items() if k[0] == row]
    rates: dict[str, list[float]] = {}
    for (state, by), x in linear.A.items():
        rates.setdefault(state, []).append(float(x) if state != by else math.nan)
    # A state is an angle, too, if its rate is another state or an input.
    turned = {*angles, *(state for state, each in rates.items() if each == [1.0])}
    springs = [part for state, part in terms if state in turned]
    parts = [sum(springs, ZERO), *(part for state, part in terms if state not in turned)]
    return float(np.sqrt(np.mean(sum(map(np.abs, parts), ZERO) ** 2)))


def with_candidates(posterior: Posterior, theta: Array) -> Posterior:
    """Add parameters of missing effects as unknowns, with limits from the motion at `theta (D,)`."""
    sizes = rig_candidates(posterior.likelihood.observations, posterior.space.full(theta[None]))
    free = []
    for name, size in sizes.items():
        symbol, prior = Symbol(name, "", "", "", ""), Uniform(0.0, size)
        free.append(Unknown(symbol=symbol, role="sensor", prior=prior, start=0.0))

    def convert(observation: Observation) -> Observation:
        response = observation.response
        return observation.for_rig(with_named(response.model, [*sizes]), response.sensing)

    return posterior.edit(free=free, convert=convert)


def with_gear(posterior: Posterior, times: float) -> Posterior:
    """Return the posterior with the gear reduction factor multiplied by `times`.

    Another gear is equivalent to this gear with other parameters at the motor, so the simulators
    need not be compiled again.
    """
    space, model = posterior.space, posterior.likelihood.observations[0].response.model
    powers = {n: 1 for m in model.roles.motors for n in (m.torque_constant, m.back_emf)}
    at_motor = [name for name in model.parameters if model.roles.side(name) == "motor"]
    powers |= {name: GEAR_POWERS[model.symbols[name].unit] for name in at_motor}
    relations = dict(space.relations)

    def geared(observation: Observation) -> Observation:
        called = dict(zip(observation.response.parameters, observation.parameters, strict=True))
        for name in (name for name in powers if name in called):
            symbol, factor = called[name], float(times ** -powers[name])
            formula = expression(f"{symbol}*{factor!r}", [symbol]).substituted(space.relations)
            called[name] = f"geared_{symbol}"
            relations[called[name]] = formula
        return dataclasses.replace(observation, parameters=[*called.values()])

    observations = tuple(map(geared, posterior.likelihood.observations))
    added = (name for name in relations if name not in space.relations)
    wider = dataclasses.replace(space, model=(*space.model, *added), relations=relations)
    likelihood = Likelihood(tuple(each.bind(wider) for each in observations), wider)
    return dataclasses.replace(posterior, space=wider, likelihood=likelihood)
