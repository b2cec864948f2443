"""Report what a record can show: sentences, tables, profiles, and the information's spectrum."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesdrill.analysis.identifiability.profile import THRESHOLD, Profile
from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy, KnownProduct, StudyPoint
from bayesdrill.analysis.verdict import basis
from bayesdrill.basics.symbols import Symbol, fraction
from bayesdrill.config.schema.config import IdentifySpec
from bayesdrill.design.targets import product_target
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import scales, style
from bayesdrill.report.doubts import unbelievable
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.pages import build_page, is_first_column, legend_above
from bayesdrill.report.section import Picture, Plain, Section, aligned, build, listed
from bayesdrill.report.sections.friction import friction_sentences
from bayesdrill.report.sections.torque import stand_ins
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import ReportContext, ReportPart
from bayesdrill.rig.models.linear import Model

MOST_REMEDIES = 8
WELL = 0.5  # sd of the log, from the record alone, above which an unknown is not known well
SHAPES = {
    "bounded": "the record bounds it on both sides",
    "one-sided": "the record bounds it on one side only; the prior does the rest",
    "flat": "any value of its prior fits as well: the record does not determine it",
    "at the bound": "the best fit lies at the end of its prior",
}
# The text for a parameter that is bounded only because others would leave their priors.
THROUGH_OTHERS = "by the ends of the others' priors; the record alone does not determine it"


def product(names: Sequence[str], exponents: Sequence[float]) -> str:
    """Return a product as one writes it by hand, for example `k_T r_m^2 / (k_s j_1)`."""
    above = [_power(n, e) for n, e in zip(names, exponents, strict=True) if e > 0]
    below = [_power(n, -e) for n, e in zip(names, exponents, strict=True) if e < 0]
    return fraction(above, below, " ")


def describe_study_point(point: StudyPoint, problem: Problem) -> str:
    """Return why a record is not studied at the start values; empty if the rig moves there."""
    if not point.inert:
        return ""
    named = zip(problem.names, point.theta.tolist(), strict=True)
    values = ", ".join(f"{name} = {problem.units.format_value(name, x)}" for name, x in named)
    what = f"What follows is computed at {point.description} ({values})"
    if not point.description:
        what = "Nor does it at likely draws from the priors, so that the record cannot be judged"
    holds = ", as friction may hold it" if problem.model.frictions else ""
    return (
        f"AT REST: at the start values the rig does not move{holds}, and in the record it does "
        f"({listed(point.inert)}). {what}. Give priors a `start:` with which it moves, or look at the "
        "maximum: `bayesdrill identify --at-map`."
    )


def describe_study(study: IdentifiabilityStudy, rig: Model, reasons: Sequence[str] = ()) -> str:
    """Describe all that `identify` prints; `reasons` say why not to believe the fit at the point."""
    parts = [unbelievable(reasons, converged=False), structure(study), dependence_sentences(study)]
    parts += [] if reasons else [knowledge(study), nuisances(study)]
    parts += [friction_sentences(study.frictions, rig)]
    parts += [stand_ins(study, rig), remedies(study)]
    return "\n\n".join(part for part in parts if part).rstrip()


def structure(study: IdentifiabilityStudy) -> str:
    """Describe the exact symmetries, and the products that they do not change."""
    structure = study.structure
    names = structure.names
    if not structure.symmetries and not structure.unexplained:
        return (
            f"structure: no exact symmetry; all of {listed(names)} leave a trace of their own in "
            "the measured signals"
        )
    n = len(structure.symmetries) + structure.unexplained
    lines = [
        f"structure: {_count(n, 'exact symmetry', 'exact symmetries')}, along which no record "
        "of these channels, however long or clean, shows where the rig is:"
    ]
    lines += [f"  - {line}" for line in _symmetries(study)]
    if structure.invariants:
        products = ", ".join(product(names, e) for e in structure.invariants)
        lines.append(
            f"such a record can determine {len(structure.invariants)} products of powers: {products}"
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
            f"{listed(names)} at once, without a common factor, "
            f"{'leaves' if structure.unexplained == 1 else 'leave'} every signal unchanged"
        )
    return lines


def symmetry(names: Sequence[str], exponents: Exponents) -> str:
    """Describe one symmetry in a sentence."""
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
        f"{listed(groups[e])} {'is' if len(groups[e]) == 1 else 'are'} "
        f"{'multiplied' if e > 0 else 'divided'} by {_power('f', abs(e))}"
        for e in sorted(groups, reverse=True)
    ]
    return f"for any factor f, no measured signal changes if {', and '.join(parts)}"


def dependence_sentences(study: IdentifiabilityStudy) -> str:
    """Describe unknowns that depend on fixed values or on priors, in a sentence each."""
    lines = []
    for dependence in study.resting:
        verb = "depends" if len(dependence.unknown) == 1 else "depend"
        through = listed(dependence.through)
        why = f"{through}, which the config holds. Errors of the latter become errors of the former"
        if priors := dependence.priors((dependence.narrowest,), (1,)):
            why = f"{priors_of(priors)} more than on the record, which hardly shows {through}"
        lines.append(
            f"{listed(dependence.unknown)} {verb} on {why}. In the record, "
            f"{symmetry(dependence.names, dependence.exponents)}."
        )
    return "\n".join(lines)


def priors_of(names: Sequence[str]) -> str:
    """Name the prior of one unknown, or the priors of several."""
    return f"the {'prior' if len(names) == 1 else 'priors'} of {listed(names)}"


def knowledge(study: IdentifiabilityStudy) -> str:
    """Describe how well parameters and simple products would be known, before sampling."""
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
    best = "what the record determines best: simple products, each independent of those above it"
    return "\n".join([opening, every, best, products])


def nuisances(study: IdentifiabilityStudy) -> str:
    """Describe how well nuisances would be known, and which unknowns resemble them."""
    if not study.nuisances:
        return ""
    lines = ["other unknowns (standard deviations, SI):"]
    header = ("", "with the record", "prior", "")
    rows = [(f"  {n.name}", f"{n.sd:.2g}", f"{n.prior_sd:.2g}", n.word) for n in study.nuisances]
    lines.append(aligned([header, *rows], left={0, 3}))
    for nuisance in study.nuisances:
        if nuisance.like:
            each = ", ".join(f"{other} ({times:.2g} times)" for other, times in nuisance.like)
            others = listed([other for other, _ in nuisance.like])
            lines.append(
                f"{nuisance.name} can hardly be distinguished from {others}. If it were known, sds "
                f"would be smaller: {each}."
            )
    return "\n".join(lines)


def remedies(study: IdentifiabilityStudy) -> str:
    """Describe which further measurements would help, the best first."""
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
        kept = remedy.left - study.structure.unexplained
        effect = "no symmetry is left" if kept <= 0 else f"{kept} of {n} left"
        if not remedy.breaks:
            effect = "breaks no symmetry"
        rows.append((f"  {remedy.what}", f"{remedy.shrink:.1f} x", effect if n else ""))
    lines.append(aligned(rows, left={0, 2}))
    return "\n".join(lines)


def open_products(study: IdentifiabilityStudy, thresholds: IdentifySpec) -> list[Exponents]:
    """Return products, selected as in a verdict, that a record is not expected to determine."""
    prior_sd = np.array([known.prior_sd for known in study.parameters])
    expected = study.information.with_priors(prior_sd)

    def is_open(exponents: Exponents) -> bool:
        powers = np.array(exponents, dtype=float)
        sd_ratio = expected.bound(powers) / float(np.linalg.norm(prior_sd * powers))
        return thresholds.classify(sd_ratio) != "determined"

    return [*filter(is_open, basis(study, study.names))]


def next_experiment(names: Sequence[str], quantities: Sequence[Exponents], config: str) -> str:
    """Return the command that designs an experiment for these products; empty without any."""
    if not quantities:
        return ""
    targets = ",".join(product_target(names, exponents).name for exponents in quantities)
    command = f"bayesdrill design {config} --learn '{targets}'"
    return f"to search an experiment that determines what is left open: {command}"


def summarise_study(study: IdentifiabilityStudy) -> str:
    """Describe the symmetries at the start of a run, and where to read on."""
    symmetries, rests = _symmetries(study), dependence_sentences(study).splitlines()
    if not symmetries:
        return "\n".join([_of_each(study), *rests])
    lines = [
        "no such record can determine all parameters:",
        *(f"  {line}" for line in symmetries),
        "  `bayesdrill identify` says which measurement would help",
    ]
    return "\n".join([*lines, *rests])


def _of_each(study: IdentifiabilityStudy) -> str:
    """Describe the unknowns that the record determines badly although there is no symmetry."""
    named = list(zip(study.names, study.parameters, strict=True))
    loose = [f"{name} to {percent(known.bound)}" for name, known in named if known.bound > WELL]
    open_ones = [name for name, known in named if known.word != "determined"]
    unseen = [nuisance.name for nuisance in study.nuisances if nuisance.word != "determined"]
    tied = [n for n in study.nuisances if n.like]
    if not loose and not open_ones and not tied:
        if not unseen:
            return "the record determines every unknown"
        return (
            f"the record determines every unknown but {listed(unseen)}, which it leaves largely to "
            "the prior"
        )
    parts = ["no symmetry hides an unknown from this record"]
    if loose:
        parts.append(f"without priors it would determine {listed(loose)} at best")
    if open_ones:
        parts.append(f"with them it leaves {listed(open_ones)} largely to the prior")
    for n in tied:
        parts.append(f"{n.name} can hardly be distinguished from {listed([o for o, _ in n.like])}")
    return "; ".join(parts)


def describe_profiles(
    profiles: Sequence[Profile], study: IdentifiabilityStudy, symbols: Sequence[Symbol]
) -> str:
    """Describe each profile in a line, in the units of `symbols`."""
    named = {symbol.name: symbol.plain_unit for symbol in symbols}
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


def _row(study: IdentifiabilityStudy, known_product: KnownProduct) -> tuple[str, ...]:
    # The record alone determines only ratios to other unknowns, whose priors do the rest.
    shared = math.isinf(known_product.bound) and known_product.word != "left to the prior"
    return (
        f"  {product(study.names, known_product.exponents)}",
        percent(known_product.sd),
        percent(known_product.prior_sd),
        "not at all" if math.isinf(known_product.bound) else percent(known_product.bound),
        "through the priors of others" if shared else known_product.word,
    )


def percent(sd_of_log: float) -> str:
    """Return a standard deviation of a log as a percentage; above 1000 %, only this limit."""
    value = 100.0 * sd_of_log
    if value > 1000:
        return "> 1000 %"
    return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1 else f"{name}^{exponent:g}"


def _count(n: int, text: str, many: str) -> str:
    return f"{n} {text if n == 1 else many}"


LETTER = 0.04  # width of a letter, relative to a panel
HIGHEST = 8.0  # largest loss that is shown
MARGIN = 0.04  # margin at both ends of an axis, relative to its range, for curves that end steeply


def profile_figure(
    profiles: Sequence[Profile],
    symbols: Mapping[str, Symbol],
    nominal: Mapping[str, float],
    logs: Collection[str] = (),
    width: float = scales.DOUBLE,
) -> Figure:
    """Draw the loss of each parameter, and its 95 % interval; parameters in `logs` have log axes."""
    with style.styled(width):
        width = width if len(profiles) > 1 else scales.SINGLE
        figure, panels = build_page(len(profiles), 3, 1.75, width)
        sides = set()
        for panel, profile in zip(panels, profiles, strict=True):
            known, log = nominal.get(profile.name), profile.name in logs
            sides.add(_panel(panel, profile, symbols[profile.name], known, log=log))
            side = is_first_column(panel)
            panel.tick_params(labelleft=side)
            panel.set_ylabel("loss of log likelihood" if side else "")
        return legend_above(figure, {"within 95 %": style.FAINT_BAND, **style.nominal_looks(sides)})


def _panel(
    panel: Axes, profile: Profile, symbol: Symbol, nominal: float | None, *, log: bool
) -> int:
    """Draw a profile; return the side on which the nominal value is off the axis: -1, 0 or 1."""
    low = profile.loss <= HIGHEST
    first, last = (int(k) for k in np.flatnonzero(low)[[0, -1]])
    shown = slice(max(first - 1, 0), min(last + 2, len(low)))
    values, loss = profile.values[shown], profile.loss[shown]
    scale = scales.scale(_edge(values, loss, 0), _edge(values, loss, -1), log=log, margin=MARGIN)
    fine = np.geomspace(values[0], values[-1], 400)
    from scipy.interpolate import PchipInterpolator  # imported late: only `identify` needs it

    line = PchipInterpolator(np.log(values), loss)(np.log(fine))
    panel.plot(scale(fine), line, color=style.BLACK)
    panel.plot(scale(values), loss, color=style.BLACK, marker="o", markersize=2, linestyle="none")
    panel.axhline(THRESHOLD, color=style.MIDDLE, linewidth=0.7, linestyle=(0, (1, 1)))
    left = values[0] if profile.low is None else profile.low
    right = values[-1] if profile.high is None else profile.high
    panel.axvspan(float(scale(left)), float(scale(right)), color=style.FAINT, zorder=-2)
    side = style.mark_values(panel, scale, nominal, arrow=False)
    panel.set_xlim(scale.low, scale.high)
    panel.set_ylim(-0.03 * HIGHEST, HIGHEST)
    style.set_ticks(panel.yaxis, (0.0, 2.0, 4.0, 6.0), ["0", "2", "4", "6"])
    panel.set_xlabel(scale.label(symbol), labelpad=1)
    style.set_numbers(panel.xaxis, scale, 3, clear=0.08, letter=LETTER)
    style.corner_text(panel, profile.shape, "right", fontsize=style.letters("legend.fontsize"))
    return side


def _edge(values: np.ndarray, loss: np.ndarray, end: int) -> float:
    inner = 1 if end == 0 else -2
    if len(values) < 2 or loss[end] <= HIGHEST:
        return float(values[end])
    ratio = (HIGHEST - loss[inner]) / (loss[end] - loss[inner])
    return float(values[inner] + np.sqrt(max(ratio, 0.0)) * (values[end] - values[inner]))


BAR, NARROW_BAR = 0.27, 0.42  # heights of bars [in]; narrow figures have labels above their bars
LEAST_EXPONENT = 0.15  # smaller exponents are left out of a label
BEYOND = 30.0  # factor by which the axis exceeds the finite sds at either end


def spectrum_figure(
    study: IdentifiabilityStudy, latex: Mapping[str, str], width: float = scales.DOUBLE
) -> Figure:
    """Draw a bar for each direction; it ends at the Cramer-Rao bound, on a logarithmic axis."""
    directions = study.information.directions
    wide, n = width >= scales.DOUBLE, len(directions)
    bar = BAR if wide else NARROW_BAR
    labels = [_label(study.names, d.exponents, latex) for d in directions]
    blind = {"leaves no trace in the record": BLIND}
    looks = {"prior": style.PRIOR_LINE} | (
        blind if np.isinf([d.sd for d in directions]).any() else {}
    )
    with style.styled(width):
        figure, (panel,) = build_page(1, 1, 0.5 + n * bar, width)
        _bars(panel, study, 0.62 * BAR / bar)
        panel.set_yticks(np.arange(n), labels if wide else [""] * n)
        panel.tick_params(axis="y", length=0)
        panel.set_ylim(n - 0.4, -0.6 if wide else -0.8)
        if not wide:
            across = panel.get_yaxis_transform()
            for position, label in enumerate(labels):
                panel.text(0.01, position - 0.24, label, transform=across, va="bottom")
        return legend_above(figure, looks)


def _bars(panel: Axes, study: IdentifiabilityStudy, thick: float) -> None:
    bounds = [direction.sd for direction in study.information.directions]
    sd = 100.0 * np.array(bounds)
    finite = np.isfinite(sd)
    prior = 100.0 * float(np.median([known.prior_sd for known in study.parameters]))
    largest = max(sd[finite].max(initial=prior), prior) * BEYOND
    smallest = min(sd[finite].min(initial=prior), prior) / BEYOND
    x = scales.Scale(0.0, 0, math.log10(smallest), math.log10(largest), log=True)
    places = np.arange(len(sd))
    inside = finite & (sd < prior)
    ends = np.where(finite, x(sd), x.high)
    for mask, look in ((inside, KNOWN), (finite & ~inside, UNKNOWN), (~finite, BLIND)):
        panel.barh(places[mask], ends[mask] - x.low, height=thick, left=x.low, **look)
    panel.axvline(float(x(prior)), **style.PRIOR_LINE)
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
    size = 0.94 * style.letters("legend.fontsize")
    text: dict[str, Any] = {"va": "center", "fontsize": size, "bbox": box}
    for k in places[finite]:
        at = (ends[k], k)
        panel.annotate(percent(bounds[k]), at, (3, 0), textcoords="offset points", **text)
    label = "relative standard deviation of the product, record alone [%]"
    style.scale_axis(panel.xaxis, x, label, 8)


KNOWN: dict[str, Any] = {"facecolor": style.DARK}
UNKNOWN: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.DARK, "linewidth": 0.5}
BLIND: dict[str, Any] = {**style.HATCHED, "facecolor": "white", "linewidth": 0.5, "hatch": "//////"}


def _label(names: Sequence[str], exponents: Sequence[float], latex: Mapping[str, str]) -> str:
    parts = []
    for name, exponent in zip(names, exponents, strict=True):
        if abs(exponent) >= LEAST_EXPONENT:
            rounded = f"{exponent:.1f}".removesuffix(".0")
            power = "" if rounded == "1" else f"^{{{rounded}}}"
            parts.append(f"{{{latex[name]}}}{power}")
    return "$" + r"\,".join(parts) + "$"


NO_FINDING = "nothing found: energy, poles and sampling are as in a real rig"


def _sections(run: ReportContext, _: Sequence[Picture]) -> Iterator[Section]:
    judged = run.analysis.judged
    if judged is None:
        return
    study, records = judged.study, len(run.problem.observations)
    known = () if run.reasons else (knowledge,)
    parts = (words_of(study) for words_of in (structure, dependence_sentences, *known))
    yield build(
        f"What {'this record' if records == 1 else 'these records'} can show, at the MAP",
        Plain("\n\n".join(filter(None, parts))),
        friction_sentences(study.frictions, run.problem.model),
        stand_ins(study, run.problem.model),
        brief=False,
    )
    physical = "\n".join(finding_sentences(judged.findings)) or NO_FINDING
    yield build("Physical consistency of the posterior", physical, brief=False)


PART = ReportPart(sections=_sections)
