"""Check the entries of a record and of its columns: file, time and windows."""

from __future__ import annotations

import itertools

from bayesdrill.basics import units
from bayesdrill.basics.registry import lookup
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import ColumnSpec, FileSpec, Series, TimeColumn, window_spans
from bayesdrill.config.yaml_source import IssueCollector, Location
from bayesdrill.record.formats import FORMATS


def check_record(errors: IssueCollector, config: Config) -> None:
    """Check time, format and windows of the record."""
    check_time(errors, ("record", "time"), config.record.time)
    if config.record.format is not None:
        errors.run(("record", "format"), lookup, FORMATS, config.record.format, "format")
    spans = window_spans(config.record.window)
    for name, windows in (("window", spans), ("held_out", window_spans(config.record.held_out))):
        for begin, end in windows:
            if not begin < end:
                errors.add(("record", name), f"{begin:g} s is not before {end:g} s")
    for (_, end), (begin, _) in itertools.pairwise(spans):
        if not end < begin:
            message = f"a window that begins at {begin:g} s stands after one that ends at {end:g} s"
            errors.add(("record", "window"), f"{message}; put them in order, without overlap")


def check_series(errors: IssueCollector, location: Location, spec: Series) -> None:
    """Check that a column is named, and check its time and its file."""
    _check_address(errors, location, spec)
    check_time(errors, (*location, "time"), spec.time)
    if isinstance(spec.file, FileSpec) and spec.file.format is not None:
        errors.run((*location, "file", "format"), lookup, FORMATS, spec.file.format, "format")


def check_time(errors: IssueCollector, location: Location, time: object) -> None:
    """Check the unit of a column of times, and that the column is named."""
    if isinstance(time, TimeColumn):
        errors.run((*location, "unit"), units.factor, time.unit, "s")
        _check_address(errors, location, time)


def _check_address(errors: IssueCollector, location: Location, spec: ColumnSpec) -> None:
    if spec.column is None and spec.variable is None:
        errors.add(location, "there is neither `column:` nor `variable:`; give one of the two")
