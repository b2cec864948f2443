"""Several runs side by side: what is read of each, and the folder of what they say together."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from bayesdrill.basics import own_files, software
from bayesdrill.basics.errors import InputError, encodable
from bayesdrill.basics.own_files import OVERLAY
from bayesdrill.engines.mode import Mode
from bayesdrill.engines.sampling import Sampled
from bayesdrill.inference import residual_checks
from bayesdrill.insight.overlay import Layer
from bayesdrill.report import words
from bayesdrill.report.overlay_looks import LOOKS
from bayesdrill.report.overlay_report import OverlayReport
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup.job import Job
from bayesdrill.setup.own_units import SI, OwnUnits

FEWEST, MOST = 2, len(LOOKS)  # that can be told apart in grey
LONGEST = 100  # letters of a folder's name
TITLE = "overlay"  # inside of figures, where a file's format may write letters of a name otherwise


def check_number(n: int) -> None:
    """Raises `InputError` for fewer runs than two, and for more than can be told apart."""
    if not FEWEST <= n <= MOST:
        message = f"{n} given; {FEWEST} to {MOST} runs can be laid over each other"
        raise InputError.one("runs", message)


def units(jobs: Sequence[Job]) -> OwnUnits:
    """Of each unknown those of the first run that says any; SI where a name means two things."""
    found, kinds = SI, dict[str, set[str]]()
    for job in jobs:
        found = found.over(job.units)
        for symbol in job.problem.symbols:
            kinds.setdefault(symbol.name, set()).add(symbol.unit)
    same = {name: one for name, one in found.units.items() if len(kinds.get(name, ())) < 2}
    return OwnUnits(same)


def layer(name: str, job: Job, found: Mode, sampled: Sampled, own: OwnUnits) -> Layer:
    """A run under the name that it has among others, its settings in these units."""
    posterior = job.problem.posterior
    left = residual_checks.left(posterior.likelihood, posterior.space.vector(found.values))
    return Layer(
        name=name,
        mark=provenance.marks(job.config, job.problem, "")[provenance.RUN_MARK],
        problem=job.problem,
        draws=sampled.draws.reshape(-1, sampled.draws.shape[-1]),
        settings=provenance.settings(job.config, job.problem, own),
        warning=words.warning(sampled, left),
        reasons=words.reasons(sampled, left),
    )


def distinct(names: Sequence[str]) -> list[str]:
    """As they are, if they are text, with a number where one comes again."""
    found: list[str] = []
    for name in map(encodable, names):
        n, own = 1, name
        while own in found:
            n += 1
            own = f"{name} ({n})"
        found.append(own)
    return found


def usual_place(names: Sequence[str]) -> Path:
    return Path("results") / "-".join(names)[:LONGEST]


def check_place(output: Path, runs: Sequence[Path | None], *, force: bool) -> None:
    """Raises `InputError` where `publish` would, before runs are read."""
    if output.resolve() in [run.resolve() for run in runs if run is not None]:
        raise InputError.one(str(output), "is one of these runs; give another --output")
    Folder(output, "force" if force else "fresh", {}, OVERLAY).check()


def publish(
    report: OverlayReport, runs: Sequence[Path | None], output: Path, *, force: bool
) -> None:
    """Table, page and figures; `runs`: where each run is, None where it is in no folder."""
    from bayesdrill.report import style  # late: matplotlib takes a second to load

    check_place(output, runs, force=force)
    with Folder(output, "force" if force else "fresh", {}, OVERLAY) as folder:
        folder.begin(status="running", versions=software.versions())
        for name, text in report.texts.items():
            folder.write_text(name, text)
        figures = output / own_files.FIGURES
        figures.mkdir(exist_ok=True)
        note = _note(report)
        for name, drawing in report.figures.items():
            own = {**note, "Title": f"{TITLE}: {name}"}
            style.save(drawing.figure(*drawing.arguments), figures, name, own)
        folder.write_text("report.html", report.page(figures))
        files = {name: own_files.digest(output / name) for name in folder.made()}
        listed = [told(*pair, output) for pair in zip(report.layers, runs, strict=True)]
        folder.write_run(status="finished", runs=listed, reasons=list(report.reasons), files=files)


def _note(report: OverlayReport) -> dict[str, str]:
    """Inside of each figure."""
    return {"Creator": software.creator(), provenance.RUN_MARK: mark(report)}


def mark(report: OverlayReport) -> str:
    """By which a figure says whose it is: the marks of all runs."""
    return " ".join(layer.mark for layer in report.layers)


def told(of: Layer, run: Path | None, output: Path) -> dict[str, str | None]:
    """For `run.json`."""
    place = None
    if run is not None:
        place = Path(os.path.relpath(run.resolve(), output.resolve())).as_posix()
    return {"name": of.name, "run": of.mark, "folder": place}
