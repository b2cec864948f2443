"""Find records that were read with a wrong column, unit, counter or timing."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.analysis.edits import rig_parameters
from bayesdrill.analysis.identifiability.information import SensitivityStudy, root_of
from bayesdrill.analysis.record_findings import findings_of_record
from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.findings import Finding
from bayesdrill.basics.symbols import SPEED_UNITS
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import prior_log_sd
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.inference.unknowns import RIG_ROLES
from bayesdrill.record import anomalies
from bayesdrill.record.clocks import median_step
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.record.regression import integral
from bayesdrill.rig.models.linear import Model, constant_forcing, dynamics

BITS = (12, 14, 16, 24, 32)  # usual numbers of bits of counters
# Largest step by motion, divided by the period of a counter; larger steps are overflows.
MAX_CALM_STEP = 0.4
MIN_R_SQUARED = 0.98  # smallest R^2 of two columns that show one motion in different units
MIN_UNIT_FACTOR = 1.5  # no sensor's error is as large as this factor
# Ratios of units that are easily confused, in either direction.
FACTORS = (
    (180 / math.pi, "degrees for radians (57.3)"),
    (30 / math.pi, "rpm for rad/s (9.55)"),
    (2 * math.pi, "revolutions for radians (6.28)"),
    (1000.0, "thousandths for the whole, as mA for A (1000)"),
)
NEAR_FACTOR = 0.05  # tolerance of the log of a factor between two columns
NEAR_START_FACTOR = 0.2  # the same tolerance for a channel and its prediction at the start values
# Largest plausible ratio of measured and predicted size at the start; factor of a wrong prefix.
FAR_FROM_START, PREFIX = 20.0, 1000.0
NEAR_MISFIT = 0.02  # (rms of residuals / rms of channel)^2, below which a prediction is near
# Largest sd of a prior's log (two decades), as the middle of a wider prior predicts nothing.
MAX_LOG_SD = 1.5
FEW, ALL = 3, 50  # numbers of positions of an anomaly in a report, and in the output of `check`


def suspicions_of_problem(problem: Problem, max_positions: int = FEW) -> Iterator[Finding]:
    """Yield findings on columns and units, and anomalies with at most `max_positions` positions each."""
    space = problem.posterior.space
    full = space.full(space.vector(space.start)[None])
    for observation in problem.observations:
        experiment = _without_gains(observation, full)
        label = {"experiment": observation.label} if observation.label else {}
        factors = [channel.factor for channel in experiment.channels]
        odd = [
            Finding("anomaly", {"text": each.in_words(max_positions)})
            for each in experiment.anomalies
        ]
        general = findings_of_record(experiment, problem.model, problem.posterior.space.free)
        columns = suspicions_of_record(experiment, factors, problem.model)
        for finding in (*odd, *general, *columns):
            yield replace(finding, names={**finding.names, **label})
    yield from suspicions_of_start(problem)


def _without_gains(observation: Observation, full: Array) -> Experiment:
    """Return the record without the gains of sensors, at parameters `full (1, P)`."""
    experiment, sensors = observation.experiment, observation.response.sensors
    row, names = observation.simulator_parameters(full), sensors.sensing.gains
    known = [names.get(channel.name, "") for channel in experiment.channels]
    gains = [float(sensors.column(name, row)[0]) if name else 1.0 for name in known]
    series = {name: sensors.acting_input(name, row) for name in experiment.series}
    return replace(experiment, y=experiment.y / gains, series=series)


def suspicions_of_record(
    experiment: Experiment, factors: Sequence[float], model: Model
) -> Iterator[Finding]:
    """Yield suspicions of the columns; `factors (K,)` are SI units per unit of each column."""
    for channel, y, factor in zip(experiment.channels, experiment.y.T, factors, strict=True):
        yield from _overrun(channel, experiment.t, y, factor)
    yield from _pairs(experiment, model)


def suspicions_of_start(problem: Problem) -> Iterator[Finding]:
    """Yield channels that differ from predictions at the start by the factor of a wrong unit, or by far.

    A start that is only the middle of a wide prior predicts nothing; then no unit is suspected.
    """
    space = problem.posterior.space
    rig = [unknown for unknown in space.unknowns if unknown.role in RIG_ROLES]
    if any(u.name not in problem.nominal and prior_log_sd(u.prior) > MAX_LOG_SD for u in rig):
        return
    full, contradictions = space.full(space.vector(space.start)[None]), list[Finding]()
    columns = (
        zip(each.experiment.channels, each.experiment.y.T, each.signals(full)[0].T, strict=True)
        for each in problem.observations
    )
    for channel, measured, expected in itertools.chain.from_iterable(columns):
        y, p = measured[~np.isnan(measured)], expected[~np.isnan(measured)]
        power = float(p @ p)
        if not (math.isfinite(power) and power > 0):
            continue
        times = float(y @ p) / power
        r_squared = 1 - float(np.sum((y - times * p) ** 2)) / float(y @ y)
        named = _likely_mistakes(times, NEAR_START_FACTOR, problem.model.gear_ratio)
        if r_squared > MIN_R_SQUARED and named:
            names = {"channel": channel.name, "mistakes": named}
            contradictions.append(Finding("unit against the start", names, {"times": times}))
    yield from contradictions or _far_from_start(problem)


def _far_from_start(problem: Problem) -> Iterator[Finding]:
    """Yield the channel whose size is farthest from the prediction at the start, with an explanation.

    Each parameter of the rig is tried a thousand times larger and smaller, as with a wrong prefix.
    """
    tried, rows = _wrong_prefixes(problem)
    # `misfits` sums (rms residual / rms channel)^2; `sizes` are ratios measured / predicted.
    misfits, sizes = np.zeros(len(rows)), list[tuple[float, str]]()
    with np.errstate(all="ignore"):
        for each in problem.observations:
            signals = each.signals(rows)
            for k, channel in enumerate(each.experiment.channels):
                y = each.experiment.y[:, k]
                power = float(np.nanmean(y**2))
                ratio = math.sqrt(power / max(float(np.nanmean(signals[0, :, k] ** 2)), 1e-300))
                sizes.append((ratio, channel.name))
                misfit = np.nanmean((signals[:, :, k] - y) ** 2, axis=1)
                misfits += np.where(np.isfinite(misfit), misfit, np.inf) / max(power, 1e-300)
    times, name = max(sizes, key=lambda size: abs(math.log(max(size[0], 1e-300))))
    best, limit = int(np.argmin(misfits)), NEAR_MISFIT * len(sizes)
    is_far = not 1 / FAR_FROM_START < times < FAR_FROM_START
    is_explained = best > 0 and (misfits[best] < limit < MIN_LEFT * len(sizes) < misfits[0])
    if not (is_far or is_explained):
        return
    names = {"channel": name if is_far else "", "value": "", "factor": ""}
    if is_explained or misfits[best] < MIN_LEFT * len(sizes):
        names |= {"value": tried[best][0], "factor": f"{tried[best][1]:g}"}
    yield Finding("size against the start", names, {"times": times})


def _wrong_prefixes(problem: Problem) -> tuple[list[tuple[str, float]], Array]:
    """Return pairs (name, factor), the unchanged start first, and the parameters `(n, P)` of each."""
    space = problem.posterior.space
    start = space.vector(space.start)
    full = space.full(start[None])[0]
    tried, rows = [("", 1.0)], [full]
    for name, times in itertools.product(problem.model.parameters, (PREFIX, 1 / PREFIX)):
        if name in space.free:
            theta = np.where(np.array(space.free) == name, times * start, start)
            rows.append(space.full(theta[None])[0])
        elif name in space.fixed and name in space.model:
            rows.append(np.where(np.array(space.model) == name, times * full, full))
        else:
            continue
        tried.append((name, times))
    return tried, np.array(rows)


def _likely_mistakes(times: float, tolerance: float, gear: float) -> str:
    """Return mistakes that explain the factor `times`, the nearest first; empty if there is none."""
    if times == 0 or 1 / MIN_UNIT_FACTOR < times < MIN_UNIT_FACTOR:
        return ""
    size, known = abs(math.log(abs(times))), [*FACTORS]
    turns = max(gear, 1 / gear)
    if turns > MIN_UNIT_FACTOR:
        known.append((turns, f"a side of the gear for the other ({turns:.4g})"))
    distances = sorted((abs(size - math.log(factor)), mistake) for factor, mistake in known)
    units = " or ".join(mistake for distance, mistake in distances if distance < tolerance)
    signs = "a sign" if times < 0 and (units or size < math.log(MIN_UNIT_FACTOR)) else ""
    return " and ".join(mistake for mistake in (units, signs) if mistake)


def _overrun(channel: Channel, t: Array, y: Array, factor: float) -> Iterator[Finding]:
    """Yield jumps by the range of a counter, or by one turn, between steps that are small."""
    t, y = t[~np.isnan(y)], y[~np.isnan(y)]
    steps = np.abs(np.diff(y / factor))
    turn = 2 * math.pi / factor if channel.unit == "rad" else math.nan
    periods = [(2.0**bits, f"2^{bits} counts") for bits in BITS] + [(turn, "one turn")]
    for period, what in periods:
        jumps = np.abs(steps - period) < MAX_CALM_STEP * period
        if np.any(jumps) and np.all(steps[~jumps] < MAX_CALM_STEP * period) and _goes_on(y, jumps):
            first = float(t[int(np.argmax(jumps)) + 1])
            numbers = {"period": period, "jumps": float(np.sum(jumps)), "first": first}
            yield Finding("overflow", {"channel": channel.name, "range": what}, numbers)
            break


def _goes_on(y: Array, jumps: Flags) -> bool:
    """Return whether jumps oppose the motion before them, and the next step reverses none of them."""
    steps, at = np.diff(y), np.flatnonzero(jumps)
    before = steps[np.maximum(at - 1, 0)]
    spikes = jumps[1:] & jumps[:-1]
    return not np.any(spikes) and bool(np.mean(np.sign(steps[at]) * np.sign(before)) <= 0)


def _pairs(experiment: Experiment, model: Model) -> Iterator[Finding]:
    """Yield contradictions between an angle and a speed of the same part."""
    columns = zip(experiment.channels, experiment.y.T, strict=True)
    for (angle, a), (speed, w) in itertools.product(columns, repeat=2):
        ratio = _ratio(angle, speed, model.roles.speeds)
        if ratio is None:
            continue
        # A log may have them at different times, so both are interpolated.
        t_a, t_w = experiment.t[~np.isnan(a)], experiment.t[~np.isnan(w)]
        if min(len(t_a), len(t_w)) > 2:
            begin, end = max(t_a[0], t_w[0]), min(t_a[-1], t_w[-1])
            t = experiment.t[(experiment.t >= begin) & (experiment.t <= end)]
            angles = np.interp(t, t_a, a[~np.isnan(a)])
            turned = np.interp(t, t_w, w[~np.isnan(w)]) * ratio
            yield from _pair(angle.name, angles, speed.name, turned, t, model.gear_ratio)
        if (
            len(t_a) == len(t_w) == len(experiment.t)
            and experiment.uniform
            and anomalies.differenced(a, w, experiment.dt)
        ):
            yield Finding("differentiated angle", {"angle": angle.name, "speed": speed.name})


def _ratio(angle: Channel, speed: Channel, speeds: Mapping[str, str]) -> float | None:
    """Return the factor from the speed's motion to the angle's; None if they are of different parts."""
    turned = {speeds.get(name, name): x for name, x in angle.weights.items() if x}
    moved = {name: x for name, x in speed.weights.items() if x}
    angles = all(name in speeds for name, x in angle.weights.items() if x)
    if not angles or not turned or turned.keys() != moved.keys():
        return None
    ratios = [turned[name] / moved[name] for name in turned]
    return ratios[0] if max(ratios) - min(ratios) < 1e-9 * abs(ratios[0]) else None


def _pair(angle: str, a: Array, speed: str, w: Array, t: Array, gear: float) -> Iterator[Finding]:
    times, r_squared = _slope(integral(w, np.diff(t)), a)
    if r_squared > MIN_R_SQUARED and 1 / MIN_UNIT_FACTOR < times < MIN_UNIT_FACTOR:
        return
    swapped, swapped_r_squared = _slope(integral(a, np.diff(t)), w)
    if swapped_r_squared > MIN_R_SQUARED and abs(swapped - 1) < 2 * NEAR_FACTOR:
        yield Finding("swapped columns", {"angle": angle, "speed": speed})
    elif r_squared >= MIN_R_SQUARED and (named := _likely_mistakes(times, NEAR_FACTOR, gear)):
        names = {"angle": angle, "speed": speed, "mistakes": named}
        yield Finding("unit of an angle", names, {"times": times})


def _slope(x: Array, y: Array) -> tuple[float, float]:
    """Return slope and R^2 of the regression of y on x."""
    x, y = x - x.mean(), y - y.mean()
    across, size = float(x @ y), float(x @ x) * float(y @ y)
    return (across / float(x @ x), across**2 / size) if size > 0 else (math.nan, 0.0)


MIN_LEFT = 0.3  # smallest unexplained fraction of a channel that the model does not fit
MIN_FOLLOWED = 0.95  # smallest R^2 of the regression of a channel on an input that it follows
MAX_FOLLOWING = 20  # largest lag of such a channel behind the input, in samples


def find_reference(
    problem: Problem, residuals: Sequence[ResidualSummary]
) -> tuple[str, str] | None:
    """Return an input that is a set point, and an angle that follows this input only in the record."""
    shares = {(row.experiment, row.channel): row.share for row in residuals}
    goals = {motor.goal for motor in problem.model.roles.motors}
    for observation in problem.observations:
        experiment = observation.experiment
        # A model with a goal includes the control loop that follows it.
        inputs = [(name, u) for name, u in experiment.series.items() if name not in goals]
        for channel, y in zip(experiment.channels, experiment.y.T, strict=True):
            unexplained = shares[observation.label, channel.name] > MIN_LEFT
            if channel.unit not in SPEED_UNITS or np.isnan(y).any() or not unexplained:
                continue
            for name, u in inputs:
                lags = range(min(MAX_FOLLOWING, len(u) // 2))
                if max(_slope(u[: len(u) - k], y[k:])[1] for k in lags) > MIN_FOLLOWED:
                    return name, channel.name
    return None


MIN_SHIFT_SDS = 0.5  # smallest shift of an unknown, in sds, that is reported


@dataclass(frozen=True, slots=True, kw_only=True)
class InputTiming:
    """Estimates of unknowns would move by `shifts`, in sds, if the inputs came `seconds` later."""

    seconds: float
    shifts: tuple[tuple[str, float], ...]

    @property
    def worst(self) -> tuple[str, float]:
        """Return the unknown that would move most, and its shift in sds."""
        return max(self.shifts, key=lambda shift: abs(shift[1]))

    @property
    def is_reported(self) -> bool:
        """Return whether any unknown would move so far that it is reported."""
        return abs(self.worst[1]) > MIN_SHIFT_SDS


def half_sample_shift(sensitivity: SensitivityStudy, theta: Array) -> InputTiming | None:
    """Return the shifts at `theta (D,)` that inputs half a sample later would cause.

    The result is None if lags are unknowns, or if no input acts.
    """
    observations = sensitivity.likelihood.observations
    experiments = [observation.experiment for observation in observations]
    if not any(each.series or any(each.constant.values()) for each in experiments):
        return None
    if not sensitivity.unknowns or any(_lag_is_free(observation) for observation in observations):
        return None
    half = 0.5 * min(_typical_step(observation.experiment) for observation in observations)
    pairs = zip(observations, sensitivity.motions(theta), strict=True)
    late = np.concatenate([_delay_sensitivity(*p, sensitivity, theta).ravel() for p in pairs])
    rows = sensitivity.with_nuisances(theta)
    if not (np.isfinite(half) and np.isfinite(late).all()):
        return None
    matrix = np.vstack([rows, np.diag(1.0 / sensitivity.prior_spreads)])
    target = np.append(half * late, np.zeros(rows.shape[1]))
    moved = np.linalg.lstsq(matrix, target, rcond=None)[0]
    sds = np.linalg.norm(np.linalg.inv(root_of(matrix)), axis=1)
    ratio = (moved / sds)[: len(sensitivity.unknowns)].tolist()
    return InputTiming(seconds=half, shifts=tuple(zip(sensitivity.unknowns, ratio, strict=True)))


def _typical_step(experiment: Experiment) -> float:
    """Return the typical step [s] of the inputs or, if all are constant, of the channels."""
    if experiment.series:
        return min(experiment.input_steps.get(name, experiment.dt) for name in experiment.series)
    return min(median_step(experiment.t[sampled]) for sampled in experiment.is_measured.T)


def _lag_is_free(observation: Observation) -> bool:
    sensing, experiment = observation.response.sensing, observation.experiment
    every_input = sensing.input_lags and len(sensing.input_lags) == len(experiment.series)
    every_channel = len(sensing.lags) == len(experiment.channels)
    return bool(sensing.delay is not None or every_input or every_channel)


def _delay_sensitivity(
    observation: Observation, motion: Array, sensitivity: SensitivityStudy, theta: Array
) -> Array:
    """Return the whitened derivative of signals by a delay, which is minus their rate of change."""
    experiment, model = observation.experiment, observation.response.model
    full = sensitivity.likelihood.space.full(theta[None])
    linear, n = model.linear(rig_parameters(observation, full)), len(experiment.t)
    constant, series = experiment.constant, experiment.series
    given = {name: constant.get(name, 0.0) + series.get(name, 0.0) for name in model.inputs}
    change = motion @ dynamics(linear, model.states, 1)[0].T
    change = change + constant_forcing(linear, model.states, n, given)
    slopes = -change[None] @ experiment.weights(model.states).T
    return observation.whitened_jacobian_at(slopes, theta)
