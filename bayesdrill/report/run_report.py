"""What is said of a finished run or of a maximum alone: sections in the order in which they are
read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis.diagnostics import Row
from bayesdrill.analysis.verdict import Judgement, Verdict
from bayesdrill.basics.software import citation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.output_files import CONFIG_FILE, RESOLVED_FILE
from bayesdrill.report import section, words
from bayesdrill.report.section import (
    WORDS,
    Bar,
    Block,
    Mark,
    Marks,
    Note,
    Picture,
    Plain,
    Section,
    Sentences,
    Table,
)
from bayesdrill.report.sections import (
    fit_words,
    identify_words,
    physics_words,
    torque_words,
    verdict_words,
)
from bayesdrill.report.view import View
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import CHAIN, read_run


def run_marks(run: View) -> tuple[Mark, ...]:
    """Nothing is good about a run that must not be believed; what is bad about it comes first."""
    converged = run.sampled.convergence.converged
    first = Mark("converged", "good") if converged else Mark("not converged", "bad")
    fit = _fit_mark(run)
    if run.reasons:
        plain = [replace(one, tone="plain") if one.tone == "good" else one for one in (fit, first)]
        return tuple(sorted(plain, key=lambda one: one.tone != "bad"))
    return (first, fit) if run.analysis.judged is None else (first, fit, _table(run))


def _fit_mark(run: View) -> Mark:
    if any(one.unbelievable for one in run.analysis.fit):
        return Mark("does not fit", "bad")
    if like_noise(run.analysis.fit):
        return Mark("fits: noise is left", "good")
    return Mark("more than noise is left", "doubt")


def _table(run: View) -> Mark:
    assert run.analysis.judged is not None
    found, table = run.analysis.judged.verdict, run.problem.compared_with
    if all(quantity.says == "not determined" for quantity in found.products):
        return Mark(f"says nothing of {table}", "doubt")
    if not found.fits:
        return Mark("verdict in doubt", "doubt")
    return (
        Mark(f"agrees with {table}", "good")
        if found.agrees
        else Mark(f"disagrees with {table}", "doubt")
    )


CHECKED = (
    "`bayesdrill verify` computes the tables again from the chain and says whether config, record, "
    "chain, tables and figures of a folder still belong together."
)


def provenance_section(run: View, folder: Path) -> Section:
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
    yield from provenance_of_records(run.problem)
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


def provenance_of_records(problem: Problem) -> Iterator[tuple[str, str]]:
    """The file of each experiment, and its channels."""
    every = provenance.records(problem)
    for one in problem.observations:
        files = ", ".join(f"`{name}`" for name in one.experiment.written.files)
        length = one.experiment.t[-1] - one.experiment.t[0]
        yield one.entitled("record"), f"{files}: {every[one.label]} over {length:g} s"
        yield one.entitled("channels"), ", ".join(one.experiment.names)


def _digests(folder: Path) -> Iterator[str]:
    for name in (CONFIG_FILE, RESOLVED_FILE, CHAIN):
        if (folder / name).exists():
            yield f"`{name}` {output_files.digest(folder / name)}"


def _config(folder: Path) -> Iterator[Plain]:
    path = folder / RESOLVED_FILE
    if path.exists():
        yield Plain(path.read_text(encoding="utf-8"), folded="The config, with every default")


FOUND = "nothing found: energy, poles and sampling are as in a real rig"


def sections(run: View, pictures: Sequence[Picture] = ()) -> tuple[Section, ...]:
    """Of which a terminal shows the brief ones, the last first."""
    judged = run.analysis.judged
    shown = (Section("Figures", tuple(pictures), brief=False),) if pictures else ()
    return (
        Section("Verdict", tuple(_verdict(run))),
        Section("Fit", tuple(_fit(run))),
        Section("Parameters", _parameters(run)),
        *((_against(run, judged.verdict),) if judged is not None else ()),
        *_repeats(run),
        *_torque(run),
        *_energy(run),
        *shown,
        *_evidence(run),
        *(_shown(run, judged) if judged is not None else ()),
        Section("What follows from these", (_following(run),), brief=False),
        Section(
            "Maximum of the posterior (MAP)",
            (Sentences(words.mode(run.mode, run.units)),),
            brief=False,
        ),
        Section(
            "Convergence",
            (Sentences(words.convergence(run.sampled)), Note(words.DIAGNOSTICS)),
            brief=False,
        ),
    )


def _verdict(run: View) -> Iterator[Block]:
    """The whole in a line, then whether it may be believed."""
    c, table = run.sampled.convergence, run.problem.compared_with
    yield Marks(run_marks(run))
    if doubts := words.unbelievable(run.reasons, converged=c.converged):
        yield Sentences(doubts)
    if run.analysis.judged is not None:
        n, verdict = len(run.problem.observations), run.analysis.judged.verdict
        roles = run.problem.model.roles
        lacking = fit_words.lacking(run.analysis.causes, roles)
        said = verdict_words.verdict_sentences(
            verdict,
            table,
            converged=c.converged,
            believed=not run.reasons,
            records=n,
            lacking=lacking,
            rests=run.analysis.judged.study.resting,
        )
        more = fit_words.instead(run.analysis.instead, roles) if c.converged else ()
        yield Sentences("\n".join([said, *more]))


def _fit(run: View) -> Iterator[Block]:
    if several := words.maxima(run.mode, run.sampled.held, run.units):
        yield Sentences(several)
    yield Sentences(fit_words.residual_sentences(run.analysis.fit, run.clock))
    if said := fit_words.explained(run.analysis.causes, run.problem):
        yield Sentences(said)
    if said := verdict_words.step_sentences(run.analysis.step_errors):
        yield Sentences(said)


def _repeats(run: View) -> Iterator[Section]:
    """Where there are several experiments to compare."""
    if run.analysis.repeats:
        names = run.names_of_rig
        said = Sentences(verdict_words.repeats_sentence(run.analysis.repeats, names))
        read = Note(verdict_words.REPEATS_EXPLAINED)
        yield Section(
            "From one experiment to the next",
            (said, verdict_words.repeats_table(run.analysis.repeats, names), read),
        )


def _evidence(run: View) -> Iterator[Section]:
    if run.analysis.evidence is not None:
        said = verdict_words.evidence_sentences(
            run.analysis.evidence, run.analysis.vague, converged=run.sampled.convergence.converged
        )
        yield Section("Evidence", (Sentences(said), Note(verdict_words.EVIDENCE_EXPLAINED)))


def _torque(run: View) -> Iterator[Section]:
    """Of a rig whose equations leave one out."""
    for one in run.analysis.torques:
        where = f" of {one.label}" if one.label else ""
        law = torque_words.followed(one)
        parts = (torque_words.torque_sentence(one), law, torque_words.strayed(one))
        said = Sentences("\n".join(filter(None, parts)))
        shown = torque_words.torque_table(one)
        yield Section(f"The missing torque{where}", (said, shown, Note(torque_words.READ)))


def _energy(run: View) -> Iterator[Section]:
    """Of a rig that rubs."""
    model = run.problem.model
    for one in run.analysis.energy:
        where = f" in {one.label}" if one.label else ""
        shown = physics_words.energy_table(one, model)
        read = Note(physics_words.energy_note(one, model))
        yield Section(f"Where the energy goes{where}", (shown, read), brief=False)


def _parameters(run: View) -> tuple[Block, ...]:
    read = (
        "`shrinkage` is one minus the ratio of the posterior's to the prior's standard deviation."
    )
    if any(row.nominal is not None for row in run.analysis.unknowns):
        nominal = f"the nominal value ({run.problem.compared_with})"
        read = f"`dev. %` is the deviation of the posterior mean from {nominal}; {read}"
    drawn = bars(run.analysis.unknowns, run.problem.posterior.space.priors)
    known = [
        *section.in_words(run.analysis.unknowns),
        *words.leaning(run.analysis.leaning).splitlines(),
    ]
    said = Sentences("\n".join([*([] if run.reasons else known), *run.notes]))
    return (
        _told(run, section.of_rows(run.units.rows(run.analysis.unknowns), drawn)),
        Note(read),
        said,
    )


def _told(run: View, table: Table) -> Table:
    """Without words for what is known, where it must not be believed."""
    return table.only([head for head in table.heads if not (run.reasons and head in WORDS)])


def _following(run: View) -> Table | Note:
    rows, meanings = run.units.rows(run.analysis.derived), run.analysis.meanings
    return physics_words.derived_table(rows, meanings) if rows else Note("none")


def _against(run: View, verdict: Verdict) -> Section:
    rule = () if run.reasons else (Note(verdict_words.verdict_rule(verdict)),)
    shown = _told(run, verdict_words.verdict_table(verdict))
    return Section(
        "Against the nominal table", (shown, *rule, Note(verdict_words.VERDICT_EXPLAINED))
    )


def _shown(run: View, judged: Judgement) -> Iterator[Section]:
    study, records = judged.study, len(run.problem.observations)
    known = () if run.reasons else (identify_words.knowledge,)
    parts = (identify_words.structure, identify_words.resting, *known)
    shown = "\n\n".join(filter(None, (words_of(study) for words_of in parts)))
    whose = "this record" if records == 1 else "these records"
    rubs = physics_words.friction_sentences(study.frictions)
    stands = torque_words.stand_ins(study)
    more = [Sentences(one) for one in (rubs, stands) if one]
    said: tuple[Block, ...] = (Plain(shown), *more)
    yield Section(f"What {whose} can show, at the MAP", said, brief=False)
    physical = Sentences("\n".join(judged.findings) or FOUND)
    yield Section("Physical consistency of the posterior", (physical,), brief=False)


TAIL = 0.001  # of a prior, outside of the range
DECADES = 1.5  # from which on a range that is flat in logs is drawn so


def bars(rows: Sequence[Row], priors: Mapping[str, Prior]) -> tuple[Bar, ...]:
    return tuple(_bar(row, priors[row.name]) for row in rows)


def _bar(row: Row, prior: Prior) -> Bar:
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
    return Bar(share(row.hdi_low), share(row.hdi_high), nominal, share(row.map))
