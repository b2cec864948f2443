"""Check arguments of the API; define the base classes `ManyFits` and `ExperimentPlanner`."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from bayesdrill.basics.arguments import check_arguments as check_arguments
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue, did_you_mean, short_repr
from bayesdrill.basics.processes import available_processors
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.basics.registry import lookup
from bayesdrill.config.job import Job
from bayesdrill.output_files import DESIGN, refuse_other_text
from bayesdrill.record.experiment import check_time
from bayesdrill.rig.models import MODELS
from bayesdrill.rig.models.linear import Model

if TYPE_CHECKING:
    from bayesdrill.results.run_folder import WriteMode
    from bayesdrill.tasks.design import Designed
    from bayesdrill.tasks.remote import RefitExecutor


MOST_PROCESSES = 256  # largest number of worker processes; each loads all libraries into memory


def series(location: str, values: Any, issues: list[Issue]) -> Array:
    """Return an array as floats `(T,)`, NaN if masked; mistakes are added to `issues`."""
    try:
        masked = np.ma.getmaskarray(values) if isinstance(values, np.ma.MaskedArray) else None
        raw = np.asarray(values)
    except Exception:  # uneven lists, or any exception of other array libraries
        raw, masked = np.array(None), None
    if raw.ndim == 2 and 1 in raw.shape:
        raw = raw.reshape(-1)
    if raw.dtype.kind in "mM":
        issues.append(Issue(location, "these are dates or durations; give seconds, as numbers"))
    elif raw.dtype.kind not in "iufbO" or (raw.dtype.kind == "O" and raw.ndim == 0):
        kind = type(values).__name__ if raw.ndim == 0 else raw.dtype
        issues.append(Issue(location, f"give an array of numbers, not {kind}"))
    elif raw.ndim != 1:
        issues.append(
            Issue(location, f"give one row of numbers, not an array of shape {raw.shape}")
        )
    else:
        try:
            numbers = raw.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            issues.append(Issue(location, "some of these values are not numbers"))
        else:
            return numbers if masked is None else np.where(masked.reshape(-1), np.nan, numbers)
    return np.zeros(0)


def rig(value: Any) -> Model:
    """Return a given model, or build a model with defaults from its name; raises `InputError`."""
    kinds = tuple(MODELS.usable().values())
    if isinstance(value, kinds):
        return value
    if isinstance(value, str):
        return known(MODELS, value, "rig", "model")()
    wanted = f"a name ({', '.join(MODELS)}) or a model, such as MotorShaft()"
    raise InputError.at("rig", f"give {wanted}")


def known[T](registry: Mapping[str, T], name: Any, location: str, what: str) -> T:
    """Look up a name; raises `InputError` at `location` with the most similar known name."""
    try:
        return lookup(registry, str(name), what)
    except ValueError as error:
        raise InputError.at(location, str(error)) from None


def integer(location: str, value: int, minimum: int) -> int:
    """Return a whole number; raises `InputError` below `minimum` and from 2**64 on."""
    if not minimum <= value < 2**64:
        message = f"{short_repr(value)} is not a whole number from {minimum} to 2**64 - 1"
        raise InputError.at(location, message)
    return int(value)


def mode(*, resume: bool, force: bool) -> WriteMode:
    """Return how existing results are treated; raises `InputError` if both flags are set."""
    if resume and force:
        raise InputError.at("", "--resume and --force exclude each other; give one of them")
    return "resume" if resume else "force" if force else "fresh"


def results_folder(folder: str | Path | None, default: Path) -> Path:
    """Return `folder` with its `~` expanded, or the `default` for None."""
    return default if folder is None else Path(folder).expanduser()


def workers(processes: int | None) -> int:
    """Return the number of processes, by default one per processor; raises `InputError`."""
    if processes is None:
        return available_processors()
    count = integer("processes", processes, 1)
    if count > MOST_PROCESSES:
        raise InputError.at("processes", f"{count} are more than {MOST_PROCESSES}; give fewer")
    return count


def crew(processes: Any, scheduler: str | None) -> AbstractContextManager[RefitExecutor]:
    """Return an executor with local processes, or on the Dask cluster with this scheduler."""
    from bayesdrill.tasks import remote

    if scheduler is not None:
        return remote.dask_executor(scheduler)
    return remote.local_executor(workers(processes))


def is_series(value: Any) -> bool:
    """Return whether a value is a sequence or an array, not a single number or a string."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return hasattr(value, "__len__") and not isinstance(value, str)


def number(location: str, value: Any, issues: list[Issue], *, positive: bool = False) -> float:
    """Return a finite number as a float; any other value is added to `issues` as a mistake."""
    try:
        read = float(value) if not isinstance(value, str | bool | np.bool) else float("nan")
    except (TypeError, ValueError, OverflowError):
        read = float("nan")
    if not np.isfinite(read) or (positive and not read > 0):
        wanted = "a positive number" if positive else "a number"
        issues.append(Issue(location, f"{short_repr(value)} is not {wanted}"))
    return read


def number_or_series(location: str, value: Any, issues: list[Issue]) -> Array:
    """Return a number as an array `()`, or a series `(T,)`; mistakes are added to `issues`."""
    if is_series(value):
        return series(location, value, issues)
    return np.array(number(location, value, issues))


def check_names(
    names: Collection[str], given: Collection[str], location: str, owner: str, issues: list[Issue]
) -> None:
    """Add an issue for each name in `given` that is not in `names`, and for each missing name."""
    for name in given:
        if name not in names:
            hint = did_you_mean(name, names)
            issues.append(Issue(f"{location}.{name}", f"{owner} has no such name{hint}"))
    issues += [Issue(f"{location}.{name}", "is missing") for name in names if name not in given]


def times(t: Any, issues: list[Issue]) -> Array:
    """Check and return increasing times `(T,)` in s; mistakes are added to `issues`."""
    values = series("t", t, issues)
    if not issues and len(values) < 2:
        issues.append(Issue("t", f"{len(values)} times; give at least two"))
    if not issues:
        issues += check_time("t", values, lambda index: f"sample {index + 1}")
    return values


@check_arguments
class ManyFits[T]:
    """A job with many fits can run in several processes or on a cluster.

    By default, the name of the results folder ends with `kind`.
    """

    job: Job

    kind: ClassVar[str]

    def place(self, folder: str | Path | None = None) -> Path:
        """Return the folder for the results of `run`, by default `results/<name>-<kind>`."""
        default = Path("results") / f"{self.job.config.name}-{self.kind}"
        return results_folder(folder, default)

    def run(
        self,
        folder: str | Path | None = None,
        *,
        resume: bool = False,
        force: bool = False,
        processes: int | None = 1,
        scheduler: str | None = None,
        report: Reporter | None = None,
    ) -> T:
        """Run all fits; save the result of each fit as soon as the fit is done.

        Parameters
        ----------
        folder : str or path, optional
            The folder for the results; by default see `place`.
        resume, force : bool
            `resume` continues an interrupted job in `folder`; `force` replaces its results.
        processes, report
            See `Case.sample`.
        scheduler : str, optional
            The address of a Dask scheduler; the fits then run on its cluster, not in `processes`.

        Returns
        -------
        CalibrationOutcome, LadderOutcome or CampaignOutcome
            The folder and the results; `said` is the text that describes them.

        Raises
        ------
        InputError
            If an argument is wrong or the folder cannot be used.
        Interrupted
            If a signal, such as Ctrl-C, stops the job.
        """
        how, path = mode(resume=resume, force=force), self.place(folder)
        with crew(processes, scheduler) as executor:
            return self._run(path, how, executor, report or SILENT)

    @abstractmethod
    def _run(self, path: Path, how: WriteMode, executor: RefitExecutor, report: Reporter) -> T:
        """Run all fits with checked arguments."""


@check_arguments
class ExperimentPlanner:
    """A planner designs experiments, whose channels and noise are those of its `job`."""

    job: Job

    def _known_draws(self) -> Array | None:
        """Return draws `(N, D)` of the posterior, or None if only the priors are known."""
        return None

    @staticmethod
    def check_design_place(folder: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` if a design cannot be saved in `folder`; call it before `design`."""
        refuse_other_text(Path(folder).expanduser(), DESIGN, force=force)

    def design(
        self,
        learn: Sequence[str] | str = (),
        *,
        tell: ExperimentPlanner | None = None,
        input: str | None = None,
        low: float | None = None,
        high: float | None = None,
        hold: float | None = None,
        duration: float | None = None,
        rate: float | None = None,
        slew: float | None = None,
        limits: Sequence[str] | str = (),
        family: str | None = None,
        experiments: int = 1,
        draws: int = 8,
        report: Reporter | None = None,
    ) -> Designed:
        """Design the next experiment: the most informative waveform of an input.

        The design starts from the priors of a case, or the posterior of a run.  The sensitivities
        of a linear rig are linear in its input, so the search has an exact gradient.  A rig with
        friction is simulated anew for each waveform that the search tries.

        Parameters
        ----------
        learn : str or sequence of str
            Parameters, derived quantities, or formulas such as `"k_s/j_1"`, to be determined well;
            by default all products of parameters that can be determined.
        tell : Case, optional
            A rival model of the same channels; the experiment shall tell which model is true.
        input : str, optional
            The input whose waveform is designed; by default the input that drives the rig.
        low, high : float, optional
            The range of the input in SI; by default that of the record, widened to include zero.
        hold : float, optional
            The time in s for which each level is held; by default duration / 40.
        duration, rate : float, optional
            Length in s and sampling rate in Hz of the new record; by default those of the old one.
        slew : float, optional
            The largest change of the input in SI per second; by default unlimited.
        limits : str or sequence of str
            Bounds `formula=low:high` in SI on states, inputs and parameters, kept in 99 % of draws.
            Examples are `"w_2=0:"`, which keeps a motor from turning backwards, `"theta_1 -
            theta_2=-1:1"`, and `"integral(r_m*i**2)=:50"` for the heat over the run.
        family : str, optional
            `free` levels (the default), `step`, `prbs`, `chirp`, `multisine`, `steps` or `coast`.
        experiments : int
            The number of new experiments; each design includes the information of the earlier ones.
        draws : int
            The number of draws over which the design is averaged; with 1, a case uses start values.
        report : Reporter, optional
            Receives the progress, see `Case.sample`.

        Returns
        -------
        Designed
            The levels, and the standard deviations expected from them; `print` shows both.

        Raises
        ------
        InputError
            If arguments contradict each other, or no waveform helps; the message names a remedy.

        Examples
        --------
        >>> case.design("k_s", high=12.0, hold=0.5, draws=1).levels.shape
        (12,)
        """
        from bayesdrill.tasks import design  # late: it loads the libraries of figures

        options = {
            "input": input, "low": low, "high": high, "hold": hold, "duration": duration,
            "rate": rate, "slew": slew, "family": family,
            "experiments": integer("experiments", experiments, 1),
        }  # fmt: skip
        names, bounds = ((x,) if isinstance(x, str) else tuple(x) for x in (learn, limits))
        count = integer("draws", draws, 1)
        return design.design(
            self.job, self._known_draws(), names, options, bounds, count, report or SILENT,
            rival=None if tell is None else tell.job,
        )  # fmt: skip
