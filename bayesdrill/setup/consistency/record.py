"""The record and the experiment: channels, time and the initial state, with their units."""

from __future__ import annotations

import itertools

from bayesdrill.basics import units
from bayesdrill.basics.expressions import linear_combination
from bayesdrill.basics.registry import lookup
from bayesdrill.inference.noise import NOISES
from bayesdrill.record.formats import FORMATS
from bayesdrill.rig import vocabulary
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import build, number_entries
from bayesdrill.setup.config import Config
from bayesdrill.setup.consistency import noises
from bayesdrill.setup.consistency.collector import Collector
from bayesdrill.setup.experiment_entries import ChannelSpec
from bayesdrill.setup.record_entries import (
    Column,
    FileSpec,
    Series,
    TimeColumn,
    windows,
)
from bayesdrill.setup.yaml_source import Place


def check_channels(found: Collector, config: Config, model: Model) -> None:
    for name, spec in config.record.channels.items():
        place: Place = ("record", "channels", name)
        _check_measured(found, place, spec, model)
        check_series(found, place, spec)
        if spec.derived_from is not None:
            _check_derived(found, config, place, spec.derived_from)


def _check_measured(found: Collector, place: Place, spec: ChannelSpec, model: Model) -> None:
    """Entry by entry, so that each mistake has the line where it stands."""
    before = len(found.problems)
    combines = {str(place[-1]): 1.0}
    if spec.measures is not None:
        text, at = spec.measures, (*place, "measures")
        combines = found.run(at, linear_combination, text, model.outer) or {}
    states = [vocabulary.STATES[state] for state in combines if state in model.outer]
    if states:
        found.run((*place, "unit"), units.factor, spec.unit, states[0].unit)
    found.run((*place, "noise"), lookup, NOISES, spec.noise.name, "noise")
    for entry, message in noises.in_vain(spec).items():
        found.add((*place, "noise", entry), message)
    known = spec.model_copy(update={"sigma": 1.0})
    if len(found.problems) == before:
        found.run(place, build.measured, place[-1], known, model.outer)
    if len(found.problems) == before:
        one = found.run((*place, "sigma"), build.measured, place[-1], spec, model.outer)
        if one is not None:
            found.run((*place, "noise"), build.noise, [one], 1)


def _check_derived(found: Collector, config: Config, place: Place, of: str) -> None:
    name, at, every = str(place[-1]), (*place, "derived_from"), config.record.channels
    others = [one for one in every if one != name]
    found.expect(at, of, others, f"'{of}' is no other channel")
    if of in others and every[of].derived_from is not None:
        found.add(at, f"'{of}' is itself derived from {every[of].derived_from}; name that channel")


def check_series(found: Collector, place: Place, spec: Series) -> None:
    _check_address(found, place, spec)
    if isinstance(spec.time, TimeColumn):
        found.run((*place, "time", "unit"), units.factor, spec.time.unit, "s")
        _check_address(found, (*place, "time"), spec.time)
    if isinstance(spec.file, FileSpec) and spec.file.format is not None:
        found.run((*place, "file", "format"), lookup, FORMATS, spec.file.format, "format")


def _check_address(found: Collector, place: Place, spec: Column) -> None:
    if spec.column is None and spec.variable is None:
        found.add(place, "neither `column:` nor `variable:` says where the numbers stand")


def check_record(found: Collector, config: Config) -> None:
    time = config.record.time
    if isinstance(time, TimeColumn):
        found.run(("record", "time", "unit"), units.factor, time.unit, "s")
        _check_address(found, ("record", "time"), time)
    if config.record.format is not None:
        found.run(("record", "format"), lookup, FORMATS, config.record.format, "format")
    spans = windows(config.record.window)
    for name, given in (("window", spans), ("held_out", windows(config.record.held_out))):
        for begin, end in given:
            if not begin < end:
                found.add(("record", name), f"{begin:g} s is not before {end:g} s")
    for (_, end), (begin, _) in itertools.pairwise(spans):
        if not end < begin:
            message = f"a window that begins at {begin:g} s stands after one that ends at {end:g} s"
            found.add(("record", "window"), f"{message}; put them in order, apart from each other")


def check_states(found: Collector, config: Config, model: Model) -> None:
    for name in model.outer:
        value = getattr(config.initial, name)
        check_quantity(found, ("initial", name), value, vocabulary.STATES[name].unit)


def check_quantity(
    found: Collector, place: Place, value: float | number_entries.Quantity, unit: str
) -> None:
    if isinstance(value, number_entries.Quantity):
        found.run((*place, "unit"), units.factor, value.unit, unit)
