"""Clean one column: masks, missing samples, angles that wrap, glitches and derived channels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.symbols import SPEED_UNITS
from bayesdrill.config.records.sources import Clock, Sources
from bayesdrill.config.schema.records import (
    AngleColumn,
    ChannelSpec,
    InputColumn,
    Series,
    as_mask_spec,
)
from bayesdrill.config.yaml_source import Location
from bayesdrill.record import anomalies
from bayesdrill.record.anomalies import Spans
from bayesdrill.record.experiment import Anomaly

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class RecordColumn:
    """A record column has `values (n,)` at the rows of its clock, in the file's unit; NaN if unused."""

    location: Location
    spec: Series
    clock: Clock
    values: Array

    @property
    def name(self) -> str:
        """Return the name of the channel or input."""
        return str(self.location[-1])

    @property
    def is_input(self) -> bool:
        """Return whether the column is an input of the rig."""
        return isinstance(self.spec, InputColumn)


def row_mask(sources: Sources, location: Location, spec: Series, clock: Clock) -> Mask:
    """Return a mask `(n,)` of the rows that the config masks; add an issue for an empty span."""
    masked_rows, mask_spec = np.zeros(len(clock.t), dtype=np.bool_), as_mask_spec(spec.mask)
    spans: list[tuple[str, int, Sequence[float], NDArray[Any], str]]
    spans = [("rows", *span, clock.numbers, "") for span in enumerate(mask_spec.rows)]
    spans += [("times", *span, clock.t, " s") for span in enumerate(mask_spec.times)]
    for entry, k, (first, last), values, unit in spans:
        slack = 1e-9 * max(abs(first), abs(last))
        in_span = (values >= first - slack) & (values <= last + slack)
        if not in_span.any():
            message = (
                f"no sample lies from {first:g} to {last:g}{unit}: used samples go from {values[0]:g} "
                f"to {values[-1]:g}{unit}; correct the two numbers, the smaller first, or remove them"
            )
            sources.add((*location, "mask", entry, k), message)
        masked_rows |= in_span
    return masked_rows


def rows_after_jumps(clock: Clock, inputs: list[RecordColumn]) -> Mask:
    """Return the rows, as a mask `(n,)`, at which a measured input has just jumped."""
    rows = np.zeros(len(clock.t), dtype=np.bool_)
    for column in inputs:
        jumped = column.clock.t[anomalies.jumps(column.values)]
        after = np.searchsorted(clock.t, jumped - 1e-12)
        rows[after[after < len(rows)]] = True
    return rows


def unwrap(sources: Sources, column: RecordColumn) -> RecordColumn:
    """Return the column, unwrapped if it has `wraps:`; add an issue if this is ambiguous."""
    wraps = column.spec.wraps if isinstance(column.spec, ChannelSpec | AngleColumn) else None
    if not wraps:
        return column
    period = 0.0 if wraps is True else float(wraps)
    if wraps is True:
        with suppress(ValueError):  # the unit is not that of an angle
            period = 2 * math.pi / units.factor(column.spec.unit, "rad")
    if not period > 0:
        way_out = "give the period, for example `wraps: 360`"
        sources.add((*column.location, "wraps"), f"{column.name} is no angle; {way_out}")
        return column
    rows = np.flatnonzero(~np.isnan(column.values))
    x = column.values[rows]
    doubtful = anomalies.ambiguous(x, period)
    if len(doubtful):
        at = int(rows[doubtful[0]])
        message = (
            f"{column.name} jumps by {x[doubtful[0]] - x[doubtful[0] - 1]:.6g} at "
            f"{column.clock.where(at)} ({len(doubtful)} such jumps), nearly half of {period:.6g}: "
            "its direction is ambiguous; mask these rows (mask: {rows: ...}), or record at a higher "
            "rate"
        )
        sources.add((*column.location, "wraps"), message)
        return column
    values, (straight, count) = column.values.copy(), anomalies.unwrap(x, period)
    values[rows] = straight
    jumps = count_noun(count, "jump")
    sources.notes.append(f"{column.name}: unwrapped {jumps} of {period:.6g} {column.spec.unit}")
    return replace(column, values=values)


def mask_glitches(
    sources: Sources, column: RecordColumn, inputs: list[RecordColumn]
) -> RecordColumn:
    """Return the column with glitches masked; a change after a jump of `inputs` is no glitch."""
    rows = np.flatnonzero(~np.isnan(column.values))
    x = column.values[rows]
    cause = None if column.is_input else rows_after_jumps(column.clock, inputs)[rows]
    spikes = anomalies.spikes(x, cause, wide=not column.is_input)
    values = column.values
    if len(spikes) and as_mask_spec(column.spec.mask).glitches:
        values = values.copy()
        values[rows[spikes.mask(len(x))]] = np.nan
        where = f"{count_noun(spikes.count, 'sample')} in {count_noun(len(spikes), 'place')}"
        first = _span_label(column.clock, spikes, rows, 0)
        note = f"{column.name}: {where} are glitches, and masked (the first at {first})"
        sources.notes.append(note)
    elif len(spikes):
        text = (
            f"glitches: {column.name} jumps away and returns within a few samples in "
            f"{count_noun(len(spikes), 'place')} ({count_noun(spikes.count, 'sample')})"
        )
        do = "; was it the sensor? Then leave them out ({}: mask: glitches)"
        sources.anomalies.append(_anomaly(column, spikes, rows, text, do))
    if not column.is_input:
        sources.anomalies.extend(_saturated_or_stuck(column, x, rows))
    return replace(column, values=values)


def _saturated_or_stuck(
    column: RecordColumn, x: Array, rows: NDArray[np.intp]
) -> Iterator[Anomaly]:
    if len(clipped := anomalies.saturated(x)):
        text = (
            f"saturated: {column.name} runs into exactly the same value, "
            f"{x[clipped.first[0]]:.6g} {column.spec.unit}, {count_noun(len(clipped), 'place')} "
            f"({count_noun(clipped.count, 'sample')})"
        )
        do = "; the end of its range? Then leave them out ({}: mask: {{rows: ...}})"
        yield _anomaly(column, clipped, rows, text, do)
    elif len(still := anomalies.stuck(x)):
        begin, end = (column.clock.t[rows[k[0]]] for k in (still.first, still.last))
        text = (
            f"stuck: {column.name} stays at exactly one value for {still.count} samples, from "
            f"{begin:.6g} to {end:.6g} s, and elsewhere hardly ever repeats a value"
        )
        do = (
            "; a sensor that was stuck, cut off or at the end of its range? Cut these samples off "
            "(record.window), or leave them out ({}: mask: {{rows: ...}})"
        )
        yield _anomaly(column, still, rows, text, do)


def _anomaly(
    column: RecordColumn, spans: Spans, rows: NDArray[np.intp], text: str, do: str
) -> Anomaly:
    """Return an anomaly at the places `spans`; `{}` in `do` stands for the column's location."""
    where = tuple(_span_label(column.clock, spans, rows, k) for k in range(len(spans)))
    return Anomaly(
        text=text, positions=where, advice=do.format(".".join(map(str, column.location)))
    )


def _span_label(clock: Clock, spans: Spans, rows: NDArray[np.intp], k: int) -> str:
    """Return rows and times of the span `k` as text; `rows (n,)` are the rows of the samples."""
    first, last = int(rows[spans.first[k]]), int(rows[spans.last[k]])
    if first == last:
        return f"{clock.where(first)} ({clock.t[first]:.6g} s)"
    times = f"{clock.t[first]:.6g} to {clock.t[last]:.6g} s"
    return f"{clock.where(first)} to {clock.numbers[last]} ({times})"


def bridge_gaps(sources: Sources, column: RecordColumn) -> Array:
    """Return an input's values with gaps filled by its `hold`; add an issue if this fails."""
    spec, missing = column.spec, np.isnan(column.values)
    if not missing.any():
        return column.values
    rows = np.flatnonzero(~missing)
    straight = isinstance(spec, InputColumn) and spec.hold == "first"
    missing_ends = [0] if len(rows) and missing[0] else []
    missing_ends += [len(missing) - 1] if len(rows) and straight and missing[-1] else []
    if not len(rows) or missing_ends:
        at = column.clock.where(missing_ends[0]) if missing_ends else "every row"
        around = "on both sides" if straight else "before it"
        way_out = "cut these rows off (record.window), or name another column"
        message = f"there is no number at {at}, and none {around} to fill the gap; {way_out}"
        sources.add(column.location, message)
        return column.values
    if straight:
        return np.interp(column.clock.t, column.clock.t[rows], column.values[rows])
    return column.values[rows[np.searchsorted(rows, np.arange(len(missing)), side="right") - 1]]


MAX_DERIVATIVE_MISMATCH = 0.3  # relative rms difference above which a derived channel is doubted


def report_derivatives(sources: Sources, columns: Mapping[Location, RecordColumn]) -> None:
    """Report that derived channels are not fitted, and their mismatch with difference quotients."""
    for column in columns.values():
        origin = column.spec.derived_from if isinstance(column.spec, ChannelSpec) else None
        if origin is None:
            continue
        reason = "it has no noise of its own, and would count the same numbers twice"
        not_counted = f"{column.name} is not counted, as it is derived from {origin}: {reason}"
        comparison = _compare_with_quotients(column, columns["record", "channels", origin])
        if comparison is None:
            other = "it was not compared, as it has other times or units"
            sources.notes.append(f"{not_counted}; {other}")
            continue
        kind, mismatch, scale = comparison
        like = f"{scale:.4g} times the {kind} difference quotient of {origin} up to {mismatch:.2g}"
        like += " of its rms"
        sources.notes.append(f"{not_counted}; it is {like}")
        if mismatch > MAX_DERIVATIVE_MISMATCH:
            text = f"derived: {column.name} is said to be derived from {origin}, but is only {like}"
            do = "; if it was measured by a sensor of its own, remove derived_from"
            sources.anomalies.append(Anomaly(text=text, positions=(), advice=do))


def _kinematic_factors(angle: str, speed: str) -> tuple[float, float] | None:
    """Return the SI factors of the units of an angle or position and of its speed, else None."""
    for si, rate in SPEED_UNITS.items():
        try:
            return units.factor(angle, si), units.factor(speed, rate)
        except ValueError:
            continue
    return None


def _compare_with_quotients(
    column: RecordColumn, origin: RecordColumn
) -> tuple[str, float, float] | None:
    """Return kind, relative rms mismatch and factor of the nearest difference quotient, or None."""
    if column.clock is not origin.clock:
        return None
    in_both = ~np.isnan(column.values) & ~np.isnan(origin.values)
    factors = _kinematic_factors(origin.spec.unit, column.spec.unit)
    if factors is None or np.sum(in_both) < anomalies.MIN_DIFFERENCED_SAMPLES:
        return None
    x, w = origin.values[in_both] * factors[0], column.values[in_both] * factors[1]
    t = column.clock.t[in_both]
    slope = next(iter(anomalies.quotients(x, t).values()))
    size = float(slope @ slope)
    scale = float(slope @ w[1:-1]) / size if size > 0 else 0.0
    if scale == 0.0:
        return None
    return (*anomalies.nearest_quotient(scale * x, w, t), scale)
