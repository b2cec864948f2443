"""Check whether values can be those of a real rig, and whether priors are too wide.

No finding is an error; `report.findings` has the sentences.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.analysis.identifiability.information import Information, SensitivityStudy
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.findings import Finding
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import Prior, prior_log_sd, prior_sd
from bayesdrill.rig.models.linear import Model, dynamics

APPRECIABLE = 0.05  # smallest relative deviation that is reported
MOST_DRAWS = 2000  # draws are thinned to about this number
UNSTABLE = 1e-9  # real part of a pole / largest |pole|, below which it may be a rounding error
FEW = 0.01  # fraction of the draws or samples, below which a finding is not reported
UNHEARD_OF = 1e-6  # prior mass next to each end in which no nominal value should lie
SAME_GEAR = 0.02  # relative tolerance of gear ratios, as data sheets round them

# Values are from the paper's Table 1. The paper calls 188 mm the radius of rotor 1, but its inertia
# shows that 188 mm is the diameter. The modulus is that of steel, as the paper gives none.
SHAFT_LENGTH, SHAFT_DIAMETER, STEEL = 2.4, 3e-3, 79.3e9  # m, m, Pa
ROTOR_MASS, ROTOR_DIAMETER = 6.4, 0.188  # kg, m
GEOMETRY: Mapping[str, tuple[float, str]] = {  # keys are names of shafts and inertias
    "shaft": (
        STEEL * math.pi * SHAFT_DIAMETER**4 / (32 * SHAFT_LENGTH),
        "a steel shaft of 2.4 m and 3 mm has",
    ),
    "rotor_1": (ROTOR_MASS * ROTOR_DIAMETER**2 / 8, "a disc of 6.4 kg and 188 mm across has"),
}


def plausibility_of_priors(problem: Problem) -> Iterator[Finding]:
    """Yield nominal values that a prior makes next to impossible without excluding them."""
    for name, prior in problem.posterior.space.priors.items():
        if (value := problem.nominal.get(name)) is None:
            continue
        low, high = (float(x) for x in prior.quantile(np.array([UNHEARD_OF, 1 - UNHEARD_OF])))
        if not low <= value <= high and prior.low < value < prior.high:
            numbers = {"value": value, "low": low, "high": high, "percent": 100 * 2 * UNHEARD_OF}
            yield Finding("unlikely nominal value", {"name": name}, numbers)


def of_roles(problem: Problem) -> Iterator[Finding]:
    """Yield a finding on states without a role, as checks of speeds and currents ignore them."""
    model = problem.model
    if others := [name for name in model.outer if name not in model.roles.states]:
        yield Finding("states without roles", {"model": model.name, "states": ", ".join(others)})


def plausibility_of_gear(problem: Problem) -> Iterator[Finding]:
    """Yield channels whose factor fits neither the shaft nor, with the gear ratio, the motor."""
    roles = problem.model.roles
    channels = [c for observation in problem.observations for c in observation.experiment.channels]
    for channel in {c.name: c for c in channels}.values():
        if len(channel.weights) > 1:
            continue
        ((state, times),) = channel.weights.items()
        here = [i for i in roles.inertias if state in (i.speed, i.angle)]
        geared = [inertia for inertia in here if inertia.reduction != 1.0]
        ratios = (1.0, *(abs(inertia.reduction) for inertia in geared))
        if geared and min(abs(abs(times) * ratio - 1) for ratio in ratios) > SAME_GEAR:
            fast, others = geared[0], {i.name for i in here} - {i.name for i in geared}
            behind = [shaft.words for shaft in roles.shafts if others & {*shaft.ends}]
            behind += [inertia.words for inertia in here if inertia.name in others]
            entry = f"model.{roles.gear}: {fast.reduction:.4g}" if roles.gear else "model.gears"
            names = {"channel": channel.name, "state": state, "fast": fast.words, "entry": entry}
            names |= {"moves": roles.motion.verb, "behind": behind[0]}
            yield Finding("another gear", names, {"times": times, "ratio": 1 / fast.reduction})


def plausibility_of_nominal(problem: Problem) -> tuple[Finding, ...]:
    """Return findings on nominal, fixed and start values, without repetitions."""
    space, model = problem.posterior.space, problem.model
    known = {**space.start, **problem.nominal, **space.fixed}
    known |= {name: float(relation.value(known)) for name, relation in space.relations.items()}
    findings: list[Finding] = []
    for observation in problem.observations:
        names = observation.named(model.parameters)
        values = {name: known[called] for name, called in names.items()}
        table = {n: x for n, x in values.items() if n in problem.published}
        table = {n: x for n, x in table.items() if x == problem.nominal[n]}
        stated = {
            n: x for n, x in values.items() if names[n] not in space.free or n in problem.nominal
        }
        findings += _energy_of_nominal(stated, model)
        findings += _geometry(table, model)
        findings += _poles(poles(model, {n: np.array([x]) for n, x in values.items()}), problem)
    return tuple(finding for k, finding in enumerate(findings) if finding not in findings[:k])


def plausibility_of_draws(
    problem: Problem, draws: Array, information: Information
) -> tuple[Finding, ...]:
    """Return findings on draws `(N, D)`; `information` is the information of the record alone."""
    model = problem.model
    thinned = draws[:: max(1, len(draws) // MOST_DRAWS)]
    values = problem.posterior.likelihood.rig_parameters(thinned)
    energy = _energy_of_draws(values, information, model)
    return (*energy, *_poles(poles(model, values), problem))


def plausibility_of_course(sensitivity: SensitivityStudy, theta: Array) -> Iterator[Finding]:
    """Yield frictions that drive, and servos that saturate, in the motion at `theta (D,)`."""
    yield from _driving_frictions(sensitivity, theta)
    yield from _saturations(sensitivity, theta)


def _saturations(sensitivity: SensitivityStudy, theta: Array) -> Iterator[Finding]:
    """Yield the fraction of samples with servos at their limits, or beyond their supply."""
    model, p = sensitivity.model, sensitivity.rig_at(theta)
    likelihood = sensitivity.likelihood
    full = likelihood.space.full(theta[None])
    for motor in (motor for motor in model.roles.motors if motor.goal):
        inertia, gain = model.roles.inertia(motor.inertia), p.get(motor.proportional, 1.0)
        largest, beyond = p.get(motor.limit, 1.0), list[Array]()
        for each, motion in zip(likelihood.observations, sensitivity.motions(theta), strict=True):
            x, row = dict(zip(model.states, motion.T, strict=True)), each.simulator_parameters(full)
            goal: Array | float = each.response.sensors.acting_input(motor.goal, row)
            if (servo := model.saturation) is not None and servo.goal == motor.goal:
                goal = servo.reference(p, each.experiment.t, goal)
            duty = gain * (goal - x[inertia.angle] / inertia.reduction)
            duty -= p.get(motor.derivative, 0.0) * x[inertia.speed] / inertia.reduction
            dead = gain * p.get(motor.band, 0.0)
            beyond.append(p[motor.duty] * (np.abs(duty) - dead) > largest)
        ratio = float(np.mean(np.concatenate(beyond)))
        names = {"motor": inertia.words, "limit": motor.limit}
        if motor.limit in p:
            yield Finding("servo that saturates", names, {"percent": 100 * ratio, "duty": largest})
        elif ratio > FEW:
            yield Finding("servo beyond its supply", names, {"percent": 100 * ratio})


def _driving_frictions(sensitivity: SensitivityStudy, theta: Array) -> Iterator[Finding]:
    """Yield frictions that drive instead of braking in the motion."""
    rig, p = sensitivity.model, sensitivity.rig_at(theta)
    for inertia in rig.roles.inertias:
        if inertia.friction not in p or inertia.speed not in sensitivity.states:
            continue
        column, moves = sensitivity.states.index(inertia.speed), rig.roles.motion.verb
        forwards = np.sign(p[inertia.friction] * inertia.reduction)
        speeds = [motion[:, column] for motion in sensitivity.motions(theta)]
        other_way = [forwards * w < -APPRECIABLE * np.abs(w).max() for w in speeds]
        fraction = float(np.mean(np.concatenate(other_way)))
        if fraction > FEW:
            drives = " and ".join(n for n in rig.inputs if rig.symbols[n].drives)
            names = {"inertia": inertia.words, "moves": moves, "drives": drives}
            names |= {"friction": inertia.friction, "sliding": inertia.sliding}
            yield Finding("friction that drives", names, {"percent": 100 * fraction})


def poles(model: Model, values: Mapping[str, Array]) -> NDArray[np.complex128]:
    """Return the eigenvalues `(W, X)` [1/s] of the dynamics at parameters `(W,)` each."""
    size = len(next(iter(values.values())))
    matrix = dynamics(model.linear(values), model.states, size)
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)


def _constants(values: Collection[str], model: Model) -> list[tuple[str, str]]:
    pairs = [(motor.torque_constant, motor.back_emf) for motor in model.roles.motors]
    return [pair for pair in pairs if {*pair} <= {*values}]


def _energy_of_nominal(values: Mapping[str, float], model: Model) -> Iterator[Finding]:
    motion = model.roles.motion
    for k_T, k_e in _constants(values, model):
        ratio = values[k_T] / values[k_e]
        if ratio > 1 + APPRECIABLE:
            names = {"constant": k_T, "back_emf": k_e}
            names |= {"newtons": motion.newtons, "angle": motion.angle}
            numbers = {"constant_value": values[k_T], "back_emf_value": values[k_e], "ratio": ratio}
            yield Finding("power of nominal values", names, numbers)


def _energy_of_draws(
    values: Mapping[str, Array], information: Information, model: Model
) -> Iterator[Finding]:
    for k_T, k_e in _constants(values, model):
        ratio = values[k_T] / values[k_e]
        fraction = float(np.mean(ratio > 1 + APPRECIABLE))
        if fraction <= FEW:
            continue
        powers = np.array([{k_T: 1.0, k_e: -1.0}.get(name, 0.0) for name in information.names])
        blind = bool(powers.any()) and not math.isfinite(information.bound(powers))
        middle = float(np.median(ratio))
        numbers = {"margin": 100 * APPRECIABLE, "percent": 100 * fraction, "ratio": middle}
        kind = "power of priors" if blind else "power of draws"
        yield Finding(kind, {"constant": k_T, "back_emf": k_e}, numbers)


def _geometry(values: Mapping[str, float], model: Model) -> Iterator[Finding]:
    names = {shaft.name: shaft.stiffness for shaft in model.roles.shafts}
    names |= {inertia.name: inertia.inertia for inertia in model.roles.inertias}
    for part, (expected, what) in GEOMETRY.items():
        name = names.get(part, "")
        value = values.get(name, expected)
        if abs(value / expected - 1) > APPRECIABLE:
            names = {"name": name, "unit": model.symbols[name].plain_unit, "part": what}
            percent = 100 * (value / expected - 1)
            numbers = {"value": value, "expected": expected, "percent": percent}
            yield Finding("geometry", names, numbers)


def _poles(poles: NDArray[np.complex128], problem: Problem) -> Iterator[Finding]:
    """Yield findings on `poles (W, X)`: one row is of nominal values, and several are of draws."""
    step = min(observation.experiment.dt for observation in problem.observations)
    size = np.abs(poles).max(axis=1)
    largest = poles.real.max(axis=1)
    fraction = float(np.mean(largest > UNSTABLE * size))
    if fraction > 0:
        pole = {"pole": float(largest.max())}
        yield Finding("unstable pole", {}, pole | _of_draws(poles, fraction))
    decay = np.abs(poles.real).max(axis=1)
    fraction = float(np.mean(decay * step > 1))
    if fraction > FEW:
        middle, model = float(np.median(decay)), problem.model
        motors = [motor for motor in model.roles.motors if motor.inductance in model.parameters]
        sets = " and ".join(f"{motor.inductance}/{motor.resistance}" for motor in motors)
        numbers = {"decay_ms": 1e3 / middle, "pole": -middle, "step_ms": 1e3 * step}
        yield Finding("fast decay", {"constants": sets}, numbers | _of_draws(poles, fraction))
    turns = np.abs(poles.imag).max(axis=1) / (2 * math.pi)
    fraction = float(np.mean(2 * turns * step > 1))
    if fraction > FEW:
        numbers = {"frequency": float(np.median(turns)), "rate": 1 / step}
        yield Finding("fast oscillation", {}, numbers | _of_draws(poles, fraction))


def _of_draws(poles: NDArray[np.complex128], fraction: float) -> dict[str, float]:
    return {} if len(poles) == 1 else {"percent": 100 * fraction}


DIFFUSE_DECADES = 2.1  # a prior is diffuse if a log-uniform prior with its sd spans more decades
DIFFUSE_RATIO = 100.0  # a prior is diffuse if its sd / (rms of the draws) is larger
# Posterior sd divided by prior sd, above which a wide prior hardly affects the evidence.
MAX_REMAINING_WIDTH = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusePrior:
    """The prior of `name` is diffuse: it spans `decades`, or its sd is `times` the unknown's size."""

    name: str
    decades: float | None = None
    times: float | None = None


def diffuse_priors(draws: Array, priors: Mapping[str, Prior]) -> Iterator[DiffusePrior]:
    """Yield each diffuse prior of an unknown that the record narrows, by the draws `(N, D)` of all."""
    for (name, prior), x in zip(priors.items(), draws.T, strict=True):
        if prior.in_logs:
            wide = prior_log_sd(prior)
            decades = wide * math.sqrt(12.0) / math.log(10.0)
            if decades > DIFFUSE_DECADES and float(np.log(x).std()) < MAX_REMAINING_WIDTH * wide:
                yield DiffusePrior(name=name, decades=decades)
                continue
        wide = prior_sd(prior)
        times = wide / math.sqrt(float(np.mean(x**2)))
        if times > DIFFUSE_RATIO and float(x.std()) < MAX_REMAINING_WIDTH * wide:
            yield DiffusePrior(name=name, times=times)
