"""What is said of a finished run: its sections, in the order in which they are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bayesdrill.insight.following import follows
from bayesdrill.insight.verdict import Judgement, Verdict
from bayesdrill.report import (
    derived_words,
    energy_words,
    evidence_words,
    friction_words,
    identify_words,
    marks,
    nuisance_words,
    repeat_words,
    residual_words,
    step_words,
    tables,
    torque_words,
    verdict_words,
    words,
)
from bayesdrill.report.bars import bars
from bayesdrill.report.sections import (
    WORDS,
    Block,
    Marks,
    Note,
    Picture,
    Plain,
    Section,
    Sentences,
    Table,
)
from bayesdrill.report.view import View
from bayesdrill.setup.build import compared_with

FOUND = "nothing found: energy, poles and sampling are as in a real rig"


def sections(run: View, pictures: Sequence[Picture] = ()) -> tuple[Section, ...]:
    """Of which a terminal shows the brief ones, the last first."""
    judged = run.judged
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
    c, table = run.sampled.convergence, compared_with(run.config)
    yield Marks(marks.of_run(run))
    if doubts := words.unbelievable(run.reasons, converged=c.converged):
        yield Sentences(doubts)
    if run.judged is not None:
        n, verdict = len(run.problem.observations), run.judged.verdict
        roles = run.problem.model.roles
        lacking = nuisance_words.lacking(run.causes, roles)
        said = verdict_words.sentences(
            verdict,
            table,
            converged=c.converged,
            believed=not run.reasons,
            records=n,
            lacking=lacking,
            rests=run.judged.study.resting,
        )
        more = nuisance_words.instead(run.instead, roles) if c.converged else ()
        yield Sentences("\n".join([said, *more]))


def _fit(run: View) -> Iterator[Block]:
    if several := words.maxima(run.mode, run.sampled.held, run.units):
        yield Sentences(several)
    yield Sentences(residual_words.sentences(run.left, run.clock))
    if said := nuisance_words.explained(run.causes, run.config):
        yield Sentences(said)
    if said := step_words.sentences(run.step_errors):
        yield Sentences(said)


def _repeats(run: View) -> Iterator[Section]:
    """Where there are several experiments to compare."""
    if run.repeats:
        names = run.names_of_rig
        said = Sentences(repeat_words.sentence(run.repeats, names))
        read = Note(repeat_words.EXPLAINED)
        yield Section(
            "From one experiment to the next", (said, repeat_words.table(run.repeats, names), read)
        )


def _evidence(run: View) -> Iterator[Section]:
    if run.evidence is not None:
        said = evidence_words.sentences(
            run.evidence, run.vague, converged=run.sampled.convergence.converged
        )
        yield Section("Evidence", (Sentences(said), Note(evidence_words.EXPLAINED)))


def _torque(run: View) -> Iterator[Section]:
    """Of a rig whose equations leave one out."""
    for one in run.shaking:
        where = f" of {one.label}" if one.label else ""
        law = torque_words.followed(one, follows(one))
        parts = (torque_words.sentence(one), law, torque_words.strayed(one))
        said = Sentences("\n".join(filter(None, parts)))
        shown = torque_words.table(one)
        yield Section(f"The missing torque{where}", (said, shown, Note(torque_words.READ)))


def _energy(run: View) -> Iterator[Section]:
    """Of a rig that rubs."""
    model = run.problem.model
    for one in run.accounts:
        where = f" in {one.label}" if one.label else ""
        shown = energy_words.table(one, model)
        read = Note(energy_words.note(one, model))
        yield Section(f"Where the energy goes{where}", (shown, read), brief=False)


def _parameters(run: View) -> tuple[Block, ...]:
    read = (
        "`shrinkage` is one minus the ratio of the posterior's to the prior's standard deviation."
    )
    if any(row.nominal is not None for row in run.rows):
        nominal = f"the nominal value ({compared_with(run.config)})"
        read = f"`dev. %` is the deviation of the posterior mean from {nominal}; {read}"
    drawn = bars(run.rows, run.problem.posterior.space.priors)
    known = [*tables.in_words(run.rows), *words.leaning(run.leaning).splitlines()]
    said = Sentences("\n".join([*([] if run.reasons else known), *run.notes]))
    return _told(run, tables.of_rows(run.units.rows(run.rows), drawn)), Note(read), said


def _told(run: View, table: Table) -> Table:
    """Without words for what is known, where it must not be believed."""
    return table.only([head for head in table.heads if not (run.reasons and head in WORDS)])


def _following(run: View) -> Table | Note:
    rows = run.following
    return derived_words.table(run.units.rows(rows), run.derived) if rows else Note("none")


def _against(run: View, verdict: Verdict) -> Section:
    rule = () if run.reasons else (Note(verdict_words.rule(verdict)),)
    shown = _told(run, verdict_words.table(verdict))
    return Section("Against the nominal table", (shown, *rule, Note(verdict_words.EXPLAINED)))


def _shown(run: View, judged: Judgement) -> Iterator[Section]:
    study, records = judged.study, len(run.problem.observations)
    known = () if run.reasons else (identify_words.knowledge,)
    parts = (identify_words.structure, identify_words.resting, *known)
    shown = "\n\n".join(filter(None, (words_of(study) for words_of in parts)))
    whose = "this record" if records == 1 else "these records"
    rubs = friction_words.sentences(study.frictions)
    stands = torque_words.stand_ins(study)
    more = [Sentences(one) for one in (rubs, stands) if one]
    said: tuple[Block, ...] = (Plain(shown), *more)
    yield Section(f"What {whose} can show, at the MAP", said, brief=False)
    physical = Sentences("\n".join(judged.findings) or FOUND)
    yield Section("Physical consistency of the posterior", (physical,), brief=False)
