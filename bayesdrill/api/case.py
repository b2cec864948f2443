"""A case: a record, a rig and what is believed of it; and what can be asked of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from bayesdrill.api.run import Best, Run
from bayesdrill.basics.progress import Reporter, Silent
from bayesdrill.commands import identify, pipeline, searching
from bayesdrill.report import words
from bayesdrill.rig.models import Rig
from bayesdrill.setup import in_memory
from bayesdrill.setup.job import Job, prepare


@dataclass(frozen=True, slots=True)
class Channel:
    """`values (T,)` in `unit`; `sigma`: their noise in that unit, or its prior as in a config.

    `measures`: a sum of states, such as `theta_1 - theta_2`, where the name is not that of one.
    """

    values: ArrayLike
    unit: str
    sigma: float | Mapping[str, Any]
    measures: str | None = None


@dataclass(frozen=True, slots=True)
class Input:
    """A measured input: `values (T,)` in `unit`, between samples held (`zero`) or straight (`first`)."""

    values: ArrayLike
    unit: str
    hold: str = "zero"


@dataclass(frozen=True, slots=True)
class Case:
    """From `load` or `case`.  `columns`: the record, `(T,)` each, where it is in no file."""

    job: Job
    columns: Mapping[str, ArrayLike] | None = None

    @property
    def unknowns(self) -> tuple[str, ...]:
        return self.job.problem.names

    def __str__(self) -> str:
        return words.opening(self.job.problem)

    __repr__ = __str__

    def identify(self, profiles: Sequence[str] = ()) -> identify.Findings:
        """What the record can show at the start values; `profiles`: names of parameters, or `all`.

        Raises `InputError` where no parameter is unknown.
        """
        space = self.job.problem.posterior.space
        start = space.vector(space.start)
        return identify.identify(self.job, start, "the start", profiles, Silent())

    def find_map(self, *, processes: int = 1, report: Reporter | None = None) -> Best:
        """The maximum of the posterior, by several searches."""
        return Best(self.job, searching.find_mode(self.job, processes, report or Silent()))

    def sample(
        self,
        best: Best | None = None,
        *,
        seed: int | None = None,
        processes: int = 1,
        report: Reporter | None = None,
    ) -> Run:
        """Ensembles from `best` (searched for where it is not given) until they converge, or not.

        `seed` instead of the config's; the same draws for the same seed, however many processes.
        More than one process wants `if __name__ == "__main__":` in a script.
        """
        job = self.job
        if seed is not None:
            job = dataclasses.replace(job, config=job.config.model_copy(update={"seed": seed}))
        told = report or Silent()
        found = best.mode if best else searching.find_mode(job, processes, told)
        sampled = pipeline.sample_in_memory(job, found, processes, told)
        return Run(job, found, sampled, self.columns)


def load(path: str | Path) -> Case:
    """The case of a YAML config; raises `InputError` with all that is wrong with it."""
    return Case(prepare(Path(path)))


def case(
    t: ArrayLike,
    channels: Mapping[str, Channel],
    inputs: Mapping[str, Input | float],
    parameters: Mapping[str, Any],
    *,
    rig: str | Rig = "motor_shaft",
    nominal: Any = None,
    seed: int = 0,
    name: str = "case",
    **entries: Any,
) -> Case:
    """Of arrays, without any file: times `t (T,)` in s, and entries as in a config (docs/config.md).

    `parameters`: a prior, a number or `"nominal"` for each; `rig`: a name, or a model such as
    `MotorShaft(i_m=1 / 8)`; `entries`: further sections, such as `sampler={"ess": 1000}`.
    Raises `InputError` with all that is wrong.
    """
    columns: dict[str, ArrayLike] = {in_memory.TIME: t}
    columns |= {name_: one.values for name_, one in channels.items()}
    measured = {key: one for key, one in inputs.items() if isinstance(one, Input)}
    columns |= {key: one.values for key, one in measured.items()}
    given = {
        "name": name,
        "seed": seed,
        "record": {"channels": {key: _entry(key, one) for key, one in channels.items()}},
        "inputs": {**inputs, **{key: _entry(key, one) for key, one in measured.items()}},
        "model": in_memory.model_entry(rig),
        "parameters": dict(parameters),
        **({} if nominal is None else {"nominal": nominal}),
        **entries,
    }
    return Case(in_memory.job(columns, given), columns)


def _entry(column: str, of: Channel | Input) -> dict[str, Any]:
    """As a config has it, but for the numbers, which stand in `column`."""
    fields = {f.name: getattr(of, f.name) for f in dataclasses.fields(of) if f.name != "values"}
    return {"column": column, **{key: one for key, one in fields.items() if one is not None}}
