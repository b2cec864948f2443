"""Describe a designed experiment: sds before and after it, hidden targets, and a figure."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.symbols import Symbol
from bayesdrill.design.study import DESIGNED, RECORDED, REPEATED, ExperimentDesign, TargetOutlook
from bayesdrill.design.waveforms import FAMILIES, FREE
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import scales, style
from bayesdrill.report.pages import build_page, legend_above
from bayesdrill.report.section import aligned, lines_as_csv, listed
from bayesdrill.report.sections.identifiability import percent
from bayesdrill.report.style import Axes, Figure

SHOWN = (RECORDED, *FAMILIES, REPEATED, DESIGNED)  # waveforms of the table
ALIKE = 1.05  # ratio of two waveforms' sds, up to which the waveforms are called equally sharp
CRITERION = "log det"


def describe_design(design: ExperimentDesign) -> str:
    """Return the whole text of a design for the terminal."""
    parts = [_opening(design), design_table(design), target_sentences(design)]
    parts += [odds_sentence(design), _limits(design), _variants(design)]
    return "\n\n".join(filter(None, parts))


def _opening(design: ExperimentDesign) -> str:
    source = design.request.source
    family = "free levels" if design.request.family == FREE else design.request.family
    where = "at the start values"
    if design.draws > 1 or design.known_from != "the prior":
        draws = count_noun(design.draws, "draw")
        where = f"averaged over {draws} of {design.known_from}, each of them a possible rig"
    waveform = "a waveform" if len(design.levels) == 1 else f"{len(design.levels)} waveforms"
    promised = "expected log odds" if design.log_odds else "promised relative sds"
    return (
        f"{waveform} of {source.input} for {source.t[-1]:.4g} s: {count_noun(source.count, 'level')} "
        f"from {source.low:.4g} to {source.high:.4g} in SI, each held for "
        f"{source.interval:.4g} s ({family})\n"
        f"{promised}, {where}:"
    )


def design_table(design: ExperimentDesign) -> str:
    """Return the table of sds before and after the recorded, the usual and the designed waveform."""
    names = [n for n in SHOWN if n in design.criteria or n in design.log_odds]
    if design.log_odds:
        odds = ("  log odds", *(f"{design.log_odds[name]:.3g}" for name in names))
        return aligned([("", *names), odds], left={0})
    head = ("", "now", *names)
    rows = [
        (f"  {target.name}", percent(target.now), *(percent(target.after[name]) for name in names))
        for target in design.targets
    ]
    total = (f"  {CRITERION}", "", *(f"{design.criteria[name]:.1f}" for name in names))
    return aligned([head, *rows, total], left={0})


def target_sentences(design: ExperimentDesign) -> str:
    """Return a sentence for each target, and the remedies that are known for it."""
    lines: list[str] = []
    for target in design.targets:
        lines += [_sentence(target)]
        lines += [f"  {what}: this divides its sd by {fall:.3g}" for what, fall in target.remedies]
    return "\n".join(lines)


def _sentence(target: TargetOutlook) -> str:
    if target.hidden_by:
        scaled = "; ".join(", ".join(names) for names in target.hidden_by)
        return (
            f"{target.name}: no waveform shows it, as scaling {scaled} together changes no channel"
        )
    sds = target.usual_sds
    best = min(sds, key=lambda name: sds[name])
    ratio = sds[best] / target.designed
    if target.designed > 0.9 * target.now:
        return f"{target.name}: hardly any waveform within these limits shows it above the noise"
    if ratio > ALIKE:
        compared = f"{ratio:.2g} times as sharp as {best}, the best usual waveform for it"
    elif ratio * ALIKE >= 1.0:
        compared = f"as sharp as {best}, the best usual waveform for it"
    else:
        compared = f"{best} would be {1 / ratio:.2g} times as sharp for it alone"
    return f"{target.name}: from {percent(target.now)} to {percent(target.designed)}, {compared}"


def odds_sentence(design: ExperimentDesign) -> str:
    """Describe what log odds mean, and compare those of a design with the best usual waveform."""
    if not design.log_odds:
        return ""
    log_odds = {n: odds for n, odds in design.log_odds.items() if n not in (RECORDED, DESIGNED)}
    best = max(log_odds, key=lambda name: log_odds[name])
    ratio = design.log_odds[DESIGNED] / log_odds[best]
    times = "about" if 1.0 / ALIKE <= ratio <= ALIKE else f"{ratio:.2g} times"
    return (
        "The config is taken to be true, and the other model is fitted to its record. Odds of 20 to 1 "
        f"are log odds of 3.\nThe designed waveform has {times} the log odds of {best}, the "
        "best usual waveform."
    )


def _limits(design: ExperimentDesign) -> str:
    if not design.request.limits:
        return ""
    limits = listed([limit.describe() for limit in design.request.limits])
    return f"{100 * design.kept:.3g} % of the draws keep the limits {limits}"


def _variants(design: ExperimentDesign) -> str:
    """Return the table of sds for the same waveform with other channels, rates, times and repeats."""
    if not design.variants:
        return ""
    head = ("", *(target.name for target in design.targets))
    rows = [(f"  {name}", *map(percent, sds)) for name, sds in design.variants.items()]
    title = "relative sds after the same waveform with other channels, rates, times or repeats:"
    return f"{title}\n{aligned([head, *rows], left={0})}"


def design_csv(design: ExperimentDesign) -> str:
    """Return relative sds as CSV: a column for each target, a row for each waveform and variant."""
    names = [target.name for target in design.targets]
    rows = [[n, *(t.after[n] for t in design.targets)] for n in design.criteria]
    rows = [["now", *(t.now for t in design.targets)], *rows]
    rows += [[name, *sds] for name, sds in design.variants.items()]
    return lines_as_csv([["experiment", *names], *rows])


def design_figure(
    design: ExperimentDesign, problem: Problem, width: float = scales.DOUBLE
) -> Figure:
    """Draw the waveform, the expected response with limits, and the sds of the targets."""
    panels_of = [*_responses(design, problem)]
    with style.styled(width):
        columns = 2 if len(panels_of) > 1 else 1
        last = 0.5 + 0.24 * len(design.targets) if design.targets else 0
        figure, panels = build_page(len(panels_of), columns, 1.25, width, first=1.1, last=last)
        source = design.request.source
        time = scales.scale(0.0, float(source.t[-1]))
        _waveform(panels[0], design, problem.model.symbols[source.input], time)
        looks: dict[str, style.Look] = {
            "designed": style.BLACK_LINE,
            "98 % of the draws": style.BAND,
        }
        if design.targets:
            _sds(panels.pop(), design.targets)
            looks |= {
                "as recorded": RECORDED_MARK,
                "best usual": USUAL_MARK,
                "now": style.PRIOR_LINE,
            }
        for panel, (label, band, ends) in zip(panels[1:], panels_of, strict=True):
            t = np.linspace(0.0, source.t[-1], band.shape[1])
            _response(panel, t, time, label, band, ends)
        if design.request.limits:
            looks["limit"] = LIMIT_LINE
        return legend_above(figure, looks)


LIMIT_LINE = style.fix_look(color=style.MAP_COLOUR, linestyle=(0, (5, 2)), linewidth=1.0)
DESIGNED_MARK = style.fix_look(color=style.BLACK, marker="o", markersize=4, linestyle="none")
RECORDED_MARK = style.fix_look(
    color=style.MIDDLE, marker="s", markersize=3.5, linestyle="none", markerfacecolor="white"
)
USUAL_MARK = style.fix_look(
    color=style.NOMINAL["color"], marker="D", markersize=3.5, linestyle="none"
)
MARK_SHIFT = 0.23  # vertical shift of marks within a row, as marks of equal sds would overlap


def _waveform(panel: Axes, design: ExperimentDesign, symbol: Symbol, time: scales.Scale) -> None:
    source = design.request.source
    edges = np.append(np.arange(source.count) * source.interval, source.t[-1])
    y = scales.scale(source.low, source.high, margin=0.08)
    levels = np.hstack([design.levels, design.levels[:, -1:]])
    panel.plot(time(edges), y(levels.T), drawstyle="steps-post", **style.BLACK_LINE)
    style.scale_axis(panel.yaxis, y, y.label(symbol, "\n"), 4)
    style.scale_axis(panel.xaxis, time, time.label(scales.TIME), 10)


def _responses(
    design: ExperimentDesign, problem: Problem
) -> Iterator[tuple[scales.Labelled, Array, tuple[float, ...]]]:
    """Yield label, band `(3, T)` and limits of each channel and of each further limited quantity."""
    limits = design.request.limits
    ends = {limit.text: tuple(filter(np.isfinite, (limit.low, limit.high))) for limit in limits}
    for k, channel in enumerate(design.experiment.channels):
        unit = channel.display_unit
        label = dataclasses.replace(channel, latex_unit=unit.latex)
        here = tuple(x / unit.factor for x in ends.pop(channel.name, ()))
        yield label, design.bands[..., k] / unit.factor, here
    for k, limit in enumerate(limits):
        if limit.text in ends:
            known: Mapping[str, Symbol] = problem.model.symbols
            shown = limit.text.replace("_", r"\_").replace("**", "^").replace("*", r"\,")
            plain = Symbol(limit.text, "", rf"\mathrm{{{shown}}}", "", "")
            yield known.get(limit.text, plain), design.limited[..., k], ends[limit.text]


def _response(
    panel: Axes,
    t: Array,
    time: scales.Scale,
    label: scales.Labelled,
    band: Array,
    ends: tuple[float, ...],
) -> None:
    low, middle, high = band
    reach = [float(low.min()), float(high.max()), *ends]
    y = scales.scale(min(reach), max(reach), margin=0.08)
    panel.fill_between(time(t), y(low), y(high), **style.BAND)
    panel.plot(time(t), y(middle), **style.BLACK_LINE)
    for end in ends:
        panel.axhline(float(y(end)), **LIMIT_LINE)
    style.scale_axis(panel.yaxis, y, y.label(label, "\n"), 4)
    style.scale_axis(panel.xaxis, time, time.label(scales.TIME), 5)


def _sds(panel: Axes, targets: tuple[TargetOutlook, ...]) -> None:
    rows = np.arange(len(targets))
    every = [sd for target in targets for sd in (target.now, *target.after.values())]
    x = scales.scale(100 * min(every), 100 * max(every), log=True, margin=0.05)
    usual = [min(target.usual_sds.values()) for target in targets]
    now = [target.now for target in targets]
    for row, sd in zip(rows, now, strict=True):
        panel.plot([float(x(100 * sd))] * 2, [row - 0.3, row + 0.3], **style.PRIOR_LINE)
    for sds, shift, look in (
        ([target.after[RECORDED] for target in targets], MARK_SHIFT, RECORDED_MARK),
        (usual, -MARK_SHIFT, USUAL_MARK),
        ([target.designed for target in targets], 0.0, DESIGNED_MARK),
    ):
        panel.plot(x(100 * np.array(sds)), rows + shift, **look)
    panel.set_ylim(len(targets) - 0.4, -0.6)
    panel.set_yticks(rows, [target.name.replace("**", "^") for target in targets])
    panel.yaxis.tick_right()  # labels at the left would move the labels of all other panels
    panel.tick_params(axis="y", length=0)
    style.scale_axis(panel.xaxis, x, "relative standard deviation [%]", 8)
