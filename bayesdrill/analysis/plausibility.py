"""Check whether values can be those of a real rig, and whether priors are too wide.

Findings are sentences with numbers, and none is an error.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.analysis.identifiability.information import Information, SensitivityStudy
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import Prior, prior_log_sd, prior_sd
from bayesdrill.rig.models.linear import Model, dynamics

APPRECIABLE = 0.05  # relative deviation from which on a finding is reported
MOST_DRAWS = 2000  # draws are thinned to about this number
UNSTABLE = 1e-9  # real part over the largest pole, below which it is a rounding error
FEW = 0.01  # share of the draws or samples below which a finding is not reported
UNHEARD_OF = 1e-6  # mass at each end of a prior in which no nominal value should lie
SAME_GEAR = 0.02  # relative tolerance of gear ratios, as data sheets round them

# Values are from the paper's Table 1.  It calls 188 mm the radius of rotor 1, but the inertia printed
# there follows from it as a diameter.  The modulus is that of steel, as the paper gives none.
SHAFT_LENGTH, SHAFT_DIAMETER, STEEL = 2.4, 3e-3, 79.3e9  # m, m, Pa
ROTOR_MASS, ROTOR_DIAMETER = 6.4, 0.188  # kg, m
GEOMETRY: Mapping[str, tuple[float, str]] = {  # keys are names of shafts and inertias
    "shaft": (
        STEEL * math.pi * SHAFT_DIAMETER**4 / (32 * SHAFT_LENGTH),
        "a steel shaft of 2.4 m and 3 mm has",
    ),
    "rotor_1": (ROTOR_MASS * ROTOR_DIAMETER**2 / 8, "a disc of 6.4 kg and 188 mm across has"),
}


def plausibility_of_priors(problem: Problem) -> Iterator[str]:
    """Yield nominal values that a prior makes next to impossible without excluding them."""
    for name, prior in problem.posterior.space.priors.items():
        if (value := problem.nominal.get(name)) is None:
            continue
        low, high = (float(x) for x in prior.quantile(np.array([UNHEARD_OF, 1 - UNHEARD_OF])))
        if not low <= value <= high and prior.low < value < prior.high:
            yield (
                f"the nominal value {value:.4g} of {name} is far outside its prior, which goes from "
                f"{low:.4g} to {high:.4g} with all but {100 * 2 * UNHEARD_OF:g} % of it. One of the "
                "two, or its unit, is wrong"
            )


def of_roles(problem: Problem) -> Iterator[str]:
    """Yield states without a role, which checks of speeds and currents cannot use."""
    model = problem.model
    if others := [name for name in model.outer if name not in model.roles.states]:
        yield (
            f"roles: {model.name} does not say what {', '.join(others)} is to it. Friction, energy "
            "and missing torques are not checked there. Name it in the rig's `roles`"
        )


def plausibility_of_gear(problem: Problem) -> Iterator[str]:
    """Yield channels that turn neither with the shaft nor, by the gear, with the motor."""
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
            yield (
                f"{channel.name} measures {times:g} * {state}, but {fast.words} "
                f"{roles.motion.moves} {1 / fast.reduction:.4g} times as fast as {behind[0]} "
                f"({entry}). One of the two is wrong for this rig"
            )


def plausibility_of_nominal(problem: Problem) -> tuple[str, ...]:
    """Return findings on nominal values, and fixed or start values of others, each once."""
    space, model = problem.posterior.space, problem.model
    known = {**space.start, **problem.nominal, **space.fixed}
    known |= {name: float(relation.value(known)) for name, relation in space.relations.items()}
    sentences: list[str] = []
    for observation in problem.observations:
        names = observation.named(model.parameters)
        values = {name: known[called] for name, called in names.items()}
        table = {n: x for n, x in values.items() if n in problem.published}
        table = {n: x for n, x in table.items() if x == problem.nominal[n]}
        sentences += _energy_of_nominal(values, model)
        sentences += _geometry(table, model)
        sentences += _poles(poles(model, {n: np.array([x]) for n, x in values.items()}), problem)
    return tuple(dict.fromkeys(sentences))


def plausibility_of_draws(problem: Problem, draws: Array, known: Information) -> tuple[str, ...]:
    """Return findings on draws `(N, D)`; `known` is the information of the record alone."""
    model = problem.model
    thinned = draws[:: max(1, len(draws) // MOST_DRAWS)]
    values = problem.posterior.likelihood.rig_parameters(thinned)
    energy = _energy_of_draws(values, known, model)
    return (*energy, *_poles(poles(model, values), problem))


def plausibility_of_course(sensitivity: SensitivityStudy, theta: Array) -> Iterator[str]:
    """Yield frictions that drive instead of braking in the motion at unknowns `theta (D,)`."""
    rig, p = sensitivity.model, sensitivity.rig_at(theta)
    for inertia in rig.roles.inertias:
        if inertia.friction not in p or inertia.speed not in sensitivity.states:
            continue
        column, moves = sensitivity.states.index(inertia.speed), rig.roles.motion.moves
        forwards = np.sign(p[inertia.friction] * inertia.reduction)
        speeds = [motion[:, column] for motion in sensitivity.motions(theta)]
        other_way = [forwards * w < -APPRECIABLE * np.abs(w).max() for w in speeds]
        share = float(np.mean(np.concatenate(other_way)))
        if share > FEW:
            drives = " and ".join(n for n in rig.inputs if rig.symbols[n].drives)
            yield (
                f"friction: in {_percent(share)} of the record {inertia.words} {moves} the other way, "
                f"and {inertia.friction}, which keeps its sign, drives instead of braking. Cut these "
                f"samples off (record.window). If it always {moves} so, turn the signs of {drives} and "
                f"of all channels. Or hold {inertia.friction} at 0 and name {inertia.sliding}, friction "
                "that changes its sign"
            )


def poles(model: Model, values: Mapping[str, Array]) -> NDArray[np.complex128]:
    """Return the eigenvalues `(W, X)` [1/s] of the dynamics at parameters `(W,)` each."""
    size = len(next(iter(values.values())))
    matrix = dynamics(model.linear(values), model.states, size)
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)


def _constants(values: Collection[str], model: Model) -> list[tuple[str, str]]:
    pairs = [(motor.torque_constant, motor.back_emf) for motor in model.roles.motors]
    return [pair for pair in pairs if {*pair} <= {*values}]


def _ideal(k_T: str, k_e: str) -> str:
    return (
        f"In SI units the two are equal in an ideal motor, and losses make {k_T} the smaller one. "
        f"Check {k_T}, {k_e}, the supply and the gear reduction"
    )


def _energy_of_nominal(values: Mapping[str, float], model: Model) -> Iterator[str]:
    motion = model.roles.motion
    for k_T, k_e in _constants(values, model):
        ratio = values[k_T] / values[k_e]
        if ratio > 1 + APPRECIABLE:
            yield (
                f"energy: {k_T} = {values[k_T]:.4g} {motion.newtons}/A is {ratio:.3g} times {k_e} = "
                f"{values[k_e]:.4g} V s/{motion.angle}. The motor would give {ratio:.3g} times the "
                f"power that it takes up. {_ideal(k_T, k_e)}"
            )


def _energy_of_draws(
    values: Mapping[str, Array], known: Information, model: Model
) -> Iterator[str]:
    for k_T, k_e in _constants(values, model):
        ratio = values[k_T] / values[k_e]
        share = float(np.mean(ratio > 1 + APPRECIABLE))
        if share <= FEW:
            continue
        powers = np.array([{k_T: 1.0, k_e: -1.0}.get(name, 0.0) for name in known.names])
        blind = bool(powers.any()) and not math.isfinite(known.bound(powers))
        whence = (
            ". The record cannot show this ratio: it is what the priors and the fixed values allow"
            if blind
            else f". {_ideal(k_T, k_e)}"
        )
        yield (
            f"energy: {k_T} is more than {100 * APPRECIABLE:g} % above {k_e} in {_percent(share)} of "
            f"the draws (median ratio {np.median(ratio):.3g}). Such a motor would give more power than "
            f"it takes up, which none does{whence}"
        )


def _geometry(values: Mapping[str, float], model: Model) -> Iterator[str]:
    names = {shaft.name: shaft.stiffness for shaft in model.roles.shafts}
    names |= {inertia.name: inertia.inertia for inertia in model.roles.inertias}
    for part, (expected, what) in GEOMETRY.items():
        name = names.get(part, "")
        value = values.get(name, expected)
        if abs(value / expected - 1) > APPRECIABLE:
            unit = model.symbols[name].plain_unit
            yield (
                f"geometry: {name} = {value:.4g} {unit} is {100 * (value / expected - 1):+.0f} % off "
                f"what the paper's dimensions give; {what} {expected:.3g} {unit}"
            )


def _poles(poles: NDArray[np.complex128], problem: Problem) -> Iterator[str]:
    """Yield findings on `poles (W, X)`, of nominal values if there is one row, and else of draws."""
    step = min(observation.experiment.dt for observation in problem.observations)
    size = np.abs(poles).max(axis=1)
    largest = poles.real.max(axis=1)
    share = float(np.mean(largest > UNSTABLE * size))
    if share > 0:
        yield (
            f"stability: a pole lies in the right half plane{_in(poles, share)}, at most "
            f"{largest.max():.3g} 1/s: the rig would run away by itself"
        )
    decay = np.abs(poles.real).max(axis=1)
    share = float(np.mean(decay * step > 1))
    if share > FEW:
        middle, model = float(np.median(decay)), problem.model
        sets = [
            f"{motor.inductance}/{motor.resistance}"
            for motor in model.roles.motors
            if motor.inductance in model.parameters
        ]
        mostly = f", mostly {' and '.join(sets)}," if sets else ""
        yield (
            f"sampling: the fastest motion dies out within {1e3 / middle:.3g} ms (pole at "
            f"{-middle:.3g} 1/s), the record has a sample every {1e3 * step:.3g} ms{_in(poles, share)}. "
            f"What sets it{mostly} is seen only through slower motions"
        )
    turns = np.abs(poles.imag).max(axis=1) / (2 * math.pi)
    share = float(np.mean(2 * turns * step > 1))
    if share > FEW:
        yield (
            f"sampling: an oscillation of {np.median(turns):.3g} Hz is faster than half of the "
            f"{1 / step:.4g} samples per second{_in(poles, share)}: the record shows a false frequency"
        )


def _in(poles: NDArray[np.complex128], share: float) -> str:
    return "" if len(poles) == 1 else f" (in {_percent(share)} of the draws)"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


DIFFUSE_DECADES = 2.1  # width of a log-uniform prior, or one of equal sd, above which it is diffuse
DIFFUSE_RATIO = 100.0  # sd of a diffuse prior over the size of the unknown
# Posterior sd over prior sd, above which a wide prior hardly affects the evidence.
MAX_REMAINING_WIDTH = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusePrior:
    """The prior of `name` is diffuse: it spans `decades`, or its sd is `times` the unknown's size."""

    name: str
    decades: float | None = None
    times: float | None = None


def diffuse_priors(draws: Array, priors: Mapping[str, Prior]) -> Iterator[DiffusePrior]:
    """Yield diffuse priors of unknowns that the record narrows; `draws (N, D)` in their order."""
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
