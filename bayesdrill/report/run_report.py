"""Write the report of a finished run, in the order of reading."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from types import MappingProxyType

from bayesdrill import output_files
from bayesdrill.basics.software import citation
from bayesdrill.inference.posterior import Problem
from bayesdrill.output_files import CONFIG_FILE, RESOLVED_FILE
from bayesdrill.report import rig_drawing, words
from bayesdrill.report.doubts import residual_sentences, unbelievable
from bayesdrill.report.section import Note, Picture, Plain, Section, Table, as_text, build
from bayesdrill.report.sections import (
    causes,
    comparison,
    convergence,
    fit,
    friction,
    identifiability,
    nominal,
    parameters,
    products,
    residuals,
    torque,
)
from bayesdrill.report.view import ReportContext
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import CHAIN

CHECKED = (
    "`bayesdrill verify` says whether config, record, chain, tables and figures of a folder are as "
    "the run wrote them, and belong together."
)


def provenance_section(run: ReportContext, folder: Path) -> Section:
    """Build the section of provenance; the run's `folder` has the config and the chain."""
    config, marks = run.config, run.marks
    c, sampler = run.sampled.convergence, config.sampler
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in run.seconds.items())
    return made_of(
        (
            ("config", config.name),
            ("run", f"{marks[provenance.RUN_MARK]}, a digest of record, config and seed"),
            *provenance_of_records(run.problem),
            ("model", words.model(run.problem)),
            ("seed", marks["Seed"]),
            (
                "sampler",
                f"{sampler.ensembles} ensembles of {sampler.walkers} walkers; burn-in {c.burn_in} of "
                f"{c.steps} steps, then thinned by {c.thin}",
            ),
            ("versions", marks["Versions"]),
            *([("seconds", seconds)] if seconds else []),
        ),
        folder,
        Note(CHECKED),
    )


def made_of(lines: tuple[tuple[str, str], ...], folder: Path, *more: Note) -> Section:
    """Build the section of provenance: `lines`, and digests of the files that are in `folder`."""
    there = [name for name in (CONFIG_FILE, RESOLVED_FILE, CHAIN) if (folder / name).exists()]
    digests = ", ".join(f"`{name}` {output_files.digest(folder / name)}" for name in there)
    table = Table(("", ""), (*lines, *([("files", digests)] if digests else [])), frozenset(("",)))
    config = None
    if RESOLVED_FILE in there:
        text = (folder / RESOLVED_FILE).read_text(encoding="utf-8")
        config = Plain(text, folded="The config, with every default")
    return build("Provenance", table, config, *more, brief=False)


def provenance_of_records(problem: Problem) -> Iterator[tuple[str, str]]:
    """Yield the files of each experiment, and its channels."""
    every = provenance.records(problem)
    for observation in problem.observations:
        files = ", ".join(f"`{name}`" for name in observation.experiment.written.files)
        length = observation.experiment.t[-1] - observation.experiment.t[0]
        yield (
            observation.title("record"),
            f"{files}: {every[observation.label]} over {length:g} s",
        )
        yield observation.title("channels"), ", ".join(observation.experiment.names)


CITE = (
    "Cite bayesdrill and the works that a result stands on, with the versions given above. "
    "`bayesdrill cite` prints these entries."
)


def cite() -> Section:
    """Build the section that says how to cite the software behind a run."""
    return build("How to cite", CITE, Plain(citation(), folded="BibTeX"), brief=False)


# In the order of reading: the verdict, the fit and its figure come before all tables.
PARTS = (
    nominal.VERDICT,
    fit.PART,
    causes.PART,
    parameters.PART,
    nominal.PART,
    torque.PART,
    friction.PART,
    comparison.EVIDENCE,
    identifiability.PART,
    products.PART,
    residuals.PART,
    convergence.PART,
    rig_drawing.PART,
)


def sections(
    run: ReportContext, pictures: Mapping[str, Sequence[Picture]] = MappingProxyType({})
) -> tuple[Section, ...]:
    """Return the sections of a run; `pictures` maps names of figures to their pictures.

    A terminal shows the brief sections, in reverse order.
    """
    others, shown = dict(pictures), list[Section]()
    for part in PARTS:
        placed = [picture for name in part.figures for picture in others.pop(name, ())]
        shown += part.sections(run, placed)
    shown.append(build("Figures", *chain.from_iterable(others.values()), brief=False))
    return tuple(section for section in shown if section.blocks)


def details(run: ReportContext) -> str:
    """Return the convergence and the sections of a run as text, without figures."""
    said = convergence.describe_convergence(run.sampled)
    return "\n\n".join((said, *as_text(sections(run))))


MOST_LINES = 16  # largest number of lines of a table on a screen
ON_SCREEN = ("", "unit", "nominal", "mean", "sd", "dev. %", "the record says")


def screen(run: ReportContext) -> str:
    """Return what a terminal shows: convergence, the parameters, the fit, and last the verdict."""
    rows = run.analysis.unknowns
    table = parameters.believed_columns(
        run, parameters.of_rows(run.units.rows(rows[:MOST_LINES]))
    ).only(ON_SCREEN)
    shown = [as_text([build("", table)])[0]] if rows else []
    if (more := len(rows) - MOST_LINES) > 0:
        shown.append(f"  and {more} more in the report")
    parts = [
        convergence.describe_sampling(run.sampled),
        "\n".join(shown),
        "\n".join([residual_sentences(run.analysis.fit, run.problem.clock), *run.notes]),
        unbelievable(run.reasons, converged=run.sampled.convergence.converged),
        nominal.run_verdict(run),
    ]
    return "\n\n".join(filter(None, parts))
