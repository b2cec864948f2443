"""Write what is said of a finished run or of a maximum alone, in the order of reading."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.analysis.verdict import Judgement, Verdict
from bayesdrill.basics.software import citation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.output_files import CONFIG_FILE, RESOLVED_FILE
from bayesdrill.report import section, words
from bayesdrill.report.section import (
    WORDS,
    Badge,
    Badges,
    Block,
    IntervalBar,
    Note,
    Picture,
    Plain,
    Section,
    Sentences,
    Table,
    as_text,
    build,
)
from bayesdrill.report.sections import (
    causes_words,
    fit_words,
    identify_words,
    physics_words,
    torque_words,
    verdict_words,
)
from bayesdrill.report.view import ReportContext
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import CHAIN


def run_marks(run: ReportContext) -> tuple[Badge, ...]:
    """Nothing is good about a run that must not be believed; what is bad about it comes first."""
    converged = run.sampled.convergence.converged
    first = Badge("converged", "good") if converged else Badge("not converged", "bad")
    fit = Badge("more than noise is left", "doubt")
    if any(summary.unbelievable for summary in run.analysis.fit):
        fit = Badge("does not fit", "bad")
    elif like_noise(run.analysis.fit):
        fit = Badge("fits: the rest looks like noise", "good")
    if run.reasons:
        plain = [
            replace(summary, tone="plain") if summary.tone == "good" else summary
            for summary in (fit, first)
        ]
        return tuple(sorted(plain, key=lambda badge: badge.tone != "bad"))
    if run.analysis.judged is None:
        return first, fit
    return first, fit, _table_mark(run.analysis.judged.verdict, run.problem.compared_with)


def _table_mark(verdict: Verdict, table: str) -> Badge:
    if not verdict.judged:
        return Badge(f"says nothing of {table}", "doubt")
    if not verdict.fits:
        return Badge("verdict in doubt", "doubt")
    if verdict.agrees:
        return Badge(f"agrees with {table}", "good")
    return Badge(f"disagrees with {table}", "doubt")


CHECKED = (
    "`bayesdrill verify` says whether config, record, chain, tables and figures of a folder are as "
    "the run wrote them, and belong together."
)


def provenance_section(run: ReportContext, folder: Path) -> Section:
    """`folder`: of the run, which holds config and chain."""
    config, marks = run.config, run.marks
    c, sampler = run.sampled.convergence, config.sampler
    took = ", ".join(f"{name} {value:.1f}" for name, value in run.seconds.items())
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
                f"{c.steps} steps, then one of {c.thin}",
            ),
            ("versions", marks["Versions"]),
            *([("seconds", took)] if took else []),
        ),
        folder,
        Note(CHECKED),
    )


def made_of(lines: tuple[tuple[str, str], ...], folder: Path, *more: Note) -> Section:
    """What is known, and digests of what it was made of, where these are in `folder`."""
    there = [name for name in (CONFIG_FILE, RESOLVED_FILE, CHAIN) if (folder / name).exists()]
    digests = ", ".join(f"`{name}` {output_files.digest(folder / name)}" for name in there)
    table = Table(("", ""), (*lines, *([("files", digests)] if digests else [])), frozenset(("",)))
    config = None
    if RESOLVED_FILE in there:
        text = (folder / RESOLVED_FILE).read_text(encoding="utf-8")
        config = Plain(text, folded="The config, with every default")
    return build("Provenance", table, config, *more, brief=False)


def provenance_of_records(problem: Problem) -> Iterator[tuple[str, str]]:
    """The file of each experiment, and its channels."""
    every = provenance.records(problem)
    for observation in problem.observations:
        files = ", ".join(f"`{name}`" for name in observation.experiment.written.files)
        length = observation.experiment.t[-1] - observation.experiment.t[0]
        yield (
            observation.entitled("record"),
            f"{files}: {every[observation.label]} over {length:g} s",
        )
        yield observation.entitled("channels"), ", ".join(observation.experiment.names)


CITE = (
    "Cite bayesdrill and the works that a result stands on, with the versions given above. "
    "`bayesdrill cite` prints these entries."
)


def cite() -> Section:
    """How to cite what a run was made with."""
    return build("How to cite", CITE, Plain(citation(), folded="BibTeX"), brief=False)


FOUND = "nothing found: energy, poles and sampling are as in a real rig"


def sections(run: ReportContext, pictures: Sequence[Picture] = ()) -> tuple[Section, ...]:
    """Of which a terminal shows the brief ones, the last first."""
    return tuple(_sections(run, pictures))


def _sections(run: ReportContext, pictures: Sequence[Picture]) -> Iterator[Section]:
    analysis, judged, sampled = run.analysis, run.analysis.judged, run.sampled
    converged = sampled.convergence.converged
    doubts = words.unbelievable(run.reasons, converged=converged)
    yield build("Verdict", Badges(run_marks(run)), doubts, _verdict(run))
    yield build(
        "Fit",
        words.maxima(run.mode, sampled.mode_shares, run.units),
        fit_words.residual_sentences(analysis.fit, run.problem.clock),
        "\n".join(f"fit: {each}" for each in analysis.inputs),
        verdict_words.step_sentences(analysis.step_errors),
    )
    if analysis.causes is not None:
        yield build("What would explain it", *causes_words.candidates(analysis.causes), brief=False)
    yield build("Parameters", *_parameters(run))
    if judged is not None:
        rule = None if run.reasons else Note(verdict_words.verdict_rule(judged.verdict))
        shown = _told(run, verdict_words.verdict_table(judged.verdict))
        read = Note(verdict_words.VERDICT_EXPLAINED)
        yield build("Against the nominal table", shown, rule, read)
    if judged is not None and analysis.repeats:
        names = judged.study.names
        said = verdict_words.repeats_sentence(analysis.repeats, names)
        shown = verdict_words.repeats_table(analysis.repeats, names)
        read = Note(verdict_words.REPEATS_EXPLAINED)
        yield build("From one experiment to the next", said, shown, read)
    for torque in analysis.torques:
        where = f" of {torque.label}" if torque.label else ""
        parts = (torque_words.torque_sentence, torque_words.law_sentences, torque_words.strayed)
        said = "\n".join(filter(None, (words_of(torque, run.problem.model) for words_of in parts)))
        shown = torque_words.torque_table(torque)
        yield build(f"The missing torque{where}", said, shown, Note(torque_words.READ))
    if pictures:
        yield build("Figures", *pictures, brief=False)
    if analysis.evidence is not None:
        said = verdict_words.evidence_sentences(
            analysis.evidence, analysis.vague, converged=converged
        )
        yield build("Evidence", said, Note(verdict_words.EVIDENCE_EXPLAINED))
    if judged is not None:
        yield from _shown(run, judged)
    rows = run.units.rows(analysis.derived)
    follows = physics_words.derived_table(rows, analysis.meanings) if rows else Note("none")
    yield build("What follows from these", follows, brief=False)
    searches = words.mode(run.mode, run.units)
    yield build("Maximum of the posterior (MAP)", searches, brief=False)
    read = Note(words.DIAGNOSTICS)
    yield build("Convergence", words.convergence(sampled), read, brief=False)


MOST_LINES = 16  # of a table on a screen
ON_SCREEN = ("", "unit", "nominal", "mean", "sd", "dev. %", "the record says")


def screen(run: ReportContext) -> str:
    """Return what a terminal shows: convergence, the parameters, the fit, and last the verdict."""
    rows = run.analysis.unknowns
    table = _told(run, section.of_rows(run.units.rows(rows[:MOST_LINES]))).only(ON_SCREEN)
    shown = [as_text([build("", table)])[0]] if rows else []
    if (more := len(rows) - MOST_LINES) > 0:
        shown.append(f"  and {more} more in the report")
    parts = [
        words.sampling(run.sampled),
        "\n".join(shown),
        "\n".join([fit_words.residual_sentences(run.analysis.fit, run.problem.clock), *run.notes]),
        words.unbelievable(run.reasons, converged=run.sampled.convergence.converged),
        _verdict(run),
    ]
    return "\n\n".join(filter(None, parts))


def _verdict(run: ReportContext) -> str:
    """The whole in a line, then what it rests on; empty where nothing is compared."""
    judged, rig = run.analysis.judged, run.problem.model
    if judged is None:
        return ""
    converged = run.sampled.convergence.converged
    said = verdict_words.verdict_sentences(
        judged.verdict,
        run.problem.compared_with,
        converged=converged,
        believed=not run.reasons,
        records=len(run.problem.observations),
        lacking=causes_words.lacking(run.analysis.causes, rig.roles),
        rests=judged.study.resting,
        units=run.units,
    )
    more = causes_words.instead(run.analysis.instead, rig) if converged else ()
    return "\n".join([said, *more])


def _parameters(run: ReportContext) -> tuple[Block | str, ...]:
    unknowns = run.analysis.unknowns
    read = (
        "`shrinkage` is one minus the ratio of the posterior's to the prior's standard deviation."
    )
    if any(row.nominal is not None for row in unknowns):
        nominal = f"the nominal value ({run.problem.compared_with})"
        read = f"`dev. %` is the deviation of the posterior mean from {nominal}; {read}"
    priors = run.problem.posterior.space.priors
    bars = tuple(interval_bar(row, priors[row.name]) for row in unknowns)
    table = _told(run, section.of_rows(run.units.rows(unknowns), bars))
    leaning = words.leaning(run.analysis.leaning).splitlines()
    known = [] if run.reasons else [*section.in_words(unknowns), *leaning]
    # Also where there is nothing to say: a terminal then shows an empty line.
    noted = Sentences("\n".join([*known, *run.notes]))
    if not run.analysis.sandwich:
        return table, Note(read), noted
    causes, sds = run.analysis.causes, run.analysis.sandwich
    remembered = section.sandwich_table(unknowns, sds, causes.windows if causes else (), run.units)
    return table, Note(read), noted, remembered, Note(section.SANDWICH_EXPLAINED)


def _told(run: ReportContext, table: Table) -> Table:
    """Without words for what is known, where it must not be believed."""
    return table.only([head for head in table.heads if not (run.reasons and head in WORDS)])


def _shown(run: ReportContext, judged: Judgement) -> Iterator[Section]:
    study, records = judged.study, len(run.problem.observations)
    known = () if run.reasons else (identify_words.knowledge,)
    parts = (identify_words.structure, identify_words.dependence_sentences, *known)
    shown = "\n\n".join(filter(None, (words_of(study) for words_of in parts)))
    yield build(
        f"What {'this record' if records == 1 else 'these records'} can show, at the MAP",
        Plain(shown),
        physics_words.friction_sentences(study.frictions, run.problem.model),
        torque_words.stand_ins(study, run.problem.model),
        brief=False,
    )
    physical = "\n".join(judged.findings) or FOUND
    yield build("Physical consistency of the posterior", physical, brief=False)


TAIL = 0.001  # of a prior, outside of the range
DECADES = 1.5  # from which on a range that is flat in logs is drawn so


def interval_bar(row: ParameterRow, prior: Prior) -> IntervalBar:
    """Return what a page draws of an unknown beside its prior."""
    shown = [row.hdi_low, row.hdi_high, row.map]
    ends = [float(x) for x in prior.quantile(np.array([TAIL, 1 - TAIL]))]
    every = [*shown, *ends, *([] if row.nominal is None else [row.nominal])]
    low, high = min(every), max(every)
    logs = flat_in_logs(prior) and low > 0 and math.log10(high / low) > DECADES

    def share(x: float) -> float:
        if logs:
            return math.log(x / low) / math.log(high / low)
        return (x - low) / (high - low) if high > low else 0.5

    nominal = None if row.nominal is None else share(row.nominal)
    return IntervalBar(share(row.hdi_low), share(row.hdi_high), nominal, share(row.map))
