"""A job: a config that has been read, checked against its record, and built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.errors import InputError, of_each
from bayesdrill.basics.errors import Problem as Wrong
from bayesdrill.basics.units import Unit
from bayesdrill.engines.mode import Mode
from bayesdrill.inference import pieces
from bayesdrill.inference.problem import Problem
from bayesdrill.insight import derived
from bayesdrill.insight.identifiability.study import Asked
from bayesdrill.record.formats import Table
from bayesdrill.setup import assembling, build, loading, own_units, reading
from bayesdrill.setup.config import Config
from bayesdrill.setup.experiments import View, views
from bayesdrill.setup.own_units import OwnUnits
from bayesdrill.setup.yaml_source import Source

Array = NDArray[np.float64]

FARTHEST = 1e10  # of a start from the record, in sigmas: rounding would hide any way to it


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    config: Config
    source: Source
    problem: Problem

    def at(self, found: Mode) -> Job:
        """With the steps that are enough where its maximum is, of a rig that is stepped."""
        if not found.pieces:
            return self
        posterior = pieces.taking(self.problem.posterior, found.pieces)
        return replace(self, problem=replace(self.problem, posterior=posterior))

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
    records = of_each(lambda view: reading.read(view.config, view.source, table), every)
    problem = assembling.problem(config, every, records)
    posterior = problem.posterior
    start = posterior.space.vector(posterior.space.start)
    if not np.isfinite(posterior.density(start[None])[0]):
        unsteady = _unsteady(every, problem, start)
        message = "the model has no finite response at the start; check values and units"
        raise InputError(unsteady or [source.problem(("parameters",), message)])
    off = float(posterior.likelihood.per_number(start[None])[0]) ** 0.5
    if off > FARTHEST:
        message = f"the start is {off:.2g} times the noise off the record; check values and units"
        raise InputError([source.problem(("parameters",), message)])
    impossible = derived.impossible(problem)
    if impossible:
        named = [source.problem(("derived", name), text) for name, text in impossible.items()]
        raise InputError(named)
    return Job(config=config, source=source, problem=problem)


def _unsteady(every: Sequence[View], problem: Problem, start: Array) -> list[Wrong]:
    """Experiments that are said to begin steadily, of a rig that has no steady state."""
    full = problem.posterior.space.full(start[None])
    seen = {one.label: one for one in problem.observations}
    message = (
        "the rig has no steady state at the start values under the first inputs; give the start, or "
        "`free`"
    )
    return [
        view.source.problem(("initial",), message)
        for view in every
        if view.label in seen
        and view.config.initial.state == "steady"
        and not np.isfinite(seen[view.label].signals(full)[0, 0]).any()
    ]
