"""Candidate models of a record: a job with one change of its config, or with several."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bayesdrill.analysis.causes import TORQUE
from bayesdrill.config.job import Job
from bayesdrill.config.yaml_source import as_yaml
from bayesdrill.selection.changes import AR1, BOTH, LINEAR, NOTHING, START, Change, Setting
from bayesdrill.selection.config_edits import SHARED, Entries, merged

MOST_PARTS = 8
NOT_OF_MODEL = ("map", "sampler", "output", "simulation")  # sections that decide no posterior


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """The model of the job that is `given`, with changes; none of them: as it is.

    `neutral`: further parameters of the rig that do nothing, which it is refitted with, so that it
    shares kernels with others.
    """

    given: Job
    changes: tuple[Change, ...]
    neutral: Mapping[str, float] = NOTHING

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its changes."""
        return tuple(change.name for change in self.changes)

    @property
    def name(self) -> str:
        """Join the names of its changes with dashes."""
        return "-".join(self.names)

    @property
    def entries(self) -> Entries:
        """The entries that go over those of the config."""
        said = merged({}, *(change.entries for change in self.changes))
        before = self.given.source.data.get(SHARED, ())
        return said | (
            {SHARED: [*dict.fromkeys((*before, *said[SHARED]))]} if SHARED in said else {}
        )

    @property
    def config_lines(self) -> str:
        """The lines that a user adds to the config."""
        lines = as_yaml(self.entries).strip()
        return lines[1:-1] if lines.startswith("{") else lines

    @property
    def data(self) -> Entries:
        """All entries of its config but those that decide no posterior."""
        given = self.given.source.data.items()
        return merged({k: x for k, x in given if k not in NOT_OF_MODEL}, self.entries)

    def owner(self, unknown: str) -> str:
        """Return the change that an unknown belongs to, the start where it is of none."""
        owners = (c.name for c in self.changes if unknown in c.lacks or unknown.startswith(c.name))
        return next(owners, START)

    def job(self, *, shared: bool = False) -> Job:
        """Return its job, `shared`: with what is neutral; raise `InputError` where there is none."""
        neutral = {"parameters": self.neutral} if shared and self.neutral else {}
        return self.given.with_data(merged(neutral, self.data))


class CandidateModels(Setting):
    """Candidate models of the job of a setting."""

    def rungs(self, every: Iterable[tuple[str, ...]]) -> list[CandidateModel]:
        """Return those with changes of these names, where there is such a thing to try."""
        return [self._rung(names) for names in every if {*names} <= {*self.changes}]

    def singles(self, *, absorbing: bool = False) -> list[CandidateModel]:
        """Return those with one change each: a cause or, `absorbing`, what absorbs any misfit."""
        every = [change for change in self.changes.values() if change.absorbs == absorbing]
        return self.rungs((change.name,) for change in every if not change.needs)

    def beyond(self, names: tuple[str, ...], more: Iterable[str]) -> list[CandidateModel]:
        """Return those with these changes and each of `more` that can go with them."""
        if len(names) >= MOST_PARTS:
            return []
        resting = [change.name for change in self.changes.values() if change.needs]
        wanted = ((*names, n) for n in dict.fromkeys((*more, *resting)) if n not in names)
        return self.rungs(filter(self.possible, wanted))

    def without_each(self, names: tuple[str, ...]) -> list[CandidateModel]:
        """Return those without each of their changes, in turn."""
        every = reversed([*itertools.combinations(names, len(names) - 1)])
        return self.rungs(fewer for fewer in every if fewer and self.possible(fewer))

    def possible(self, names: Sequence[str]) -> bool:
        """Tell whether changes go together, and together mean something that one alone does not."""
        every = [self.changes[name] for name in names if name in self.changes]
        decided = [place for change in every for place in change.decides]
        needed = {change.needs for change in every} - {""}
        freed = {parameter for change in every for parameter in change.lacks}
        if len(every) < len(names) or len({*decided}) < len(decided) or not needed <= freed:
            return False
        if self.time_references <= {*names}:
            return False
        # A missing torque wants white noise, and beside friction it is an approximation.
        torque = any(name.startswith(TORQUE) for name in names)
        apart = torque and (AR1 in names or any(change.kind > LINEAR for change in every))
        rubs = [name for name in names if name.startswith("friction_")]
        return not apart and (len(rubs) < 2 or BOTH not in self.changes)

    def windows(self, count: int) -> list[CandidateModel]:
        """Return the config as given, on each of `count` windows of the record, from a free start."""
        every = (self.window(k / count, (k + 1) / count) for k in range(count))
        changes = (Change(f"window_{k}", "", entries) for k, entries in enumerate(every, 1))
        return [CandidateModel(self.job, (change,)) for change in changes]

    def _rung(self, names: tuple[str, ...]) -> CandidateModel:
        changes = tuple(self.changes[name] for name in names)
        kind = max((change.kind for change in changes), default=0)
        others = [change for change in self.changes.values() if LINEAR <= change.kind <= kind]
        neutral = {name: x for change in others for name, x in change.neutral.items()}
        return CandidateModel(self.job, changes, neutral)
