"""Build candidate models of a record: a job with one or several changes of its config."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from bayesdrill.analysis.causes import SCALE, TORQUE
from bayesdrill.config.job import Job
from bayesdrill.config.yaml_source import as_yaml
from bayesdrill.selection.absorbing_changes import absorbing_changes
from bayesdrill.selection.change import AR1, BOTH, LINEAR, NOTHING, START, Change
from bayesdrill.selection.config_edits import SHARED, Entries, merged
from bayesdrill.selection.measuring_changes import changed_columns, changed_times, widened_priors
from bayesdrill.selection.physics_changes import added_gravity, added_inertias, added_physics
from bayesdrill.selection.scales import scale_entries
from bayesdrill.selection.setting import Setting

MOST_PARTS = 8  # largest number of changes in a candidate
NOT_OF_MODEL = ("map", "sampler", "output", "simulation")  # entries without effect on the posterior


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """A candidate model is the model of the job `base` with some `changes` or none.

    `neutral` has further parameters of the rig, with values at which they have no effect.  With these,
    all candidates of one kind have the same parameters, so their refits share compiled kernels.
    """

    base: Job
    changes: tuple[Change, ...]
    neutral: Mapping[str, float] = NOTHING

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the changes."""
        return tuple(change.name for change in self.changes)

    @property
    def name(self) -> str:
        """Return the names of the changes, joined by hyphens."""
        return "-".join(self.names)

    @property
    def entries(self) -> Entries:
        """Return the entries of all changes, which override those of the given config."""
        entries = merged({}, *(change.entries for change in self.changes))
        if SHARED in entries:
            before = self.base.source.data.get(SHARED, ())
            entries[SHARED] = [*dict.fromkeys((*before, *entries[SHARED]))]
        return entries

    @property
    def config_lines(self) -> str:
        """Return the lines that a user adds to the config."""
        lines = as_yaml(self.entries).strip()
        return lines[1:-1] if lines.startswith("{") else lines

    @property
    def data(self) -> Entries:
        """Return all entries of the changed config that affect the posterior."""
        given = self.base.source.data.items()
        return merged({k: x for k, x in given if k not in NOT_OF_MODEL}, self.entries)

    def owner(self, unknown: str) -> str:
        """Return the name of the change that introduces an unknown, or `START` if none does.

        A further inertia also introduces the start of its own states, if the config has a free start.
        """
        for change in self.changes:
            if unknown.startswith(change.name) or ("parameters", unknown) in change.decides:
                return change.name
        if START in self.names or unknown in self.base.problem.names:
            return START
        adds_states = (c.name for c in self.changes if ("model", "inertias") in c.decides)
        return next(adds_states, START)

    def job(self, *, shared: bool = False) -> Job:
        """Return the changed job, with neutral parameters if `shared`; raise `InputError` if invalid."""
        neutral = {"parameters": self.neutral} if shared and self.neutral else {}
        return self.base.with_data(merged(neutral, self.data))


class CandidateModels(Setting):
    """The class builds candidate models from the changes of a setting."""

    @cached_property
    def changes(self) -> dict[str, Change]:
        """Return all changes by name, in the order in which they are tried."""
        scales = (Change(*entries) for entries in scale_entries(self.job))
        measuring = (*widened_priors(self), *changed_columns(self), *changed_times(self))
        physics = (*added_physics(self), *added_inertias(self), *added_gravity(self))
        every = (*scales, *measuring, *physics, *absorbing_changes(self))
        return {change.name: change for change in every if change.entries}

    def rungs(self, combinations: Iterable[tuple[str, ...]]) -> list[CandidateModel]:
        """Return a candidate for each combination of names whose changes all exist."""
        return [self._rung(names) for names in combinations if {*names} <= {*self.changes}]

    def singles(self, *, absorbing: bool = False) -> list[CandidateModel]:
        """Return candidates with one change, except scales; `absorbing` selects by `Change.absorbs`."""
        changes = (x for x in self.changes.values() if not x.name.startswith(SCALE))
        selected = [change for change in changes if change.absorbs == absorbing]
        return self.rungs((change.name,) for change in selected if not change.requires)

    def extensions(self, names: tuple[str, ...], more: Iterable[str]) -> list[CandidateModel]:
        """Return the candidates with the changes `names` and one of `more`, if they are compatible."""
        if len(names) >= MOST_PARTS:
            return []
        wanted = ((*names, n) for n in more if n not in names)
        return self.rungs(filter(self.possible, wanted))

    def without_each(self, names: tuple[str, ...]) -> list[CandidateModel]:
        """Return candidates with a change omitted, or replaced by one of only some of its entries."""
        subsets = [*itertools.combinations(names, len(names) - 1)][::-1]
        for name, other in itertools.product(names, self.changes.values()):
            if other.decides < self.changes[name].decides:
                subsets.append(tuple(other.name if each == name else each for each in names))
        return self.rungs(subset for subset in subsets if subset and self.possible(subset))

    def possible(self, names: Sequence[str]) -> bool:
        """Return whether changes are compatible, and no single change is equivalent to several."""
        changes = [self.changes[name] for name in names if name in self.changes]
        decided = [place for change in changes for place in change.decides]
        needed = {change.requires for change in changes} - {""}
        freed = {parameter for change in changes for parameter in change.lacks}
        if len(changes) < len(names) or len({*decided}) < len(decided) or not needed <= freed:
            return False
        if self.time_references <= {*names}:
            return False
        # A missing torque needs white noise, and is only approximate in a rig with friction.
        torque = any(name.startswith(TORQUE) for name in names)
        if torque and (AR1 in names or any(change.kind > LINEAR for change in changes)):
            return False
        frictions = [name for name in names if name.startswith("friction_")]
        return len(frictions) < 2 or BOTH not in self.changes

    def scales(self) -> list[CandidateModel]:
        """Return the candidates in which one value or unit is corrected by a factor."""
        return self.rungs((name,) for name in self.changes if name.startswith(SCALE))

    def windows(self, count: int) -> list[CandidateModel]:
        """Return a candidate for each of `count` windows of the record: the config with a free start."""
        windows = (self.window(k / count, (k + 1) / count) for k in range(count))
        changes = (Change(f"window_{k}", "", entries) for k, entries in enumerate(windows, 1))
        return [CandidateModel(self.job, (change,)) for change in changes]

    def _rung(self, names: tuple[str, ...]) -> CandidateModel:
        changes = tuple(self.changes[name] for name in names)
        kind = max((change.kind for change in changes), default=0)
        others = [change for change in self.changes.values() if LINEAR <= change.kind <= kind]
        neutral = {name: x for change in others for name, x in change.neutral.items()}
        return CandidateModel(self.job, changes, neutral)
