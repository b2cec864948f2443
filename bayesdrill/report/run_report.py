"""What is said of a finished run: its sections, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Iterator

from bayesdrill.insight.verdict import Judgement
from bayesdrill.report import (
    derived_words,
    identify_words,
    residual_words,
    tables,
    verdict_words,
    words,
)
from bayesdrill.report.sections import Note, Plain, Section, Sentences, Table
from bayesdrill.report.view import View
from bayesdrill.setup.build import compared_with

FOUND = "nothing found: energy, poles and sampling are as in a real rig"


def sections(run: View) -> tuple[Section, ...]:
    """Of which a terminal shows the brief ones."""
    c, table = run.sampled.convergence, compared_with(run.config)
    doubts = words.unbelievable(residual_words.reasons(run.left), converged=c.converged)
    first = (words.maxima(run.mode, run.sampled), doubts, residual_words.sentences(run.left))
    read = (
        f"`dev. %` is the deviation of the posterior mean from the nominal value ({table}); "
        "`shrinkage` is one minus the ratio of the posterior's to the prior's standard deviation."
    )
    said = Sentences(tables.in_words(run.rows, run.notes))
    return (
        Section("", tuple(Sentences(text) for text in first if text)),
        Section("", (tables.of_rows(run.rows), Note(read), said)),
        Section("What follows from these", (_following(run),), brief=False),
        *(_judged(run.judged, table, converged=c.converged) if run.judged is not None else ()),
        Section("Maximum of the posterior (MAP)", (Sentences(words.mode(run.mode)),), brief=False),
        Section("Convergence", (Sentences(words.convergence(run.sampled)),), brief=False),
    )


def _following(run: View) -> Table | Note:
    rows = run.following
    return derived_words.table(rows, run.derived) if rows else Note("none")


def _judged(judged: Judgement, table: str, *, converged: bool) -> Iterator[Section]:
    verdict, study = judged.verdict, judged.study
    yield Section(
        "Verdict",
        (
            Sentences(verdict_words.sentences(verdict, table, converged=converged)),
            Note(verdict_words.rule(verdict)),
            verdict_words.table(verdict),
            Note(verdict_words.EXPLAINED),
        ),
    )
    shown = f"{identify_words.structure(study)}\n\n{identify_words.knowledge(study)}"
    yield Section("What this record can show, at the MAP", (Plain(shown),), brief=False)
    physical = Sentences("\n".join(judged.findings) or FOUND)
    yield Section("Physical consistency of the posterior", (physical,), brief=False)
