"""A case: a record, a rig and what is believed of it; and what can be asked of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from numpy.typing import ArrayLike

from bayesdrill.analysis.identifiability.information import Scenery
from bayesdrill.api import arguments
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value, alike, checked
from bayesdrill.config import job
from bayesdrill.config.job import Job, prepare
from bayesdrill.record.experiment import raise_if_any
from bayesdrill.report import words
from bayesdrill.rig.models.linear import Model
from bayesdrill.tasks import identify

if TYPE_CHECKING:
    from bayesdrill.api.run import Best, Candidates, Run
    from bayesdrill.sampling.mode_search import Mode as Maximum
    from bayesdrill.tasks.pipeline import Outcome


CHANNELS = "a bd.Channel(values, unit, sigma) for each name"
INPUTS = "a number in SI or a bd.Input(values, unit) for each name"
PRIORS = "a prior, a number or 'nominal' for each name"


@dataclass(frozen=True, slots=True, eq=False)
class Channel(Value):
    """`values (T,)` in `unit`; `sigma`: their noise in that unit, or its prior as in a config.

    `measures`: a sum of states, such as `theta_1 - theta_2`, where the name is not that of one; `noise`:
    its kind and entries, as in a config, where it is not white.  `gain`, `offset` (in that unit) and
    `lag` (s) of its sensor: numbers or priors, as in a config.  What is wrong with it `case` says.
    """

    values: ArrayLike
    unit: str
    sigma: float | Mapping[str, Any]
    measures: str | None = None
    noise: str | Mapping[str, Any] | None = None
    gain: float | Mapping[str, Any] | None = None
    offset: float | Mapping[str, Any] | None = None
    lag: float | Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Input(Value):
    """A measured input: `values (T,)` in `unit`, between samples held (`zero`) or straight (`first`).

    `gain`, `offset`, `lag`: as of a `Channel`.  What is wrong with it `case` says.
    """

    values: ArrayLike
    unit: str
    hold: str = "zero"
    gain: float | Mapping[str, Any] | None = None
    offset: float | Mapping[str, Any] | None = None
    lag: float | Mapping[str, Any] | None = None


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Case(Value):
    """From `load` or `case`.  `columns`: the record, `(T,)` each, where it is in no file."""

    job: Job
    columns: Mapping[str, Array] | None = None

    @property
    def unknowns(self) -> tuple[str, ...]:
        return self.job.problem.names

    def __str__(self) -> str:
        return words.opening(self.job.problem, self.job.units)

    __repr__ = __str__

    def preview(self) -> str:
        """What would run: columns and units, priors, the start, sizes, and what the record can show."""
        problem, config = self.job.problem, self.job.config
        first = identify.preflight(self.job, Scenery(problem.posterior.likelihood))
        columns = [] if self.columns is not None else [words.record_columns(problem, self.job.case)]
        return "\n".join(
            [str(self), *columns, words.preview(problem, config, self.job.units), first]
        )

    def identify(
        self,
        profiles: Sequence[str] | str = (),
        *,
        at: Best | None = None,
        report: Reporter | None = None,
    ) -> identify.Findings:
        """What the record can show; `profiles`: names of parameters, or `all`.

        At the start values, or `at` the maximum that was found.  Raises `InputError` where no parameter
        is unknown.
        """
        job, space = self.job, self.job.problem.posterior.space
        values, where = space.start, "the start"
        if at is not None:
            found = self._mode(at)
            job, values, where = job.with_steps_at(found), found.values, "the MAP"
        names = [profiles] if isinstance(profiles, str) else profiles
        told = report or SILENT
        return identify.identify(job, space.vector(values), where, names, told)

    @staticmethod
    def check_place(folder: str | Path, *, force: bool = False) -> None:
        """Raises `InputError` where findings could not be saved, before minutes of profiles."""
        identify.check_place(Path(folder).expanduser(), force=force)

    def find_map(
        self, *, quick: bool = False, processes: int | None = 1, report: Reporter | None = None
    ) -> Best:
        """The maximum of the posterior, by several searches or, `quick`, by one.

        `processes`, `report`: see `sample`.
        """
        from bayesdrill.api.run import Best  # late: it loads all that sampling needs
        from bayesdrill.tasks import find_map

        workers = arguments.workers(processes)
        found = find_map.find_mode(self.job, workers, report or SILENT, quick=quick)
        return Best(self.job, found, self.columns)

    def candidates(
        self, *, processes: int | None = 1, report: Reporter | None = None
    ) -> Candidates:
        """What would explain what the best fit leaves: see `Best.candidates`."""
        best = self.find_map(processes=processes, report=report)
        return best.candidates(processes=processes, report=report)

    def run(
        self,
        folder: str | Path | None = None,
        *,
        resume: bool = False,
        force: bool = False,
        processes: int | None = 1,
        report: Reporter | None = None,
    ) -> Outcome:
        """The whole job of a case of a file, as `bayesdrill posterior` does it.

        What is sampled is saved as it is made, so that a run that is stopped can be resumed.

        `folder`: `results/<name>` by default.  `processes`, `report`: see `sample`.  Raises
        `InputError`, and `Interrupted` when asked to stop.
        """
        from bayesdrill.tasks import pipeline

        if self.columns is not None:
            message = (
                "arrays are in no file yet; give `sample().save(folder)`, then `load` its config"
            )
            raise InputError.one("run", message)
        how = arguments.mode(resume=resume, force=force)
        place, workers = self.place(folder), arguments.workers(processes)
        return pipeline.posterior(self.job, place, how, workers, report or SILENT)

    def place(self, folder: str | Path | None = None) -> Path:
        """Where `run` leaves its results."""
        return arguments.results_folder(folder, Path("results") / self.job.config.name)

    def sample(
        self,
        best: Best | None = None,
        *,
        seed: int | None = None,
        processes: int | None = 1,
        report: Reporter | None = None,
    ) -> Run:
        """Ensembles from `best` (searched for where it is not given) until they converge, or not.

        `seed` instead of the config's; the same draws for the same seed, however many processes.
        More than one process (None: all there are) wants `if __name__ == "__main__":` in a script.
        `report`: has `say(text)` and `update(fraction, text)`, which are told how far it is.  Raises
        `InputError`.
        """
        from bayesdrill.api.run import Run
        from bayesdrill.tasks import find_map, pipeline

        job, workers = self.job, arguments.workers(processes)
        if seed is not None:
            own = {"seed": arguments.whole("seed", seed, 0)}
            job = job.with_settings(**own)
        told = report or SILENT
        found = find_map.find_mode(job, workers, told) if best is None else self._mode(best)
        job = job.with_steps_at(found)
        sampled = pipeline.sample_in_memory(job, found, workers, told)
        return Run(job, found, sampled, self.columns)

    def _mode(self, best: Best) -> Maximum:
        from bayesdrill.api.run import Best

        if not isinstance(best, Best):
            raise InputError.one("best", f"give what find_map found, not {type(best).__name__}")
        if not alike(best.job.problem.posterior, self.job.problem.posterior):
            raise InputError.one(
                "best", "this is the maximum of another case; find that of this one"
            )
        return best.mode


@checked
def load(path: str | Path) -> Case:
    """The case of a YAML config; raises `InputError` with all that is wrong with it."""
    return Case(prepare(Path(path).expanduser()))


@checked
def case(
    t: ArrayLike,
    channels: Annotated[Mapping[str, Channel], CHANNELS],
    inputs: Annotated[Mapping[str, Input | float], INPUTS],
    parameters: Annotated[Mapping[str, Any], PRIORS],
    *,
    rig: str | Model = "motor_shaft",
    nominal: Any = None,
    seed: int = 0,
    name: str = "case",
    **entries: Any,
) -> Case:
    """Of arrays, without any file: times `t (T,)` in s, increasing, and entries as in a config
    (docs/config.md).

    `inputs`: a number in SI or a measured `Input` for each; `parameters`: for each a number, `"nominal"`
    or a prior, such as `{"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}` (one that the
    rig only offers, such as `c_s`, is switched on so); `nominal`: a table or values of your own
    (`{"k_s": 0.27}`); without it a parameter that relies on a table takes `tables_2_3`, and is compared
    with it; `rig`: a name, or a model such as `MotorShaft(i_m=1 / 8)`; `entries`: further sections, such
    as `sampler={"ess": 1000}`, and what `record` says beside arrays, such as `record={"missing":
    "drop"}`.  The rig is at rest at 0 s, with measured inputs at the first sample, unless
    `initial={"w_1": ...}` says otherwise.  Raises `InputError` with all that is wrong.
    """
    columns, measured = _columns(t, channels, inputs)
    record = entries.pop("record", {})
    if not isinstance(record, Mapping):
        message = f"give entries, such as a window, not {type(record).__name__}"
        raise InputError.one("record", message)
    said = [name for name in ("model",) if name in entries]
    said += [f"record.{name}" for name in ("file", "format", "time", "channels") if name in record]
    if said:
        raise InputError.one(said[0], "arrays and `rig` say this already; leave it out")
    model = arguments.rig(rig)
    believed = dict(parameters)
    unsaid = [name for name in model.added if name not in believed]
    raise_if_any([Issue(f"parameters.{n}", f"the rig has it; give {PRIORS}") for n in unsaid])
    given = {
        "name": name,
        "seed": seed,
        "record": {**record, "channels": {key: _entry(key, one) for key, one in channels.items()}},
        "inputs": {**inputs, **{key: _entry(key, one) for key, one in measured.items()}},
        "model": job.model_entry(model),
        "parameters": believed,
        **({} if nominal is None else {"nominal": nominal}),
        **entries,
    }
    return Case(job.job_in_memory(columns, given), columns)


def _columns(
    t: ArrayLike, channels: Mapping[str, Channel], inputs: Mapping[str, Input | float]
) -> tuple[dict[str, Array], dict[str, Input]]:
    """All `(T,)` columns, and the inputs that are measured."""
    found: list[Issue] = []
    every: dict[str, Array] = {job.TIME_COLUMN: arguments.series("t", t, found)}
    for name, one in channels.items():
        if isinstance(one, Channel):
            every[name] = arguments.series(f"channels.{name}", one.values, found)
        else:
            found.append(Issue(f"channels.{name}", f"give {CHANNELS}, not {type(one).__name__}"))
    measured = {}
    for name, given in inputs.items():
        if isinstance(given, Input) and name in channels:
            said = "an input has this name; give the channel another, with `measures`"
            found.append(Issue(f"channels.{name}", said))
        elif isinstance(given, Input):
            measured[name] = given
            every[name] = arguments.series(f"inputs.{name}", given.values, found)
        elif not isinstance(given, Mapping):
            arguments.number(f"inputs.{name}", given, found)
    if not found and not channels:
        found.append(Issue("channels", f"nothing is measured; give {CHANNELS}"))
    lengths = {name: len(values) for name, values in every.items()}
    if not found:
        found += [
            Issue(name, f"{n} values, but there are {lengths[job.TIME_COLUMN]} times")
            for name, n in lengths.items()
            if n != lengths[job.TIME_COLUMN]
        ]
    hints = [f"; give {INPUTS}" if one.place.startswith("inputs.") else "" for one in found]
    raise_if_any([Issue(one.place, one.message + h) for one, h in zip(found, hints, strict=True)])
    return every, measured


def _entry(column: str, of: Channel | Input) -> dict[str, Any]:
    """As a config has it, but for the numbers, which stand in `column`."""
    fields = {f.name: getattr(of, f.name) for f in dataclasses.fields(of) if f.name != "values"}
    return {"column": column, **{key: one for key, one in fields.items() if one is not None}}
