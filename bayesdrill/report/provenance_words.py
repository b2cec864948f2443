"""Where a run comes from: config, record, seed, software, times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from bayesdrill.basics import own_files
from bayesdrill.basics.citation import citation
from bayesdrill.basics.own_files import CONFIG_FILE, RESOLVED_FILE
from bayesdrill.inference.problem import Problem
from bayesdrill.report import words
from bayesdrill.report.sections import Note, Plain, Section, Sentences, Table
from bayesdrill.report.view import View
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import CHAIN, read_run
from bayesdrill.setup import experiments, sources
from bayesdrill.setup.config import Config

CHECKED = (
    "`bayesdrill verify` computes the tables again from the chain and says whether config, record, "
    "chain, tables and figures of a folder still belong together."
)


def section(run: View, folder: Path) -> Section:
    """`folder`: of the run, which holds config and chain."""
    made = made_of(tuple(_lines(run)), folder)
    return replace(made, blocks=(*made.blocks, Note(CHECKED)))


def cite(folder: Path | None = None) -> Section:
    """How to cite what the run in `folder` was made with, or what is installed."""
    run = {} if folder is None else read_run(folder) or {}
    found = citation(run.get("versions"))
    return Section(
        "How to cite",
        (Sentences(found.text.replace("\n\n", "\n")), Plain(found.bibtex, folded="BibTeX")),
        brief=False,
    )


def made_of(lines: tuple[tuple[str, str], ...], folder: Path) -> Section:
    """What is known, and digests of what it was made of, where these are in `folder`."""
    digests = tuple(("files", found) for found in (", ".join(_digests(folder)),) if found)
    table = Table(("", ""), (*lines, *digests), frozenset(("",)))
    return Section("Provenance", (table, *_config(folder)), brief=False)


def _lines(run: View) -> Iterator[tuple[str, str]]:
    config, marks = run.config, run.marks
    c, sampler = run.sampled.convergence, config.sampler
    yield "config", config.name
    yield "run", f"{marks[provenance.RUN_MARK]}, a digest of record, config and seed"
    yield from records(run.problem, config)
    yield "model", words.model(run.problem)
    yield "seed", marks["Seed"]
    yield (
        "sampler",
        f"{sampler.ensembles} ensembles of {sampler.walkers} walkers; burn-in {c.burn_in} of {c.steps} "
        f"steps, then one of {c.thin}",
    )
    yield "versions", marks["Versions"]
    if run.seconds:
        yield "seconds", ", ".join(f"{name} {value:.1f}" for name, value in run.seconds.items())


def records(problem: Problem, config: Config) -> Iterator[tuple[str, str]]:
    """The file of each experiment, and its channels."""
    every = provenance.records(problem)
    for one in problem.observations:
        files = sources.named(experiments.of(config, one.label))
        length = one.experiment.t[-1] - one.experiment.t[0]
        yield one.entitled("record"), f"{files}: {every[one.label]} over {length:g} s"
        yield one.entitled("channels"), ", ".join(one.experiment.names)


def _digests(folder: Path) -> Iterator[str]:
    for name in (CONFIG_FILE, RESOLVED_FILE, CHAIN):
        if (folder / name).exists():
            yield f"`{name}` {own_files.digest(folder / name)}"


def _config(folder: Path) -> Iterator[Plain]:
    path = folder / RESOLVED_FILE
    if path.exists():
        yield Plain(path.read_text(encoding="utf-8"), folded="The config, with every default")
