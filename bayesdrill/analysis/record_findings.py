"""Find doubtful columns without a fit: stillness, wrong signs, one direction, odd cells."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.findings import Finding
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.record.regression import integral, linear_fit
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import InertiaRoles

SMALLEST_RANGE = 1e-12  # a column with a smaller range [SI] is constant, as no sensor resolves less
MIN_SAMPLES = 20  # shorter columns are not judged
MAX_SAMPLES = 20_000  # largest number of samples of a record that are judged
MIN_VARIANCE_RATIO = 1.5  # smallest residual variance of a speed without the input / that with it
MIN_R_SQUARED = 0.5  # R^2 of the regression of a speed, below which its sign is not judged
TURNED_CORRELATION = -0.9  # correlation of two angles, below which one of them counts backwards
FALLING_CORRELATION = -0.5  # correlation below which the speed falls while the input rises
MAX_GOAL_RATIO = 5.0  # largest plausible ratio of a servo's angle and its goal
ONE_WAY_SHARE = 0.98  # smallest fraction of all motion in one direction if a rig turns one way
MAX_PERIOD = 20  # largest number of rows between two measured values of a slower sensor
MIN_HELD_SHARE = 0.9  # smallest fraction of runs of equal values that have the typical length
MIN_STEP_DIGITS = 3.0  # least typical step, in last digits; a slow angle changes by one digit


def findings_of_record(
    experiment: Experiment, model: Model, unknowns: Collection[str] = ()
) -> Iterator[Finding]:
    """Yield findings on one record of a rig whose `unknowns` have these names."""
    columns = [*zip(experiment.channels, experiment.y.T, strict=True)]
    measured = {channel.name: y[~np.isnan(y)] for channel, y in columns}
    judged = {name: y for name, y in measured.items() if len(y) >= MIN_SAMPLES}
    still = [name for name, y in judged.items() if float(np.ptp(y)) < SMALLEST_RANGE]
    if len(still) == len(columns):
        yield Finding("nothing moved", {"channels": ", ".join(still)})
        return
    for name in still:
        yield Finding("still channel", {"channel": name})
    moving = [(channel, y) for channel, y in columns if channel.name not in still]
    for channel, y in moving:
        yield from _odd_cells(channel.name, y)
    for name in sorted({*experiment.series} | {*experiment.constant}):
        driven = model.roles.moved(name)
        if driven is not None and driven[1] != "speed":
            yield from _motion(name, *driven, moving, experiment, model, unknowns)


def _odd_cells(name: str, y: Array) -> Iterator[Finding]:
    """Yield a finding if a slower sensor left zeros between its values, or repeated each value."""
    known = y[~np.isnan(y)][:MAX_SAMPLES]
    zero = known == 0
    for period in range(2, min(MAX_PERIOD, len(known) // MIN_SAMPLES) + 1):
        phases = [zero[k::period] for k in range(period)]
        filled = [k for k, cells in enumerate(phases) if cells.mean() < 1 - MIN_HELD_SHARE]
        empty = all(cells.all() for k, cells in enumerate(phases) if k not in filled)
        if len(filled) == 1 and empty:
            yield Finding("zeros between", {"channel": name}, {"period": float(period)})
            return
    changes = np.flatnonzero(np.diff(known)) + 1
    lengths, steps = np.diff(changes), np.abs(np.diff(known[changes]))
    if len(lengths) < MIN_SAMPLES:
        return
    period = int(np.median(lengths))
    coarse = float(np.median(steps)) < MIN_STEP_DIGITS * float(steps[steps > 0].min(initial=np.inf))
    typical = float(np.mean(np.abs(lengths - period) <= (period > 2)))
    if 2 <= period <= MAX_PERIOD and typical > MIN_HELD_SHARE and not coarse:
        yield Finding("repeated cells", {"channel": name}, {"period": float(period)})


def _motion(
    drive: str,
    inertia: InertiaRoles,
    kind: str,
    columns: Sequence[tuple[Channel, Array]],
    experiment: Experiment,
    model: Model,
    unknowns: Collection[str],
) -> Iterator[Finding]:
    """Yield findings on the motion of an inertia that the input `drive` of a `kind` drives."""
    speeds = model.roles.speeds
    motions = [(c, *m) for c, y in columns if (m := _motion_of(c, y, experiment.t, speeds))]
    driven = [motion for motion in motions if motion[1] == inertia.speed]
    if not driven:
        return
    channel, _, state_sign, t, angle, w = driven[0]
    sign = state_sign if inertia.reduction > 0 else -state_sign
    constant = np.full(len(experiment.t), experiment.constant.get(drive, 0.0))
    u = np.interp(t, experiment.t, experiment.series.get(drive, constant))
    others = [x for name, x in experiment.series.items() if name != drive]
    by_time = [np.interp(t, experiment.t, x) for x in others]
    # A servo has w = a goal - b angle, with a / b near one; integrated once, it has the same form.
    moved = (angle, integral(angle, np.diff(t))) if kind == "goal" else (w, angle)
    effect, back = _effects(*moved, u, by_time, t)
    response = sign * float(np.sign(effect))
    travel = float(np.abs(w).sum())
    one_way = float(np.maximum(w * np.sign(w.sum()), 0.0).sum()) > ONE_WAY_SHARE * travel
    one_way &= bool(np.all(u >= 0) or np.all(u <= 0)) and bool(np.any(u))
    names = {"channel": channel.name, "input": drive}
    # From rest, a drive feeds in more energy than it takes back, whatever controls it.
    fed = sign * float(np.sum(u * w))
    if response < 0 and (fed < 0 or kind == "goal"):
        yield Finding("opposite signs", names)
        return
    if kind == "goal" and back < 0:
        times = -effect / (back * inertia.reduction * sum(channel.weights.values()))
        if not 1 / MAX_GOAL_RATIO < times < MAX_GOAL_RATIO:
            yield Finding("unit of a goal", names, {"times": times})
    if response < 0 and one_way and sign * _correlation(u, w) < FALLING_CORRELATION:
        yield Finding("speed falls", names)
        return
    for other, _, its_sign, its_t, its_angle, _ in motions:
        correlation = _correlation(np.interp(its_t, t, angle), its_angle)
        if state_sign * its_sign * correlation < TURNED_CORRELATION:
            yield Finding("channel turned", {"channel": other.name, "other": channel.name})
    if response >= 0 and one_way and np.ptp(u) > 0:
        yield from _one_direction(names, inertia, model, unknowns)


def _one_direction(
    names: Mapping[str, str], inertia: InertiaRoles, model: Model, unknowns: Collection[str]
) -> Iterator[Finding]:
    """Yield a finding, unless the user has chosen an unknown friction and a fixed offset."""
    offset = next((name for name in unknowns if name.startswith(f"offset_{names['input']}")), "")
    motor = model.roles.motor(inertia.name)
    rubbing = (inertia.sliding, inertia.friction, motor.drop if motor else "")
    frictions = ", ".join(name for name in rubbing if name and name in unknowns)
    if offset or not frictions:
        said = {"offset": offset or f"an offset of {names['input']}"}
        said["frictions"] = frictions or f"dry friction {inertia.at}"
        yield Finding("one direction", {**names, **said})


def _motion_of(
    channel: Channel, y: Array, t: Array, speeds: Mapping[str, str]
) -> tuple[str, float, Array, Array, Array] | None:
    """Return speed state, sign, times, angle and speed that a channel of one state shows, or None."""
    states = [(name, x) for name, x in channel.weights.items() if x]
    known = ~np.isnan(y)
    if len(states) != 1 or np.sum(known) < MIN_SAMPLES:
        return None
    (state, weight), t, y = states[0], t[known], y[known]
    if state in speeds:
        return speeds[state], float(np.sign(weight)), t, y, np.gradient(y, t)
    if state not in speeds.values():
        return None
    return state, float(np.sign(weight)), t, integral(y, np.diff(t)), y


def _effects(
    w: Array, angle: Array, u: Array, others: Sequence[Array], t: Array
) -> tuple[float, float]:
    """Return the effects of an input and of the angle on a speed; zeros if the record shows none.

    The equation of motion, integrated once, is w = a * integral of u - b * angle + c * t + d. Its `a`
    is positive whatever the friction, the load and a controller are.  The effects are a and -b.
    """
    if np.ptp(u) < 1e-9 * np.abs(u).max(initial=0.0) or not u.any():
        mean = float(np.mean(w))
        clear = abs(mean) > MIN_R_SQUARED * float(np.sqrt(np.mean(w**2))) and not others
        return (float(np.sign(mean) * np.sign(u[0])) if clear else 0.0), 0.0
    integrals = [integral(x, np.diff(t)) for x in (*others, u - u.mean())]
    every = slice(None, None, -(-len(w) // MAX_SAMPLES))
    causes = [cause[every] for cause in (angle, t - t[0], *integrals)]
    _, without = linear_fit(w[every], causes[:-1])
    slopes, residual = linear_fit(w[every], causes)
    total = float(np.var(w))
    clear = without > MIN_VARIANCE_RATIO * residual and residual < (1 - MIN_R_SQUARED) * total
    return (float(slopes[-2]), float(slopes[0])) if clear else (0.0, 0.0)


def _correlation(x: Array, y: Array) -> float:
    x, y = x - x.mean(), y - y.mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / size if size > 0 else 0.0
