"""Read each file of a record once, check the times of its columns, and decimate records."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill import output_files
from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.entries import build_member
from bayesdrill.basics.errors import InputError, Issue, count_noun, encodable
from bayesdrill.config.building.case import ResolvedCase, ResolvedExperiment
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import (
    ColumnSpec,
    FileSpec,
    InputColumn,
    Series,
    TimeColumn,
    TimeRate,
    window_spans,
)
from bayesdrill.config.yaml_source import Location
from bayesdrill.record import anomalies, clocks
from bayesdrill.record.clocks import on_grid
from bayesdrill.record.experiment import Anomaly, Experiment, check_time, frozen
from bayesdrill.record.formats import FORMATS, format_of
from bayesdrill.record.formats.table import RecordTable, variable_name

OTHER_TIMES_HINT = "; if this file has its times in another column, give the entry its own `time:`"


def file_entries(config: Config) -> dict[Location, Series]:
    """Return the entries of channels, then of measured inputs, by location."""
    channels = {("record", "channels", name): s for name, s in config.record.channels.items()}
    inputs = config.measured_inputs.items()
    return channels | {("inputs", config.input_entry(name)): s for name, s in inputs}


def inputs_as_given(
    config: Config, experiment: Experiment
) -> Iterator[tuple[str, InputColumn, Array]]:
    """Yield the entry, the column and the values `(T,)` of each input, in the column's unit."""
    for name, spec in config.measured_inputs.items():
        entry, values = config.input_entry(name), experiment.series[name]
        if entry != name:
            values = anomalies.integrate_speeds(values, experiment.t, experiment.start[entry])
        yield entry, spec, values / units.factor(spec.unit, config.vocabulary.entries[entry].unit)


def file_of(spec: Series) -> FileSpec | None:
    """Return the column's own file; None stands for the file of the record."""
    return FileSpec(path=spec.file) if isinstance(spec.file, str) else spec.file


def path_of(resolved: ResolvedExperiment, file: FileSpec | None = None) -> Path:
    """Return the path of a record's file; relative paths start at the folder of the config."""
    name = resolved.config.record.file if file is None else file.path
    return resolved.source.path.parent / name


def paths(resolved: ResolvedExperiment) -> list[Path]:
    """Return the paths of all files of an experiment, each once, the file of the record first."""
    files = dict.fromkeys([None, *map(file_of, file_entries(resolved.config).values())])
    return [path_of(resolved, file) for file in files]


def files(case: ResolvedCase) -> list[Path]:
    """Return the paths of a config and of all files that it names."""
    return [case.source.path, *(path for each in case.experiments for path in paths(each))]


def named_files(data: Mapping[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Return each mapping with a file name in the raw `data` of a config, and that name's key."""
    record, inputs = data.get("record", {}), data.get("inputs", {})
    entries = [record, *record.get("channels", {}).values(), *inputs.values()]
    having = [entry for entry in entries if isinstance(entry, dict) and "file" in entry]
    paired = [(entry, entry["file"]) for entry in having]
    return [(file, "path") if isinstance(file, dict) else (s, "file") for s, file in paired]


def rebase(data: Mapping[str, Any], old: Path, new: Path) -> None:
    """Rewrite file names that are relative to folder `old` so that they are relative to `new`.

    Links are resolved first, as `..` in a path leads to the parent of a link's target.
    """
    for section, key in named_files(data):
        section[key] = relative_name(new.resolve(), (old / section[key]).resolve())


def relative_name(folder: Path, file: Path) -> str:
    """Return the name of `file` in a config in `folder`; raises `InputError` if it is not UTF-8."""
    name = Path(os.path.relpath(file, folder)).as_posix()
    if encodable(name) != name:
        message = "is not UTF-8, and no config can name it; rename the file or the folder"
        raise InputError.at(str(file), message)
    return name


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """A clock has times `t (n,)` [s] at `rows (n,)` of a table; `in_window (n,)` is true if used."""

    table: RecordTable
    t: Array
    rows: NDArray[np.intp]  # with several clocks, also the rows next to the windows
    in_window: NDArray[np.bool_]
    n_rows: int

    def where(self, index: int) -> str:
        """Return the position of a row in its file as text, such as `line 18`."""
        return self.table.where(int(self.rows[index]))

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Return the row numbers that messages give."""
        return np.asarray(self.table.numbers[self.rows], dtype=np.int64)


MAX_KEPT = 4_000_000  # largest number of values in a kept table, as the sampler needs the memory


@dataclass(frozen=True, slots=True, eq=False)
class Files:
    """Keep tables and records that were read, so that no file is read twice.

    `tables` holds small tables by path, format, options and variables. `records` holds each
    experiment's record, as first read, by its label. `array_table` is that of a record of arrays.
    """

    array_table: RecordTable | None = None
    tables: dict[tuple[Any, ...], RecordTable] = field(default_factory=dict)
    records: dict[str, tuple[ResolvedExperiment, Experiment]] = field(default_factory=dict)

    def table(
        self, path: Path, form: str, options: Any, variables: frozenset[str] | None
    ) -> RecordTable:
        """Return the table of a file, with all variables or only `variables`; raises `InputError`."""
        key = (path, form, options, variables)
        if key in self.tables:
            return self.tables[key]
        output_files.check_file(path)
        table = FORMATS[form].read(path, options, variables)
        if sum(column.size for column in table.variables.values()) <= MAX_KEPT:
            self.tables[key] = table
        return table


class Sources:
    """The sources hold tables and clocks of all columns; they collect issues, notes and anomalies."""

    def __init__(self, resolved: ResolvedExperiment, files: Files) -> None:
        self.issues: list[Issue] = []
        self.notes: list[str] = []
        self.anomalies: list[Anomaly] = []
        self._resolved, self._config, self._files = resolved, resolved.config, files
        self._tables: dict[FileSpec | None, RecordTable | None] = {}
        self._clocks: dict[object, Clock | None] = {}
        self._spans = window_spans(self._config.record.window)
        entries = file_entries(self._config)
        self.several_clocks = len({(file_of(spec), spec.time) for spec in entries.values()}) > 1
        for location, spec in entries.items():
            if (file_of(spec), spec.time) not in self._clocks:
                self._clocks[file_of(spec), spec.time] = self._clock(location, spec)

    def label(self, location: Location) -> str:
        """Return the label of a location in messages."""
        return self._resolved.source.issue(location, "").place

    def add(self, location: Location, message: str) -> None:
        """Add an issue."""
        self.issues.append(self._resolved.source.issue(location, message))

    def clock(self, spec: Series) -> Clock | None:
        """Return the clock of a column; None if it could not be read."""
        return self._clocks[file_of(spec), spec.time]

    @property
    def clocks(self) -> list[Clock]:
        """Return all clocks."""
        return [clock for clock in self._clocks.values() if clock is not None]

    def column(self, location: Location, spec: Series) -> Array | None:
        """Return all rows of a channel or an input, in the unit of the file."""
        table = self._tables.get(file_of(spec))
        return None if table is None else self._pick(location, spec, table)

    def _pick(
        self, location: Location, spec: ColumnSpec, table: RecordTable, instead: str = ""
    ) -> Array | None:
        label = self.label(column_location(location, spec))
        try:
            return table.pick(spec.column, spec.variable, location=label)
        except InputError as error:
            self.issues += [Issue(p.place, f"{p.message}{instead}") for p in error.problems]
            return None

    def _clock(self, location: Location, spec: Series) -> Clock | None:
        file = file_of(spec)
        if file not in self._tables:
            self._tables[file] = self._read(location, file)
        table = self._tables[file]
        if table is None:
            return None
        time, time_place, instead = spec.time, (*location, "time"), ""
        if time is None and spec.file is None:
            time_place = ("record", "time")
        elif time is None:
            time_place, instead = (*location, "file"), OTHER_TIMES_HINT
        time = time or self._config.record.time
        if isinstance(time, TimeRate):
            values, factor = self._pick(location, spec, table), 1.0
            values = None if values is None else np.arange(len(values)) / time.rate
        else:
            values = self._pick(time_place, time, table, instead)
            factor = units.factor(time.unit, "s")
            values = values if values is None or time.scale is None else values * time.scale
        if values is None:
            return None
        raw, offset = values * factor, (time.offset or 0.0) * factor
        return self._windowed(location, time_place, table, raw + offset if offset else raw)

    def _windowed(
        self, location: Location, time_place: Location, table: RecordTable, raw: Array
    ) -> Clock | None:
        rows, in_window = np.arange(len(raw)), np.ones(len(raw), dtype=np.bool_)
        if self._spans:
            begin, end = min(a for a, _ in self._spans), max(b for _, b in self._spans)
            slack = 1e-9 * max(abs(begin), abs(end))
            in_window = (raw >= begin - slack) & (raw <= end + slack)
            if not in_window.any() and location[0] == "record":
                message = f"no sample lies in it: the record goes from {raw[0]:g} to {raw[-1]:g} s"
                self.add(("record", "window"), message)
                return None
            before, after = rows[raw < begin - slack][-1:], rows[raw > end + slack][:1]
            within = rows[in_window]
            rows = np.concatenate([before, within, after]) if self.several_clocks else within
        clock = Clock(table, raw[rows], rows, in_window[rows], len(raw))
        issues = check_time(self.label(time_place), clock.t, clock.where)
        self.issues += issues
        # Wrong times are kept, so that mistakes in the columns are reported together with them.
        return clock if issues else dataclasses.replace(clock, t=on_grid(clock.t))

    def _read(self, location: Location, file: FileSpec | None) -> RecordTable | None:
        at_file: Location = ("record", "file") if file is None else (*location, "file")
        if self._files.array_table is not None:
            if file is None:
                return self._files.array_table
            self.add(at_file, "the record is given as arrays; give this column as one of them")
            return None
        path, written = path_of(self._resolved, file), file or self._config.record
        try:
            form = written.format or format_of(path)
            options: object = build_member(FORMATS[form].options, written)
            table = self._files.table(path, form, options, self._variables(file))
            return table.between(self._config.record.rows) if file is None else table
        except ValueError as error:
            self.add(at_file, str(error))
        except InputError as error:
            self.issues += [Issue(self.label(at_file), str(p)) for p in error.problems]
        return None

    def _variables(self, file: FileSpec | None) -> frozenset[str] | None:
        """Return the variables that the config names in a file; None if a column has no name."""
        specs = [s for s in file_entries(self._config).values() if file_of(s) == file]
        times = [spec.time or self._config.record.time for spec in specs]
        columns = [*specs, *(time for time in times if isinstance(time, TimeColumn))]
        names = {variable_name(spec.column, spec.variable) for spec in columns}
        return None if None in names else frozenset(name for name in names if name is not None)


def column_location(location: Location, spec: ColumnSpec) -> Location:
    """Return the location of the entry that names the column."""
    return (*location, "column" if spec.column is not None else "variable")


MIN_SAMPLES = 10  # smallest number of samples after decimation


def refuse_decimation(experiment: Experiment, factor: int, *, filtered: bool) -> str:
    """Return why a record cannot be decimated, with advice; an empty text if it can be."""
    rows = len(experiment.t)
    if filtered and not experiment.uniform:
        way_out = "remove `decimate:`, write `filter: false`, or cut the record at gaps"
        return f"a filter needs equal time steps, and the steps of this record differ; {way_out}"
    if filtered and not experiment.is_measured.all():
        k = int(np.argmin(experiment.counts))
        return (
            f"a filter needs every sample, and {rows - experiment.counts[k]} of "
            f"{experiment.names[k]} are missing, masked or outside the windows; remove "
            "`decimate:`, write `filter: false`, or name one window without them"
        )
    available = rows if filtered else min(experiment.counts)
    need = (clocks.filter_length(factor) if filtered else 1) + (MIN_SAMPLES - 1) * factor
    few = f"{count_noun(available, 'sample is', 'samples are')} too few"
    wanted = f"{need} are needed to keep {MIN_SAMPLES}; take a smaller factor"
    return f"{few}: {wanted}" if available < need else ""


def decimate_filtered(experiment: Experiment, factor: int) -> Experiment:
    """Return the experiment with filtered channels that keep every `factor`-th sample.

    Measured inputs keep all samples, as the rig responds to each of their steps. With such inputs,
    channels are NaN at the samples that are not kept.
    """
    decimation = clocks.decimated(experiment.y, factor)
    if experiment.series:
        t, y = experiment.t, np.full_like(experiment.y, np.nan)
        y[decimation.samples] = decimation.y
    else:
        t, y = experiment.t[decimation.samples], decimation.y
    taps, half = clocks.filter_length(factor), clocks.cutoff(factor, experiment.dt)
    removed = ", ".join(
        f"{sd:.3g} {channel.unit} of {channel.name}"
        for sd, channel in zip(decimation.removed, experiment.channels, strict=True)
    )
    note = (
        f"{', '.join(experiment.names)}: filtered and decimated, one sample in {factor} is kept "
        f"({len(decimation.samples)} of {len(experiment.t)}). The filter is a zero-phase FIR of {taps} "
        f"samples, half of the amplitude at {half:.6g} Hz. {taps // 2} samples at each end are "
        f"dropped. The filter removed (sd) {removed}. Sigma is the noise after the "
        "filter; the model is not filtered"
    )
    return dataclasses.replace(
        experiment, t=frozen(t), y=frozen(y), notes=(*experiment.notes, note)
    )


def decimate_unfiltered(experiment: Experiment, factor: int) -> Experiment:
    """Return the experiment with every `factor`-th sample of each channel, from the first on."""
    measured = experiment.is_measured
    selected = measured & ((np.cumsum(measured, axis=0) - 1) % factor == 0)
    t, y = experiment.t, np.where(selected, experiment.y, np.nan)
    if not experiment.series and experiment.held_out is None:
        rows = selected.any(axis=1)
        t, y = t[rows], y[rows]
    counts = ", ".join(
        f"{np.count_nonzero(selected[:, k])} of {np.count_nonzero(measured[:, k])} of {name}"
        for k, name in enumerate(experiment.names)
    )
    note = (
        f"decimated without a filter: one sample in {factor} is kept ({counts}), as it was "
        "measured; motion above half the new rate acts as noise. Sigma is the noise of a single "
        "sample"
    )
    return dataclasses.replace(
        experiment, t=frozen(t), y=frozen(y), notes=(*experiment.notes, note)
    )
