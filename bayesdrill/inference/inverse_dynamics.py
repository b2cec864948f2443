"""Find a start for searches by inverse dynamics: fit equations of motion to measured states.

If inputs and channels give all states, nothing has to be simulated.  Each equation
x' = A x + B u + c is multiplied by bumps, which are zero at both ends, and integrated by parts:
- int bump' x = int bump (A x + B u + c), so no measured state is differentiated (modulating
functions, Shinbrot 1957).  Bumps have zero mean, so the initial values of integrated angles do not
matter.  The misfit has no ripples over the parameters, unlike the misfit of a simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.friction import DIRECTION
from bayesdrill.rig.models.linear import Model

BUMP_COUNTS = (3, 10, 30, 100)  # numbers of bumps along the record
MIN_BUMP_SAMPLES = 6  # smallest number of samples in a bump
MIN_SPARSE_SAMPLES = 4096  # for records of at least this length, bumps are sparse matrices
MIN_FAST_SAMPLES = 100  # smallest number of samples in a bump with several periods
MIN_PERIOD_SAMPLES = 8  # smallest number of samples in a period
LARGE_MISFIT = 1e9  # replaces a misfit that is not finite
MAX_SAMPLES = 20_000  # longer records are thinned to this many samples


def regression_start(posterior: Posterior) -> Array | None:
    """Return the physical unknowns `(D,)` whose equations of motion fit the records best.

    Sensors, starts and noise keep the configured values.  The result is None if channels and inputs
    of a record do not give all states, or if the configured start has a higher density.
    """
    space, coordinates = posterior.space, posterior.coordinates
    observations = posterior.likelihood.observations
    start = space.vector(space.start)
    columns = space.columns("rig", "quantity", "offset")
    motions = [motion for each in observations if (motion := _motion(each))]
    if not columns or len(motions) < len(observations):
        return None
    surface = LogDensity(posterior, physical=True)
    first = np.clip(coordinates.from_physical(start[None])[0], surface.low, surface.high)

    def unknowns(u: Array) -> Array:
        z = first.copy()
        z[columns] = u
        return coordinates.to_physical(z[None])

    def misfits(u: Array) -> Array:
        full = space.full(unknowns(u))
        parts: Array = np.concatenate([motion(full) for motion in motions])
        return np.nan_to_num(parts, posinf=LARGE_MISFIT, neginf=-LARGE_MISFIT)

    bounds = surface.low[columns], surface.high[columns]
    theta = unknowns(scipy.optimize.least_squares(misfits, first[columns], bounds=bounds).x)
    better = posterior.density(theta)[0] > posterior.density(start[None])[0]
    return theta[0] if better else None


def _motion(observation: Observation) -> Callable[[Array], Array] | None:
    """Return the function that maps parameters `(1, P)` to misfits; None if a state is missing.

    Each equation with parameters has a misfit for each bump, divided by the norm of its left side.
    States and inputs `(T - 1,)` are taken in the middle of each step.
    """
    model, experiment = observation.response.model, observation.experiment
    stride = slice(None, None, -(-len(experiment.t) // MAX_SAMPLES))
    t = experiment.t[stride]
    inputs: dict[str, Array | float]
    inputs = {name: experiment.constant.get(name, 0.0) for name in model.inputs}
    for name, series in experiment.series.items():
        u = series[stride]
        inputs[name] = _midpoints(u) if experiment.first_order else u[:-1]
    kinematics = _kinematics(model)
    measured = _states(model, kinematics, experiment, stride, inputs)
    if len(measured) < len(model.states) or len(t) < 2 * MIN_BUMP_SAMPLES:
        return None
    states = {name: _midpoints(x) for name, x in measured.items()}
    bumps, slopes = _bumps(t)
    left_sides = {row: -slopes @ states[row] for row in model.states if row not in kinematics}

    def misfits(full: Array) -> Array:
        p = {name: float(x[0]) for name, x in observation.rig_parameters(full).items()}
        acting = {**states, **inputs}
        for friction in model.frictions:
            speed = states[friction.against]
            seen = {**acting, DIRECTION: np.sign(speed)}
            acting[friction.name] = np.sign(speed) * friction.law.size(p, np.abs(speed), seen)
        for gravity in model.gravities:
            acting[gravity.name] = gravity.torque(p, states[gravity.angle])
        if (servo := model.saturation) is not None:
            acting[servo.goal] = servo.reference(p, t[:-1], inputs[servo.goal])
            wanted = servo.wanted(model.linear, p, acting)
            level = servo.level(acting)
            voltage = servo.voltage(p, wanted)
            acting[servo.name] = (voltage if level is None else level * voltage) - wanted
        linear = model.linear(p)
        rates: dict[str, Any] = dict(linear.c)
        for (row, name), factor in (*linear.A.items(), *linear.B.items()):
            rates[row] = rates.get(row, 0.0) + factor * acting[name]
        parts = []
        for row, lhs in left_sides.items():
            size = max(float(np.linalg.norm(lhs)), np.finfo(float).tiny)
            parts.append((lhs - bumps @ rates[row]) / size)
        return np.concatenate(parts)

    return misfits


def _kinematics(model: Model) -> dict[str, dict[str, Any]]:
    """Return equations without parameters: for each state, the factors of states and inputs."""
    linear = model.linear({name: Dual(1.0, 1.0) for name in model.parameters})  # type: ignore[misc]
    rows: dict[str, dict[str, Any]] = {name: {} for name in model.states}
    for (row, name), factor in (*linear.A.items(), *linear.B.items()):
        rows[row][name] = factor
    return {r: x for r, x in rows.items() if all(isinstance(f, float | int) for f in x.values())}


def _states(
    model: Model,
    kinematics: Mapping[str, Mapping[str, Any]],
    experiment: Experiment,
    stride: slice,
    inputs: Mapping[str, Array | float],
) -> dict[str, Array]:
    """Return the states `(T,)` that follow from a record, by name.

    A channel gives a state once all other states that it measures are known.  Kinematic equations
    give further states: angles are integrated from zero, and speeds are derivatives of angles.
    """
    t, states = experiment.t[stride], dict[str, Array]()
    columns = zip(experiment.channels, experiment.y.T, experiment.is_measured.T, strict=True)
    channels = [
        (channel.weights, np.interp(t, experiment.t[seen], y[seen]))
        for channel, y, seen in columns
        if seen.any()
    ]
    for _ in model.states:  # each round may find another state
        for weights, y in channels:
            missing = [name for name in weights if name not in states]
            if len(missing) == 1:
                known_part = sum(weights[name] * states[name] for name in weights if name in states)
                states[missing[0]] = (y - known_part) / weights[missing[0]]
        for angle, row in kinematics.items():
            if angle not in states and all(name in {**states, **inputs} for name in row):
                acting = {**inputs, **{name: _midpoints(x) for name, x in states.items()}}
                rate = sum(factor * acting[name] for name, factor in row.items())
                states[angle] = np.concatenate([[0.0], np.cumsum(rate * np.diff(t))])
            speeds = [name for name in row if name in model.states and name not in states]
            if angle in states and len(row) == len(speeds) == 1:
                states[speeds[0]] = np.gradient(states[angle], t)
    return states


def _midpoints(x: Array) -> Array:
    """Return the mean `(T - 1,)` of the values at both ends of each step."""
    return np.asarray(0.5 * (x[1:] + x[:-1]))


def _bumps(t: Array) -> tuple[Any, Any]:
    """Return M bumps `(M, T - 1)` along `t (T,)` and their slopes, multiplied by time steps.

    Bumps are whole periods of a sine, and overlap their neighbours by half.  If the shortest bumps
    have many samples, they get more periods to resolve faster oscillations.
    """
    bumps, slopes, middle = [], [], _midpoints(t)
    for count in BUMP_COUNTS:
        width = (t[-1] - t[0]) * 2 / (count + 1)
        if width * len(t) < MIN_BUMP_SAMPLES * (t[-1] - t[0]):
            break
        phase = (middle - t[0]) / width - 0.5 * np.arange(count)[:, None]
        inside = (phase >= 0.0) & (phase <= 1.0)
        samples = width * len(t) / (t[-1] - t[0])
        is_long = count == BUMP_COUNTS[-1] and samples > MIN_FAST_SAMPLES
        fastest = int(math.log2(samples / MIN_PERIOD_SAMPLES)) if is_long else 0
        for turns in 2.0 * np.pi * 2.0 ** np.arange(1 + fastest):
            bumps.append(np.where(inside, np.sin(turns * phase), 0.0))
            slopes.append(np.where(inside, np.cos(turns * phase), 0.0) * turns / width)
    both = np.concatenate(bumps) * np.diff(t), np.concatenate(slopes) * np.diff(t)
    if len(t) < MIN_SPARSE_SAMPLES:
        return both
    return scipy.sparse.csr_array(both[0]), scipy.sparse.csr_array(both[1])
