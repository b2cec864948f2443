"""From the record's file to an `Experiment` in SI: all that is wrong with it, at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import sizes, symbols, units
from bayesdrill.basics.entries import made
from bayesdrill.basics.errors import InputError, Problem
from bayesdrill.record.experiment import (
    Experiment,
    calendar,
    check_length,
    check_series,
    check_time,
    frozen,
    raise_if_any,
)
from bayesdrill.record.formats import FORMATS, CsvOptions, Table, format_of, variable_name
from bayesdrill.setup import build
from bayesdrill.setup.config import Column, Config, RecordSpec, TimeColumn, TimeRate
from bayesdrill.setup.yaml_source import Place, Source

Array = NDArray[np.float64]

FAR = 1000  # times its own length after the initial state, and a record has times of a clock


def path_of(config: Config, source: Source) -> Path:
    """The record's file: relative paths start at the folder of the config."""
    return source.path.parent / config.record.file


def csv_options(record: RecordSpec) -> CsvOptions:
    """How a text file is written, as far as the config says so."""
    return made(CsvOptions, record)


def read(config: Config, source: Source, table: Table | None = None) -> Experiment:
    """Raises `InputError` with the places in the config and the rows of the file.

    `table`: what the file would hold, where there is none.
    """
    return _Reader(config, source, table).experiment()


class _Reader:
    """One pass over a record: columns are picked and judged one by one, problems collected."""

    def __init__(self, config: Config, source: Source, table: Table | None) -> None:
        self._config = config
        self._source = source
        self._path = path_of(config, source)
        self._problems: list[Problem] = []
        self._table = self._read_table() if table is None else table
        self._n_rows = 0

    def experiment(self) -> Experiment:
        config = self._config
        model = build.model(config)
        measured = build.channels(config, model)
        time, kept = self._time()
        columns = [
            self._column(("record", "channels", e.channel.name), spec, e.factor, kept, varying=True)
            for e, spec in zip(measured, config.record.channels.values(), strict=True)
        ]
        series = {
            name: self._column(
                ("inputs", name), spec, units.factor(spec.unit, symbols.INPUTS[name].unit), kept
            )
            for name, spec in build.measured_inputs(config).items()
        }
        raise_if_any(self._problems)
        try:
            sizes.check_record(len(time), len(columns))
        except ValueError as error:
            raise InputError([self._source.problem(("record", "file"), str(error))]) from None
        noise = build.noise(measured, len(time))
        n_unknown = len(build.space(config, model, noise.unknowns).free)
        shortened_by = "file" if config.record.window is None else "window"
        raise_if_any(
            check_length(self._label(("record", shortened_by)), len(time), len(columns), n_unknown)
        )
        return Experiment(
            t=frozen(time),
            y=frozen(np.stack(columns, axis=-1)),
            channels=tuple(entry.channel for entry in measured),
            constant=build.constant_inputs(config),
            series={name: frozen(values) for name, values in series.items()},
            first_order=any(
                spec.hold == "first" for spec in build.measured_inputs(config).values()
            ),
            start=build.initial_state(config, model),
            t_start=self._t_start(time, has_series=bool(series)),
        )

    def _read_table(self) -> Table:
        record = self._config.record
        try:
            sizes.check_file(self._path)
        except ValueError as error:
            raise InputError([self._source.problem(("record", "file"), str(error))]) from None
        try:
            kind = FORMATS[record.format or format_of(self._path)]
            return kind.read(self._path, made(kind.options, record), _wanted(self._config))
        except InputError as error:
            label = self._label(("record", "file"))
            raise InputError([Problem(label, str(problem)) for problem in error.problems]) from None

    def _label(self, place: Place) -> str:
        return self._source.problem(place, "").place

    def _pick(self, place: Place, spec: Column) -> Array | None:
        try:
            return self._table.pick(spec.column, spec.variable, place=self._label(_at(place, spec)))
        except InputError as error:
            self._problems += error.problems
            return None

    def _time(self) -> tuple[Array, NDArray[np.intp]]:
        """The times in SI and the rows that are used."""
        spec, place = self._config.record.time, ("record", "time")
        if isinstance(spec, TimeRate):
            first = next(iter(self._config.record.channels.items()))
            values = self._pick(("record", "channels", first[0]), first[1])
            raw = None if values is None else np.arange(len(values)) / spec.rate
        else:
            values = self._pick(place, spec)
            raw = None if values is None else values * units.factor(spec.unit, "s")
        if raw is None:
            self._pick_all()
            raise InputError(list(dict.fromkeys(self._problems)))
        self._n_rows = len(raw)
        kept = np.arange(len(raw))
        window = self._config.record.window
        if window is not None:
            slack = 1e-9 * max(abs(window[0]), abs(window[1]))
            kept = np.flatnonzero((raw >= window[0] - slack) & (raw <= window[1] + slack))
            if len(kept) == 0:
                message = f"no sample lies in it: the record goes from {raw[0]:g} to {raw[-1]:g} s"
                self._problems.append(self._source.problem(("record", "window"), message))
                raise InputError(self._problems)
        self._problems += check_time(self._label(place), raw[kept], self._where(kept))
        return raw[kept], kept

    def _column(
        self,
        place: Place,
        spec: Column,
        factor: float,
        kept: NDArray[np.intp],
        *,
        varying: bool = False,
    ) -> Array:
        values = self._pick(place, spec)
        if values is None:
            return np.zeros(0)
        if len(values) != self._n_rows:
            message = f"{len(values)} values, but the time has {self._n_rows}; name one recording's"
            self._problems.append(self._source.problem(_at(place, spec), message))
            return np.zeros(0)
        values = values[kept]
        what = f"column {spec.column if spec.column is not None else spec.variable!r}"
        self._problems += check_series(
            self._label(_at(place, spec)), what, values, self._where(kept), varying=varying
        )
        return values * factor

    def _where(self, kept: NDArray[np.intp]) -> Callable[[int], str]:
        return lambda index: self._table.where(int(kept[index]))

    def _pick_all(self) -> None:
        """Without a time no column can be judged, but it can be missed."""
        for name, channel in self._config.record.channels.items():
            self._pick(("record", "channels", name), channel)
        for name, spec in build.measured_inputs(self._config).items():
            self._pick(("inputs", name), spec)

    def _t_start(self, time: Array, *, has_series: bool) -> float:
        """With measured inputs nothing is known before the first sample: the state is given there."""
        if has_series:
            return float(time[0])
        begin = self._config.initial.time
        if begin is None:
            begin = 0.0 if self._config.record.window is None else float(time[0])
        if begin > time[0] + 1e-9 * max(1.0, abs(time[0])):
            place: Place = (
                ("initial", "time") if self._config.initial.time is not None else ("record",)
            )
            message = (
                f"the initial state is at {begin:g} s, after the first sample at {time[0]:g} s; give "
                "`initial: {time: ...}` at or before it"
            )
            raise InputError([self._source.problem(place, message)])
        if self._config.initial.time is None and time[0] - begin > FAR * (time[-1] - time[0]):
            message = (
                f"the record begins at {time[0]:.10g} s, and the initial state is at {begin:g} s by "
                "default; if these are times of a clock, give `initial: {time: ...}`"
                f"{calendar(time)}"
            )
            raise InputError([self._source.problem(("record", "time"), message)])
        return min(begin, float(time[0]))


def _wanted(config: Config) -> set[str] | None:
    """Variables that the config names; None where it leaves one to be found out."""
    specs = [*config.record.channels.values(), *build.measured_inputs(config).values()]
    time = config.record.time
    columns = [*specs, *([time] if isinstance(time, TimeColumn) else [])]
    names = {variable_name(spec.column, spec.variable) for spec in columns}
    return None if None in names else {name for name in names if name is not None}


def _at(place: Place, spec: Column) -> Place:
    """The entry that says which numbers are meant."""
    return (*place, "column" if spec.column is not None else "variable")
