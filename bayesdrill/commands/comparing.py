"""Several models of one record: what is read of each, and the folder of what they say together."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path

from bayesdrill.basics import own_files, software
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.own_files import COMPARE
from bayesdrill.commands import overlaying
from bayesdrill.engines.mode import Mode
from bayesdrill.engines.sampling import Sampled
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import left
from bayesdrill.inference.unknowns import MOVES
from bayesdrill.insight import prediction_scores
from bayesdrill.insight.comparison import Contender
from bayesdrill.insight.diagnostics import summarise
from bayesdrill.insight.vagueness import vague
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup import experiments
from bayesdrill.setup.job import Job
from bayesdrill.setup.own_units import OwnUnits

FEWEST, MOST = 2, 24
TITLE = "comparison"  # inside of the figure
OF_NOISE = ("the noise of", "the kind of noise")  # begin the names of settings
WITHOUT = (
    "has no log evidence: it was made before there was any, or its proposal found nothing; "
    "`bayesdrill posterior CONFIG --resume` computes it from the chain that is there"
)


def check_number(n: int) -> None:
    """Raises `InputError` for fewer models than two, and for more than a table has room for."""
    if not FEWEST <= n <= MOST:
        raise InputError.one("runs", f"{n} given; {FEWEST} to {MOST} runs can be compared")


def check_same_record(places: Sequence[str], problems: Sequence[Problem]) -> None:
    """Raises `InputError` where one is not of the record of the first: such odds mean nothing."""
    first = _record(problems[0])
    for place, problem in zip(places[1:], problems[1:], strict=True):
        own = _record(problem)
        if own == first:
            continue
        names = [name for name in {**first, **own} if own.get(name) != first.get(name)]
        what = f" of {names[0]}" if names[0] else ""
        message = (
            "odds are those of models of one record, and this is another: give runs of one, or lay "
            f"these over each other with `bayesdrill report`; the record{what} is "
            f"{own.get(names[0], 'missing')} here and {first.get(names[0], 'missing')} in {places[0]}"
        )
        raise InputError.one(place, message)


def _record(problem: Problem) -> dict[str, str]:
    """Of each experiment: channels, samples and what is held out."""
    found, whole = {}, {one.label for one in problem.posterior.likelihood.apart}
    for label, digest in provenance.records(problem).items():
        one = next(each for each in problem.every if each.label == label)
        held = one.experiment.held_out
        apart = "" if held is None else hashlib.sha256(held.tobytes()).hexdigest()[:6]
        held_out = f", held out {apart}" if apart else ""
        held_out += ", held out as a whole" if label in whole else ""
        found[label] = f"{digest} of {', '.join(one.experiment.names)}{held_out}"
    return found


def contender(
    name: str, place: str, job: Job, found: Mode, sampled: Sampled, own: OwnUnits
) -> Contender:
    """A run under the name that it has among others; raises `InputError` where it has no evidence."""
    if sampled.evidence is None:
        raise InputError.one(place, WITHOUT)
    layer = overlaying.layer(name, job, found, sampled, own)
    posterior = job.problem.posterior
    rest = left(posterior.likelihood, posterior.space.vector(found.values))
    rows = summarise(job.problem, sampled.draws, found, sampled.convergence)
    return Contender(
        layer=layer,
        converged=sampled.convergence.converged,
        evidence=sampled.evidence,
        left=rest,
        vague=vague(rows, layer.draws, posterior.space.priors),
        rig=_rig(job),
        noise=_noise(job),
        beliefs={name: repr(prior) for name, prior in posterior.space.priors.items()},
        held_out=prediction_scores.held_out(posterior, layer.draws),
        loo=prediction_scores.leave_one_out(posterior, layer.draws, rest),
    )


def _rig(job: Job) -> dict[str, str]:
    """Rig, sensors, inputs and start, and which of their numbers are unknown."""
    space = job.problem.posterior.space
    unknown = {space.free[k]: "unknown" for k in space.columns(*MOVES)}
    said = provenance.settings(job.config, job.problem, job.units)
    others = ("the seed", *space.free)
    kept = {n: v for n, v in said.items() if n not in others and not n.startswith(OF_NOISE)}
    torque = getattr(job.config, "missing_torque", None)
    if torque is not None:
        unknown["a missing torque"] = f"at {torque.at}, {torque.smoothness}"
    return kept | unknown


def _noise(job: Job) -> dict[str, str]:
    """Of each channel: its kind, and its size where it is known."""
    found = {}
    for one in job.problem.observations:
        record = experiments.of(job.config, one.label).record
        for name, channel in record.channels.items():
            known = isinstance(channel.sigma, int | float)
            size = f"sigma {channel.sigma}" if known else "sigma unknown"
            found[one.entitled(name)] = f"{channel.noise.model_dump()}, {size}"
    return found


def usual_place(names: Sequence[str]) -> Path:
    return Path("results") / ("compare-" + "-".join(names))[: overlaying.LONGEST]


def check_place(output: Path, runs: Sequence[Path | None], *, force: bool) -> None:
    """Raises `InputError` where `publish` would, before runs are read."""
    if output.resolve() in [run.resolve() for run in runs if run is not None]:
        raise InputError.one(str(output), "is one of these runs; give another --output")
    Folder(output, "force" if force else "fresh", {}, COMPARE).check()


def publish(
    report: ComparisonReport, runs: Sequence[Path | None], output: Path, *, force: bool
) -> None:
    """Table, page and figure; `runs`: where each run is, None where it is in no folder."""
    check_place(output, runs, force=force)
    with Folder(output, "force" if force else "fresh", {}, COMPARE) as folder:
        folder.begin(status="running", versions=software.versions())
        write(report, folder)
        files = {name: own_files.digest(output / name) for name in folder.made()}
        pairs = zip([one.layer for one in report.models], runs, strict=True)
        told = [overlaying.told(*pair, output) for pair in pairs]
        folder.write_run(status="finished", runs=told, files=files, **entries(report))


def write(report: ComparisonReport, folder: Folder, title: str = "") -> None:
    """Tables, page and figure into a folder that is open."""
    from bayesdrill.report import style  # late: matplotlib takes a second to load

    if title:
        report = dataclasses.replace(report, heading=title)
    for name, text in report.texts.items():
        folder.write_text(name, text)
    figures = folder.path / own_files.FIGURES
    figures.mkdir(exist_ok=True)
    mark = " ".join(one.layer.mark for one in report.models)
    note = {"Creator": software.creator(), provenance.RUN_MARK: mark}
    for name, drawing in report.figures.items():
        own = {**note, "Title": f"{TITLE}: {name}"}
        style.save(drawing.figure(*drawing.arguments), figures, name, own)
    folder.write_text("report.html", report.page(figures))


def entries(report: ComparisonReport) -> dict[str, object]:
    """Of `run.json`."""
    found = report.decision
    return {
        "verdict": found.word,
        "best": report.best.name,
        "log_evidence": {one.name: one.log_z for one in report.models},
        "log_evidence_error": {one.name: one.evidence.error for one in report.models},
        "reasons": list(report.reasons),
    }
