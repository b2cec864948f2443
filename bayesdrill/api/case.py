"""A case: a record, a rig and what is believed of it; and what can be asked of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.api import arguments
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.values import Value, check_arguments, equal_content
from bayesdrill.config import job
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import sources
from bayesdrill.output_files import FORMATS, refuse_replacing
from bayesdrill.record.experiment import raise_if_any
from bayesdrill.report import words
from bayesdrill.report.sections.fit import save_record
from bayesdrill.rig.models.linear import Model
from bayesdrill.tasks import identify

if TYPE_CHECKING:
    from bayesdrill.api.run import Best, Candidates, Run
    from bayesdrill.sampling.mode_search import Mode as Maximum
    from bayesdrill.tasks.pipeline import Outcome


CHANNELS = "a bd.Channel(values, unit, sigma) for each name"
INPUTS = "a number in SI or a bd.Input(values, unit) for each name"
VALUES = "a number in SI, or several, for each unknown"
PRIORS = "a prior, a number or 'nominal' for each name"

POINTS_AT_ONCE = 50  # of a log density: some kinds of noise keep all samples of each point


@dataclass(frozen=True, slots=True, eq=False)
class Channel(Value):
    """A measured channel: `values (T,)` in `unit`, at the times of its case.

    For example::

        bd.Channel(w_1, "rpm", sigma=2.0)
        bd.Channel(twist, "deg", sigma={"prior": "half_normal", "scale": 0.5},
                   measures="theta_1 - theta_2")

    `sigma`: standard deviation of its noise in that unit, or its prior as in a config.
    `measures`: a sum of states, such as `theta_1 - theta_2`, where the name is not that of one;
    `noise`: its kind and entries, as in a config, where it is not white.  `gain`, `offset` (in
    that unit) and `lag` (s) of its sensor: numbers or priors, as in a config.  What is wrong with
    it `case` says.
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
    """A measured input: `values (T,)` in `unit`.

        bd.Input(v, "V")

    Between samples it is held (`hold="zero"`) or straight (`first`); by default an angle is straight,
    and all else is held.

    `gain`, `offset`, `lag`: as of a `Channel`.  What is wrong with it `case` says.
    """

    values: ArrayLike
    unit: str
    hold: str | None = None
    gain: float | Mapping[str, Any] | None = None
    offset: float | Mapping[str, Any] | None = None
    lag: float | Mapping[str, Any] | None = None


def _figure_file(job: Job, option: str, path: str | Path) -> Path:
    file = Path(path).expanduser()
    if file.suffix[1:] not in FORMATS:
        raise InputError.at(option, f"'{file.name}' is none of .{', .'.join(FORMATS)}")
    refuse_replacing(sources.files(job.case), [file])
    return file


@check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Case(Value):
    """A record, a rig and what is believed of its parameters; made by `bd.load` or `bd.case`.

        case = bd.load("configs/nominal_step.yaml")
        run = case.sample(case.find_map(), seed=1)

    `print(case)` shows it.  `columns`: the record, `(T,)` each, where it is in no file.
    """

    job: Job
    columns: Mapping[str, Array] | None = None

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The names of all unknowns, in the order of draws."""
        return self.job.problem.names

    def __str__(self) -> str:
        return words.opening(self.job.problem)

    __repr__ = __str__

    def preview(self) -> str:
        """Describe what would run: columns, priors, start, sizes, and what the record can show."""
        problem, config = self.job.problem, self.job.config
        first = identify.preflight(self.job, SensitivityStudy(problem.posterior.likelihood))
        columns = [] if self.columns is not None else [words.record_columns(problem, self.job.case)]
        return "\n".join([str(self), *columns, words.preview(problem, config), first])

    def log_density(self, values: Annotated[Mapping[str, ArrayLike], VALUES]) -> Array:
        """Compute the unnormalised log posterior density over the unknowns: `(N,)`.

            case.log_density(case.find_map().values)

        It is the log likelihood plus the log prior, both normalised, and -inf outside the priors.
        `values`: for each unknown a number or `(N,)` numbers, SI.  Raises `InputError` with all that is
        wrong.
        """
        issues, names = list[Issue](), self.unknowns
        arguments.check_names(names, values, "values", "the case", issues)
        columns = {
            name: arguments.number_or_series(f"values.{name}", values[name], issues)
            for name in names
            if name in values
        }
        lengths = {len(column) for column in columns.values() if column.ndim}
        if len(lengths) > 1:
            issues.append(Issue("values", f"give {VALUES}, and equally many"))
        raise_if_any(issues)
        theta = np.empty((max(lengths, default=1), len(names)))
        for position, name in enumerate(names):
            theta[:, position] = columns[name]
        parts = np.array_split(theta, max(1, -(-len(theta) // POINTS_AT_ONCE)))
        return np.concatenate([self.job.problem.posterior.density(part) for part in parts])

    def draw_rig(self, path: str | Path) -> str:
        """Draw inertias, shafts, gears and drives of the rig; says what is written.

        Raises `InputError` for a file that is no .pdf, .png or .svg.
        """
        from bayesdrill.report.rig_drawing import save_rig  # late: it loads what draws

        problem, to = self.job.problem, _figure_file(self.job, "--figure", path)
        return f"figure: {save_rig(problem.model, to)}"

    def draw_record(self, path: str | Path) -> str:
        """Draw channels and inputs over time, of each experiment; says and raises as `draw_rig`."""
        to = _figure_file(self.job, "--figure-record", path)
        written = save_record(self.job.problem, to)
        return f"figure: {', '.join(map(str, written))}"

    def identify(
        self,
        profiles: Sequence[str] | str = (),
        *,
        at: Best | None = None,
        report: Reporter | None = None,
    ) -> identify.Findings:
        """Compute what the record can show of each unknown, before any sampling.

            case.identify("all", at=case.find_map())

        `profiles`: names of parameters whose profile likelihoods are computed, or `all`; `at`: the
        maximum at which this is evaluated, else the start values or, where the rig stands still
        there, a draw from the priors.  Raises `InputError` where no parameter is unknown.
        """
        mode = None if at is None else self._mode(at)
        job = self.job if mode is None else self.job.with_steps_at(mode)
        names = [profiles] if isinstance(profiles, str) else profiles
        return identify.identify(job, mode, names, report or SILENT)

    @staticmethod
    def check_place(folder: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` where findings could not be saved, before minutes of profiles."""
        identify.check_place(Path(folder).expanduser(), force=force)

    def find_map(
        self, *, quick: bool = False, processes: int | None = 1, report: Reporter | None = None
    ) -> Best:
        """Find the maximum of the posterior (MAP), by several searches or, `quick`, by one.

            case.find_map().plot()

        `processes`, `report`: see `sample`.
        """
        from bayesdrill.api.run import Best  # late: it loads all that sampling needs
        from bayesdrill.tasks import find_map

        workers = arguments.workers(processes)
        mode = find_map.find_mode(self.job, workers, report or SILENT, quick=quick)
        return Best(self.job, mode, self.columns)

    def check_new_config(self, path: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` where `Candidates.apply` would, before minutes of searches."""
        from bayesdrill.tasks import find_map

        find_map.check_new_config(self.job, Path(path).expanduser(), force=force)

    def candidates(
        self, *, processes: int | None = 1, report: Reporter | None = None
    ) -> Candidates:
        """Find the maximum, and rank models that explain what it leaves: see `Best.candidates`."""
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
        verbose: bool = False,
    ) -> Outcome:
        """Do the whole job of a case that was loaded from a file, as `bayesdrill posterior` does.

        What is sampled is saved as it is made, so that a run that is stopped can be resumed.

        `folder`: `results/<name>` by default.  `processes`, `report`: see `sample`; `verbose`:
        whether `report` is told the details too.  Raises `InputError`, and `Interrupted` when asked to
        stop.
        """
        from bayesdrill.tasks import pipeline

        if self.columns is not None:
            way_out = "give `sample().save(folder)`, then `load` its config"
            raise InputError.at("run", f"arrays are in no file yet; {way_out}")
        how = arguments.mode(resume=resume, force=force)
        path, workers = self.place(folder), arguments.workers(processes)
        told = report or SILENT
        details = told if verbose else SILENT
        return pipeline.run_posterior(self.job, path, how, workers, told, details)

    def place(self, folder: str | Path | None = None) -> Path:
        """Return where `run` leaves its results: `results/<name>` by default."""
        return arguments.results_folder(folder, Path("results") / self.job.config.name)

    def sample(
        self,
        best: Best | None = None,
        *,
        seed: int | None = None,
        processes: int | None = 1,
        report: Reporter | None = None,
    ) -> Run:
        """Sample the posterior by ensembles of walkers until they converge, or have no steps left.

            run = case.sample(seed=1, processes=None)

        `best`: the maximum where they begin, searched for where it is not given.  `seed` instead of the
        config's; the same draws for the same seed, however many processes.
        More than one process (None: all there are) wants `if __name__ == "__main__":` in a script.
        `report`: has `say(text)` and `update(fraction, text)`, which are told how far it is.  Raises
        `InputError`.
        """
        from bayesdrill.api.run import Run
        from bayesdrill.tasks import find_map, pipeline

        job, workers = self.job, arguments.workers(processes)
        if seed is not None:
            job = job.with_settings(seed=arguments.whole("seed", seed, 0))
        progress = report or SILENT
        mode = find_map.find_mode(job, workers, progress) if best is None else self._mode(best)
        job = job.with_steps_at(mode)
        sampled = pipeline.sample_in_memory(job, mode, workers, progress)
        return Run(job, mode, sampled, self.columns)

    def _mode(self, best: Best) -> Maximum:
        from bayesdrill.api.run import Best

        if not isinstance(best, Best):
            raise InputError.at("best", f"give what find_map found, not {type(best).__name__}")
        if not equal_content(best.job.problem.posterior, self.job.problem.posterior):
            message = "this is the maximum of another case; find that of this one"
            raise InputError.at("best", message)
        return best.mode


@check_arguments
def load(path: str | Path) -> Case:
    """Load the case of a YAML config; raises `InputError` with all that is wrong with it.

        case = bd.load("configs/nominal_step.yaml")

    `print(case)` shows its unknowns and their priors.
    """
    return Case(prepare(Path(path).expanduser()))


@check_arguments
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
    """Make a case of arrays, without any file.

        bd.case(t, {"w_1": bd.Channel(w, "rad/s", sigma=0.1)}, {"v": 8.0, "t_1": 0.0},
                {"k_s": {"prior": "uniform", "low": 0.1, "high": 1.0}, ...})

    `t (T,)`: times in s, increasing; the other entries are as in a config (docs/config.md).
    `inputs`: a number in SI or a measured `Input` for each; `parameters`: for each a number,
    `"nominal"` or a prior, such as `{"prior": "uniform", "low": 0.5, "high": 1.5, "relative":
    True}` (one that the rig only offers, such as `c_s`, is switched on so); `nominal`: a table or
    values of your own (`{"k_s": 0.27}`); without it a parameter that relies on a table takes
    `tables_2_3`, and is compared with it; `rig`: a name, or a model such as `MotorShaft(i_m=1 /
    8)`; `entries`: further sections, such as `sampler={"ess": 1000}`, and what `record` says
    beside arrays, such as `record={"missing": "drop"}`.  The rig is at rest at 0 s, with measured
    inputs at the first sample, unless `initial={"w_1": ...}` says otherwise.  Raises `InputError`
    with all that is wrong.
    """
    columns, measured = _columns(t, channels, inputs)
    record = entries.pop("record", {})
    if not isinstance(record, Mapping):
        message = f"give entries, such as a window, not {type(record).__name__}"
        raise InputError.at("record", message)
    refused = ["model"] if "model" in entries else []
    said = ("file", "format", "time", "channels")
    refused += [f"record.{name}" for name in said if name in record]
    if refused:
        raise InputError.at(refused[0], "arrays and `rig` say this already; leave it out")
    model = arguments.rig(rig)
    believed = dict(parameters)
    unsaid = [name for name in model.added if name not in believed]
    raise_if_any([Issue(f"parameters.{n}", f"the rig has it; give {PRIORS}") for n in unsaid])
    given = {
        "name": name,
        "seed": seed,
        "record": {
            **record,
            "channels": {key: _entry(key, channel) for key, channel in channels.items()},
        },
        "inputs": {**inputs, **{key: _entry(key, column) for key, column in measured.items()}},
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
    issues: list[Issue] = []
    columns: dict[str, Array] = {job.TIME_COLUMN: arguments.series("t", t, issues)}
    for name, channel in channels.items():
        if isinstance(channel, Channel):
            columns[name] = arguments.series(f"channels.{name}", channel.values, issues)
        else:
            text = f"give {CHANNELS}, not {type(channel).__name__}"
            issues.append(Issue(f"channels.{name}", text))
    measured = {}
    for name, given in inputs.items():
        if isinstance(given, Input) and name in channels:
            text = "an input has this name; give the channel another, with `measures`"
            issues.append(Issue(f"channels.{name}", text))
        elif isinstance(given, Input):
            measured[name] = given
            columns[name] = arguments.series(f"inputs.{name}", given.values, issues)
        elif not isinstance(given, Mapping):
            arguments.number(f"inputs.{name}", given, issues)
    if not issues and not channels:
        issues.append(Issue("channels", f"nothing is measured; give {CHANNELS}"))
    lengths = {name: len(values) for name, values in columns.items()}
    if not issues:
        issues += [
            Issue(name, f"{n} values, but there are {lengths[job.TIME_COLUMN]} times")
            for name, n in lengths.items()
            if n != lengths[job.TIME_COLUMN]
        ]
    hints = {"inputs": f"; give {INPUTS}"}
    raise_if_any([Issue(i.place, i.message + hints.get(i.place.split(".")[0], "")) for i in issues])
    return columns, measured


def _entry(column: str, spec: Channel | Input) -> dict[str, Any]:
    """As a config has it, but for the numbers, which stand in `column`."""
    fields = {f.name: getattr(spec, f.name) for f in dataclasses.fields(spec) if f.name != "values"}
    return {"column": column, **{key: value for key, value in fields.items() if value is not None}}
