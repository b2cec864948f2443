"""Find the time, the rows to use and the sensors in columns, and relations between signals."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.errors import count_noun
from bayesdrill.drafting.columns import DRIVES, MAX_NUMBER, MIN_SAMPLES, SI, TWIST, FileColumn
from bayesdrill.record import anomalies
from bayesdrill.record.regression import integral, linear_fit

TYPICAL_RATE = 300.0  # Hz; the geometric centre of usual sampling rates
GIVEN_REASON = "as `--columns` says"
REVERSAL_RATIO, CLEAR_REVERSAL_RATIO = 0.1, 0.3  # least (smaller / larger) extent for a reversal
MAX_DEAD_SAMPLES, N_PAST, MAX_ROWS = 10, 3, 20_000  # largest delay; fitted past samples; most rows
STRIDES, MIN_BLOCKS = (1, 2, 4, 8), 100  # samples per block mean, least number of blocks
MAX_RESIDUAL_RATIO = 0.64  # largest ratio of residual variances with and without a delay


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """The timing holds times `t (T,)` [s] of all rows; `column` is None if only a rate is known."""

    t: Array
    column: FileColumn | None
    unit: str
    reason: str
    doubt: str = ""

    @property
    def dt(self) -> float:
        """Return the median step [s]."""
        return float(np.nanmedian(np.diff(self.t)))

    @property
    def rate(self) -> float:
        """Return the sampling rate [Hz]."""
        return 1 / self.dt


def find_time(columns: Sequence[FileColumn], rate: float = 0.0, given: float = 0.0) -> Timing:
    """Return the timing by what is known first: `given` [Hz], a time column, `rate` [Hz], or 100 Hz."""
    indices = np.arange(len(columns[0].values))
    if given:
        return Timing(indices / given, None, "s", "as given")
    for column in columns:
        if column.meaning.kind == "time" and _mostly_increases(column.values):
            return _timing(column, GIVEN_REASON if column.meaning.is_given else "by its name")
    for column in columns:
        if not column.meaning.kind and column.is_even:
            doubt = "no column is named as a time; this one grows in equal steps"
            return _timing(column, "", doubt)
    if rate:
        doubt = "no column is a time; the rate follows from an angle and its speed"
        return Timing(indices / rate, None, "s", "", doubt)
    doubt = "no column is a time; 100 samples a second are a guess: use `--rate`, or write your own [Hz]"
    return Timing(indices / 100.0, None, "s", "", doubt)


def _timing(column: FileColumn, why: str, doubt: str = "") -> Timing:
    unit = column.meaning.unit
    if not unit:
        step = float(np.nanmedian(np.diff(column.values)))
        rates = {u: 1 / (step * units.factor(u, "s")) for u in ("s", "ms", "us", "ns")}
        unit = min(rates, key=lambda u: abs(math.log(rates[u] / TYPICAL_RATE)))
        text = f"no unit is stated; steps of {step:.6g} {unit} make a usual sampling rate"
        doubt = f"{doubt}; {text}" if doubt else text
    return Timing(column.values * units.factor(unit, "s"), column, unit, why, doubt)


def _mostly_increases(values: Array) -> bool:
    """Return whether over 90 % of the steps are positive; other rows are cut off later."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 0 and float(np.mean(_are_time_steps(steps))) > 0.9


def _are_time_steps(steps: Array) -> Flags:
    """Return a mask of the steps that are plausible for a time in any unit."""
    return np.asarray((steps > 1 / MAX_NUMBER) & (steps < MAX_NUMBER))


LONG_GAP = 10.0  # in median steps; longer gaps are not interpolated
EVEN_GRID_TOLERANCE = 0.01  # largest relative deviation of a step from the median step
WINDOW_SLACK = 1e-9  # excess of a window beyond its ends, relative to the largest time


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A segment has the used `rows` and their times `t (T,)` [s]; `is_cut` if rows are cut off."""

    rows: slice
    t: Array
    grid: Array  # (n,), s; even and without long gaps, for the comparison of signals
    is_cut: bool

    @property
    def dt(self) -> float:
        """Return the step of the grid [s]."""
        return float(self.grid[1] - self.grid[0])


def longest_segment(time: Timing, columns: Sequence[FileColumn]) -> Segment | None:
    """Return the longest part with increasing times and no infinite number; None if it is too short."""
    sound = np.isfinite(time.t)
    for column in columns:
        sound &= ~np.isinf(column.values)
    joined = sound[1:] & sound[:-1] & _are_time_steps(np.diff(time.t))
    rows = _unambiguous_rows(time.t, _longest_run(joined))
    if rows.stop - rows.start < MIN_SAMPLES:
        return None
    t = time.t[rows]
    steps = np.diff(t)
    step = float(np.median(steps))
    grid = t[_longest_run(steps <= LONG_GAP * step)]
    if not np.all(np.abs(np.diff(grid) - step) <= EVEN_GRID_TOLERANCE * step):
        grid = grid[0] + step * np.arange(int((grid[-1] - grid[0]) / step) + 1)
    return None if len(grid) < MIN_SAMPLES else Segment(rows, t, grid, len(t) < len(time.t))


def _unambiguous_rows(t: Array, rows: slice) -> slice:
    """Return the longest part of `rows` whose times a window can separate from all other rows."""
    inner, others = t[rows], np.sort(np.delete(t, np.arange(len(t))[rows]))
    slack = WINDOW_SLACK * float(np.abs(inner).max(initial=0.0))
    before = np.searchsorted(others, inner - slack)
    after = np.searchsorted(others, inner + slack, "right")
    free = after == before  # NaN sorts to the end
    part = _longest_run(free[1:] & free[:-1] & (before[1:] == before[:-1]))
    return slice(rows.start + part.start, rows.start + part.stop)


def _longest_run(joined: Flags) -> slice:
    """Return the longest run of rows; `joined (T - 1,)`: whether a row continues with the next."""
    runs = anomalies.spans(joined)
    if not len(runs):
        return slice(0, 0)
    best = int(np.argmax(runs.last - runs.first))
    return slice(int(runs.first[best]), int(runs.last[best]) + 2)


FACTOR_TOLERANCE = 0.15  # largest error of the logarithm of a derivative's factor
EXPLAINED_SHARE = 0.98  # least fraction of an angle's variance that its speed explains


def explained(y: Array, *causes: Array) -> tuple[list[float], float]:
    """Fit `y (T,)` by causes `(T,)` and a constant; return factors, explained variance fraction."""
    factors, remaining = linear_fit(y, causes)
    total = float(np.var(y))
    return factors[:-1].tolist(), 1 - remaining / total if total > 0 else 0.0


def explained_by(y: Array, cause: Array) -> tuple[float, float]:
    """Fit centred `y (T,)` by centred `cause (T,)`; return factor, explained variance fraction."""
    # In `y @ cause` BLAS would start threads, which cost far more than the sum.
    pairs = ((y, y), (cause, cause), (y, cause))
    total, square, both = (float(np.einsum("i,i", *pair)) for pair in pairs)
    if total == 0 or square == 0:
        return 0.0, 0.0
    return both / square, both / square * both / total


def units_by_factor(factor: float, angle: str, speed: str) -> list[tuple[str, str]]:
    """Return the unit pairs (angle, speed) that fit a factor; "" stands for an unknown unit."""
    pairs = itertools.product(("rad", "deg"), ("rad/s", "deg/s", "rpm"))
    known = [p for p in pairs if factor and angle in ("", p[0]) and speed in ("", p[1])]
    errors = [abs(math.log(abs(factor) / derivative_factor(*pair))) for pair in known]
    return [p for p, error in zip(known, errors, strict=True) if error < FACTOR_TOLERANCE]


def derivative_factor(angle: str, speed: str) -> float:
    """Return one speed unit in angle units per second: 6 for a speed in rpm and an angle in deg."""
    return units.factor(speed, "rad/s") / units.factor(angle, "rad")


def ratio(over: Array, under: Array) -> float:
    """Return over / under for proportional angles `(T,)`; NaN if `under` does not move."""
    first, second = over - over[0], under - under[0]
    square = float(second @ second)
    return float(first @ second) / square if square > 0 else math.nan


def ratio_through_shaft(over: Array, rotor: Array, dt: float) -> float:
    """Return the ratio of the angle `over` before the shaft to the angle `rotor` behind the shaft.

    The model is over = ratio * rotor + c * d2 rotor / dt2, integrated twice because of noise.
    """
    upper, lower = (integral(integral(x - x[0], dt), dt) for x in (over, rotor))
    factors, _ = explained(upper, lower, rotor, integral(np.ones(len(rotor)), dt))
    return factors[0]


def differenced(angle: Array, speed: Array, t: Array) -> bool:
    """Return whether the speed was computed by differences of the angle; all arrays are `(T,)`."""
    rough = np.diff(speed[1:-1], 2)
    if len(rough) < 3 or not np.any(rough):
        return False
    quotients = anomalies.quotients(angle, t).values()
    return any(explained(rough, np.diff(guess, 2))[1] > 0.999 for guess in quotients)


def step(values: Array) -> float:
    """Return the step between levels of a counted or rounded signal; 0 for a constant signal."""
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > 1e-9 * float(np.ptp(values))]
    return float(np.mean(gaps[gaps < 1.5 * gaps.min()])) if len(gaps) else 0.0


def counted_unit(angle: Array) -> str:
    """Return the unit in which one turn has a round number of encoder steps; else an empty text."""
    count = step(angle)
    if count == 0 or abs(math.log10(count) - round(math.log10(count))) < 1e-6:  # rounded numbers
        return ""
    if not np.allclose(angle / count, np.round(angle / count), atol=0.1, rtol=1e-4):
        return ""
    for unit in ("rad", "deg"):
        counts = TURN[unit] / count
        whole = round(counts)
        is_whole = whole > 0 and abs(counts / whole - 1) < 2e-4
        if is_whole and 100 <= whole <= 65536 and (whole % 100 == 0 or whole & (whole - 1) == 0):
            return unit
    return ""


def coarse_step(values: Array) -> float:
    """Return the step of a signal with few levels; 0 if levels are at least half of the samples."""
    return step(values) if len(np.unique(values)) < 0.5 * len(values) else 0.0


def noise(values: Array) -> float:
    """Estimate the standard deviation of the noise of `values (T,)` by their differences.

    The result is at least the sd of rounding. Differences of orders 2 to 5 are tried: since higher
    orders contain less of the signal, the smallest estimate is taken.
    """
    estimates = []
    for order in (2, 3, 4, 5):
        rough = np.diff(values, order)
        if len(rough) > order:
            gain = math.sqrt(math.comb(2 * order, order))
            estimates.append(float(np.median(np.abs(rough))) / 0.6745 / gain)
    tiny = 1e-6 * float(np.ptp(values))
    return max(min(estimates, default=0.0), coarse_step(values) / math.sqrt(12), tiny)


TURNS = ("angle", "speed")  # kinds of sensors that show a rotation
TURN = {"deg": 360.0, "rad": 2 * math.pi, "revolution": 1.0}
COUNTER_BITS = (12, 14, 16, 24, 32)  # numbers of bits of encoder counters that may overflow
WRAPPED_SHARE = 0.9  # smallest range of a wrapped angle, in periods
WRAPPED_STEP = 4.0  # largest unwrapped step at a wrap, relative to the typical step


@dataclass(frozen=True, slots=True, eq=False)
class RawSamples:
    """Raw samples are finite measurements `x (m,)` at times `t (m,)` [s], without likely glitches."""

    t: Array
    x: Array
    n_missing: int = 0
    glitches: tuple[tuple[float, float], ...] = ()  # first and last time of each glitch [s]
    wrap_period: float = 0.0  # 0 if the signal does not wrap


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A sensor is a column with its presumed kind, location and unit; `doubts` are to be reviewed."""

    column: FileColumn
    values: Array  # (n,), on the grid of its segment
    kind: str
    location: str
    unit: str
    raw: RawSamples
    reasons: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    guessed: bool = False  # the unit follows only from magnitude or words

    @property
    def name(self) -> str:
        """Return the name of the column."""
        return self.column.name

    @property
    def si(self) -> Array:
        """Return the values `(n,)` in SI, with the sign of the state that they measure."""
        sign = -1.0 if self.column.meaning.is_reversed else 1.0
        return sign * self.values * units.factor(self.unit, SI[self.kind])

    @property
    def noise(self) -> float:
        """Return the noise's sd in the column's unit; at least step / sqrt(6) for coarse speeds."""
        steps = coarse_step(self.raw.x) / math.sqrt(6) if self.kind == "speed" else 0.0
        return max(noise(self.raw.x), steps)

    @property
    def varies(self) -> bool:
        """Return whether any two samples differ."""
        return bool(np.ptp(self.raw.x) > 0)

    def angle(self, dt: float) -> Array:
        """Return the angle `(n,)` [rad], integrated from a speed if necessary."""
        return self.si if self.kind == "angle" else integral(self.si, dt)

    def revised(self, *, why: str = "", doubt: str = "", **changes: Any) -> Sensor:
        """Return a copy with an additional reason or doubt, and with changed fields."""
        return dataclasses.replace(
            self,
            reasons=(*self.reasons, why) if why else self.reasons,
            doubts=(*self.doubts, doubt) if doubt else self.doubts,
            **changes,
        )


def read_sensors(
    columns: Sequence[FileColumn], segment: Segment
) -> tuple[list[Sensor], dict[str, str]]:
    """Return the usable columns as sensors that headers describe, and why others are unused."""
    unused = {c.name: why for c in columns if (why := _why_unusable(c, segment.rows))}
    usable = [column for column in columns if column.name not in unused]
    jumped = input_jumps(usable, segment)
    sensors = [read_sensor(column, segment, jumped) for column in usable]
    return [_without_swings(sensor, sensors, segment) for sensor in sensors], unused


MAX_DEPARTURE = 1.5  # largest departure of another channel during a glitch / typical departure


def _without_swings(sensor: Sensor, others: Sequence[Sensor], segment: Segment) -> Sensor:
    """Return the sensor; a long glitch stays in `glitches` only if no other channel departs then."""
    channels = [o.values for o in others if o is not sensor and o.kind in (*TURNS, "current")]

    def alone(begin: float, end: float) -> bool:
        first, last = np.searchsorted(segment.grid, (begin - 1e-9, end + 1e-9)) - (0, 1)
        away = (anomalies.leaves_chord(x, int(first), int(last)) for x in channels)
        return last - first < anomalies.MAX_SHORT_SPIKE or all(x < MAX_DEPARTURE for x in away)

    glitches = tuple(pair for pair in sensor.raw.glitches if alone(*pair))
    return sensor.revised(raw=dataclasses.replace(sensor.raw, glitches=glitches))


def input_jumps(columns: Sequence[FileColumn], segment: Segment) -> Flags:
    """Return a mask `(T,)` of the rows at which a voltage among the columns has just jumped."""
    jumped = np.zeros(len(segment.t), dtype=np.bool_)
    for column in columns:
        if column.meaning.kind == "voltage":
            jumped[anomalies.jumps(column.values[segment.rows])] = True
    return jumped


def read_sensor(
    column: FileColumn, segment: Segment, jumped: Flags, kind: str = "", unit: str = ""
) -> Sensor:
    """Return a column as a sensor, without glitches and unwrapped.

    `jumped (T,)` marks rows at which a voltage jumps; `kind` and `unit` replace the header's.
    """
    kind, unit = kind or column.meaning.kind, unit or column.meaning.unit
    values = column.values[segment.rows]
    known = np.flatnonzero(np.isfinite(values))
    t, x = segment.t[known], values[known]
    doubt, period, spikes = "", 0.0, anomalies.spans(np.zeros(len(x), dtype=np.bool_))
    if kind == "angle" and column.meaning.location != TWIST:
        period, period_unit = _wrap_period(x, unit)
        if period and not unit:
            unit = period_unit
            doubt = f"no unit is stated; {unit}, as it begins again after {period:.6g}"
        x = anomalies.unwrap(x, period)[0] if period else x
    if kind in (*TURNS, "current"):
        spikes = anomalies.spikes(x, jumped[known], inert=kind in TURNS)
    glitches = tuple(zip(t[spikes.first].tolist(), t[spikes.last].tolist(), strict=True))
    sound = ~spikes.mask(len(x))
    t, x = t[sound], x[sound]
    raw = RawSamples(t, x, len(values) - len(known), glitches, period)
    on_grid = x if np.array_equal(t, segment.grid) else np.interp(segment.grid, t, x)
    sensor = Sensor(column, on_grid, kind, column.meaning.location, unit, raw)
    return sensor.revised(doubt=doubt)


def _wrap_period(x: Array, unit: str) -> tuple[float, str]:
    """Return the period with which an angle wraps, and its unit; the period is 0 without wraps."""
    periods = [(turn, name) for name, turn in TURN.items() if unit in ("", name)]
    if unit.startswith("count"):
        counts = [2 * math.pi / units.factor(unit, "rad"), *(2.0**bits for bits in COUNTER_BITS)]
        periods = [(count, unit) for count in counts]
    steps = np.abs(np.diff(x))
    for period, name in periods:
        wrapped = steps > 0.5 * period
        if not wrapped.any() or not WRAPPED_SHARE * period < np.ptp(x) < 1.001 * period:
            continue
        unwrapped = np.abs(np.diff(anomalies.unwrap(x, period)[0]))
        typical = float(np.quantile(unwrapped[~wrapped], 0.99)) if (~wrapped).any() else math.inf
        smooth = np.all(unwrapped[wrapped] <= WRAPPED_STEP * typical)
        if smooth and not len(anomalies.ambiguous(x, period)):
            return period, name
    return 0.0, ""


def _why_unusable(column: FileColumn, rows: slice) -> str:
    meaning, values = column.meaning, column.values[rows]
    kind, unit = meaning.kind, meaning.unknown_unit
    numbers = values[np.isfinite(values)]
    second = "another column is the time already, or it does not increase"
    largest, same = np.abs(numbers).max(initial=0.0), not np.diff(numbers).any()
    other = f'has no known angle or length; use --columns "{column.command}=theta_2 '
    other += '[count/2800]" for 2800 counts a turn, or "x_cart [count/(560/cm)]" for a linear scale'
    if kind not in TURNS:
        other = "is none of time, angle, speed, voltage, current or torque"
    if unit == "%" and kind in DRIVES:
        other = f"is a share of the rated {kind}; look up its value, and give a torque by "
        other += f'--columns "{column.command}=t_m [% of 9.84 mN*m]", a current by "i [% of 1.2 A]"'
    checks = (
        (unit, f"has the unit {unit!r}, which {other}"),
        (column.counts_rows, "grows by one a row: a row number"),
        (np.isinf(values).any(), "has infinite values"),
        (
            len(numbers) < MIN_SAMPLES,
            f"has {count_noun(len(numbers), 'number')} in the rows that are used",
        ),
        (not is_plausible(numbers), f"has numbers up to {largest:.3g}, which no rig has"),
        (kind == "time", f"is a time, but {second}"),
        (kind == "force" and not meaning.symbol, "is a force, which the rig does not have"),
        (meaning.is_setpoint and kind != "voltage", "is a set point, not a measurement"),
        (same and kind != "voltage", f"is {next(iter(numbers), 0.0):g} in every row"),
    )
    return next((why for wrong, why in checks if wrong), "")


def reverses(sensor: Sensor, min_ratio: float = REVERSAL_RATIO) -> bool:
    """Return whether a drive or motion reverses: smaller / larger extent about zero > `min_ratio`."""
    x, stride = sensor.raw.x, max(1, len(sensor.raw.x) // 200)
    if sensor.kind in ("angle", "position"):
        x = x[stride:] - x[:-stride]
    low, high = np.percentile(x, [2, 98])
    return bool(min(-low, high) > min_ratio * max(-low, high))


def dead_samples(
    channels: Sequence[Sensor], inputs: Sequence[Sensor], *, rigid: bool
) -> tuple[int, int]:
    """Return the delay of the first speed after the first input, and its resolution, in samples.

    Both are 0 if no delay is clear. Without a speed, differences of the first angle are used. Noise
    hides a delay of many samples, so for a `rigid` drive means of several samples are tried, too.
    """
    speeds = [sensor.values for sensor in channels if sensor.kind in ("speed", "velocity")]
    angles = [s for s in channels if s.kind in ("angle", "position") and s.location != TWIST]
    speeds += [np.diff(s.values, prepend=s.values[0]) for s in angles]
    driving = [sensor for sensor in inputs if sensor.kind in DRIVES and sensor.varies]
    if not speeds or not driving:
        return 0, 0
    clearest, found = MAX_RESIDUAL_RATIO, (0, 0)
    for stride in STRIDES if rigid else STRIDES[:1]:
        n = len(speeds[0]) // stride
        if stride > 1 and n < MIN_BLOCKS:
            break
        pair = speeds[0], driving[0].values
        x, u = (values[: n * stride].reshape(n, -1).mean(axis=1) for values in pair)
        k = np.arange(N_PAST + MAX_DEAD_SAMPLES, min(n, MAX_ROWS))
        past = [x[k - j] for j in range(1, N_PAST + 1)]
        lags = range(MAX_DEAD_SAMPLES + 1)
        residuals = [1 - explained(x[k], *past, u[k - d - 1])[1] for d in lags]
        best = int(np.argmin(residuals))
        if residuals[best] < clearest * residuals[0]:
            clearest, found = residuals[best] / residuals[0], (best * stride, stride)
    return found


def is_plausible(values: Array) -> bool:
    """Return whether the largest magnitude is zero, or from 1 / `MAX_NUMBER` to `MAX_NUMBER`."""
    largest = float(np.abs(values).max(initial=0.0))
    return largest == 0 or 1 / MAX_NUMBER < largest < MAX_NUMBER
