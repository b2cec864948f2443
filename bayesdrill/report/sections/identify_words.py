"""What a record can and cannot say, in sentences and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence

from bayesdrill.analysis.identifiability.profile import Profile
from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.analysis.identifiability.study import (
    IdentifiabilityStudy,
    KnownProduct,
    StudyPoint,
)
from bayesdrill.basics.symbols import Symbol, fraction
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.section import aligned
from bayesdrill.report.sections import physics_words, torque_words
from bayesdrill.report.sections.physics_words import listed
from bayesdrill.report.words import unbelievable
from bayesdrill.rig.models.linear import Model

MOST_REMEDIES = 8
WELL = 0.5  # sd of the log, from the record alone, above which an unknown is not known well

SHAPES = {
    "bounded": "the record bounds it on both sides",
    "one-sided": "the record bounds it on one side only; the prior does the rest",
    "flat": "any value of its prior fits as well: the record does not determine it",
    "at the bound": "the best fit lies at the end of its prior",
}


# Of a parameter without a trace of its own: beyond such a limit the others would leave their priors.
THROUGH_OTHERS = "by the ends of the others' priors; the record alone does not determine it"


def product(names: Sequence[str], exponents: Sequence[float]) -> str:
    """`k_T r_m^2 / (k_s j_1)`, as one writes it by hand."""
    above = [_power(n, e) for n, e in zip(names, exponents, strict=True) if e > 0]
    below = [_power(n, -e) for n, e in zip(names, exponents, strict=True) if e < 0]
    return fraction(above, below, " ")


def study_point(point: StudyPoint, problem: Problem) -> str:
    """Return why a record is not studied at the start; empty where the rig moves there."""
    if not point.still:
        return ""
    named = zip(problem.names, point.theta.tolist(), strict=True)
    values = ", ".join(f"{name} = {problem.units.format_value(name, x)}" for name, x in named)
    what = f"What follows is computed at {point.at} ({values})"
    if not point.at:
        what = (
            "Nor does it at likely draws from the priors, so that nothing can be said of the record"
        )
    holds = ", as friction may hold it" if problem.model.frictions else ""
    return (
        f"AT REST: at the start values the rig does not move{holds}, and in the record it does "
        f"({listed(point.still)}). {what}. Give priors a `start:` with which it moves, or look at the "
        "maximum: `bayesdrill identify --at-map`."
    )


def full(study: IdentifiabilityStudy, rig: Model, reasons: Sequence[str] = ()) -> str:
    """All that `identify` prints; `reasons`: why a fit, where it is at one, must not be believed."""
    parts = [unbelievable(reasons, converged=False), structure(study), dependence_sentences(study)]
    parts += [] if reasons else [knowledge(study), nuisances(study)]
    parts += [physics_words.friction_sentences(study.frictions, rig)]
    parts += [torque_words.stand_ins(study, rig), remedies(study)]
    return "\n\n".join(part for part in parts if part).rstrip()


def structure(study: IdentifiabilityStudy) -> str:
    """The exact symmetries and what is left."""
    structure = study.structure
    names = structure.names
    if not structure.symmetries and not structure.unexplained:
        return (
            f"structure: no exact symmetry; all of {listed(names)} leave a trace of their own in "
            "the measured signals"
        )
    n = len(structure.symmetries) + structure.unexplained
    lines = [
        f"structure: {_count(n, 'exact symmetry', 'exact symmetries')}; no record "
        "of these channels, however long or clean, shows where on it the rig is:"
    ]
    lines += [f"  - {line}" for line in _symmetries(study)]
    if structure.invariants:
        products = ", ".join(product(names, e) for e in structure.invariants)
        lines.append(
            f"what such a record can show are {len(structure.invariants)} products of powers: {products}"
        )
    return "\n".join(lines)


def _symmetries(study: IdentifiabilityStudy) -> list[str]:
    structure = study.structure
    lines = [symmetry(structure.names, e) for e in structure.symmetries]
    if structure.unexplained:
        blind = [known.exponents.index(1) for known in study.parameters if math.isinf(known.bound)]
        names = [structure.names[k] for k in blind] or structure.names
        lines.append(
            f"{_count(structure.unexplained, 'change', 'changes')} of several of "
            f"{listed(names)} at once, by no common factor, "
            f"{'leaves' if structure.unexplained == 1 else 'leave'} every signal as it is"
        )
    return lines


def symmetry(names: Sequence[str], exponents: Exponents) -> str:
    """One symmetry as a sentence."""
    groups: dict[int, list[str]] = {}
    for name, exponent in zip(names, exponents, strict=True):
        if exponent:
            groups.setdefault(exponent, []).append(name)
    if groups.keys() == {1}:
        how = "be multiplied by any factor"
        if len(groups[1]) > 1:
            how = "all be multiplied by the same factor"
        return f"{listed(groups[1])} can {how} without changing any measured signal"
    parts = [
        f"{listed(groups[e])} {'multiplied' if e > 0 else 'divided'} by {_power('f', abs(e))}"
        for e in sorted(groups, reverse=True)
    ]
    return f"with {', '.join(parts)}, for any factor f, no measured signal changes"


def dependence_sentences(study: IdentifiabilityStudy) -> str:
    """A sentence for each scale that numbers which are held settle, or would."""
    lines = []
    for dependence in study.resting:
        verb = "depends" if len(dependence.unknown) == 1 else "depend"
        through = listed(dependence.through)
        why = f"{through}, which the config holds, and can be right only as far as that is"
        if priors := dependence.priors((dependence.narrowest,), (1,)):
            why = f"{priors_of(priors)} more than on the record, which hardly shows {through}"
        lines.append(
            f"{listed(dependence.unknown)} {verb} on {why}. In the record, "
            f"{symmetry(dependence.names, dependence.exponents)}."
        )
    return "\n".join(lines)


def priors_of(names: Sequence[str]) -> str:
    """Of one or several."""
    return f"the {'prior' if len(names) == 1 else 'priors'} of {listed(names)}"


def knowledge(study: IdentifiabilityStudy) -> str:
    """How well parameters and simple products would be known, before sampling."""
    opening = (
        "what to expect (Fisher information at "
        f"{study.at}; relative standard deviations; 'alone' is the Cramer-Rao bound of the record "
        "without any prior):"
    )
    header = ("", "with the prior", "prior", "alone", "")
    every, products = (
        aligned([header, *(_row(study, known) for known in shown)], left={0, 4})
        for shown in (study.parameters, study.products)
    )
    best = "what the record knows best: simple products, each independent of those above it"
    return "\n".join([opening, every, best, products])


def nuisances(study: IdentifiabilityStudy) -> str:
    """Sensors and starts: how well each would be known, and what it can hardly be told from."""
    if not study.nuisances:
        return ""
    lines = ["sensors and starts (standard deviations, SI):"]
    header = ("", "with the record", "prior", "")
    rows = [(f"  {n.name}", f"{n.sd:.2g}", f"{n.prior_sd:.2g}", n.word) for n in study.nuisances]
    lines.append(aligned([header, *rows], left={0, 3}))
    for nuisance in study.nuisances:
        if nuisance.like:
            each = ", ".join(f"{other} ({times:.2g} times)" for other, times in nuisance.like)
            others = listed([other for other, _ in nuisance.like])
            lines.append(
                f"{nuisance.name} can hardly be told from {others}. If it were known, sds would be "
                f"smaller: {each}."
            )
    return "\n".join(lines)


def remedies(study: IdentifiabilityStudy) -> str:
    """What would help, the best first."""
    helpful = [r for r in study.remedies if r.breaks or r.shrink > 1.05]
    if not helpful:
        return "no single further measurement that was tried would help much"
    lines = [
        f"what would help, each alone (standard deviations of {listed(study.of_interest)} shrink "
        "by this factor, on average):"
    ]
    n = len(study.structure.symmetries)
    rows = []
    for remedy in helpful[:MOST_REMEDIES]:
        left = remedy.left - study.structure.unexplained
        effect = "no symmetry is left" if left <= 0 else f"{left} of {n} left"
        if not remedy.breaks:
            effect = "breaks no symmetry"
        rows.append((f"  {remedy.what}", f"{remedy.shrink:.1f} x", effect if n else ""))
    lines.append(aligned(rows, left={0, 2}))
    return "\n".join(lines)


def brief(study: IdentifiabilityStudy) -> str:
    """For the start of a run: the symmetries, or that there are none, and where to read on."""
    symmetries, rests = _symmetries(study), dependence_sentences(study).splitlines()
    if not symmetries:
        return "\n".join([_of_each(study), *rests])
    lines = [
        "no such record shows everything:",
        *(f"  {line}" for line in symmetries),
        "  `bayesdrill identify` says what would",
    ]
    return "\n".join([*lines, *rests])


def _of_each(study: IdentifiabilityStudy) -> str:
    """Where no symmetry hides anything: what the record does not know well, even so."""
    named = list(zip(study.names, study.parameters, strict=True))
    loose = [f"{name} to {percent(known.bound)}" for name, known in named if known.bound > WELL]
    left = [name for name, known in named if known.word != "determined"]
    unseen = [nuisance.name for nuisance in study.nuisances if nuisance.word != "determined"]
    tied = [n for n in study.nuisances if n.like]
    if not loose and not left and not tied:
        if not unseen:
            return "the record determines every unknown"
        sensors = f"of sensors and starts it leaves {listed(unseen)} largely to the prior"
        return f"the record determines every parameter of the rig; {sensors}"
    parts = ["no symmetry hides an unknown from this record"]
    if loose:
        parts.append(f"without their priors it would know {listed(loose)} at best")
    if left:
        parts.append(f"with them it leaves {listed(left)} largely to the prior")
    parts += [f"{n.name} can hardly be told from {listed([o for o, _ in n.like])}" for n in tied]
    return "; ".join(parts)


def profiles(
    profiles: Sequence[Profile], study: IdentifiabilityStudy, shown: Sequence[Symbol]
) -> str:
    """One line each, in the units of the symbols `shown`."""
    named = {symbol.name: symbol.plain_unit for symbol in shown}
    open_ones = {
        name
        for name, known in zip(study.names, study.parameters, strict=True)
        if math.isinf(known.bound)
    }
    rows = [("", "unit", "best fit", "95 % from", "to", "")]
    for p in profiles:
        low, high = ("-" if x is None else f"{x:.6g}" for x in (p.low, p.high))
        best = "-" if p.shape == "flat" else f"{p.best:.6g}"
        meant = SHAPES[p.shape]
        if p.name in open_ones and p.shape in ("bounded", "one-sided"):
            meant = THROUGH_OTHERS
        rows.append((p.name, named[p.name], best, low, high, f"{p.shape}: {meant}"))
    return "profile likelihood:\n" + aligned(rows, left={0, 1, 5})


def _row(study: IdentifiabilityStudy, known: KnownProduct) -> tuple[str, ...]:
    # Narrowed without a trace of its own: ratios are known, and the others have priors.
    shared = math.isinf(known.bound) and known.word != "left to the prior"
    return (
        f"  {product(study.names, known.exponents)}",
        percent(known.sd),
        percent(known.prior_sd),
        "not at all" if math.isinf(known.bound) else percent(known.bound),
        "through the priors of others" if shared else known.word,
    )


def percent(sd_of_log: float) -> str:
    """A standard deviation of a log, as a share; beyond a factor of ten it says little."""
    value = 100.0 * sd_of_log
    if value > 1000:
        return "> 1000 %"
    return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1 else f"{name}^{exponent:g}"


def _count(n: int, text: str, many: str) -> str:
    return f"{n} {text if n == 1 else many}"
