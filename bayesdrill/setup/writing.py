"""A record as text, in the form in which its config reads one."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import units
from bayesdrill.basics.errors import InputError
from bayesdrill.record.experiment import Experiment
from bayesdrill.record.formats import check_options, format_of, text_table
from bayesdrill.setup import given_inputs, reading, sources
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiment_entries import ChannelSpec
from bayesdrill.setup.record_entries import Column, TimeColumn
from bayesdrill.setup.yaml_source import Place, Source

Array = NDArray[np.float64]

DIGITS = 9
SAME = 1e-8  # of the largest number in a column


@dataclass(frozen=True, slots=True)
class _Column:
    """`values` as the config reads them, under the name that stands at `place`."""

    place: Place
    name: str
    values: Array


def check_form(config: Config, source: Source, target: Path | None) -> None:
    """That the config can read what is written to `target`, by default its own record, at all.

    Raises `InputError`: it is text, with a header.
    """
    record, wrong = config.record, ""
    place: Place = ("record", "file")
    try:
        kind = record.format or format_of(target or reading.path_of(config, source))
        check_options(Path(), reading.csv_options(record))
        wrong = "" if kind == "csv" else "a simulated record is text; name a .csv file"
    except InputError as error:
        wrong = error.problems[0].message
    if not wrong:
        place, wrong = _impossible(config)
    if not wrong and reading.csv_options(record).header is False:
        place, wrong = ("record", "header"), "a simulated record has a header; remove this entry"
    if wrong:
        raise InputError([source.problem(place, wrong)])


def _impossible(config: Config) -> tuple[Place, str]:
    """What a simulated record cannot have; empty where there is nothing."""
    for place, spec in sources.entries(config).items():
        if spec.file is not None or spec.time is not None:
            entry: Place = (*place, "file" if spec.file is not None else "time")
            return entry, "a simulated record is one file with one time; remove this entry"
        if isinstance(spec, ChannelSpec) and spec.derived_from is not None:
            message = "a simulated record has measured channels only; remove this channel"
            return (*place, "derived_from"), message
    if config.record.decimate is not None:
        return (
            "record",
            "decimate",
        ), "a simulated record would be decimated again; remove this entry"
    return ("record", "file"), ""


def as_text(config: Config, source: Source, experiment: Experiment, y: Array) -> str:
    """Channels `y (T, K)` in the units of their columns, with time and inputs of `experiment`."""
    columns = _columns(config, source, experiment, y)
    record = reading.csv_options(config.record)
    mark = record.delimiter or (";" if record.decimal == "," else ",")
    head, body = io.StringIO(), io.StringIO()
    csv.writer(head, delimiter=mark, lineterminator="\n").writerow([c.name for c in columns])
    np.savetxt(body, np.stack([c.values for c in columns], axis=-1), f"%.{DIGITS}g", mark)
    numbers = body.getvalue()
    if record.decimal == ",":
        numbers = numbers.replace(".", ",")
    text = "# simulated\n" * record.skip_rows + head.getvalue() + numbers
    _check_read_back(config, source, text, columns)
    return text


def _columns(config: Config, source: Source, experiment: Experiment, y: Array) -> list[_Column]:
    columns = []
    time = config.record.time
    if isinstance(time, TimeColumn):
        place: Place = ("record", "time")
        values = experiment.t / units.factor(time.unit, "s")
        columns.append(_Column(place, _name(source, place, time), values))
    for (name, spec), channel in zip(config.record.channels.items(), y.T, strict=True):
        place = ("record", "channels", name)
        columns.append(_Column(place, _name(source, place, spec), channel))
    for name, given in given_inputs.measured(config).items():
        place = ("inputs", given_inputs.entry(config, name))
        factor = units.factor(given.unit, given_inputs.unit(place[1]))
        values = given_inputs.as_given(config, experiment, name) / factor
        columns.append(_Column(place, _name(source, place, given), values))
    return columns


def _name(source: Source, place: Place, spec: Column) -> str:
    if isinstance(spec.column, str):
        return spec.column
    raise InputError(
        [source.problem(place, "a simulated record is a CSV file with named columns; give a name")]
    )


def _check_read_back(config: Config, source: Source, text: str, columns: list[_Column]) -> None:
    """Names and marks that a reader takes for something else."""
    path = reading.path_of(config, source)
    try:
        table = text_table(path, text, reading.csv_options(config.record))
        for column in columns:
            found = table.pick(column.name)
            if not np.allclose(found, column.values, rtol=0, atol=SAME * np.ptp(column.values)):
                raise InputError.one("", f"column {column.name!r} would come out otherwise")
    except InputError as error:
        first = error.problems[0].message
        message = f"the record could not be read as this config reads it: {first}"
        raise InputError([source.problem(("record",), message)]) from None
