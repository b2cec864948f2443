"""Compare runs side by side, or as models of one record, and write the results in a folder."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bayesdrill import output_files
from bayesdrill.analysis import prediction
from bayesdrill.analysis.comparison import PosteriorSummary, RunSummary
from bayesdrill.analysis.plausibility import diffuse_priors
from bayesdrill.basics import software
from bayesdrill.basics.errors import InputError, encodable
from bayesdrill.basics.json_records import as_data, from_data
from bayesdrill.basics.units import Unit
from bayesdrill.config.job import Job
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.inference.unknowns import SIMULATOR_ROLES
from bayesdrill.report.comparison_report import COMPARED, OVERLAID, ComparisonReport, Form
from bayesdrill.report.doubts import figure_warning, run_doubts
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import Folder
from bayesdrill.tasks import conclusions
from bayesdrill.tasks.conclusions import SampledRun

FEWEST = 2  # smallest number of runs in a comparison
LONGEST = 100  # largest number of letters in the name of a folder
OF_NOISE = ("the noise of", "the kind of noise")  # prefixes of the settings that describe noise
WITHOUT = (
    "has no log evidence: an older version made the run, or its proposal failed. "
    "`bayesdrill posterior CONFIG --resume` computes it from the existing chain"
)


@dataclass(frozen=True, slots=True)
class NamedRun:
    """A run is compared under a name; `folder` is None if it was never saved."""

    name: str
    folder: Path | None
    run: SampledRun

    @property
    def location(self) -> str:
        """Return the folder of a saved run, or else the name, for messages."""
        return self.name if self.folder is None else str(self.folder)


def check_runs(form: Form, runs: Sequence[object]) -> None:
    """Raise `InputError` for too few or too many runs, or if a run would be compared with itself.

    `runs` are folders, or run objects, which are compared by identity.
    """
    if not FEWEST <= len(runs) <= form.max_runs:
        message = f"{len(runs)} given; {FEWEST} to {form.max_runs} runs can be {form.purpose}"
        raise InputError.at("runs", message)
    places = [run.resolve() if isinstance(run, Path) else id(run) for run in runs]
    for k, place in enumerate(places):
        if place in places[:k] and form is COMPARED:
            name = str(runs[k]) if isinstance(place, Path) else f"number {k + 1}"
            raise InputError.at("runs", f"{name} would be compared with itself; give another run")


FORMS: Mapping[str, Form] = {form.name: form for form in (OVERLAID, COMPARED)}


def report(form: Form, runs: Sequence[NamedRun]) -> ComparisonReport:
    """Return the report of an overlay of runs, or of a comparison of models of one record.

    Each unknown has the unit of the first run that gives a unit.  A comparison raises `InputError`
    if records differ or an evidence is missing.
    """
    units = overlay_units([run.run.job for run in runs])
    if form is OVERLAID:
        layers = tuple(overlay_layer(run.name, run.run, units) for run in runs)
        return ComparisonReport(layers, units)
    check_same_record(runs)
    return ComparisonReport.of_models([contender(run, units) for run in runs], units)


def overlay_units(jobs: Sequence[Job]) -> DisplayUnits:
    """Return each unknown's unit from the first job that gives one; SI if the jobs' SI units differ."""
    units, kinds = dict[str, Unit](), dict[str, set[str]]()
    for job in jobs:
        units = {**job.problem.units.units, **units}
        for symbol in job.problem.symbols:
            kinds.setdefault(symbol.name, set()).add(symbol.unit)
    same = {name: item for name, item in units.items() if len(kinds.get(name, ())) < 2}
    return DisplayUnits(same)


def overlay_layer(
    name: str, run: SampledRun, units: DisplayUnits, fit: tuple[ResidualSummary, ...] | None = None
) -> PosteriorSummary:
    """Return the summary of a run, with settings in `units`; `fit` has its residuals, if known."""
    job, sampled, fit = run.job, run.sampled, residuals(run) if fit is None else fit
    return PosteriorSummary(
        name=name,
        mark=mark(run),
        problem=job.problem,
        draws=sampled.draws.reshape(-1, sampled.draws.shape[-1]),
        settings=provenance.settings(job.config, job.problem, units),
        warning=figure_warning(sampled, fit),
        reasons=run_doubts(sampled, fit, run.stored.unsupported if run.stored else {}),
    )


def mark(run: SampledRun) -> str:
    """Return the mark of a run, which identifies the run in its files."""
    return provenance.marks(run.job.config, run.job.problem)[provenance.RUN_MARK]


def residuals(run: SampledRun) -> tuple[ResidualSummary, ...]:
    """Return the residuals of each channel at the MAP."""
    return conclusions.residuals(run.job, run.mode) if run.stored is None else run.stored.fit


def distinct(names: Sequence[str]) -> list[str]:
    """Return names as printable text; repeated names get a number."""
    texts: list[str] = []
    for name in map(encodable, names):
        n, candidate = 1, name
        while candidate in texts:
            n += 1
            candidate = f"{name} ({n})"
        texts.append(candidate)
    return texts


def default_folder(form: Form, names: Sequence[str]) -> Path:
    """Return the default folder of a comparison."""
    return Path("results") / (form.prefix + "-".join(names))[:LONGEST]


def check_folder(form: Form, output: Path, runs: Sequence[Path | None], *, force: bool) -> None:
    """Raise the `InputError` that `publish` would raise; called before runs are read."""
    if output.resolve() in [run.resolve() for run in runs if run is not None]:
        raise InputError.at(str(output), "is one of these runs; give another --output")
    Folder(output, "force" if force else "fresh", {}, form.kind).check()


def publish(
    report: ComparisonReport, runs: Sequence[Path | None], output: Path, *, force: bool
) -> None:
    """Write table, page and figures; `runs` are the runs' folders, None for a run in memory."""
    check_folder(report.form, output, runs, force=force)
    with Folder(output, "force" if force else "fresh", {}, report.form.kind) as folder:
        folder.begin(status="running", versions=software.installed_versions())
        write(report, folder)
        folder.write_run(status="finished", **entries(report, runs, folder))


def write(report: ComparisonReport, folder: Folder) -> None:
    """Write table, page and figures into an open folder."""
    from bayesdrill.report import style  # imported late, as matplotlib takes a second to load

    for name, text in report.texts.items():
        folder.write_text(name, text)
    figures = folder.path / output_files.FIGURES
    figures.mkdir(exist_ok=True)
    note = {"Creator": software.creator(), provenance.RUN_MARK: report.mark}
    for name, drawing in report.figures.items():
        # The title omits the heading, as figure formats may encode the names of runs differently.
        style.save(drawing.drawn(), figures, name, {**note, "Title": f"{report.form.name}: {name}"})
    folder.write_text("report.html", report.page(figures))


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparedRun:
    """A compared run has a name, the mark (digest) of its results, and a folder (None if in memory)."""

    name: str
    run: str
    folder: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRecord:
    """The `run.json` of a finished comparison, an overlay or a ladder of models has these fields.

    `reasons` say why the result must not be believed.  Overlays leave the last four fields empty.
    """

    form: int = 1
    runs: tuple[ComparedRun, ...]
    reasons: tuple[str, ...] = ()
    verdict: str | None = None
    best: str | None = None
    log_evidence: Mapping[str, float] = field(default_factory=dict)
    log_evidence_error: Mapping[str, float] = field(default_factory=dict)


def entries(
    report: ComparisonReport, runs: Sequence[Path | None], folder: Folder
) -> dict[str, object]:
    """Return the entries of `run.json` after all files are written."""
    home = folder.path.resolve()
    places = [
        None if run is None else Path(os.path.relpath(run.resolve(), home)).as_posix()
        for run in runs
    ]
    record = ComparisonRecord(
        runs=tuple(
            ComparedRun(name=layer.name, run=layer.mark, folder=place)
            for layer, place in zip(report.layers, places, strict=True)
        ),
        reasons=report.reasons,
        verdict=None if report.decision is None else report.decision.word,
        best=None if report.best is None else report.best.name,
        log_evidence={model.name: model.log_z for model in report.models},
        log_evidence_error={model.name: model.evidence.error for model in report.models},
    )
    return {"files": folder.digests(), **as_data(record)}


def read_record(run: Mapping[str, Any], folder: Path) -> ComparisonRecord:
    """Return the record in `run`, the `run.json` of `folder`; raises `InputError` if invalid."""
    try:
        record = from_data(ComparisonRecord, run)
        # Pydantic changes names of folders that are not UTF-8, so names are taken from `run`.
        places = [each["folder"] for each in run["runs"]]
        pairs = zip(record.runs, places, strict=True)
        return replace(record, runs=tuple(replace(each, folder=place) for each, place in pairs))
    except ValueError:
        message = "is damaged, or of another version; compare the runs again"
        raise InputError.at(str(folder / output_files.RUN), message) from None


def check_same_record(runs: Sequence[NamedRun]) -> None:
    """Raise `InputError` if runs have different records, as odds would mean nothing."""
    first = _record(runs[0].run.job.problem)
    for run in runs[1:]:
        record = _record(run.run.job.problem)
        if record == first:
            continue
        names = [name for name in {**first, **record} if record.get(name) != first.get(name)]
        what = f" of {names[0]}" if names[0] else ""
        message = (
            "this run has another record, but odds compare models of one record. Give runs of one "
            f"record, or overlay these by `bayesdrill report`. The record{what} is "
            f"{record.get(names[0], 'missing')} here and {first.get(names[0], 'missing')} in "
            f"{runs[0].location}"
        )
        raise InputError.at(run.location, message)


def _record(problem: Problem) -> dict[str, str]:
    """Describe the channels, samples and held-out parts of each experiment."""
    digests, records = {}, provenance.records(problem)
    whole = {observation.label for observation in problem.posterior.likelihood.held_out}
    for observation in problem.all_observations:
        label = observation.label
        held_out = "" if observation.experiment.held_out is None else ", some samples held out"
        held_out += ", held out as a whole" if label in whole else ""
        digests[label] = f"{records[label]} of {', '.join(observation.experiment.names)}{held_out}"
    return digests


def contender(named: NamedRun, units: DisplayUnits) -> RunSummary:
    """Return the summary of a named run; raises `InputError` if the run has no evidence."""
    run = named.run
    if run.sampled.evidence is None:
        raise InputError.at(named.location, WITHOUT)
    posterior, fit = run.job.problem.posterior, residuals(run)
    layer = overlay_layer(named.name, run, units, fit)
    return RunSummary(
        layer=layer,
        converged=run.sampled.convergence.converged,
        evidence=run.sampled.evidence,
        residuals=fit,
        vague=tuple(diffuse_priors(layer.draws, posterior.space.priors))
        if run.stored is None
        else run.stored.vague,
        rig=_rig(run.job),
        noise=_noise(run.job),
        beliefs={name: repr(prior) for name, prior in posterior.space.priors.items()},
        held_out=prediction.held_out(posterior, layer.draws),
        loo=prediction.leave_one_out(posterior, layer.draws, fit),
    )


def _rig(job: Job) -> dict[str, str]:
    """Describe rig, sensors, inputs and start state, and list their unknowns."""
    space = job.problem.posterior.space
    unknown = {space.free[k]: "unknown" for k in space.columns(*SIMULATOR_ROLES)}
    said = provenance.settings(job.config, job.problem, job.problem.units)
    others = ("the seed", *space.free)
    kept = {n: v for n, v in said.items() if n not in others and not n.startswith(OF_NOISE)}
    if torque := job.config.missing_torque:
        unknown["a missing torque"] = f"at {torque.at}, {torque.smoothness}"
    return kept | unknown


def _noise(job: Job) -> dict[str, str]:
    """Describe the noise of each channel: its kind, and sigma if it is known."""
    result = {}
    for observation in job.problem.observations:
        record = job.case.experiment(observation.label).config.record
        for name, channel in record.channels.items():
            known = isinstance(channel.sigma, int | float)
            size = f"sigma {channel.sigma}" if known else "sigma unknown"
            result[observation.title(name)] = f"{channel.noise.model_dump()}, {size}"
    return result
