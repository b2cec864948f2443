"""A job: a config that has been read, checked against its record, and built."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import InputError
from bayesdrill.basics.units import Unit
from bayesdrill.inference.problem import Problem
from bayesdrill.insight import derived
from bayesdrill.insight.identifiability.study import Asked
from bayesdrill.record.formats import Table
from bayesdrill.setup import build, loading, own_units, reading
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiments import views
from bayesdrill.setup.own_units import OwnUnits
from bayesdrill.setup.yaml_source import Source

FARTHEST = 1e10  # of a start from the record, in sigmas: rounding would hide any way to it


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    config: Config
    source: Source
    problem: Problem

    @property
    def asked(self) -> Asked:
        return build.asked(self.config)

    @property
    def units(self) -> OwnUnits:
        """In which people are shown what is inferred."""
        return OwnUnits.of(self.config, self.problem)

    @property
    def clock(self) -> Unit:
        """In which they are told times."""
        return own_units.clock(self.config, self.problem)


def prepare(path: Path) -> Job:
    """Everything that can be wrong with the input is found here; nothing is written."""
    config, source = loading.load(path)
    return assemble(config, source)


def assemble(config: Config, source: Source, table: Table | None = None) -> Job:
    """The job of a config that is already validated; `source` is where its paths start.

    `table`: the record, where it is in no file.
    """
    every = views(config, source)
    records = [reading.read(view.config, view.source, table) for view in every]
    try:
        problem = build.problem(config, every, records)
    except ValueError as error:
        raise InputError([source.problem(("record",), str(error))]) from None
    posterior = problem.posterior
    start = posterior.space.vector(posterior.space.start)
    if not np.isfinite(posterior.density(start[None])[0]):
        message = "the model has no finite response at the start; check values and units"
        raise InputError([source.problem(("parameters",), message)])
    off = float(posterior.likelihood.per_number(start[None])[0]) ** 0.5
    if off > FARTHEST:
        message = f"the start is {off:.2g} times the noise off the record; check values and units"
        raise InputError([source.problem(("parameters",), message)])
    impossible = derived.impossible(problem)
    if impossible:
        named = [source.problem(("derived", name), text) for name, text in impossible.items()]
        raise InputError(named)
    return Job(config=config, source=source, problem=problem)
