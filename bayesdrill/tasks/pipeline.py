"""Run the main job: a config goes in, and a results folder comes out."""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.config.job import Job, prepare
from bayesdrill.output_files import POSTERIOR, RESOLVED_FILE
from bayesdrill.report import publish, words
from bayesdrill.report.run_report import details, screen
from bayesdrill.report.sections.causes import describe_causes
from bayesdrill.report.sections.identifiability import next_experiment
from bayesdrill.report.view import ReportContext
from bayesdrill.results import provenance, run_folder
from bayesdrill.results.provenance import begin, check_record, interruptions
from bayesdrill.results.run_folder import Folder
from bayesdrill.rig.compression.basis import CompressionError
from bayesdrill.sampling import ensembles
from bayesdrill.sampling.ensembles import Backend, MemoryBackend, SamplingResult
from bayesdrill.sampling.fit import begin_searches, sample_maxima, weigh
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.proposal.learning import NoSupportError
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import find_map, run_entries
from bayesdrill.tasks.conclusions import (
    SampledRun,
    analysis_mark,
    causes,
    concluded,
    plan,
    residuals,
)
from bayesdrill.tasks.identify import preflight

# Slow modules that sampling and report load when they need them.
LOADED_LATE = (
    "scipy.stats",
    "arviz_stats.base",
    "bayesdrill.results.arviz_tree",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A finished run has a `summary` for a screen, and `details` with everything except figures.

    `reasons` say why the result must not be believed, such as a bad fit.  `missing` names the
    tables and figures that could not be made.
    """

    folder: Path
    mode: Mode
    sampled: SamplingResult
    rows: tuple[ParameterRow, ...]
    verdict: Verdict | None
    summary: str
    details: str
    reasons: tuple[str, ...]
    missing: tuple[str, ...]
    seconds: Mapping[str, float]


def run_posterior(
    job: Job,
    output: Path,
    how: run_folder.WriteMode,
    processes: int,
    report: Reporter,
    details: Reporter = SILENT,
) -> Outcome:
    """Search the MAP, sample the posterior and write the report into `output`.

    `details` receives all messages that are too long for `report`.  Raises `Interrupted` when asked
    to stop, and `BrokenProcessPool` when a worker was killed; finished results are saved.
    """
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, how, marks, POSTERIOR) as folder:
        mode: Mode | None = None
        if how == "resume":  # read before writing, so that a refused run stays unchanged
            _read_ahead(job, folder)
            mode = find_map.read_mode(folder, job.problem)
        report.say(words.headline(job.problem, job.config))
        if any((folder.path / output_files.PIECES).glob("*.npz")):
            report.say("unfinished segments of an older version are not read")
        details.say(words.opening(job.problem))
        details.say(words.size(job.problem, job.config))
        begin(job, folder)
        with interruptions(folder, lambda: _saved_so_far(folder)):
            return _run(job, folder, mode, processes, report, details)


def _saved_so_far(folder: Folder) -> str:
    """Describe the saved results of a stopped run."""
    if folder.sampled:
        return f"all samples so far are saved in {folder.path}"
    if (folder.path / find_map.MAP_FILE).exists():
        return f"the maximum is saved in {folder.path}, but nothing was sampled yet"
    return f"no maximum was found yet; {folder.path} only has the config"


def _read_ahead(job: Job, folder: Folder) -> None:
    sampler, names = job.config.sampler, job.problem.names
    folder.read_ahead(sampler.ensembles, (sampler.walkers, len(names)))


def _run(
    job: Job, folder: Folder, mode: Mode | None, processes: int, report: Reporter, details: Reporter
) -> Outcome:
    clock = [time.perf_counter()]
    # A thread loads modules for sampling and report, while workers compute.
    with ThreadPoolExecutor(1) as thread, WorkerPool(job.problem.posterior, processes) as pool:
        if not pool.in_process:
            thread.submit(list, map(importlib.import_module, LOADED_LATE))
        searches = None if mode else begin_searches(pool, find_map.fit_plan(job), report)
        # While workers search the MAP, this process computes what the record can determine.
        study = SensitivityStudy(job.problem.posterior.likelihood)
        report.update(0.0, "computing what the record can determine")
        details.say(preflight(job, study))
        if searches is not None:
            mode = find_map.end_search(pool, searches, report)
            find_map.write_mode(folder, mode)
        assert mode is not None
        job = job.with_steps_at(mode)
        fit = residuals(job, mode)
        if misfit := find_map.misfit(fit, job.problem.clock):
            report.say(misfit)
        # Causes are reported before sampling, so that the user can stop a useless run.
        explained = causes(job, mode, fit, pool.submit_function, report)
        if explained is not None:
            report.say(describe_causes(explained))
        pool.set_steps(mode.pieces)
        if mode.pieces:
            study = SensitivityStudy(job.problem.posterior.likelihood)
        clock.append(time.perf_counter())
        sampled = _sample(job, pool, mode, folder, report)
        # Workers draw figures while this process computes the evidence.
        run = SampledRun(job, mode, sampled)
        view = concluded(run, study, explain=lambda _: explained, map_each=pool.map_each)
        figures = publish.begin_figures(view, folder, pool, report)
        sampled = weigh(pool, sampled, find_map.fit_plan(job), report)
        clock.append(time.perf_counter())
        _finish_chain(job, folder, sampled)
        searching, sampling = (round(end - start, 3) for start, end in pairwise(clock))
        seconds = {"map": searching, "sampling": sampling}
        view = replace(view, chain=replace(view.chain, sampled=sampled), seconds=seconds)
        return _publish(job, folder, view, figures, report, clock[-1])


def republish(
    output: Path, processes: int, report: Reporter = SILENT, *, pdf: bool = False
) -> Outcome:
    """Make tables and figures again from the chain in `output`; `pdf` adds PDFs of all figures."""
    job, marks = _read_job(output)
    with Folder(output, "report", marks, POSTERIOR) as folder:
        finished = _read_sampled(job, folder)
        run = run_folder.read_run(output) or {}
        folder.begin()
        with WorkerPool(finished.job.problem.posterior, processes) as pool:
            seconds = dict(run.get("seconds", {}))
            seconds.pop("report", None)  # the duration of the earlier report
            view = concluded(finished, seconds=seconds, map_each=pool.map_each)
            figures = publish.begin_figures(view, folder, pool, report, pdf=pdf)
            return _publish(finished.job, folder, view, figures, report)


def copy_result(source: Path, output: Path, *, force: bool) -> None:
    """Copy a read-only run without its report; raises `InputError` if `source` has no run."""
    if output.resolve() == source.resolve():
        raise InputError.at(str(output), "is the folder of this run; omit --output")
    how: run_folder.WriteMode = "force" if force else "fresh"
    Folder(output, how, {}, POSTERIOR).check()  # checked before the chain is read
    job = read_result(source).job
    check_record(job, output)
    run = run_folder.read_run(source) or {}
    with Folder(output, how, run["fingerprint"], POSTERIOR) as folder:
        folder.begin(**run | {"status": "running"})
        folder.write_text(RESOLVED_FILE, provenance.resolved(job.case, output))
        for name in output_files.output_names(source, output_files.REPORT_SOURCES):
            if name != output_files.RUN:
                folder.take_over(name, source)


def read_result(output: Path) -> SampledRun:
    """Read the run in `output` without writing anything."""
    job, marks = _read_job(output)
    with Folder(output, "read", marks, POSTERIOR) as folder:
        return _read_sampled(job, folder)


def _read_job(output: Path) -> tuple[Job, dict[str, str]]:
    """Return the job of a run, and its fingerprint."""
    run = run_folder.read_run(output)
    if run is None:
        raise InputError.at(str(output), "no results here; give the folder of a finished run")
    if run.get("job") != POSTERIOR.job:
        whose = f"results of `bayesdrill {run.get('job')}`"
        way_out = "a command that makes its own tables and figures; give the folder of a posterior"
        raise InputError.at(str(output), f"{whose}, {way_out}")
    if not (output / RESOLVED_FILE).exists():
        raise InputError.at(str(output), "the run stopped as it began; continue it with --resume")
    job = prepare(output / RESOLVED_FILE)
    return job, provenance.fingerprint(job.config, job.problem)


def _read_sampled(job: Job, folder: Folder) -> SampledRun:
    path = folder.path
    mode = find_map.read_mode(folder, job.problem)
    if mode is None:
        message = "is missing; continue with --resume, which searches the MAP again"
        raise InputError.at(str(path / find_map.MAP_FILE), message)
    job = job.with_steps_at(mode)
    posterior = job.problem.posterior
    _read_ahead(job, folder)
    again = ensembles.load_sampled(posterior, plan(job.config), folder.segments, str(path))
    record = run_entries.read_record(run_folder.read_run(path) or {}, path)
    if record is not None:
        again = replace(
            again.with_missed(record.missed),
            mode_shares=np.array(shares) if (shares := [x.weight for x in record.maxima]) else None,
            evidence=record.evidence,
            compression=record.compression,
        )
    sampled = again.with_reasons(mode.doubts)
    analysis = None
    if record is not None and record.analysis_of == analysis_mark(job, mode, sampled):
        analysis = record.analysis
    return SampledRun(job, mode, sampled, stored=analysis)


def write_result(
    job: Job, view: ReportContext, output: Path, record: str | None, *, force: bool
) -> Outcome:
    """Write a run from memory like `run_posterior`; `record` is the text of a record in memory."""
    check_record(job, output, record)
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, "force" if force else "fresh", marks, POSTERIOR) as folder:
        begin(job, folder, record)
        find_map.write_mode(folder, view.mode)
        for ensemble, pieces in enumerate(view.sampled.segments):
            first = 0
            for piece in pieces:
                folder.save(ensemble, first, piece)
                first += len(piece.z)
        _finish_chain(job, folder, view.sampled)
        with WorkerPool(job.problem.posterior, 1) as pool:
            figures = publish.begin_figures(view, folder, pool, SILENT)
            return _publish(job, folder, view, figures, SILENT)


def sample_in_memory(job: Job, mode: Mode, processes: int, report: Reporter) -> SamplingResult:
    """Sample from the maximum `mode`; the job must have the step sizes chosen at this maximum."""
    with WorkerPool(job.problem.posterior, processes) as pool:
        sampled = _sample(job, pool, mode, MemoryBackend(), report)
        return weigh(pool, sampled, find_map.fit_plan(job), report)


def _sample(
    job: Job, pool: WorkerPool, mode: Mode, backend: Backend, report: Reporter
) -> SamplingResult:
    try:
        return sample_maxima(pool, mode, find_map.fit_plan(job), backend, report)
    except NoSupportError as error:
        message = f"{error}; record and priors contradict each other; check units and values"
        raise job.source.error(("parameters",), message) from None
    except CompressionError as error:
        message = f"cannot be compressed: {error}; write `auto`, or omit this entry"
        raise job.source.error(("sampler", "likelihood"), message) from None


def _finish_chain(job: Job, folder: Folder, sampled: SamplingResult) -> None:
    names = ",".join(job.problem.names)
    logs = job.problem.posterior.coordinates.logs
    coordinates = ",".join("log" if log else "linear" for log in logs)
    units = ",".join(symbol.unit for symbol in job.problem.symbols)
    attributes = {"coordinates": coordinates, "unknowns": names, "units": units}
    folder.finish_chain(sampled.segments, attributes)


def _publish(
    job: Job,
    folder: Folder,
    view: ReportContext,
    figures: publish.PendingFigures,
    report: Reporter,
    start_time: float | None = None,
) -> Outcome:
    """Write tables, figures and `run.json`; `start_time` [s] is when the report began, if timed."""
    missing = publish.write_results(view, folder, figures, report)
    report.update(1.0, "")
    seconds, judged = dict(view.seconds), view.analysis.judged
    if start_time is not None:
        seconds["report"] = round(time.perf_counter() - start_time, 3)
        folder.write_run(seconds=seconds)
    folder.write_run(
        status="finished",
        missing=missing,
        files=folder.digests(),
        **run_entries.entries(view, analysis_mark(job, view.mode, view.sampled)),
    )
    advice = ""
    if judged is not None and not view.reasons:
        undetermined = [quantity.exponents for quantity in judged.verdict.undetermined]
        advice = next_experiment(judged.verdict.names, undetermined, str(folder.path))
    return Outcome(
        folder=folder.path,
        mode=view.mode,
        sampled=view.sampled,
        rows=view.analysis.unknowns,
        verdict=None if judged is None else judged.verdict,
        summary="\n".join(filter(None, [screen(view), advice])),
        details="\n\n".join(filter(None, [details(view), advice])),
        reasons=view.reasons,
        missing=missing,
        seconds=seconds,
    )
