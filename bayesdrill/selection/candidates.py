"""Candidate models of a record: configs that differ from one in a thing each, or in several."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from bayesdrill.config import loading
from bayesdrill.config.job import Job, assemble
from bayesdrill.config.yaml_source import Source, as_yaml
from bayesdrill.record.formats.table import RecordTable
from bayesdrill.selection import config_edits
from bayesdrill.selection.parts import BOTH, LINEAR, START, UNKNOWN, Part, Setting

GIVEN, AS_GIVEN = "as_given", "the config as it is"
MOST_PHYSICS = 8  # unknowns
MOST_PARTS = 8
LONGEST_NAME = 100  # letters, of a config


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """A candidate model, as the config that has it.

    `parts` that it has beside the config as given; `lines` of a config that say so; `table`: a record
    that is in no file; `neutral`: further parameters of the rig that do nothing, which it is refitted
    with, so that it shares kernels with others.
    """

    parts: tuple[Part, ...]
    source: Source
    lines: str = ""
    table: RecordTable | None = None
    neutral: Mapping[str, float] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its parts."""
        return tuple(part.name for part in self.parts)

    @property
    def name(self) -> str:
        """Its name: parts with dashes between."""
        return "-".join(self.names) or GIVEN

    @property
    def words(self) -> tuple[str, ...]:
        """What each part is."""
        return tuple(part.words for part in self.parts)

    @property
    def about(self) -> str:
        """What it has beside the config as given, in words."""
        return " and ".join(self.words) or AS_GIVEN

    def owner(self, unknown: str) -> str:
        """Return the part that an unknown belongs to, the start where it is of none."""
        owners = (p.name for p in self.parts if unknown in p.lacks or unknown.startswith(p.name))
        return next(owners, START)

    def job(self) -> Job:
        """Raises `InputError` where the config cannot have it."""
        return assemble(loading.validate(self.source), self.table)

    def refit_job(self) -> Job:
        """Return the job that it is refitted by: what is neutral changes nothing but the kernels."""
        if not self.neutral:
            return self.job()
        data = copy.deepcopy(self.source.data)
        data["parameters"] = {**self.neutral, **data["parameters"]}
        source = replace(self.source, text=as_yaml(data), data=data)
        return assemble(loading.validate(source), self.table)

    def file(self, folder: Path, given: Source, about: Sequence[str], name: str = "") -> str:
        """Return its config as the text of a file in `folder`; see `config_edits.as_file`."""
        return config_edits.as_file(self.source.data, given, folder, about, name)


@dataclass(frozen=True)
class CandidateModels:
    """Candidate models of the job of a `setting`."""

    setting: Setting

    @classmethod
    def from_job(cls, job: Job, values: Mapping[str, float]) -> CandidateModels:
        """Return those whose sizes follow from the start of the config and from `values`."""
        return cls(Setting.from_job(job, values))

    @property
    def job(self) -> Job:
        """The job as given."""
        return self.setting.job

    @cached_property
    def parts(self) -> dict[str, Part]:
        """The parts that candidates may have, by name."""
        return self.setting.parts()

    def with_numbers(self, **numbers: float) -> CandidateModels:
        """Return candidates whose parts have these constants."""
        known = {**self.setting.numbers, **numbers}
        return replace(self, setting=replace(self.setting, numbers=known))

    def rungs(self, every: Iterable[tuple[str, ...]]) -> list[CandidateModel]:
        """Return those with parts of these names, where there is such a thing to try."""
        return [rung for names in every if (rung := self._rung(names)) is not None]

    def singles(self, *, absorbing: bool = False) -> list[CandidateModel]:
        """Return those with one thing each: a cause or, `absorbing`, what absorbs any misfit."""
        parts = [part for part in self.parts.values() if part.absorbs == absorbing]
        return self.rungs((part.name,) for part in parts if not part.needs)

    def beyond(self, names: tuple[str, ...], more: Iterable[str]) -> list[CandidateModel]:
        """Return those with these parts and each of `more` that can go with them."""
        if len(names) >= MOST_PARTS:
            return []
        freed = {parameter for name in names for parameter in self.parts[name].lacks}
        resting = [part.name for part in self.parts.values() if part.needs in freed and part.needs]
        wanted = dict.fromkeys((*more, *resting))
        return self.rungs(filter(self.possible, ((*names, n) for n in wanted if n not in names)))

    def without_each(self, names: tuple[str, ...]) -> list[CandidateModel]:
        """Return those without each of their parts, in turn."""
        every = (tuple(one for one in names if one != name) for name in names)
        return self.rungs(fewer for fewer in every if fewer and self.possible(fewer))

    def possible(self, names: Sequence[str]) -> bool:
        """Tell whether parts go together, and together mean something that one alone does not."""
        parts = [self.parts[name] for name in names if name in self.parts]
        decided = [what for part in parts for what in part.decides]
        freed = {parameter for part in parts for parameter in part.lacks}
        if len(parts) < len(names) or len({*decided}) < len(decided):
            return False
        if any(part.needs and part.needs not in freed for part in parts):
            return False
        if self._time_references and self._time_references <= {*names}:
            return False
        rubs = [p for p in parts if p.name.startswith("friction_")]
        # A missing torque wants white noise, and beside friction it is an approximation.
        torque = [p for p in parts if p.absorbs and "noise" not in p.decides]
        white = not any("noise" in p.decides and p.name != UNKNOWN for p in parts)
        apart = torque and (not white or any(p.rubs for p in parts))
        return not apart and (len(rubs) < 2 or BOTH not in self.parts)

    @cached_property
    def _time_references(self) -> frozenset[str]:
        return self.setting.time_references()

    def windows(self, count: int) -> list[CandidateModel]:
        """Return the config as given, on each of `count` windows of the record, from a free start."""
        given = self.job.source
        rungs = []
        for k in range(count):
            data = copy.deepcopy(given.data)
            for seen in self.job.problem.observations:  # what is held out stays as it is
                t = seen.experiment.t
                ends = t[0] + (t[-1] - t[0]) * np.array([k, k + 1]) / count
                config_edits.set_window(data, seen.label, *ends.tolist())
            source = Source(given.path, as_yaml(data), data, {}, ())
            rungs.append(CandidateModel((), source, table=self.job.table))
        return rungs

    def _rung(self, names: tuple[str, ...]) -> CandidateModel | None:
        """Return None where there is no such thing to try."""
        given, table = self.job.source, self.job.table
        if not names:
            return CandidateModel((), given, table=table)
        data = copy.deepcopy(given.data)
        parts = tuple(self.parts[name] for name in names if name in self.parts)
        if len(parts) < len(names) or not all(part.edit(data) for part in parts):
            return None
        lines = as_yaml(config_edits.changed_entries(given.data, data)).strip()
        lines = lines[1:-1] if lines.startswith("{") else lines
        data["output"] = {**data.get("output", {}), "figures": ["fit"]}
        data.pop("simulation", None)
        problem = self.job.problem
        channels = sum(len(each.experiment.channels) for each in problem.observations)
        config_edits.raise_walkers(data, len(problem.names) + 2 * channels + MOST_PHYSICS)
        source = Source(given.path, as_yaml(data), data, {}, ())
        kind = max(part.kind for part in parts)
        others = [part for part in self.parts.values() if LINEAR <= part.kind <= kind]
        neutral = {name: x for part in others for name, x in part.neutral.items()}
        neutral = {name: x for name, x in neutral.items() if name not in data["parameters"]}
        return CandidateModel(parts, source, lines, table, neutral)
