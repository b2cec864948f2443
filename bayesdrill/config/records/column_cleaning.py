"""One column as it comes: what is masked or missing, what a sensor seems to have made, differences
of another column.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.config.records.sources import Clock, Sources
from bayesdrill.config.schema.records import AngleColumn, ChannelSpec, InputColumn, Series, mask
from bayesdrill.config.yaml_source import Place
from bayesdrill.record import anomalies
from bayesdrill.record.anomalies import Spans
from bayesdrill.record.experiment import Odd, count_noun

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """`values (n,)` on the rows of its clock, in the unit of the file; NaN where none is used."""

    place: Place
    spec: Series
    clock: Clock
    values: Array

    @property
    def name(self) -> str:
        return str(self.place[-1])

    @property
    def is_input(self) -> bool:
        return isinstance(self.spec, InputColumn)


@dataclass(frozen=True, slots=True)
class Findings:
    """What was done, in sentences, and what looks odd."""

    told: list[str] = field(default_factory=list)
    odd: list[Odd] = field(default_factory=list)


def masked(sources: Sources, place: Place, spec: Series, clock: Clock) -> Mask:
    """`(n,)` of the rows of a clock: those that the config names; a span without a row is a problem."""
    found, own = np.zeros(len(clock.t), dtype=np.bool_), mask(spec.mask)
    numbers, t = clock.numbers, clock.t
    spans = [("rows", k, float(a), float(b)) for k, (a, b) in enumerate(own.rows)]
    spans += [("times", k, a, b) for k, (a, b) in enumerate(own.times)]
    for entry, k, first, last in spans:
        of, unit = (numbers, "") if entry == "rows" else (t, " s")
        slack = 1e-9 * max(abs(first), abs(last))
        one = (of >= first - slack) & (of <= last + slack)
        if not one.any():
            message = (
                f"no sample lies from {first:g} to {last:g}{unit}: those that are used go from "
                f"{of[0]:g} to {of[-1]:g}{unit}; mend the two, the smaller first, or remove them"
            )
            sources.add((*place, "mask", entry, k), message)
        found |= one
    return found


def caused(clock: Clock, inputs: list[Column]) -> Mask:
    """`(n,)`: rows at which a measured input has just jumped."""
    found = np.zeros(len(clock.t), dtype=np.bool_)
    for one in inputs:
        jumped = one.clock.t[anomalies.jumps(one.values)]
        after = np.searchsorted(clock.t, jumped - 1e-12)
        found[after[after < len(found)]] = True
    return found


def unwrapped(sources: Sources, one: Column, turn: float, findings: Findings) -> Column:
    """`turn`: how much of the column's unit one turn is; NaN where it is no angle."""
    wraps = one.spec.wraps if isinstance(one.spec, ChannelSpec | AngleColumn) else None
    if not wraps:
        return one
    period = turn if wraps is True else float(wraps)
    if not period > 0:
        message = (
            f"{one.name} is no angle; say after how much it begins again, for example `wraps: 360`"
        )
        sources.add((*one.place, "wraps"), message)
        return one
    known = np.flatnonzero(~np.isnan(one.values))
    x = one.values[known]
    doubtful = anomalies.ambiguous(x, period)
    if len(doubtful):
        at = int(known[doubtful[0]])
        message = (
            f"{one.name} jumps by {x[doubtful[0]] - x[doubtful[0] - 1]:.6g} at {one.clock.where(at)} "
            f"({len(doubtful)} such jumps), nearly half of {period:.6g}: it cannot be told which way it "
            "went; mask these rows (mask: {rows: ...}), or record at a higher rate"
        )
        sources.add((*one.place, "wraps"), message)
        return one
    values, (straight, count) = one.values.copy(), anomalies.unwrap(x, period)
    values[known] = straight
    findings.told.append(
        f"{one.name}: unwrapped {count_noun(count, 'jump')} of {period:.6g} {one.spec.unit}"
    )
    return Column(one.place, one.spec, one.clock, values)


def judged(one: Column, inputs: list[Column], findings: Findings) -> Column:
    """Without the glitches that are masked; what is odd is named.  `inputs`: jumps of these are no
    glitches of a channel.
    """
    known = np.flatnonzero(~np.isnan(one.values))
    x = one.values[known]
    cause = None if one.is_input else caused(one.clock, inputs)[known]
    spikes = anomalies.spikes(x, cause, wide=not one.is_input)
    values = one.values
    if len(spikes) and mask(one.spec.mask).glitches:
        values = values.copy()
        values[known[spikes.mask(len(x))]] = np.nan
        samples, places = count_noun(spikes.count, "sample"), count_noun(len(spikes), "place")
        first = _where(one.clock, spikes, known, 0)
        findings.told.append(
            f"{one.name}: {samples} in {places} are glitches, and masked (the first at {first})"
        )
    elif len(spikes):
        findings.odd.append(_glitches(one, spikes, known))
    if not one.is_input:
        findings.odd.extend(_ends(one, x, known))
    return Column(one.place, one.spec, one.clock, values)


def _glitches(one: Column, spikes: Spans, known: NDArray[np.intp]) -> Odd:
    entry = ".".join(map(str, one.place))
    return Odd(
        said=f"glitches: {one.name} leaves its course and is back within a few samples in "
        f"{count_noun(len(spikes), 'place')} ({count_noun(spikes.count, 'sample')})",
        where=_every(one.clock, spikes, known),
        do=f"; was it the sensor? Then leave them out ({entry}: mask: glitches)",
    )


def _ends(one: Column, x: Array, known: NDArray[np.intp]) -> list[Odd]:
    entry = ".".join(map(str, one.place))
    clipped = anomalies.saturated(x)
    if len(clipped):
        return [
            Odd(
                said=f"saturated: {one.name} runs into exactly the same value, "
                f"{x[clipped.first[0]]:.6g} {one.spec.unit}, {count_noun(len(clipped), 'place')} "
                f"({count_noun(clipped.count, 'sample')})",
                where=_every(one.clock, clipped, known),
                do=f"; the end of its range? Then leave them out ({entry}: mask: {{rows: ...}})",
            )
        ]
    still = anomalies.stuck(x)
    if not len(still):
        return []
    first, last = known[still.first[0]], known[still.last[0]]
    t = one.clock.t
    return [
        Odd(
            said=f"stuck: {one.name} stays at exactly one value for {still.count} samples, from "
            f"{t[first]:.6g} to {t[last]:.6g} s, and elsewhere hardly ever repeats one",
            where=_every(one.clock, still, known),
            do="; a sensor that was stuck, cut off or at the end of its range? Cut these samples off "
            f"(record.window), or leave them out ({entry}: mask: {{rows: ...}})",
        )
    ]


def _every(clock: Clock, of: Spans, known: NDArray[np.intp]) -> tuple[str, ...]:
    return tuple(_where(clock, of, known, k) for k in range(len(of)))


def _where(clock: Clock, of: Spans, known: NDArray[np.intp], k: int) -> str:
    """Rows and times of the span `k`, of samples that are `known` rows."""
    first, last = int(known[of.first[k]]), int(known[of.last[k]])
    if first == last:
        return f"{clock.where(first)} ({clock.t[first]:.6g} s)"
    return (
        f"{clock.where(first)} to {clock.numbers[last]} "
        f"({clock.t[first]:.6g} to {clock.t[last]:.6g} s)"
    )


def bridged(sources: Sources, one: Column) -> Array:
    """An input's values, what is missing as its hold has it; where that cannot be, a problem."""
    spec, missing = one.spec, np.isnan(one.values)
    if not missing.any():
        return one.values
    known = np.flatnonzero(~missing)
    straight = isinstance(spec, InputColumn) and spec.hold == "first"
    ends = [0] if len(known) and missing[0] else []
    ends += [len(missing) - 1] if len(known) and straight and missing[-1] else []
    if not len(known) or ends:
        at = one.clock.where(ends[0]) if ends else "every row"
        message = (
            f"no number is there, at {at}, and none {'on both sides' if straight else 'before it'} to "
            "hold; cut these rows off (record.window), or name another column"
        )
        sources.add(one.place, message)
        return one.values
    if straight:
        return np.interp(one.clock.t, one.clock.t[known], one.values[known])
    return one.values[known[np.searchsorted(known, np.arange(len(missing)), side="right") - 1]]


NEAR = 0.3  # of its rms: farther off, a channel is hardly what it is said to be


def find_derivatives(columns: Mapping[Place, Column], findings: Findings) -> None:
    """Of each derived channel: that it is not counted, and how well it is what it is said to be."""
    for one in columns.values():
        of = one.spec.derived_from if isinstance(one.spec, ChannelSpec) else None
        if of is None:
            continue
        why = "it has no noise of its own, and would count the same numbers twice"
        not_counted = f"{one.name} is not counted, as it is derived from {of}: {why}"
        found = _compared(one, columns["record", "channels", of])
        if found is None:
            findings.told.append(
                f"{not_counted}; it was not compared, as it has other times or units"
            )
            continue
        kind, off, times = found
        like = f"{times:.4g} times the {kind} difference quotient of {of} to {off:.2g} of its rms"
        findings.told.append(f"{not_counted}; it is {like}")
        if off > NEAR:
            findings.odd.append(
                Odd(
                    said=f"derived: {one.name} is said to be derived from {of}, but is only {like}",
                    where=(),
                    do="; if it was measured by a sensor of its own, remove derived_from",
                )
            )


def _compared(one: Column, of: Column) -> tuple[str, float, float] | None:
    """Which quotient, how far off (of the rms), and how many times it, in SI."""
    if one.clock is not of.clock:
        return None
    both = ~np.isnan(one.values) & ~np.isnan(of.values)
    try:
        turned = units.factor(of.spec.unit, "rad")
        moved = units.factor(one.spec.unit, "rad/s")
    except ValueError:
        return None
    if np.sum(both) < anomalies.MIN_DIFFERENCED_SAMPLES:
        return None
    x, w, t = of.values[both] * turned, one.values[both] * moved, one.clock.t[both]
    slope = next(iter(anomalies.quotients(x, t).values()))
    size = float(slope @ slope)
    times = float(slope @ w[1:-1]) / size if size > 0 else 0.0
    if times == 0.0:
        return None
    return (*anomalies.nearest_quotient(times * x, w, t), times)
