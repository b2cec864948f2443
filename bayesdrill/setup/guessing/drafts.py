"""A column as a sensor: without glitches and turns that began again, at even times."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.record import angles, glitches
from bayesdrill.setup.guessing import relations
from bayesdrill.setup.guessing.columns import LEAST, Array, Seen, believable
from bayesdrill.setup.guessing.names import SI, TWIST
from bayesdrill.setup.guessing.parts import Part

TURNS = ("angle", "speed")
TURN = {"deg": 360.0, "rad": 2 * math.pi, "revolution": 1.0}
BITS = (12, 14, 16, 24, 32)  # of counters
FULL = 0.9  # of a turn, that an angle which begins again has to cover
SMOOTH = 4.0  # times the usual step, at most, is left where it begins again


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """What was measured, `x (m,)` at times `t (m,)` s; how many samples are no number or glitches.

    `wraps`: after how much it begins again, 0: it does not.
    """

    t: Array
    x: Array
    missing: int = 0
    glitches: int = 0
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
        return self.values * units.factor(self.unit, SI[self.kind])

    @property
    def noise(self) -> float:
        """In the column's unit."""
        return relations.noise(self.raw.x)

    @property
    def varies(self) -> bool:
        return bool(np.ptp(self.raw.x) > 0)

    def angle(self, dt: float) -> Array:
        """How far it has turned, in rad, (n,)."""
        return self.si if self.kind == "angle" else relations.integral(self.si, dt)

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
    return [draft(one, part, jumped) for one in useful], left_out


def jumps(columns: Sequence[Seen], part: Part) -> NDArray[np.bool_]:
    """Rows `(T,)` at which a voltage among the columns has just jumped."""
    found = np.zeros(len(part.t), dtype=np.bool_)
    for one in (column for column in columns if column.says.kind == "voltage"):
        known = np.flatnonzero(np.isfinite(one.values[part.rows]))
        values = one.values[part.rows][known]
        found[known[1:][np.abs(np.diff(values)) > glitches.JUMP * np.ptp(values)]] = True
    return found


def draft(
    one: Seen, part: Part, jumped: NDArray[np.bool_], kind: str = "", unit: str = ""
) -> Sensor:
    """`kind` and `unit`: where they are known otherwise than by the head."""
    kind, unit = kind or one.says.kind, unit or one.says.unit
    values = one.values[part.rows]
    known = np.flatnonzero(np.isfinite(values))
    t, x = part.t[known], values[known]
    doubt, period, spikes = "", 0.0, np.zeros(len(x), dtype=np.bool_)
    if kind == "angle" and one.says.place != TWIST:
        period, turned = _wraps(x, unit)
        if period and not unit:
            unit, doubt = (
                turned,
                f"no unit is said; {turned}, as it begins again after {period:.6g}",
            )
        x = angles.unwrapped(x, period)[0] if period else x
    if kind in (*TURNS, "current"):
        spikes = glitches.spikes(x, jumped[known]).mask(len(x))
    missing, t, x = len(values) - len(known), t[~spikes], x[~spikes]
    raw = Raw(t, x, missing, int(spikes.sum()), period)
    even = len(t) == len(part.grid) and bool(np.array_equal(t, part.grid))
    on_grid = x if even else np.interp(part.grid, t, x)
    said = Sensor(one, on_grid, kind, one.says.place, unit, raw)
    return said.but(doubt=doubt)


def _wraps(x: Array, unit: str) -> tuple[float, str]:
    """After how much an angle begins again, 0: it does not; and of which unit that is a turn."""
    turns = {unit: TURN[unit]} if unit in TURN else {} if unit else TURN
    periods = [(turn, name) for name, turn in turns.items()]
    if unit.startswith("count"):
        periods += [
            (2 * math.pi / units.factor(unit, "rad"), unit),
            *((2.0**b, unit) for b in BITS),
        ]
    steps = np.abs(np.diff(x))
    for period, name in periods:
        far = steps > 0.5 * period
        if not far.any() or not FULL * period < np.ptp(x) < 1.001 * period:
            continue
        rest = np.abs(np.diff(angles.unwrapped(x, period)[0]))
        usual = float(np.quantile(rest[~far], 0.99)) if (~far).any() else math.inf
        if np.all(rest[far] <= SMOOTH * usual) and not len(angles.ambiguous(x, period)):
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
