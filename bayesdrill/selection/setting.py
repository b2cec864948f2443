"""Collect what is known of a job, from which changes of its config are built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from bayesdrill.analysis import edits
from bayesdrill.config.building.experiments import EXPERIMENTS
from bayesdrill.config.job import Job
from bayesdrill.inference.likelihood import Observation
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.selection.change import CLOCK, MOMENT, NOTHING
from bayesdrill.selection.config_edits import (
    SHARED,
    Entries,
    Place,
    columns,
    merged,
    nested,
    rounded,
)

OF_SENSOR = ("gain", "offset", "lag")  # keys of a sensor in the entry of a column
# Largest dry friction, divided by the friction that acts as strongly as all other torques.  The root
# mean square of these torques is small in a record in which the rig mostly rests.
HOLDING = 4.0


@dataclass(frozen=True)
class Setting:
    """A setting has the information from which changes of `job` are built.

    At a value in `sizes`, a parameter would act as strongly as all others.  `speeds` are the largest
    speeds of inertias, `values` the rig's parameters at the maximum.  `numbers` maps names of changes
    to the constants that they set.
    """

    job: Job
    sizes: Mapping[str, float] = NOTHING
    speeds: Mapping[str, float] = NOTHING
    values: Mapping[str, float] = NOTHING
    numbers: Mapping[str, float] = NOTHING

    @classmethod
    def from_job(cls, job: Job, values: Mapping[str, float]) -> Self:
        """Return the setting with sizes and speeds at the start or at `values`, whichever are larger."""
        space, observations = job.problem.posterior.space, job.problem.observations
        setting, inertias = cls(job), [i for i in job.problem.model.roles.inertias if i.static]
        for at in (space.start, {**space.start, **values}):
            full = space.full(space.vector(at)[None])
            sizes, speeds = edits.rig_candidates(observations, full), _speeds(observations, full)
            setting = setting.at_least(sizes, speeds)
            p = edits.rig_parameters(observations[0], full)
            shown = edits.rig_candidates(observations, full, measured=True)
            held = {i.static: HOLDING * shown[i.sliding] for i in inertias if i.sliding in shown}
            setting = setting.at_least(held, {})
        return replace(setting, values=p)

    def with_numbers(self, **numbers: float) -> Self:
        """Return the setting with further constants of changes, by name."""
        return replace(self, numbers={**self.numbers, **numbers})

    def at_least(self, sizes: Mapping[str, float], speeds: Mapping[str, float]) -> Self:
        """Return the setting with each size and speed raised to at least the given one."""
        return replace(
            self, sizes=_largest(self.sizes, sizes), speeds=_largest(self.speeds, speeds)
        )

    @property
    def rig(self) -> Model:
        """Return the model of the rig."""
        return self.job.problem.model

    @property
    def weights(self) -> dict[str, float]:
        """Return by name the value of each inertia that is a parameter of the rig."""
        inertias = self.rig.roles.inertias
        return {i.name: self.values[i.inertia] for i in inertias if i.inertia in self.values}

    @property
    def data(self) -> Entries:
        """Return the entries of the config."""
        return dict(self.job.source.data)

    @property
    def observations(self) -> tuple[Observation, ...]:
        """Return the observations that are fitted."""
        return self.job.problem.observations

    @cached_property
    def experiments(self) -> list[Experiment]:
        """Return the records that are fitted."""
        return [observation.experiment for observation in self.observations]

    @cached_property
    def units(self) -> dict[str, str]:
        """Return the unit of each channel."""
        return {c.name: c.unit for each in self.experiments for c in each.channels}

    @cached_property
    def inputs(self) -> list[str]:
        """Return the names of the measured inputs; those that drive the rig come first."""
        names = dict.fromkeys(name for each in self.experiments for name in each.series)
        return sorted(names, key=lambda name: not self.rig.symbols[name].drives)

    @property
    def span(self) -> tuple[float, float]:
        """Return the shortest step between samples, and the length of the longest record, in s."""
        lengths = [float(np.ptp(each.t)) for each in self.experiments]
        return min(each.dt for each in self.experiments), max(lengths)

    def shared(self, *names: str) -> Entries:
        """Return the entry that makes `names` common to all experiments, if there are several."""
        return {SHARED: [*names]} if self.data.get(EXPERIMENTS) else {}

    def prior(self, name: str) -> tuple[Place, Entries] | None:
        """Return the place and the entry of an unknown's prior; None if it is not found."""
        ending = next((f"_{e.label}" for e in self.observations if name.endswith(e.label)), "")
        kind, _, owner = name.removesuffix(ending).partition("_")
        tops = ("parameters", "quantities", "inputs")
        numbers: dict[Place, Any] = {(n, name): (self.data.get(n) or {}).get(name) for n in tops}
        if kind in OF_SENSOR:
            numbers |= {(*p, kind): x.get(kind) for p, x in columns(self.data, owner)}
        priors = (
            pair for pair in numbers.items() if isinstance(pair[1], dict) and "prior" in pair[1]
        )
        return next(priors, None)

    @cached_property
    def is_driven(self) -> bool:
        """Return whether an input changes in any record."""
        return any(np.ptp(u) > 0 for each in self.experiments for u in each.series.values())

    @cached_property
    def time_references(self) -> frozenset[str]:
        """Return names of changes that shift a channel, or all inputs, in time.

        No candidate has all of them: a channel, or inputs that change, must be the reference of time.
        """
        sensing = [observation.response.sensing for observation in self.observations]
        known = not any(each.states or each.steady for each in sensing)
        switched = known and any(x for each in self.experiments for x in each.constant.values())
        moments = {MOMENT} if self.is_driven or switched else set()
        return frozenset({*(f"lag_{name}" for name in self.units), *moments})

    @property
    def clocks(self) -> tuple[str, ...]:
        """Return the names of clock changes, for record and channels; none if all share one clock."""
        names = (*self.units, *self.inputs)
        timed = {n for n in names for _, entry in columns(self.data, n) if "time" in entry}
        return (CLOCK, *(f"{CLOCK}_{n}" for n in self.units if n in timed)) if timed else ()

    def window(self, begin: float, end: float, later: float = 0.0) -> Entries:
        """Return lines that limit records to fractions of their time, and make their starts free."""
        several, lines = self.data.get(EXPERIMENTS), []
        for observation in self.observations:  # experiments that are held out do not change
            first, *_, last = observation.experiment.t.tolist()
            ends = [(1.0 - fraction) * first + fraction * last for fraction in (begin, end)]
            window = [rounded(ends[0] + later, 9), ends[1]]
            place = (EXPERIMENTS, observation.label) if several else ()
            lines.append(nested(place, {"record": {"window": window}, "initial": "free"}))
        return merged({}, *lines)

    def model_entries(self, entries: Entries) -> Entries:
        """Return the entry of the rig with further `entries`."""
        given = self.data.get("model", {})
        return {"model": {**({"name": given} if isinstance(given, str) else {}), **entries}}

    def offered(self, *names: str) -> bool:
        """Return whether the rig can have these parameters and does not yet have any of them."""
        return all(names) and {*names} <= {*self.rig.offers} - {*self.rig.parameters}


def _largest(first: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    return {name: max(first.get(name, 0.0), other.get(name, 0.0)) for name in {**first, **other}}


def _speeds(observations: tuple[Observation, ...], full: Any) -> dict[str, float]:
    """Return the largest speed of each inertia, by its name."""
    speeds: dict[str, float] = {}
    for observation in observations:
        model = observation.response.model
        largest = np.abs(edits.state_motion(observation, full)).max(axis=0).tolist()
        known = dict(zip(model.states, largest, strict=True))
        turning = [i for i in model.roles.inertias if i.speed in known]
        speeds = _largest(speeds, {i.name: known[i.speed] / i.reduction for i in turning})
    return speeds
