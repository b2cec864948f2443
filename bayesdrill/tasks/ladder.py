"""Rank candidate models of one record at their maxima, and sample and compare the best of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.analysis.causes import Cause, Causes
from bayesdrill.analysis.comparison import SURE_LOG_ODDS, RunSummary
from bayesdrill.basics.errors import InputError, count_noun
from bayesdrill.basics.json_records import as_data, from_data
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.config.job import Job
from bayesdrill.config.yaml_source import as_yaml
from bayesdrill.inference.posterior import Posterior
from bayesdrill.output_files import LADDER, POSTERIOR, RECOMMENDED
from bayesdrill.report import comparison_report
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.results import provenance, run_folder
from bayesdrill.results.provenance import begin, check_record, interruptions
from bayesdrill.results.run_folder import Folder
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.fit import FitPlan, begin_searches, end_searches, fit
from bayesdrill.sampling.mode_search import Mode
from bayesdrill.sampling.proposal.learning import NoSupportError
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.selection import config_edits
from bayesdrill.tasks import comparison, pipeline, ranking
from bayesdrill.tasks.conclusions import SampledRun, concluded
from bayesdrill.tasks.find_map import fit_plan
from bayesdrill.tasks.remote import RefitExecutor, packed, run_jobs

RANKED = "candidates"  # entry of `run.json` with the ranking
KEPT = 20  # largest number of candidates in `run.json`
STEPS = 400  # typical number of steps of a walker for a posterior with one maximum
GIVEN, AS_GIVEN = "as_given", "the config as it is"
LONGEST_NAME = 100  # largest number of letters in the name of a config


@dataclass(frozen=True, slots=True)
class LadderModel:
    """A model of a ladder adds the changes `change_names` to the config; `about` describes it."""

    name: str
    about: str
    change_names: tuple[str, ...]
    job: Job


def _with_lines(base_job: Job, cause: Cause) -> Job:
    """Return a job whose config also has the lines of a cause; raise `InputError` if invalid."""
    data = config_edits.amended(base_job, cause)
    data["output"] = {**data.get("output", {}), "figures": ["fit"]}
    data.pop("simulation", None)
    return base_job.with_data(data, as_yaml(data))


@dataclass(frozen=True, slots=True, kw_only=True)
class LadderOutcome:
    """A ladder has a folder, a comparison of its models and a recommendation.

    `rungs` are the models that were sampled, in the order of `report.models`.  `left_out` has the
    reasons why other models were not.  `config` is the path of the `recommended` model's config.
    """

    folder: Path
    report: ComparisonReport
    rungs: tuple[LadderModel, ...]
    left_out: Mapping[str, str]
    recommended: LadderModel
    config: Path

    @property
    def summary(self) -> str:
        """Return the text for the terminal."""
        about = self.recommended.about
        conclusion = comparison_report.ladder_conclusion(about, self.left_out, self.config)
        return f"{self.report.text}\n{conclusion}"


def ladder(
    job: Job,
    output: Path,
    how: run_folder.WriteMode,
    pool: RefitExecutor,
    report: Reporter,
    sample: int = 2,
) -> LadderOutcome:
    """Run the whole job, in which the `sample` most probable candidates are sampled.

    Raises `Interrupted` when asked to stop, and `BrokenProcessPool` when a worker was killed.
    Finished models stay in the folder.
    """
    marks = provenance.fingerprint(job.config, job.problem)
    for name in LADDER.nested:
        Folder(output / name, "fresh" if how == "fresh" else "force", {}, POSTERIOR).check()
    check_record(job, output)
    with Folder(output, how, marks, LADDER) as folder:
        begin(job, folder)
        work = _Sampling(job, folder, pool, report, again=how == "resume")

        def progress() -> str:
            done = count_noun(len(work.done), "model is", "models are")
            return f"{done} done and kept in {output}"

        with interruptions(folder, progress, (InputError,)):
            work.run(sample)
        return _published(job, folder, work)


class _Sampling:
    """A sampling fits models of a ladder; `left_out` has reasons for models without a result."""

    def __init__(
        self, job: Job, folder: Folder, pool: RefitExecutor, report: Reporter, *, again: bool
    ) -> None:
        self.job, self.folder, self.again = job, folder, again
        self.pool, self.report = pool, report
        self.done: dict[str, tuple[LadderModel, RunSummary]] = {}
        self.left_out: dict[str, str] = {}

    def run(self, sample: int) -> None:
        """Rank all candidates, including the given config, and sample the most probable ones."""
        causes = (self._ranked_before() if self.again else None) or self._ranked()
        self.folder.write_run(**{RANKED: as_data(causes)})
        better = [cause for cause in causes.ranked if cause.bayes > 0.0]
        models = dict[str, LadderModel]()
        for k, cause in enumerate([*better, None, *causes.ranked[len(better) :]][:sample], start=1):
            if cause is None:
                models[f"model_{k}"] = LadderModel(GIVEN, AS_GIVEN, (), self.job)
                continue
            try:
                made = _with_lines(self.job, cause)
            except InputError as error:
                self.left_out[cause.name] = error.problems[0].message
            else:
                models[f"model_{k}"] = LadderModel(cause.name, cause.about, cause.parts, made)
        missing = {place: x for place, x in models.items() if not self._taken_up(place, x)}
        abouts = {model.name: model.about for model in models.values()}
        self.report.say(comparison_report.ladder_opening(abouts, len(missing)))

        def finish(place: str, modes: tuple[Mode, SamplingResult] | str) -> str:
            self._finish(modes, place, missing[place])
            return count_noun(len(self.done), "model")

        tasks = {
            place: (packed(model.job.problem.posterior, fit_plan(model.job)),)
            for place, model in missing.items()
        }
        run_jobs(self.pool, _fit, tasks, finish, self.folder.path, self.report)

    def _ranked_before(self) -> Causes | None:
        run = run_folder.read_run(self.folder.path) or {}
        try:
            return from_data(Causes, run[RANKED])
        except (KeyError, ValueError):
            return None

    def _ranked(self) -> Causes:
        job = self.job
        mode = self.pool.submit(search, job.problem.posterior, fit_plan(job)).result()
        there, sampler = job.with_steps_at(mode), job.config.sampler
        causes, maxima = ranking.rank(there, mode.values, self.pool.submit, self.report)
        evaluations = sampler.ensembles * sampler.walkers * STEPS
        times = {parts: evaluations * each.seconds for parts, each in maxima.items()}
        self.report.say(comparison_report.ranking(causes, times))
        return dataclasses.replace(causes, ranked=causes.ranked[:KEPT])

    def _taken_up(self, place: str, model: LadderModel) -> bool:
        """Read the earlier result of a model, and return whether it exists and has an evidence."""
        folder = self.folder.path / place
        run = (run_folder.read_run(folder) if self.again else None) or {}
        marks = provenance.fingerprint(model.job.config, model.job.problem)
        if run.get("fingerprint") != marks or run.get("status") != "finished":
            return False
        return self._known(place, model, pipeline.read_result(folder))

    def _finish(
        self, made: tuple[Mode, SamplingResult] | str, place: str, model: LadderModel
    ) -> None:
        if isinstance(made, str):
            self.left_out[model.name] = made
            return
        mode, sampled = made
        run = SampledRun(model.job.with_steps_at(mode), mode, sampled)
        view = concluded(run, is_single=False)  # the ranking already names missing causes
        pipeline.write_result(run.job, view, self.folder.path / place, None, force=True)
        if not self._known(place, model, dataclasses.replace(run, stored=view.analysis)):
            self.left_out[model.name] = "its evidence could not be computed"

    def _known(self, place: str, model: LadderModel, run: SampledRun) -> bool:
        if run.sampled.evidence is not None:
            named = comparison.NamedRun(model.name, self.folder.path / place, run)
            self.done[place] = model, comparison.contender(named, self.job.problem.units)
        return place in self.done


def search(posterior: Posterior, plan: FitPlan) -> Mode:
    """Find the MAP in this process, without workers."""
    with WorkerPool(posterior, 1) as pool:
        return end_searches(pool, begin_searches(pool, plan, SILENT), SILENT)


def _fit(posterior: Posterior, plan: FitPlan) -> tuple[Mode, SamplingResult] | str:
    """Fit a posterior; if nothing can be sampled, return a sentence that says why."""
    try:
        return fit(posterior, plan)
    except NoSupportError as error:
        return str(error)


def _published(job: Job, folder: Folder, work: _Sampling) -> LadderOutcome:
    """Write the comparison of all models; the reference is the model that was ranked last."""
    if not work.done:
        raise InputError.at(str(job.source.path), "; ".join(work.left_out.values()))
    places = sorted(work.done, reverse=True)
    every = [work.done[place] for place in places]
    report = ComparisonReport.of_models([summary for _, summary in every], job.problem.units)
    report = dataclasses.replace(report, heading=f"Ladder of {job.config.name}")
    chosen = recommended([model for model, _ in every], report)
    about = comparison_report.about_config(chosen.about, job.config.name, report)
    name = f"{job.config.name}_{chosen.name}"[:LONGEST_NAME]
    given = chosen.job.source.data, job.source, folder.path
    text = config_edits.as_file(*given, about.splitlines(), name)
    folder.write_text(RECOMMENDED, text)
    comparison.write(report, folder)
    folder.write_run(
        status="finished",
        recommended=chosen.name,
        left_out=work.left_out,
        **comparison.entries(report, [folder.path / place for place in places], folder),
    )
    return LadderOutcome(
        folder=folder.path,
        report=report,
        rungs=tuple(model for model, _ in every),
        left_out=work.left_out,
        recommended=chosen,
        config=folder.path / RECOMMENDED,
    )


def recommended(candidates: Sequence[LadderModel], report: ComparisonReport) -> LadderModel:
    """Return the simplest model whose log evidence is near the highest (`SURE_LOG_ODDS`)."""
    models = report.models
    least = max(model.log_z for model in models) - SURE_LOG_ODDS
    good = [k for k, model in enumerate(models) if model.log_z >= least]
    sizes = {
        k: (len(candidates[k].change_names), len(models[k].layer.problem.symbols), k) for k in good
    }
    return candidates[min(good, key=sizes.__getitem__)]
