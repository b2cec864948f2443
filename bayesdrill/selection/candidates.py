"""Candidate models of a record: configs that differ from one in a thing each, or in several."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bayesdrill.analysis.causes import TORQUE
from bayesdrill.config import loading
from bayesdrill.config.job import Job, assemble
from bayesdrill.config.yaml_source import Source, as_yaml
from bayesdrill.record.formats.table import RecordTable
from bayesdrill.selection import config_edits
from bayesdrill.selection.parts import AR1, BOTH, LINEAR, NOTHING, START, Part, Setting

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
    table: RecordTable | None
    lines: str = ""
    neutral: Mapping[str, float] = NOTHING

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its parts."""
        return tuple(part.name for part in self.parts)

    @property
    def name(self) -> str:
        """Its name: parts with dashes between."""
        return "-".join(self.names) or GIVEN

    @property
    def about(self) -> str:
        """What it has beside the config as given, in words."""
        return " and ".join(part.words for part in self.parts) or AS_GIVEN

    def owner(self, unknown: str) -> str:
        """Return the part that an unknown belongs to, the start where it is of none."""
        owners = (p.name for p in self.parts if unknown in p.lacks or unknown.startswith(p.name))
        return next(owners, START)

    def job(self, *, shared: bool = False) -> Job:
        """Return its job, `shared`: with what is neutral; raise `InputError` where there is none."""
        neutral = {"parameters": self.neutral} if shared and self.neutral else {}
        data = config_edits.merged(neutral, self.source.data)
        source = config_edits.with_data(self.source, data) if neutral else self.source
        return assemble(loading.validate(source), self.table)


class CandidateModels(Setting):
    """Candidate models of the job of a setting."""

    def rungs(self, every: Iterable[tuple[str, ...]]) -> list[CandidateModel]:
        """Return those with parts of these names, where there is such a thing to try."""
        return [self._rung(names) for names in every if {*names} <= {*self.parts}]

    def singles(self, *, absorbing: bool = False) -> list[CandidateModel]:
        """Return those with one thing each: a cause or, `absorbing`, what absorbs any misfit."""
        parts = [part for part in self.parts.values() if part.absorbs == absorbing]
        return self.rungs((part.name,) for part in parts if not part.needs)

    def beyond(self, names: tuple[str, ...], more: Iterable[str]) -> list[CandidateModel]:
        """Return those with these parts and each of `more` that can go with them."""
        if len(names) >= MOST_PARTS:
            return []
        resting = [part.name for part in self.parts.values() if part.needs]
        wanted = ((*names, n) for n in dict.fromkeys((*more, *resting)) if n not in names)
        return self.rungs(filter(self.possible, wanted))

    def without_each(self, names: tuple[str, ...]) -> list[CandidateModel]:
        """Return those without each of their parts, in turn."""
        every = reversed([*itertools.combinations(names, len(names) - 1)])
        return self.rungs(fewer for fewer in every if fewer and self.possible(fewer))

    def possible(self, names: Sequence[str]) -> bool:
        """Tell whether parts go together, and together mean something that one alone does not."""
        parts = [self.parts[name] for name in names if name in self.parts]
        decided = [place for part in parts for place in part.decides]
        needed = {part.needs for part in parts} - {""}
        freed = {parameter for part in parts for parameter in part.lacks}
        if len(parts) < len(names) or len({*decided}) < len(decided) or not needed <= freed:
            return False
        if self.time_references <= {*names}:
            return False
        # A missing torque wants white noise, and beside friction it is an approximation.
        torque = any(part.name.startswith(TORQUE) for part in parts)
        apart = torque and (AR1 in names or any(part.kind > LINEAR for part in parts))
        rubs = [name for name in names if name.startswith("friction_")]
        return not apart and (len(rubs) < 2 or BOTH not in self.parts)

    def windows(self, count: int) -> list[CandidateModel]:
        """Return the config as given, on each of `count` windows of the record, from a free start."""
        given, table = self.job.source, self.job.table
        every = (self.window(k / count, (k + 1) / count) for k in range(count))
        changed = (config_edits.merged(given.data, lines) for lines in every)
        return [CandidateModel((), config_edits.with_data(given, x), table) for x in changed]

    def _rung(self, names: tuple[str, ...]) -> CandidateModel:
        given, table = self.job.source, self.job.table
        if not names:
            return CandidateModel((), given, table)
        parts = tuple(self.parts[name] for name in names)
        said = config_edits.merged({}, *(part.lines for part in parts))
        data = config_edits.merged(given.data, said)
        said |= {key: data[key] for key in said if key == config_edits.SHARED}
        lines = as_yaml(said).strip()
        lines = lines[1:-1] if lines.startswith("{") else lines
        data["output"] = {**data.get("output", {}), "figures": ["fit"]}
        data.pop("simulation", None)
        problem = self.job.problem
        channels = sum(len(each.experiment.channels) for each in problem.observations)
        config_edits.raise_walkers(data, len(problem.names) + 2 * channels + MOST_PHYSICS)
        kind = max(part.kind for part in parts)
        others = [part for part in self.parts.values() if LINEAR <= part.kind <= kind]
        neutral = {
            n: x for p in others for n, x in p.neutral.items() if n not in data["parameters"]
        }
        return CandidateModel(parts, config_edits.with_data(given, data), table, lines, neutral)
