"""A ladder of models of one record: rungs handed out, each a run of its own, and compared."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files, selection
from bayesdrill.analysis.comparison import SURE, Contender
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Reporter
from bayesdrill.config.job import Job
from bayesdrill.inference.posterior import Posterior
from bayesdrill.output_files import POSTERIOR, RECOMMENDED
from bayesdrill.report import comparison_report
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.results import provenance, run_folder
from bayesdrill.results.provenance import begin, check_record, interruptions
from bayesdrill.results.run_folder import Folder
from bayesdrill.sampling.ensembles import Sampled
from bayesdrill.sampling.fit import FitPlan, fit
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.proposal.learning import Nowhere
from bayesdrill.selection import Ladder, Rung
from bayesdrill.tasks import comparison, pipeline
from bayesdrill.tasks.conclusions import SampledRun, concluded
from bayesdrill.tasks.find_map import fit_plan
from bayesdrill.tasks.remote import RefitExecutor, packed, run_jobs


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """`rungs`: those that were run, in the order of `report.models`; `left_out`: why others were not;
    `recommended`: one of them, whose config is at `config`.
    """

    folder: Path
    report: ComparisonReport
    rungs: tuple[Rung, ...]
    left_out: Mapping[str, str]
    recommended: Rung
    config: Path

    @property
    def said(self) -> str:
        """For the terminal."""
        told = comparison_report.ladder_conclusion(self.recommended, self.left_out, self.config)
        return f"{self.report.text}\n{told}"


def ladder(
    job: Job, output: Path, how: run_folder.Mode, crew: RefitExecutor, report: Reporter
) -> Outcome:
    """The whole job. Raises `Interrupted` when asked to stop, and `BrokenProcessPool` when a worker was
    killed; rungs that are done are kept.
    """
    marks = provenance.fingerprint(job.config, job.problem)
    kind = output_files.ladder_files(selection.rung_names())
    for name in selection.rung_names():
        Folder(output / name, "fresh" if how == "fresh" else "force", {}, POSTERIOR).check()
    check_record(job, output)
    with Folder(output, how, marks, kind) as folder:
        begin(job, folder)
        work = _Climb(job, output, crew, report, again=how == "resume")

        def progress() -> str:
            return f"{len(work.done)} rungs are done and kept in {output}"

        with interruptions(folder, progress, (InputError,)):
            work.up(Ladder.of(job))
        return _published(job, folder, work)


class _Climb:
    """Rungs under way: `done` has what each that was run says, `left_out` why others were not."""

    def __init__(
        self, job: Job, output: Path, crew: RefitExecutor, report: Reporter, *, again: bool
    ) -> None:
        self.job, self.output, self.again = job, output, again
        self.crew, self.report = crew, report
        self.done: dict[str, tuple[Rung, Contender]] = {}
        self.left_out: dict[str, str] = {}

    def up(self, made: Ladder) -> None:
        """All that need nothing of others; then what the best of these asks for; and as long as the best
        leaves more than noise, and each time gets better, all that it may have beside.
        """
        self._run(made.first())
        if selection.GIVEN not in self.done:
            raise InputError.one(str(self.job.source.path), self.left_out[selection.GIVEN])
        least = self.done[selection.GIVEN][1].log_z + SURE
        better = [name for name, (_, one) in self.done.items() if one.log_z > least]
        self._run(made.then(sorted(better, key=lambda name: -self.done[name][1].log_z)))
        before, best = -math.inf, self._best()
        while best[1].log_z > before + SURE and not best[1].like_noise:
            tried = {*self.done, *self.left_out}
            self._run([one for one in made.beyond(best[0].parts) if one.name not in tried])
            before, best = best[1].log_z, self._best()

    def _best(self) -> tuple[Rung, Contender]:
        return max(self.done.values(), key=lambda pair: pair[1].log_z)

    def _run(self, wanted: Sequence[Rung]) -> None:
        jobs = {one.name: (one, made) for one in wanted if (made := self._job(one)) is not None}
        missing = {name: pair for name, pair in jobs.items() if not self._taken_up(*pair)}
        self.report.say(
            comparison_report.ladder_opening([one for one, _ in jobs.values()], len(missing))
        )

        def finish(name: str, found: tuple[Mode, Sampled] | str) -> str:
            self._finish(found, *missing[name])
            return f"{len(self.done)} rungs"

        tasks = {
            name: (packed(made.problem.posterior, fit_plan(made)),)
            for name, (_, made) in missing.items()
        }
        run_jobs(self.crew, _fit, tasks, finish, self.output, self.report)

    def _job(self, rung: Rung) -> Job | None:
        if not rung.parts:
            return self.job
        try:
            return rung.job()
        except InputError as error:
            self.left_out[rung.name] = error.problems[0].message
            return None

    def _taken_up(self, rung: Rung, job: Job) -> bool:
        """Whether it was run before."""
        place = self.output / rung.name
        run = run_folder.read_run(place) if self.again else None
        same = run is not None and run.get("fingerprint") == provenance.fingerprint(
            job.config, job.problem
        )
        if run is None or not same or run.get("status") != "finished":
            return False
        return self._known(rung, pipeline.read_result(place))

    def _finish(self, made: tuple[Mode, Sampled] | str, rung: Rung, job: Job) -> None:
        if isinstance(made, str):
            self.left_out[rung.name] = made
            return
        found, sampled = made
        job = job.at(found)
        # What may be missing the other rungs say, and the report of the config as given.
        view = concluded(job, found, sampled, alone=not rung.parts)
        pipeline.write_result(job, view, self.output / rung.name, None, force=True)
        if not self._known(rung, SampledRun(job, found, sampled, kept=view.analysis)):
            self.left_out[rung.name] = "its evidence could not be computed"

    def _known(self, rung: Rung, run: SampledRun) -> bool:
        if run.sampled.evidence is None:
            return False
        named = comparison.NamedRun(rung.name, self.output / rung.name, run)
        self.done[rung.name] = rung, comparison.contender(named, self.job.units)
        return True


def _fit(posterior: Posterior, plan: FitPlan) -> tuple[Mode, Sampled] | str:
    """A sentence where nothing can be sampled."""
    try:
        return fit(posterior, plan)
    except Nowhere as error:
        return str(error)


def _published(job: Job, folder: Folder, work: _Climb) -> Outcome:
    """Always in the same order: the config as given first, and then as they are named."""
    order = [name for name in selection.rung_names() if name in work.done]
    every = [work.done[name] for name in order]
    report = ComparisonReport.of_models([one for _, one in every], job.units)
    report = dataclasses.replace(report, heading=f"Ladder of {job.config.name}")
    chosen = recommended([rung for rung, _ in every], report)
    about = comparison_report.about_config(chosen, job.config.name, report)
    name = f"{job.config.name}_{chosen.name}"[: selection.LONGEST_NAME]
    folder.write_text(RECOMMENDED, selection.recommended(chosen, name, folder.path, about))
    comparison.write(report, folder)
    places = [folder.path / rung.name for rung, _ in every]
    folder.write_run(
        status="finished",
        recommended=chosen.name,
        left_out=work.left_out,
        **comparison.entries(report, places, folder),
    )
    return Outcome(
        folder=folder.path,
        report=report,
        rungs=tuple(rung for rung, _ in every),
        left_out=work.left_out,
        recommended=chosen,
        config=folder.path / RECOMMENDED,
    )


def recommended(every: Sequence[Rung], report: ComparisonReport) -> Rung:
    """The simplest of those that are about as probable as the best."""
    models = report.models
    least = max(one.log_z for one in models) - SURE
    good = [k for k, one in enumerate(models) if one.log_z >= least]
    return every[
        min(good, key=lambda k: (len(every[k].parts), len(models[k].layer.problem.symbols), k))
    ]
