"""Read the files of a record into an `Experiment` in SI, or raise all mistakes at once."""

from __future__ import annotations

import math

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import build_member
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.units import Unit
from bayesdrill.config.building.case import ResolvedExperiment
from bayesdrill.config.records import column_cleaning, sources
from bayesdrill.config.records.column_cleaning import RecordColumn
from bayesdrill.config.records.sources import Files, Sources, column_location
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.numbers import SensorFields
from bayesdrill.config.schema.records import (
    AngleColumn,
    InputColumn,
    InputQuantity,
    RecordSpec,
    Series,
    TimeColumn,
    inside_spans,
    window_spans,
)
from bayesdrill.config.yaml_source import Location
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.record import anomalies, clocks
from bayesdrill.record.experiment import (
    Anomaly,
    Experiment,
    Written,
    calendar_hint,
    check_length,
    check_series,
    frozen,
    raise_if_any,
)
from bayesdrill.record.formats.csv import CsvOptions

MAX_LEAD = 1000  # (time before the first sample / record length) above which times may be dates


def csv_options(record: RecordSpec) -> CsvOptions:
    """Return the options that the config gives for a text file."""
    return build_member(CsvOptions, record)


def read(resolved: ResolvedExperiment, files: Files | None = None) -> Experiment:
    """Read the record of one experiment; raises `InputError`.

    Tables and records that are already in `files` are not read again.
    """
    files = Files() if files is None else files
    first, known = files.records.get(resolved.label, (resolved, None))
    if known is not None and _origin(first) == _origin(resolved):
        return known
    experiment = _Reader(resolved, files).experiment()
    files.records.setdefault(resolved.label, (resolved, experiment))
    return experiment


def _origin(resolved: ResolvedExperiment) -> tuple[object, ...]:
    """Return all entries that determine the record of an experiment, for comparisons."""
    config = resolved.config
    measured = dict.fromkeys((*SensorFields.model_fields, "sigma", "noise"))
    columns = {
        place: {**dict(spec), **measured} for place, spec in sources.file_entries(config).items()
    }
    return (
        config.record.model_copy(update={"channels": {}}),
        columns,
        tuple(entry.channel for entry in resolved.channels),
        resolved.constant_inputs,
        resolved.initial_state,
        config.initial.time,
    )


class _Reader:
    """The reader reads a record once, and collects the mistakes in all columns."""

    def __init__(self, resolved: ResolvedExperiment, files: Files) -> None:
        self._resolved, self._config, self._source = resolved, resolved.config, resolved.source
        self._sources = Sources(resolved, files)

    def experiment(self) -> Experiment:
        config = self._config
        columns = self._columns()
        t = self._times()
        y = self._signals(t, columns)
        try:
            output_files.check_record(len(t), y.shape[1])
        except ValueError as error:
            raise self._source.error(("record", "file"), str(error)) from None
        held_out = self._held_out(t, y)
        measured = config.measured_inputs
        inputs = {n: columns["inputs", config.input_entry(n)] for n in measured}
        series, turned = self._inputs(t, inputs)
        raise_if_any(self._sources.issues)
        time, numbers = config.record.time, self._resolved.local_numbers.numbers.values()
        n_unknown = len(self._resolved.rig_numbers.space().free)
        n_unknown += sum(isinstance(number, Unknown) for number in numbers)
        shortened_by = "file" if config.record.window is None else "window"
        label = self._sources.label(("record", shortened_by))
        raise_if_any(check_length(label, np.sum(~np.isnan(y), axis=0).tolist(), n_unknown))
        experiment = Experiment(
            t=frozen(t),
            y=frozen(y),
            channels=tuple(entry.channel for entry in self._resolved.channels),
            constant=self._resolved.constant_inputs,
            series={name: frozen(values) for name, values in series.items()},
            first_order=any(map(_is_first_order, measured.values())),
            start={**self._resolved.initial_state, **turned},
            t_start=self._t_start(t, has_series=bool(series)),
            notes=tuple(self._sources.notes),
            anomalies=tuple(self._sources.anomalies),
            held_out=None if held_out is None else frozen(held_out),
            input_steps={n: clocks.median_step(column.clock.t) for n, column in inputs.items()},
            written=Written(
                files=tuple(path.name for path in sources.paths(self._resolved)),
                time=units.display_unit(time.unit if isinstance(time, TimeColumn) else "s", "s"),
                inputs={name: _unit_of_input(config, name) for name in config.vocabulary.inputs},
            ),
            input_symbols=dict(config.vocabulary.inputs),
        )
        if (decimation := config.record.decimate) is None:
            return experiment
        factor, filtered = decimation.factor, decimation.filter
        if refusal := sources.refuse_decimation(experiment, factor, filtered=filtered):
            raise self._source.error(("record", "decimate"), refusal)
        decimated = sources.decimate_filtered if filtered else sources.decimate_unfiltered
        return decimated(experiment, factor)

    def _columns(self) -> dict[Location, RecordColumn]:
        """Return all columns that the config names, by location, with NaN in unused rows."""
        entries = sources.file_entries(self._config)
        picked_columns = [self._column(location, spec) for location, spec in entries.items()]
        raise_if_any(list(dict.fromkeys(self._sources.issues)))
        columns = {column.location: column for column in picked_columns if column is not None}
        inputs = [column for column in columns.values() if column.is_input]
        column_cleaning.report_derivatives(self._sources, columns)
        return {
            location: column_cleaning.mask_glitches(self._sources, column, inputs)
            for location, column in columns.items()
        }

    def _times(self) -> Array:
        """Return the times `(T,)` [s] of all clocks, merged."""
        clocks_ = self._sources.clocks
        times = [clock.t[clock.in_window] for clock in clocks_ if clock.in_window.any()]
        if len(times) == 1:
            return times[0]
        t = clocks.union(times)
        counts = ", ".join(str(len(clock_times)) for clock_times in times)
        note = f"{len(t)} times of {len(times)} clocks ({counts} samples)"
        self._sources.notes.append(f"{note}; times closer than 1e-9 of a step are merged")
        close = clocks.crowded_time(t, times)
        if not math.isnan(close):
            text = f"clocks: two of the record's times, at {close:.10g} s, are nearly the same"
            do = "; one clock, written with different digits? Then give both columns the same `time:`"
            self._sources.anomalies.append(Anomaly(text=text, positions=(), advice=do))
        return t

    def _signals(self, t: Array, columns: dict[Location, RecordColumn]) -> Array:
        """Return the channels `(T, K)` in SI, with NaN where a channel has no sample."""
        measured = self._resolved.channels
        y = np.full((len(t), len(measured)), np.nan)
        for k, entry in enumerate(measured):
            column = columns["record", "channels", entry.channel.name]
            in_window = column.clock.in_window
            times = column.clock.t[in_window]
            one_clock = not self._sources.several_clocks
            rows = np.arange(len(t)) if one_clock else clocks.indices_in(t, times)
            y[rows, k] = column.values[in_window] * entry.channel.factor
        spans = window_spans(self._config.record.window)
        if len(spans) > 1:
            y[~inside_spans(t, spans)] = np.nan
        return y

    def _held_out(self, t: Array, y: Array) -> Array | None:
        """Move held-out samples from `y` to a new array and return this array, or None if empty."""
        spans = window_spans(self._config.record.held_out)
        if not spans:
            return None
        held_back = inside_spans(t, spans)
        held_out = np.where(held_back[:, None], y, np.nan)
        y[held_back] = np.nan
        count = int(np.sum(~np.isnan(held_out)))
        location: Location = ("record", "held_out")
        if count == 0:
            self._sources.add(location, "no sample lies in it; give times of the record [s]")
        elif np.isnan(y).all(axis=0).any():
            self._sources.add(
                location, "leaves no fitted sample of a channel; hold fewer samples out"
            )
        held = count_noun(count, "sample is", "samples are")
        self._sources.notes.append(f"{held} held out, and not fitted")
        return held_out

    def _inputs(
        self, t: Array, inputs: dict[str, RecordColumn]
    ) -> tuple[dict[str, Array], dict[str, float]]:
        """Return the inputs in SI at every time, and the initial values of imposed angles."""
        series, start_angles = dict[str, Array](), dict[str, float]()
        for name, spec in self._config.measured_inputs.items():
            column, entry = inputs[name], inputs[name].name
            if missing := int(np.isnan(column.values).sum()):
                bridged = count_noun(missing, "sample is", "samples are")
                self._sources.notes.append(f"{entry}: {bridged} bridged (hold: {spec.hold})")
            values = column_cleaning.bridge_gaps(self._sources, column)
            si = self._config.vocabulary.entries[entry].unit
            values = values * units.factor(spec.unit, si)
            if isinstance(spec, AngleColumn):
                clock = column.clock.t
                start_angles[entry] = float(np.interp(t[0], clock, values))
                values = anomalies.held_speeds(values, clock)
            if self._sources.several_clocks:
                values = self._on_record_times(t, column, values)
            series[name] = values
        return series, start_angles

    def _on_record_times(self, t: Array, column: RecordColumn, values: Array) -> Array:
        """Return an input at the record's times, which include the times of the input's clock."""
        clock, slack = column.clock.t, 1e-9 * float(np.ptp(t)) / len(t)
        straight = isinstance(column.spec, InputColumn) and column.spec.hold == "first"
        rule = "" if isinstance(column.spec, AngleColumn) else ", or `hold: zero`"
        late, early = clock[0] > t[0] + slack, clock[-1] < t[-1] - slack
        if late or (early and straight):
            message = (
                f"{column.name} is known from {clock[0]:g} to {clock[-1]:g} s, and the record goes from "
                f"{t[0]:g} to {t[-1]:g} s; give a record.window inside both"
            )
            self._sources.add(column.location, message + ("" if late else rule))
        elif early:
            note = f"{column.name}: held after its last sample at {clock[-1]:g} s"
            self._sources.notes.append(note)
        return clocks.hold_input(t, clock, values, first_order=_is_first_order(column.spec))

    def _column(self, location: Location, spec: Series) -> RecordColumn | None:
        clock, values = self._sources.clock(spec), self._sources.column(location, spec)
        if values is None or clock is None:
            return None
        if len(values) != clock.n_rows:
            message = f"{count_noun(len(values), 'value')}, but the time has {clock.n_rows}"
            self._sources.add(column_location(location, spec), f"{message}; name one recording's")
            return None
        values = values[clock.rows]
        masked = column_cleaning.row_mask(self._sources, location, spec, clock)
        unmasked = np.where(masked, np.nan, values) if masked.any() else values
        missing = int(np.sum(np.isnan(values) & ~masked))
        if masked.any():
            count = count_noun(int(masked.sum()), "sample is", "samples are")
            self._sources.notes.append(f"{location[-1]}: {count} masked (mask)")
        is_input = isinstance(spec, InputColumn)
        if missing and not is_input:
            count = count_noun(missing, "missing sample is", "missing samples are")
            self._sources.notes.append(f"{location[-1]}: {count} left out")
        allowed = spec.missing if isinstance(spec, InputColumn) else self._config.record.missing
        refused = missing > 0 and allowed is None
        numbers = np.where(masked, 0.0, values) if refused else unmasked
        bridge = "bridge them (missing: hold)" if is_input else ""
        way_out = bridge or "leave them out (record.missing: drop)"
        self._sources.issues += check_series(
            self._sources.label(column_location(location, spec)),
            f"column {spec.column if spec.column is not None else spec.variable!r}",
            numbers,
            clock.where,
            varying=not is_input,
            missing=not refused,
            instead=f", or {way_out}" if np.isnan(numbers).any() else "",
        )
        if said := units.other_unit(str(spec.column), spec.unit):
            text = f"unit: the header of {spec.column!r} says {said}, and the config {spec.unit}"
            do = f"; correct `unit:` at {'.'.join(map(str, location))}, or rename the column"
            self._sources.anomalies.append(Anomaly(text=text, positions=(), advice=do))
        column = RecordColumn(location, spec, clock, unmasked)
        return column_cleaning.unwrap(self._sources, column)

    def _t_start(self, time: Array, *, has_series: bool) -> float:
        """Return the time of the initial state; with measured inputs, that of the first sample."""
        if has_series:
            return float(time[0])
        t_start = self._config.initial.time
        if t_start is None:
            t_start = 0.0 if self._config.record.window is None else float(time[0])
        if t_start > time[0] + 1e-9 * max(1.0, abs(time[0])):
            given = self._config.initial.time is not None
            location: Location = ("initial", "time") if given else ("record",)
            late = f"the initial state is at {t_start:g} s, after the first sample at {time[0]:g} s"
            way_out = "give `initial: {time: ...}`, at or before that sample"
            raise self._source.error(location, f"{late}; {way_out}")
        lead, length = time[0] - t_start, time[-1] - time[0]
        if self._config.initial.time is None and lead > MAX_LEAD * length:
            message = (
                f"the record begins at {time[0]:.10g} s, and the initial state is at {t_start:g} s by "
                "default; if these are times of a clock, give `initial: {time: ...}`"
                f"{calendar_hint(time)}"
            )
            raise self._source.error(("record", "time"), message)
        return min(t_start, float(time[0]))


def _unit_of_input(config: Config, name: str) -> Unit:
    """Return the unit of an input; a speed from an imposed angle has the SI unit."""
    spec, symbol = config.inputs.get(name), config.vocabulary.inputs[name]
    unit = spec.unit if isinstance(spec, InputColumn | InputQuantity) else symbol.unit
    return units.display_unit(unit, symbol.unit, symbol.latex_unit)


def _is_first_order(spec: Series) -> bool:
    """Return whether an input is linear between samples; the speed of an imposed angle is not."""
    angle = isinstance(spec, AngleColumn)
    return isinstance(spec, InputColumn) and spec.hold == "first" and not angle
