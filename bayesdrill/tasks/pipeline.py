"""The main job: a config goes in, a results folder comes out. Reads like a method section."""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.analysis.diagnostics import Row
from bayesdrill.analysis.identifiability.information import Scenery
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.config.job import Job, prepare
from bayesdrill.output_files import POSTERIOR, RESOLVED_FILE
from bayesdrill.report import publish, words
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_text
from bayesdrill.report.view import View
from bayesdrill.results import provenance, run_folder
from bayesdrill.results.provenance import begin, check_record, interruptions
from bayesdrill.results.run_folder import Folder
from bayesdrill.sampling.ensembles import Memory, Sampled, Shelf, loaded, stored
from bayesdrill.sampling.fit import begin_searches, sample_maxima
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.opened_ends import not_kept
from bayesdrill.sampling.proposal.learning import Nowhere
from bayesdrill.sampling.workers import Crew
from bayesdrill.tasks import find_map
from bayesdrill.tasks.conclusions import SampledRun, analysis_mark, concluded, kept_analysis, plan
from bayesdrill.tasks.identify import preflight
from bayesdrill.tasks.run_entries import entries, evidence_of_data, maxima_weights

DRAWS_SAY = "looking at what the draws say"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """`said`: for the terminal.

    `reasons`: why the result must not be believed: it did not converge, or does not fit.
    `missing`: tables and figures that could not be made.
    """

    folder: Path
    mode: Mode
    sampled: Sampled
    rows: tuple[Row, ...]
    verdict: Verdict | None
    said: str
    reasons: tuple[str, ...]
    missing: tuple[str, ...]
    seconds: Mapping[str, float]


def posterior(
    job: Job, output: Path, how: run_folder.Mode, processes: int, report: Reporter
) -> Outcome:
    """The whole job. Raises `Interrupted` when asked to stop, and `BrokenProcessPool` when a worker
    was killed; what was found and sampled is saved.
    """
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, how, marks, POSTERIOR) as folder:
        known = None
        if how == "resume":  # read before anything is written: what cannot go on stays as it is
            _read_ahead(job, folder)
            known = find_map.read_mode(folder, job.problem)
        report.say(
            f"{words.opening(job.problem, job.units)}\n{words.size(job.problem, job.config)}"
        )
        begin(job, folder)
        with interruptions(folder, lambda: _kept(folder)):
            return _run(job, folder, known, processes, report)


def _kept(folder: Folder) -> str:
    """What a run that was stopped leaves."""
    if folder.sampled:
        return f"what was sampled is saved in {folder.path}"
    if (folder.path / find_map.MAP_FILE).exists():
        return f"the maximum is saved in {folder.path}, and nothing was sampled yet"
    return f"nothing was found yet, and {folder.path} holds the config alone"


def _read_ahead(job: Job, folder: Folder) -> None:
    sampler, names = job.config.sampler, job.problem.names
    folder.read_ahead(sampler.ensembles, (sampler.walkers, len(names)))


def _run(job: Job, folder: Folder, known: Mode | None, processes: int, report: Reporter) -> Outcome:
    clock = [time.perf_counter()]
    with Crew(job.problem.posterior, processes) as crew:
        hunt = None if known else begin_searches(crew, find_map.fit_plan(job), report)
        # While others search the MAP, this process looks at what the record can show, and loads
        # what sampling and report will need.
        scenery = Scenery(job.problem.posterior.likelihood)
        report.update(0.0, "looking at what the record can show")
        report.say(preflight(job, scenery))
        if not crew.alone:
            for _ in range(processes):  # one for each, as it is done with its searches
                crew.submit(loaded)
            for name in ("scipy.stats", "arviz_stats.base"):  # they take a while to load
                importlib.import_module(name)
        if hunt is not None:
            known = find_map.end_search(crew, hunt, job, report)
            find_map.write_mode(folder, known)
        assert known is not None
        found, job = known, job.with_steps_at(known)
        if misfit := find_map.misfit(job, found):
            report.say(misfit)
        explained, said = find_map.explain(job, found, crew.run, report)
        if said:
            report.say(said)
        crew.step(found.pieces)
        if found.pieces:
            scenery = Scenery(job.problem.posterior.likelihood)
        clock.append(time.perf_counter())
        sampled = _sample(job, crew, found, folder, report)
        clock.append(time.perf_counter())
        if not crew.alone:
            for _ in range(processes):  # while this process reads the draws
                crew.submit(publish.load_drawing)
        _finish_chain(job, folder, sampled)
        seconds = {"map": clock[1] - clock[0], "sampling": clock[2] - clock[1]}
        report.update(0.0, DRAWS_SAY)
        view = concluded(job, found, sampled, scenery, seconds, explained=explained)
        return _publish(job, folder, view, crew, report, clock[-1])


def republish(output: Path, processes: int, report: Reporter = SILENT) -> Outcome:
    """Tables and figures again, from the chain that `output` holds."""
    job, marks = _made(output)
    with Folder(output, "report", marks, POSTERIOR) as folder:
        found = _finished(job, folder)
        run = run_folder.read_run(output) or {}
        folder.begin()
        with Crew(found.job.problem.posterior, processes) as crew:
            seconds = dict(run.get("seconds", {}))
            seconds.pop("report", None)  # is being made again
            report.update(0.0, DRAWS_SAY)
            parts = (found.job, found.mode, found.sampled)
            view = concluded(*parts, seconds=seconds, kept=found.kept)
            return _publish(found.job, folder, view, crew, report)


def copied(source: Path, output: Path, *, force: bool) -> None:
    """What a report is made from, in a folder of its own: for a run that one may only read.

    Raises `InputError`, also where there is nothing to be reported.
    """
    if output.resolve() == source.resolve():
        raise InputError.one(str(output), "holds this very run; leave --output out")
    how: run_folder.Mode = "force" if force else "fresh"
    Folder(output, how, {}, POSTERIOR).check()  # before the chain is read
    job = read_result(source).job
    check_record(job, output)
    run = run_folder.read_run(source) or {}
    with Folder(output, how, run["fingerprint"], POSTERIOR) as folder:
        folder.begin(**run | {"status": "running"})
        folder.write_text(RESOLVED_FILE, provenance.resolved(job.case, output))
        for name in output_files.present(source, output_files.GROUND):
            if name != output_files.RUN:
                folder.take_over(name, source)


def read_result(output: Path) -> SampledRun:
    """The run that `output` holds; nothing is written."""
    job, marks = _made(output)
    with Folder(output, "read", marks, POSTERIOR) as folder:
        return _finished(job, folder)


def _made(output: Path) -> tuple[Job, dict[str, str]]:
    """The job of a run, and its fingerprint."""
    run = run_folder.read_run(output)
    if run is None:
        raise InputError.one(str(output), "no results here; give the folder of a finished run")
    if run.get("job") != POSTERIOR.job:
        message = (
            f"results of `bayesdrill {run.get('job')}`, which makes its tables and figures itself"
        )
        raise InputError.one(str(output), f"{message}; give the folder of a posterior")
    if not (output / RESOLVED_FILE).exists():
        raise InputError.one(str(output), "the run stopped as it began; continue it with --resume")
    job = prepare(output / RESOLVED_FILE)
    return job, provenance.fingerprint(job.config, job.problem)


def _finished(job: Job, folder: Folder) -> SampledRun:
    path = folder.path
    found = find_map.read_mode(folder, job.problem)
    if found is None:
        message = "is not there; continue with --resume, which searches the MAP again"
        raise InputError.one(str(path / find_map.MAP_FILE), message)
    job = job.with_steps_at(found)
    problem = job.problem
    _read_ahead(job, folder)
    again = stored(problem.posterior, plan(job.config), folder.pieces, str(path))
    again = again.doubted(found.doubts)
    run = run_folder.read_run(path) or {}
    beyond = folder.opened_ends(again.pieces) or not_kept(again, problem.posterior, problem.nominal)
    evidence = evidence_of_data(run)
    sampled = dataclasses.replace(again, held=maxima_weights(run), evidence=evidence, beyond=beyond)
    return SampledRun(job, found, sampled, kept=kept_analysis(job, found, sampled, run))


def write_result(job: Job, view: View, output: Path, record: str | None, *, force: bool) -> Outcome:
    """What was sampled in memory, as `posterior` leaves it; `record`: its text, where it has no file."""
    check_record(job, output, record)
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, "force" if force else "fresh", marks, POSTERIOR) as folder:
        begin(job, folder, record)
        find_map.write_mode(folder, view.mode)
        for ensemble, pieces in enumerate(view.sampled.pieces):
            first = 0
            for piece in pieces:
                folder.save(ensemble, first, piece)
                first += len(piece.z)
        _finish_chain(job, folder, view.sampled)
        with Crew(job.problem.posterior, 1) as crew:
            return _publish(job, folder, view, crew, SILENT)


def sample_in_memory(job: Job, found: Mode, processes: int, report: Reporter) -> Sampled:
    """From the maximum `found`, in whose steps the job is."""
    with Crew(job.problem.posterior, processes) as crew:
        return _sample(job, crew, found, Memory(), report)


def _sample(job: Job, crew: Crew, found: Mode, shelf: Shelf, report: Reporter) -> Sampled:
    try:
        return sample_maxima(crew, found, find_map.fit_plan(job), shelf, report)
    except Nowhere as error:
        message = f"{error}; the record and the priors do not go together, check units and values"
        raise job.source.error(("parameters",), message) from None


def _finish_chain(job: Job, folder: Folder, sampled: Sampled) -> None:
    names = ",".join(job.problem.names)
    logs = job.problem.posterior.coordinates.logs
    coordinates = ",".join("log" if log else "linear" for log in logs)
    units = ",".join(symbol.unit for symbol in job.problem.symbols)
    attributes = {"coordinates": coordinates, "unknowns": names, "units": units}
    folder.finish_chain(sampled.pieces, attributes)
    folder.keep_opened_ends(sampled.beyond, sampled.pieces)


def _publish(
    job: Job,
    folder: Folder,
    view: View,
    crew: Crew,
    report: Reporter,
    begun: float | None = None,
) -> Outcome:
    """`begun`: when the report began, of a run that is timed."""
    seconds, judged = dict(view.seconds), view.analysis.judged
    missing = publish.everything(view, folder, crew, report)
    report.update(1.0, "")
    if begun is not None:
        seconds["report"] = time.perf_counter() - begun
        folder.write_run(seconds={name: round(value, 3) for name, value in seconds.items()})
    files = {name: output_files.digest(folder.path / name) for name in folder.made()}
    folder.write_run(
        status="finished",
        missing=missing,
        files=files,
        **entries(view, analysis_mark(job, view.mode, view.sampled)),
    )
    return Outcome(
        folder=folder.path,
        mode=view.mode,
        sampled=view.sampled,
        rows=view.analysis.unknowns,
        verdict=None if judged is None else judged.verdict,
        said="\n\n".join((words.convergence(view.sampled), *as_text(sections(view)))),
        reasons=view.reasons,
        missing=missing,
        seconds=seconds,
    )
