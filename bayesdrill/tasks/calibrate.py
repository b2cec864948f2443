"""Calibrate a config: distribute refits, save each finished refit, and judge all of them."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis import calibration
from bayesdrill.analysis.calibration import CalibrationStudy, CalibrationVerdict, Refit
from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.json_records import as_data
from bayesdrill.basics.progress import Reporter
from bayesdrill.config import loading
from bayesdrill.config.assembly.problem import build_problem
from bayesdrill.config.job import Job
from bayesdrill.config.records import reading, simulation, sources
from bayesdrill.output_files import FIGURES, REFITS
from bayesdrill.record.experiment import Experiment
from bayesdrill.report import run_report
from bayesdrill.report.render import as_html
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import as_markdown, markdown
from bayesdrill.report.sections.calibration import (
    calibration_figure,
    calibration_opening,
    calibration_sections,
    describe_calibration,
    describe_refits,
    ranks_csv,
    ranks_table,
)
from bayesdrill.results import provenance, run_folder
from bayesdrill.results.provenance import begin, interruptions
from bayesdrill.results.run_folder import COMPUTED_AGAIN, Folder, dump_record, load_record
from bayesdrill.sampling.convergence import Targets
from bayesdrill.tasks.find_map import fit_plan
from bayesdrill.tasks.remote import RefitExecutor, packed, run_jobs

RANKS = "ranks.csv"
REFIT_FORM = 2  # version of the files of refits; version 1 stored reasons as sentences


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRecord:
    """The `run.json` of a finished calibration has these fields.

    `verdict` is a sentence, and `not_converged` lists refits by index.
    """

    form: int = 1
    units: Mapping[str, str]
    calibrated: bool
    verdict: str
    not_converged: tuple[int, ...]
    seconds_of_a_refit: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationOutcome:
    """The outcome of a calibration has its verdict, its refits and its folder."""

    folder: Path
    verdict: CalibrationVerdict
    refits: tuple[Refit, ...]

    @property
    def summary(self) -> str:
        """Return the text for the terminal."""
        parts = (
            describe_refits(self.verdict, self.refits),
            "",
            markdown(ranks_table(self.verdict)),
        )
        return "\n".join((*parts, describe_calibration(self.verdict)))


def prepare(path: Path) -> Job:
    """Prepare a job like `job.prepare`; no record is needed if `simulation:` has the times."""
    case = loading.load(path)
    paths = [path for experiment in case.experiments for path in sources.paths(experiment)]
    measured = all(path.exists() for path in paths)
    read: Callable[..., Experiment] = reading.read if measured else simulation.simulation_grid
    problem = build_problem(case, [read(experiment) for experiment in case.experiments])
    # In the posterior, only the priors of free states depend on the record's samples.  All samples
    # are set to zero, so that a calibration can be resumed with another record.
    blank = [np.where(o.experiment.is_measured, 0.0, np.nan) for o in problem.observations]
    posterior = problem.posterior.edit(records=blank)
    return Job(case=case, problem=dataclasses.replace(problem, posterior=posterior))


def study(job: Job) -> CalibrationStudy:
    """Return the calibration study with the settings of a config."""
    settings = job.config.calibration
    targets = Targets(r_hat=job.config.sampler.r_hat, n_tau=settings.n_tau, ess=settings.ess)
    plan = fit_plan(job)
    chains = dataclasses.replace(plan.chains, targets=targets, max_steps=settings.max_steps)
    return CalibrationStudy(
        posterior=job.problem.posterior,
        plan=dataclasses.replace(plan, starts=settings.starts, chains=chains, brief=True),
        draws=settings.draws,
    )


def calibrate(
    job: Job, output: Path, how: run_folder.WriteMode, crew: RefitExecutor, report: Reporter
) -> CalibrationOutcome:
    """Run a calibration; raises `Interrupted`, or `BrokenProcessPool` if a worker is killed."""
    settings = job.config.calibration
    # The fingerprint omits the number of refits, so that a calibration can be extended.
    marks = provenance.fingerprint(job.config, job.problem) | {
        f"calibration.{name}": repr(value) for name, value in settings if name != "refits"
    }
    begun, refitting, place = time.perf_counter(), study(job), output / REFITS

    def progress() -> str:
        done = len(saved(place, refitting))
        return f"{done} of {settings.refits} refits are saved in {output}"

    with Folder(output, how, marks, output_files.CALIBRATE) as folder:
        if how == "resume":
            saved(place, refitting)  # raises an error for damaged files before anything is written
        report.say(calibration_opening(job.problem, job.config))
        begin(job, folder, refits=settings.refits)
        with interruptions(folder, progress, (InputError,)):
            refits = run_refits(refitting, settings.refits, place, crew, report)
        verdict = _publish(job, folder, refits)
        folder.write_run(seconds=round(time.perf_counter() - begun, 3))
        return CalibrationOutcome(folder=folder.path, verdict=verdict, refits=tuple(refits))


def run_refits(
    study: CalibrationStudy, n: int, folder: Path, crew: RefitExecutor, report: Reporter
) -> list[Refit]:
    """Return the refits 0 to n - 1; refits that are not in `folder` are computed and saved.

    A refit is identified by its index, so it counts once even if two workers compute it.
    """
    done = {refit.index: refit for refit in saved(folder, study) if refit.index < n}
    folder.mkdir(exist_ok=True)
    report.update(0.0, f"{len(done)} of {n} refits")

    def finish(index: int, refit: Refit) -> str:
        output_files.write_text(folder / f"{index:06d}.json", dump_record(refit, REFIT_FORM))
        done[index] = refit
        strayed = sum(not value.converged for value in done.values())
        doubt = f", {strayed} not converged" if strayed else ""
        return f"{len(done)} of {n} refits{doubt}"

    blob = packed(study)
    tasks = {index: (blob, index) for index in range(n) if index not in done}
    run_jobs(crew, calibration.refit, tasks, finish, folder.parent, report)
    return [done[index] for index in range(n)]


def saved(folder: Path, study: CalibrationStudy) -> list[Refit]:
    """Read all refits of a folder; raises `InputError` if one is damaged or from another study."""
    is_output = output_files.CALIBRATE.is_output
    paths = sorted(path for path in folder.glob("*.json") if is_output(f"{REFITS}/{path.name}"))
    return [_read(path, study) for path in paths]


def _read(path: Path, study: CalibrationStudy) -> Refit:
    stored, _ = load_record(path, Refit, REFIT_FORM)
    ranked = {len(study.names), *([0] if stored.reasons else [])}
    right = len(stored.truth) == len(study.names) and len(stored.ranks) in ranked
    right &= 0 <= stored.steps <= study.plan.chains.max_steps
    right &= all(0 <= rank <= study.draws for rank in stored.ranks)
    if not right or stored.index != int(path.stem) or not np.isfinite(stored.truth).all():
        raise InputError.at(str(path), COMPUTED_AGAIN)  # the file is from another study
    return stored


def _publish(job: Job, folder: Folder, refits: Sequence[Refit]) -> CalibrationVerdict:
    config, symbols, names = job.config, job.problem.symbols, study(job).names
    verdict = calibration.judge_calibration(names, refits, config.calibration.draws)
    folder.write_text(RANKS, ranks_csv(names, refits))
    _draw(job, folder, verdict)
    title = f"Calibration of {config.name}"
    ending = output_files.preferred_format(config.output.formats_or_default)
    said = calibration_sections(verdict, refits, ending)
    folder.write_text("summary.md", as_markdown(title, said))
    seed, versions = str(config.seed), software.versions_text()
    lines = (("config", config.name), ("seed", seed), ("versions", versions))
    every = (*said, run_report.made_of(lines, folder.path), run_report.cite())
    page = as_html(title, "calibration", every, folder.path / FIGURES, symbols)
    folder.write_text("report.html", page)
    record = CalibrationRecord(
        units={symbol.name: symbol.unit for symbol in symbols},
        calibrated=verdict.calibrated,
        verdict=describe_calibration(verdict),
        not_converged=verdict.not_converged,
        seconds_of_a_refit=round(float(np.mean([refit.seconds for refit in refits])), 3),
    )
    folder.write_run(status="finished", **as_data(record))
    return verdict


def _draw(job: Job, folder: Folder, verdict: CalibrationVerdict) -> None:
    # Imported late, as matplotlib takes a second to load.
    from bayesdrill.report import style

    figures, output = folder.path / FIGURES, job.config.output
    formats = output.formats_or_default
    figures.mkdir(exist_ok=True)
    known, wanted = (
        output_files.figure_files("calibration", formats=each)
        for each in (output_files.FORMATS, formats)
    )
    folder.remove_stale(set(known) - set(wanted))
    note = {"Title": job.config.name, "Creator": software.creator()}
    figure = calibration_figure(verdict, job.problem.symbols, WIDTHS[output.size])
    style.save(figure, figures, "calibration", note, formats=formats, dpi=output.dpi)
