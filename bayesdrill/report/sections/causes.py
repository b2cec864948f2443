"""List what would explain a bad fit, which candidate is recommended, and what to do next."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np

from bayesdrill.analysis.causes import (
    Cause,
    Causes,
    Doubt,
    EquivalentExplanation,
    FittedValue,
)
from bayesdrill.analysis.edits import lacks
from bayesdrill.basics.errors import count_noun
from bayesdrill.report.doubts import percent
from bayesdrill.report.section import Plain, Sentences, Table, aligned, build, listed
from bayesdrill.report.view import ReportPart
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import Roles

WIDER = 2.0  # upper end of a proposed prior, divided by the estimate
SHOWN = 5  # largest number of candidates or unknowns that are shown
AND = ", and "  # after a comma, because the words of a candidate may contain an "and"
WANDERS = 3.0  # (sd between windows / sd of one estimate) above which chance is unlikely
STEPS = (
    "next: bayesdrill map CONFIG --apply NEW writes the config with these lines; map NEW shows whether "
    "it fits.\n"
    "next: bayesdrill ladder CONFIG samples the best candidates and compares them."
)
NONE_TRUSTED = "fit: none of these can be trusted, so no change of the config is recommended.\n"
FACTOR = (
    "fit: DO NOT BELIEVE the values above: a value or unit is off by a factor. Correct the line in "
    "brackets before any physics is added."
)
LOOK = (
    "next: bayesdrill check CONFIG says what is odd in columns and units.\n"
    "next: look at the inputs and the gear: does anything drive the rig that no column records?\n"
    "next: a window (`record: {window: [from, to]}`) shows where in the record the misfit begins."
)


def describe_causes(causes: Causes | None) -> str:
    """Describe candidates that would explain the misfit, the best first, and what to do next."""
    return "\n".join(
        aligned([part.heads, *part.lines], left={0}) if isinstance(part, Table) else part.text
        for part in candidates(causes)
    )


def candidates(causes: Causes | None) -> tuple[Sentences | Table | Plain, ...]:
    """Return blocks of a page: candidates, config lines of the best one, and what to do next."""
    if causes is None:
        return ()
    refitted = f"fit: {count_noun(len(causes.ranked), 'candidate was', 'candidates were')} refitted"
    notes = "\n".join(filter(None, [_excerpt(causes), _reference(causes), wandering(causes)]))
    if not causes.supported:
        tried = (
            f"{refitted}, and none explains the misfit. The candidates were values and units that are "
            "off by a factor, signs, gains, lags and offsets of columns, clocks, the start, the gear, "
            "physics that the rig may lack, and the noise."
        )
        return (Sentences("\n".join(filter(None, [tried, notes, LOOK]))),)
    best = causes.best
    stopped = sum(not cause.finished for cause in causes.supported)
    doubtful = [cause for cause in causes.supported[:SHOWN] if cause.doubts]
    doubts = "; ".join(
        f"{_difference(c, best)}: {', '.join(map(doubt, c.doubts))}" for c in doubtful
    )
    caution = _absorbing(causes.supported, best)
    said = (
        f"{refitted} from the MAP, each with all unknowns free. The best are listed: log Bayes factor "
        "(by Laplace's approximation), gain of the log posterior, and the unexplained share of each "
        "channel.",
        f"fit: {count_noun(stopped, 'refit was', 'refits were')} stopped, with no chance to become as "
        "probable as the best: their numbers are lower bounds."
        if stopped
        else "",
        _untried(causes.untried),
        f"fit: A is the config with {listed(best.words, AND)}." if best else "",
        *_instead_of(causes.supported, best),
        doubts and f"fit: do not trust the Bayes factor of {doubts}.",
        caution and f"fit: {caution} It names no cause.",
        notes,
    )
    if best is not None and best.off_by_a_factor:
        said = (*said, FACTOR)
    table = (Sentences("\n".join(filter(None, said))), _candidate_table(causes))
    if best is None:
        return (*table, Sentences(NONE_TRUSTED + LOOK))
    new = f"next: add these lines to the config (A{_new(best)}). {_left(best)}"
    return (*table, Sentences(new), Plain(best.lines), Sentences(STEPS))


def doubt(doubt: Doubt) -> str:
    """Describe why the evidence of a candidate cannot be trusted."""
    sentence = {
        "end": "{names} is at an end of its prior",
        "maxima": "there is another maximum, about as high",
        "alike": "{names} cannot be distinguished",
        "hidden": "it ignores {share:.2g} % of the samples, and does not fit the others",
    }[doubt.kind]
    return sentence.format(names=" and ".join(doubt.said_of), share=100 * doubt.share)


def _absorbing(good: Sequence[Cause], best: Cause | None) -> str:
    if best is not None and best.absorbing:
        words = dict(zip(best.parts, best.words, strict=True))
        absorbing = listed([words[part] for part in best.absorbing], AND)
        return f"{absorbing} absorbs the misfit, as it would any misfit, without explaining it."
    most = max((c for c in good if c.absorbing == c.parts), key=lambda c: c.bayes, default=None)
    if most is not None and (best is None or most.bayes > best.bayes):
        return f"{most.about} absorbs more, as it would of any misfit, without explaining it."
    return ""


def _left(best: Cause) -> str:
    if not best.absorbing:
        return f"That leaves {'what looks like the noise' if best.explains_all else 'more than noise'}."
    each = ", ".join(f"{percent(row.simulated)} of {row.name}" for row in best.fit)
    return f"That absorbs the misfit. The rig itself leaves unexplained {each}."


def _instead_of(good: Sequence[Cause], best: Cause | None) -> list[str]:
    """List changes of the best candidate that the record cannot distinguish from another change."""
    similar = (each.said_of for cause in good for each in cause.doubts if each.kind == "alike")
    words = {*(best.words if best else ())}
    pairs = dict.fromkeys(pair for pair in similar if len({*pair} & words) == 1)
    return [f"fit: {listed(pair, ', or ')}: the record cannot tell them apart." for pair in pairs]


def _untried(untried: Sequence[str]) -> str:
    if not untried:
        return ""
    counted = count_noun(len(untried), "combination was", "combinations were")
    such = f"such as {'; '.join(untried[:SHOWN])}"
    return f"fit: {counted} not tried, as the refits took too long, {such}."


def _excerpt(causes: Causes) -> str:
    if causes.samples is None:
        return ""
    return f"fit: candidates were refitted to the first {causes.samples} samples of long records."


def _reference(causes: Causes) -> str:
    if causes.reference is None:
        return ""
    name, channel = causes.reference
    return (
        f"fit: {channel} follows {name} like a set point, and does not respond like the rig. If "
        f"{name} is a reference, record the voltage, current or torque of the motor instead."
    )


def _candidate_table(causes: Causes) -> Table:
    channels, best = (row.name for row in causes.given), causes.best
    lines = [("as given", "0", "0", *(percent(summary.share) for summary in causes.given))]
    for cause in causes.supported[:SHOWN]:
        factors = (f"{cause.bayes:+.1f}", f"{cause.gain:+.1f}")
        unexplained = (percent(summary.share) for summary in cause.fit)
        lines.append((_difference(cause, best), *factors, *unexplained))
    heads = ("model", "log Bayes factor", "log posterior", *channels)
    return Table(heads, tuple(lines), frozenset({"model"}))


def _difference(cause: Cause, best: Cause | None) -> str:
    """Describe a candidate by its difference from the `best` one, called A, if that is shorter."""
    if best is None:
        return listed(cause.words, AND)
    if cause is best:
        return "A"
    pairs = zip(cause.parts, cause.words, strict=True)
    more = [words for part, words in pairs if part not in best.parts]
    less = [w for part, w in zip(best.parts, best.words, strict=True) if part not in cause.parts]
    if len(more) + len(less) >= len(cause.parts):
        return listed(cause.words, AND)
    every = {"with": more, "without": less}.items()
    return f"A {' and '.join(f'{how} {listed(words, AND)}' for how, words in every if words)}"


def wandering(causes: Causes) -> str:
    """Describe unknowns that change between windows; empty for fewer than two refitted windows."""
    if len(causes.windows) < 2:
        return ""
    changes, columns = [], dict[str, list[FittedValue]]()
    for unknown in chain.from_iterable(causes.windows):
        columns.setdefault(unknown.name, []).append(unknown)
    for column in (column for column in columns.values() if len(column) > 1):
        values = [unknown.value for unknown in column]
        sd = float(np.median([unknown.sd for unknown in column]))
        if (sds := float(np.std(values, ddof=1)) / sd if sd > 0 else 0.0) > WANDERS:
            said = f"{min(values):.3g} to {max(values):.3g} {column[0].unit}".strip()
            changes.append((sds, f"{column[0].name} from {said} (sd {sd:.2g})"))
    refitted = f"fit: the config as given was refitted on {len(causes.windows)} windows"
    opening = f"{refitted} of the record"
    if not changes:
        return f"{opening}. No unknown changes by more than {WANDERS:g} sds."
    most = ", ".join(said for _, said in sorted(changes, reverse=True)[:SHOWN])
    return (
        f"{opening}. What changes most: {most}. Constants of a rig do not change: the model lacks "
        "something that varies with time or with the motion."
    )


def _new(cause: Cause) -> str:
    few = [new for new in cause.new if not new.name.startswith(("sigma_", "rho_"))][:SHOWN]
    said = [f"{new.name} = {new.value:.3g} {new.unit}".strip() for new in few]
    return f": {', '.join(said)}" if said else ""


def lacking(causes: Causes | None, roles: Roles) -> str:
    """Describe what the model lacks, for the verdict; empty if no candidate is recommended."""
    best = None if causes is None else causes.best
    return " and ".join(f"{_lacked(n, roles)} ({n})" for n in (best.lacks if best else ()))


def instead(explanation: EquivalentExplanation | None, rig: Model) -> Iterable[str]:
    """Yield a sentence if the nominal values with one more effect explain the record."""
    if explanation is None:
        return
    how = "better than" if explanation.lost < 0 else "about as well as"
    name, value = explanation.parameter, explanation.value
    missing = f"{_lacked(name, rig.roles)} of {value:.3g} {rig.symbols[name].plain_unit}"
    prior = f"{{prior: uniform, low: 0, high: {WIDER * value:.2g}}}"
    yield (
        f"before you blame the table: its values with {missing} explain the record {how} any "
        f"values without it. Try it: say `parameters: {{{name}: {prior}}}`."
    )


def _lacked(name: str, roles: Roles) -> str:
    words = {inertia.efficiency: "friction of the gear" for inertia in roles.inertias}
    return {**words, **{lack.parameter: lack.description for lack in lacks(roles)}}[name]


PART = ReportPart(
    sections=lambda run, _: [
        build("What would explain it", *candidates(run.analysis.causes), brief=False)
    ]
)
