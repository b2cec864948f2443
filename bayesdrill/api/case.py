"""Define the class `Case`: a record, a rig and priors, to be checked, fitted and sampled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.api import arguments
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.equality import Value, equal_content
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import sources
from bayesdrill.output_files import FORMATS, IDENTIFY, refuse_other_text, refuse_replacing
from bayesdrill.record.experiment import raise_if_any
from bayesdrill.report import words
from bayesdrill.tasks import identify

if TYPE_CHECKING:
    from bayesdrill.api.run import Best, Candidates, Run
    from bayesdrill.sampling.mode_search import Mode as Maximum
    from bayesdrill.tasks.pipeline import Outcome


VALUES = "a number in SI, or several, for each unknown"

POINTS_AT_ONCE = 50  # points evaluated at once; some noises need memory for points x samples


def _figure_file(job: Job, option: str, path: str | Path) -> Path:
    file = Path(path).expanduser()
    if file.suffix[1:] not in FORMATS:
        raise InputError.at(option, f"'{file.name}' is not one of .{', .'.join(FORMATS)}")
    refuse_replacing(sources.files(job.case), [file])
    return file


@arguments.check_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Case(arguments.ExperimentPlanner, Value):
    """A case is an identification problem: a record, a model of the rig, and priors.

    The record has T samples of measured channels, such as speeds, and of inputs, such as a voltage.
    The rig is a drive train with unknown parameters, such as inertias and stiffnesses.  Each unknown
    has a prior, its probability density before the record is seen.  Prior, record and noise define
    the posterior, the probability density of the unknowns after the record is seen.

    Make a case from a config with `bd.load`, or from arrays with `bd.case`.  `print(case)` shows its
    model and unknowns.  All values are in SI.  The usual order of work is:

    1. `case.identify()` predicts how well the record determines each unknown, before any fit.
    2. `case.find_map()` finds the maximum of the posterior, a `bd.Best`.  Its `plot()` shows the
       residuals, which should look like the noise.
    3. `case.sample()` draws from the posterior.  The result is a `bd.Run` with means, intervals,
       correlations and figures.  Check that it has `converged`.
    4. `run.judge()` compares the posterior with nominal values, such as those of a data sheet.

    `case.run(folder)` takes all four steps for a case from a config, and saves the results.

    Parameters
    ----------
    job : Job
        The checked config with its record.
    columns : mapping of str to array, shape (T,), optional
        The record as arrays, if it is not in a file.

    See Also
    --------
    bayesdrill.load, bayesdrill.case : Make a case.
    bayesdrill.respond : Simulate a rig without a record.

    Examples
    --------
    The only unknown here is the shaft's stiffness, and the record is a simulated voltage step:

    >>> t = np.linspace(0.0, 4.0, 81)
    >>> w_1 = bd.respond("motor_shaft", bd.nominal(), t, {"v": 8.0}, "w_1")["w_1"]
    >>> stiffness = {"prior": "uniform", "low": 0.1, "high": 1.0}  # N m/rad
    >>> case = bd.case(
    ...     t,
    ...     channels={"w_1": bd.Channel(w_1, "rad/s", sigma=0.1)},
    ...     inputs={"v": 8.0, "t_1": 0.0},
    ...     parameters=dict.fromkeys(bd.nominal(), "nominal") | {"k_s": stiffness},
    ... )
    >>> case.unknowns
    ('k_s',)
    >>> bool(abs(case.find_map(quick=True).values["k_s"] / bd.nominal()["k_s"] - 1) < 0.01)
    True
    """

    job: Job
    columns: Mapping[str, Array] | None = None

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Return the names of all unknowns, in the order of the columns of draws."""
        return self.job.problem.names

    def __str__(self) -> str:
        return words.opening(self.job.problem)

    def preview(self) -> str:
        """Return the text that the command `bayesdrill check` prints.

        Returns
        -------
        str
            Lines on columns, priors, doubts and size of results, and whether sampling can start.

        Examples
        --------
        >>> "k_s" in case.preview()
        True
        """
        problem, config = self.job.problem, self.job.config
        first = identify.preflight(self.job, SensitivityStudy(problem.posterior.likelihood))
        columns = [] if self.columns is not None else [words.record_columns(problem, self.job.case)]
        doubts = words.doubts_before_sampling(problem)
        known = [str(self), *columns, words.preview(problem, config), *doubts, first]
        return "\n".join([*known, words.validity(doubts, self.job.source.text)])

    def log_density(self, values: Annotated[Mapping[str, ArrayLike], VALUES]) -> Array:
        """Compute the unnormalised log posterior: log likelihood + log prior.

        Parameters
        ----------
        values : mapping of str to array_like, shape () or (N,)
            For each unknown, a number or N numbers, in SI.

        Returns
        -------
        array, shape (N,)
            The sum of the two normalised log densities; -inf outside the ranges of the priors.

        Raises
        ------
        InputError
            With all mistakes in `values`.

        Examples
        --------
        >>> case.log_density({"k_s": [0.3, -1.0], "t_f": 0.09}) > -np.inf
        array([ True, False])
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
            issues.append(Issue("values", f"give {VALUES}, with one length for all series"))
        raise_if_any(issues)
        theta = np.empty((max(lengths, default=1), len(names)))
        for position, name in enumerate(names):
            theta[:, position] = columns[name]
        parts = np.array_split(theta, max(1, -(-len(theta) // POINTS_AT_ONCE)))
        return np.concatenate([self.job.problem.posterior.density(part) for part in parts])

    def draw_rig(self, path: str | Path) -> str:
        """Draw the inertias, shafts, gears and drives of the rig.

        Parameters
        ----------
        path : str or path
            The file to write; its name ends with .pdf, .png or .svg.

        Returns
        -------
        str
            A line that names the file.

        Raises
        ------
        InputError
            If the name has another ending, or the file is part of the record.

        Examples
        --------
        >>> case.draw_rig("rig.svg")
        'figure: rig.svg'
        """
        from bayesdrill.report.rig_drawing import save_rig  # late: it loads matplotlib

        problem, to = self.job.problem, _figure_file(self.job, "--figure", path)
        return f"figure: {save_rig(problem.model, to)}"

    def draw_record(self, path: str | Path) -> str:
        """Draw channels and inputs against time; each experiment has its own figure.

        Parameters
        ----------
        path : str or path
            The file to write, a .pdf, .png or .svg.  Names of several experiments are added to it.

        Returns
        -------
        str
            A line that names the files.

        Raises
        ------
        InputError
            If the name has another ending, or the file is part of the record.
        """
        from bayesdrill.report.sections.fit import save_record  # late: it loads matplotlib

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
        """Predict how well the record determines each unknown, before any sampling.

        The Fisher information, from the sensitivities of the channels, gives a lower bound of the
        standard deviation of each unknown (Cramer and Rao).

        Parameters
        ----------
        profiles : str or sequence of str
            The unknowns whose profile likelihoods are computed, or `"all"`.
        at : Best, optional
            The maximum at which the sensitivities are evaluated.  By default, they are evaluated at
            the start values or, if the rig does not move with them, at a draw from the priors.
        report : Reporter, optional
            Receives the progress, see `sample`.

        Returns
        -------
        Findings
            The predicted standard deviations, correlations and warnings; `print` shows them.

        Raises
        ------
        InputError
            If no parameter is unknown, or a name in `profiles` is not an unknown.

        Examples
        --------
        >>> "k_s" in str(case.identify())
        True
        """
        mode = None if at is None else self._mode(at)
        job = self.job if mode is None else self.job.with_steps_at(mode)
        names = [profiles] if isinstance(profiles, str) else profiles
        return identify.identify(job, mode, names, report or SILENT)

    @staticmethod
    def check_place(folder: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` if findings cannot be saved in `folder`; call it before `identify`."""
        refuse_other_text(Path(folder).expanduser(), IDENTIFY, force=force)

    def find_map(
        self, *, quick: bool = False, processes: int | None = 1, report: Reporter | None = None
    ) -> Best:
        """Find the maximum of the posterior (MAP).

        Simplex searches (Nelder and Mead 1965) start at several points, and Gauss-Newton steps
        refine their results.

        Parameters
        ----------
        quick : bool
            Whether to search only from the start values, which may miss the highest maximum.
        processes, report
            See `sample`.

        Returns
        -------
        Best
            The maximum; its `reasons` say why not to believe it, and are empty for a good fit.

        Raises
        ------
        InputError
            If no parameter is unknown, or an argument is wrong.

        Examples
        --------
        >>> sorted(case.find_map(quick=True).values)
        ['k_s', 't_f']
        """
        from bayesdrill.api.run import Best  # late: it loads the libraries of sampling
        from bayesdrill.tasks import find_map

        workers = arguments.workers(processes)
        mode = find_map.find_mode(self.job, workers, report or SILENT, quick=quick)
        return Best(self.job, mode, self.columns)

    def check_new_config(self, path: str | Path, *, force: bool = False) -> None:
        """Raise `InputError` if `Candidates.apply` cannot write `path`; call it before searches."""
        from bayesdrill.tasks import find_map

        find_map.check_new_config(self.job, Path(path).expanduser(), force=force)

    def candidates(
        self, *, processes: int | None = 1, report: Reporter | None = None
    ) -> Candidates:
        """Find the maximum of the posterior, and rank models that would explain its residuals.

        Parameters
        ----------
        processes, report
            See `sample`.

        Returns
        -------
        Candidates
            The ranked models, see `Best.candidates`.
        """
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
        """Identify, fit, sample and judge a case that was loaded from a config, and save the results.

        The command `bayesdrill posterior` does the same.  The chain is saved while it grows, so an
        interrupted run can be resumed.

        Parameters
        ----------
        folder : str or path, optional
            The folder for the results, by default `results/<name>`.
        resume, force : bool
            `resume` continues the run in `folder`; `force` replaces it.
        processes, report
            See `sample`.
        verbose : bool
            Whether `report` also receives the details of each stage.

        Returns
        -------
        Outcome
            The folder, the reasons not to believe the run, and the results that could not be made.

        Raises
        ------
        InputError
            If the folder cannot be used, or the case was made from arrays.
        Interrupted
            If a signal, such as Ctrl-C, stops the run.
        """
        from bayesdrill.tasks import pipeline

        if self.columns is not None:
            way_out = "call `sample().save(folder)`, then `load` its config"
            raise InputError.at("run", f"no file contains these arrays yet; {way_out}")
        how = arguments.mode(resume=resume, force=force)
        path, workers = self.place(folder), arguments.workers(processes)
        progress = report or SILENT
        details = progress if verbose else SILENT
        return pipeline.run_posterior(self.job, path, how, workers, progress, details)

    def place(self, folder: str | Path | None = None) -> Path:
        """Return the folder for the results of `run`, by default `results/<name>`.

        Examples
        --------
        >>> case.place().as_posix()
        'results/case'
        """
        return arguments.results_folder(folder, Path("results") / self.job.config.name)

    def sample(
        self,
        best: Best | None = None,
        *,
        seed: int | None = None,
        processes: int | None = 1,
        report: Reporter | None = None,
    ) -> Run:
        """Sample the posterior by ensembles of walkers until they converge.

        Affine invariant ensembles (Goodman and Weare 2010; emcee) also use an independence proposal,
        which is fitted before the first step.  They stop once R-hat, effective sample size and the
        number of autocorrelation times meet their targets, or after `sampler.max_steps`.

        Parameters
        ----------
        best : Best, optional
            The maximum of this case, where the ensembles start; by default `find_map` is called.
        seed : int, optional
            A seed to replace the config's.  The draws do not depend on the number of processes.
        processes : int or None
            The number of processes; None means one for each processor.  With several
            processes, a script needs `if __name__ == "__main__":`.
        report : Reporter, optional
            An object with `say(text)` and `update(fraction, text)`, which receive the progress.

        Returns
        -------
        Run
            The draws; `converged` of the run tells whether the targets were met.

        Raises
        ------
        InputError
            If `best` is the maximum of another case, or an argument is wrong.

        Examples
        --------
        >>> run = case.sample(seed=4)
        >>> run.converged
        True
        """
        from bayesdrill.api.run import Run
        from bayesdrill.tasks import find_map, pipeline

        job, workers = self.job, arguments.workers(processes)
        if seed is not None:
            job = job.with_settings(seed=arguments.integer("seed", seed, 0))
        progress = report or SILENT
        mode = find_map.find_mode(job, workers, progress) if best is None else self._mode(best)
        job = job.with_steps_at(mode)
        sampled = pipeline.sample_in_memory(job, mode, workers, progress)
        return Run(job, mode, sampled, self.columns)

    def _mode(self, best: Best) -> Maximum:
        from bayesdrill.api.run import Best

        if not isinstance(best, Best):
            raise InputError.at("best", f"give a result of find_map, not {type(best).__name__}")
        if not equal_content(best.job.problem.posterior, self.job.problem.posterior):
            message = "this is the maximum of another case; find the maximum of this one"
            raise InputError.at("best", message)
        return best.mode


@arguments.check_arguments
def load(path: str | Path) -> Case:
    """Load the case of a YAML config, with its record.

    Parameters
    ----------
    path : str or path
        The config; `docs/config.md` explains its entries.

    Returns
    -------
    Case
        The case; `print` shows its model and unknowns.

    Raises
    ------
    InputError
        With all mistakes in the config and its record.

    Examples
    --------
    >>> case = bd.load("configs/nominal_step.yaml")
    >>> case.unknowns[:2]
    ('j_m', 'c_m')
    """
    return Case(prepare(Path(path).expanduser()))
