"""Columns as signals: which is the time and in which unit, which rows are used, each column as a sensor
without glitches and turns that began again, and what columns say of each other.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.drafting.columns import LARGEST, LEAST, SI, TWIST, Seen, believable
from bayesdrill.record import anomalies
from bayesdrill.record.experiment import STEP_TOLERANCE

USUAL_RATE = 300.0  # Hz; rates of rigs lie around it, by their logarithm


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """`t (T,)` in s; `column`: None where a rate has to do; `why` it is so, `doubt` what to look at."""

    t: Array
    column: Seen | None
    unit: str
    why: str
    doubt: str = ""

    @property
    def dt(self) -> float:
        return float(np.nanmedian(np.diff(self.t)))

    @property
    def rate(self) -> float:
        return 1 / self.dt


def find_time(columns: Sequence[Seen], rate: float = 0.0, given: float = 0.0) -> Timing:
    """The `given` rate [Hz]; the time among the columns; else `rate` [Hz], or 100 to be reviewed."""
    if given:
        return Timing(np.arange(len(columns[0].values)) / given, None, "s", "as it was given")
    named = [one for one in columns if one.says.kind == "time" and _steps(one.values)]
    if named:
        one = named[0]
        return _of(one, "by its name")
    even = [one for one in columns if not one.says.kind and _even(one.values)]
    if even:
        doubt = "no column is named as a time; this one grows in equal steps"
        return _of(even[0], "", doubt)
    length = len(columns[0].values)
    t = np.arange(length) / (rate or 100.0)
    if rate:
        return Timing(t, None, "s", "found from an angle and its speed", "found, not read")
    doubt = "no column is a time; 100 samples a second are a guess: say `--rate`, or write your own [Hz]"
    return Timing(t, None, "s", "", doubt)


def _of(one: Seen, why: str, doubt: str = "") -> Timing:
    unit = one.says.unit
    step = float(np.nanmedian(np.diff(one.values)))
    if not unit:
        rates = {u: 1 / (step * units.factor(u, "s")) for u in ("s", "ms", "us")}
        unit = min(rates, key=lambda u: abs(math.log(rates[u] / USUAL_RATE)))
        said = f"no unit is said; steps of {step:.6g} {unit} make a usual sampling rate"
        doubt = f"{doubt}; {said}" if doubt else said
    return Timing(one.values * units.factor(unit, "s"), one, unit, why, doubt)


def _steps(values: Array) -> bool:
    """Whether most of it increases; what breaks off is cut later."""
    steps = np.diff(values[np.isfinite(values)])
    return len(steps) > 0 and float(np.mean(possible(steps))) > 0.9


def possible(steps: Array) -> NDArray[np.bool_]:
    """Of a time, in any unit."""
    return np.asarray((steps > 1 / LARGEST) & (steps < LARGEST))


def _even(values: Array) -> bool:
    if not np.all(np.isfinite(values)):
        return False
    steps = np.diff(values)
    usual = np.asarray(np.median(steps))
    near = np.abs(steps - usual) <= max(STEP_TOLERANCE, 0.01) * usual
    return bool(possible(usual) and np.all(near))


LONG = 10.0  # usual steps: over a longer gap nothing is told
EVEN = 0.01  # of a step
SLACK = 1e-9  # of its times, by which a window is wider than it says


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Used are `rows` with times `t (T,)` s; looked at is a `grid (n,)` s, even, without long gaps."""

    rows: slice
    t: Array
    grid: Array
    cut: bool

    @property
    def dt(self) -> float:
        return float(self.grid[1] - self.grid[0])


def part(time: Timing, used: Sequence[Seen]) -> Part | None:
    """The longest one in which times increase and no number of `used` is infinite; None: too short."""
    sound = np.isfinite(time.t)
    for one in used:
        sound &= ~np.isinf(one.values)
    steps = np.diff(time.t)
    rows = _alone(time.t, _longest(sound[1:] & sound[:-1] & possible(steps)))
    if rows.stop - rows.start < LEAST:
        return None
    t = time.t[rows]
    steps = np.diff(t)
    usual = float(np.median(steps))
    calm = t[_longest(steps <= LONG * usual)]
    even = np.all(np.abs(np.diff(calm) - usual) <= EVEN * usual)
    grid = calm if even else calm[0] + usual * np.arange(int((calm[-1] - calm[0]) / usual) + 1)
    return None if len(grid) < LEAST else Part(rows, t, grid, len(t) < len(time.t))


def _alone(t: Array, rows: slice) -> slice:
    """Of `rows` the longest stretch among whose times no other row is: a window tells them apart."""
    own, others = t[rows], np.sort(np.delete(t, np.arange(len(t))[rows]))
    slack = SLACK * float(np.abs(own).max(initial=0.0))
    before = np.searchsorted(others, own - slack)
    after = np.searchsorted(others, own + slack, "right")
    free = after == before  # NaN sorts to the end
    stretch = _longest(free[1:] & free[:-1] & (before[1:] == before[:-1]))
    return slice(rows.start + stretch.start, rows.start + stretch.stop)


def _longest(joined: np.ndarray) -> slice:
    """Of rows, each `joined (T - 1,)` to the next."""
    runs = anomalies.spans(joined)
    if not len(runs):
        return slice(0, 0)
    best = int(np.argmax(runs.last - runs.first))
    return slice(int(runs.first[best]), int(runs.last[best]) + 2)


# How many units of the angle are one of the speed, times s: what a derivative can be.
FACTORS = {
    ("rad", "rad/s"): 1.0,
    ("deg", "deg/s"): 1.0,
    ("deg", "rpm"): 6.0,
    ("deg", "rad/s"): 180 / math.pi,
    ("rad", "rpm"): math.pi / 30,
    ("rad", "deg/s"): math.pi / 180,
}
NEAR = 0.15  # of the logarithm, around one of them
EXPLAINED = 0.98  # of the variance of an angle, at least


def integral(speed: Array, dt: float) -> Array:
    """(T,) by the trapezoidal rule, zero at the first sample."""
    return np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) * (0.5 * dt))])


def explained(y: Array, *causes: Array) -> tuple[list[float], float]:
    """Factors of the causes, beside a constant, and the share of the variance that they explain."""
    design = np.stack([*causes, np.ones(len(y))], axis=-1)
    scale = np.maximum(np.abs(design).max(axis=0), 1e-300)
    factors = np.linalg.lstsq(design / scale, y, rcond=None)[0] / scale
    total = float(np.var(y))
    left = float(np.var(y - design @ factors))
    return [float(one) for one in factors[:-1]], 1 - left / total if total > 0 else 0.0


def centred(values: Array) -> Array:
    return values - values.mean()


def explained_by(y: Array, cause: Array) -> tuple[float, float]:
    """As `explained`, of one cause alone and both `centred`: for many pairs."""
    # Not `y @ cause`: BLAS shares vectors out to threads, which costs far more than the sum.
    total, square, both = (
        float(np.einsum("i,i", *pair)) for pair in ((y, y), (cause, cause), (y, cause))
    )
    if total == 0 or square == 0:
        return 0.0, 0.0
    return both / square, both / square * both / total


def units_of(factor: float, angle: str, speed: str) -> list[tuple[str, str]]:
    """Units of angle and speed (empty: not known) that such a factor between them can mean."""
    if factor == 0:
        return []
    return [
        pair
        for pair, one in FACTORS.items()
        if abs(math.log(abs(factor) / one)) < NEAR
        and angle in ("", pair[0])
        and speed in ("", pair[1])
    ]


def ratio(over: Array, under: Array) -> float:
    """Of two angles that go together; NaN where one does not move."""
    first, second = over - over[0], under - under[0]
    square = float(second @ second)
    return float(first @ second) / square if square > 0 else math.nan


def ratio_through_shaft(over: Array, rotor: Array, dt: float) -> float:
    """As `ratio`, of an angle before the shaft to that of rotor 1 behind it, which swings.

    The angle at the gearbox is `rotor` and a multiple of its acceleration; twice integrated, so that
    noise is not differentiated.
    """
    double = [integral(integral(one - one[0], dt), dt) for one in (over, rotor)]
    (found, *_), _ = explained(double[0], double[1], rotor, integral(np.ones(len(rotor)), dt))
    return found


def differenced(angle: Array, speed: Array, t: Array) -> bool:
    """Whether the speed is no measurement of its own, but differences of the angle; all `(T,)`."""
    middle = speed[1:-1]
    for guess in anomalies.quotients(angle, t).values():
        rough = np.diff(middle, 2)
        if len(rough) < 3 or not np.any(rough):
            return False
        _, share = explained(rough, np.diff(guess, 2))
        if share > 0.999:
            return True
    return False


def step(values: Array) -> float:
    """Between neighbouring levels of what is counted or rounded; 0: it has none."""
    apart = np.diff(np.unique(values))
    apart = apart[apart > 1e-9 * float(np.ptp(values))]
    return float(np.mean(apart[apart < 1.5 * apart.min()])) if len(apart) else 0.0


def counted_unit(angle: Array) -> str:
    """The unit in which the steps of an encoder make a round number for one turn; empty: none."""
    one = step(angle)
    if one == 0 or abs(math.log10(one) - round(math.log10(one))) < 1e-6:  # rounded, not counted
        return ""
    if not np.allclose(angle / one, np.round(angle / one), atol=0.1, rtol=1e-4):
        return ""
    for unit, turn in (("rad", 2 * math.pi), ("deg", 360.0)):
        count = turn / one
        whole = round(count)
        near = abs(count / whole - 1) < 2e-4 if whole else False
        if near and 100 <= whole <= 65536 and (whole % 100 == 0 or whole & (whole - 1) == 0):
            return unit
    return ""


def noise(values: Array) -> float:
    """Standard deviation of what differs from sample to sample; at least that of the last digit.

    Differences of higher order leave less of the signal, so the smallest counts.
    """
    found = []
    for order in (2, 3, 4, 5):
        rough = np.diff(values, order)
        if len(rough) > order:
            own = math.sqrt(math.comb(2 * order, order))
            found.append(float(np.median(np.abs(rough))) / 0.6745 / own)
    few = len(np.unique(values)) < 0.5 * len(values)
    rounding = step(values) / math.sqrt(12) if few else 0.0
    tiny = 1e-6 * float(np.ptp(values))
    return max(min(found, default=0.0), rounding, tiny)


TURNS = ("angle", "speed")
TURN = {"deg": 360.0, "rad": 2 * math.pi, "revolution": 1.0}
BITS = (12, 14, 16, 24, 32)  # of counters
FULL = 0.9  # of a turn, that an angle which begins again has to cover
SMOOTH = 4.0  # times the usual step, at most, is left where it begins again


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """What was measured, `x (m,)` at times `t (m,)` s, without what looks like a glitch; how many
    samples are no number.

    `wraps`: after how much it begins again, 0: it does not; `glitches`: first and last times [s].
    """

    t: Array
    x: Array
    missing: int = 0
    glitches: tuple[tuple[float, float], ...] = ()
    wraps: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A column with what is believed of it: `why` is known of it, `doubts` are to be reviewed.

    `values (n,)` are on the grid of its part; `guessed`: no head and no other column tells its unit.
    """

    seen: Seen
    values: Array
    kind: str
    place: str
    unit: str
    raw: Raw
    why: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    guessed: bool = False

    @property
    def name(self) -> str:
        return self.seen.name

    @property
    def si(self) -> Array:
        sign = -1.0 if self.seen.says.backwards else 1.0
        return sign * self.values * units.factor(self.unit, SI[self.kind])

    @property
    def noise(self) -> float:
        """In the column's unit."""
        return noise(self.raw.x)

    @property
    def varies(self) -> bool:
        return bool(np.ptp(self.raw.x) > 0)

    def angle(self, dt: float) -> Array:
        """How far it has turned, in rad, (n,)."""
        return self.si if self.kind == "angle" else integral(self.si, dt)

    def but(self, *, why: str = "", doubt: str = "", **changes: Any) -> Sensor:
        return dataclasses.replace(
            self,
            why=(*self.why, why) if why else self.why,
            doubts=(*self.doubts, doubt) if doubt else self.doubts,
            **changes,
        )


def drafts(columns: Sequence[Seen], part: Part) -> tuple[list[Sensor], dict[str, str]]:
    """Of columns beside the time, as their heads say what they are; and why others are left out."""
    left_out = {one.name: why for one in columns if (why := _useless(one, part.rows))}
    useful = [one for one in columns if one.name not in left_out]
    jumped = jumps(useful, part)
    found = [draft(one, part, jumped) for one in useful]
    return [_without_swings(one, found, part) for one in found], left_out


CALM = (
    1.5  # times what it usually leaves its chord by, that another channel may in a glitch of this
)


def _without_swings(one: Sensor, others: Sequence[Sensor], part: Part) -> Sensor:
    """Long departures are glitches only where no other channel leaves its own course with it."""
    beside = [o.values for o in others if o is not one and o.kind in (*TURNS, "current")]

    def alone(begin: float, end: float) -> bool:
        first, last = np.searchsorted(part.grid, (begin - 1e-9, end + 1e-9)) - (0, 1)
        if last - first < anomalies.SHORTEST:
            return True
        return all(anomalies.leaves_chord(x, int(first), int(last)) < CALM for x in beside)

    glitches = tuple(pair for pair in one.raw.glitches if alone(*pair))
    return one.but(raw=dataclasses.replace(one.raw, glitches=glitches))


def jumps(columns: Sequence[Seen], part: Part) -> NDArray[np.bool_]:
    """Rows `(T,)` at which a voltage among the columns has just jumped."""
    found = np.zeros(len(part.t), dtype=np.bool_)
    for one in (column for column in columns if column.says.kind == "voltage"):
        found[anomalies.jumps(one.values[part.rows])] = True
    return found


def draft(
    one: Seen, part: Part, jumped: NDArray[np.bool_], kind: str = "", unit: str = ""
) -> Sensor:
    """`kind` and `unit`: where they are known otherwise than by the head."""
    kind, unit = kind or one.says.kind, unit or one.says.unit
    values = one.values[part.rows]
    known = np.flatnonzero(np.isfinite(values))
    t, x = part.t[known], values[known]
    doubt, period, found = "", 0.0, anomalies.spans(np.zeros(len(x), dtype=np.bool_))
    if kind == "angle" and one.says.place != TWIST:
        period, turned = _wraps(x, unit)
        if period and not unit:
            unit = turned
            doubt = f"no unit is said; {turned}, as it begins again after {period:.6g}"
        x = anomalies.unwrapped(x, period)[0] if period else x
    if kind in (*TURNS, "current"):
        found = anomalies.spikes(x, jumped[known], inert=kind in TURNS)
    glitches = tuple(zip(t[found.first].tolist(), t[found.last].tolist(), strict=True))
    spikes = found.mask(len(x))
    missing, t, x = len(values) - len(known), t[~spikes], x[~spikes]
    raw = Raw(t, x, missing, glitches, period)
    even = len(t) == len(part.grid) and bool(np.array_equal(t, part.grid))
    on_grid = x if even else np.interp(part.grid, t, x)
    said = Sensor(one, on_grid, kind, one.says.place, unit, raw)
    return said.but(doubt=doubt)


def _wraps(x: Array, unit: str) -> tuple[float, str]:
    """After how much an angle begins again, 0: it does not; and of which unit that is a turn."""
    turns = {unit: TURN[unit]} if unit in TURN else {} if unit else TURN
    periods = [(turn, name) for name, turn in turns.items()]
    if unit.startswith("count"):
        counts = [2 * math.pi / units.factor(unit, "rad"), *(2.0**b for b in BITS)]
        periods += [(count, unit) for count in counts]
    steps = np.abs(np.diff(x))
    for period, name in periods:
        far = steps > 0.5 * period
        if not far.any() or not FULL * period < np.ptp(x) < 1.001 * period:
            continue
        rest = np.abs(np.diff(anomalies.unwrapped(x, period)[0]))
        usual = float(np.quantile(rest[~far], 0.99)) if (~far).any() else math.inf
        if np.all(rest[far] <= SMOOTH * usual) and not len(anomalies.ambiguous(x, period)):
            return period, name
    return 0.0, ""


def _useless(one: Seen, rows: slice) -> str:
    says, values = one.says, one.values[rows]
    if says.strange and says.kind in TURNS:
        return f"its unit {says.strange!r} does not say how far one of it turns"
    if says.strange:
        return (
            f"its unit {says.strange!r} is none of time, angle, speed, voltage, current or torque"
        )
    if np.any(np.isinf(values)):
        return "has infinite values"
    numbers = values[np.isfinite(values)]
    if len(numbers) < LEAST:
        return f"has {len(numbers)} numbers in the rows that are used"
    if not believable(numbers):
        return f"has numbers up to {np.abs(numbers).max():.3g}, which no rig has"
    if says.kind == "time":
        return "is a second time, or does not increase"
    if says.kind == "force":
        return "is a force, which the rig does not have"
    if says.wanted and says.kind != "voltage":
        return "is what was asked for, not what happened"
    if np.ptp(numbers) == 0 and says.kind != "voltage":
        return f"is {numbers[0]:g} in every row"
    return ""
