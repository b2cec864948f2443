"""Report the missing torque: sentences, a table, a file, and a figure over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy
from bayesdrill.analysis.latent_torque import TAILS, TorqueEstimate, TorqueRegression
from bayesdrill.analysis.run_analysis import TorqueSummary
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.report import scales, section, style
from bayesdrill.report.pages import build_page, is_first_column, legend_above
from bayesdrill.report.scales import time_symbol
from bayesdrill.report.section import CREDIBLE, Note, Picture, Section, Table, build, listed
from bayesdrill.report.sections.friction import speed_symbol
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart, for_each_experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import ROTARY

BINS = 24  # largest number of bins of a panel
FEWEST = 5  # smallest number of samples of a bin that is shown
TORQUE = Symbol("d", "N*m", "d", r"N\,m", "missing torque")


@dataclass(frozen=True, slots=True, kw_only=True)
class Against:
    """A quantity that a torque may follow, named by `label`, has `values (T,)` in the record.

    In bins around `centres (B,)`, the expected torque has the `means (B,)`, and the means of draws
    have the `band (2, B)`.
    """

    label: Symbol
    values: Array
    centres: Array
    means: Array
    band: Array


def regressors(torque: TorqueEstimate) -> Iterator[Against]:
    """Yield what a torque may follow: speeds, its inertia's first; angle within a turn; inputs."""
    rig, here = torque.rig, torque.inertia
    for inertia, (name, speed) in zip(torque.turned, torque.speeds, strict=True):
        geared = inertia if inertia.reduction != 1.0 else None
        yield _binned(torque, speed_symbol(name, geared, rig), speed)
    turns = torque.angle / (2 * np.pi)
    if rig.roles.motion == ROTARY and np.ptp(turns) > 1.0:
        latex = here.latex or rig.symbols[here.angle].latex
        meaning = f"angle of {here.words} within a turn, in turns"
        yield _binned(torque, Symbol("turn", "1", rf"{latex}/2\pi", "", meaning), turns % 1.0)
    for name, values in torque.inputs.items():
        if name not in torque.states:
            yield _binned(torque, rig.symbols[name], values)


def _binned(torque: TorqueEstimate, label: Symbol, values: Array) -> Against:
    edges = np.linspace(values.min(), values.max(), BINS + 1)
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    counts = np.bincount(which, minlength=BINS)
    good = np.flatnonzero(counts >= FEWEST)
    sums = np.zeros((len(torque.draws), BINS))
    for k in good:
        sums[:, k] = torque.draws[:, which == k].mean(axis=1)
    means = np.bincount(which, weights=torque.expected, minlength=BINS)
    return Against(
        label=label,
        values=values,
        centres=0.5 * (edges[1:] + edges[:-1])[good],
        means=means[good] / counts[good],
        band=np.quantile(sums[:, good], TAILS, axis=0),
    )


HARMLESS = 0.5  # admissible error of the linear approximation, rms in sds of the noise
FULL = 0.95  # share of samples in motion, above which the other samples are not mentioned
WIDE = 3.0  # a proposed prior reaches from size / WIDE to size * WIDE
HEADS = ("channel", "left without it", "left with it", "moved by it")
READ = (
    "Root mean squares divided by the spread of the channel, at the mean of the draws. *left with it*: "
    "residuals with the torque that all samples determine; with a right model, they are sensor noise. "
    "*moved by it*: the torque's effect on the channel. `torque.csv` has the torque at each sample, and "
    "the figure `torque` shows it."
)


def _where(at: str, rig: Model) -> str:
    inertia = rig.roles.inertia(at)
    return inertia.at if inertia.reduction == 1.0 else f"{inertia.at} (on its own side of the gear)"


def torque_sentence(summary: TorqueSummary, rig: Model) -> str:
    """Describe how large a missing torque is, and how well it is known."""
    of, motion = f" in {summary.label}" if summary.label else "", rig.roles.motion
    return (
        f"missing {motion.torque}{of}: {_where(summary.at, rig)} {summary.low:.3g} to "
        f"{summary.high:.3g} {motion.newtons} in 94 % of the samples, each known to "
        f"{summary.width:.2g} {motion.newtons}. Its sign is sure in {100 * summary.sure:.0f} % of the "
        "samples."
    )


def approximation_note(rig: Model) -> str:
    """Describe the approximation for a rig that is not linear, before anything is sampled."""
    if rig.saturation and not rig.frictions:
        return (
            "missing torque: with a servo that saturates it is an approximation, as if the servo "
            "never did. It is good if the torque moves the servo little."
        )
    if not rig.frictions:
        return (
            "missing torque: with gravity it is an approximation, as if a pendulum were a spring. It "
            "is good if the torque moves the pendulum little."
        )
    return (
        "missing torque: with friction it is an approximation, as if no friction changed its sign. A "
        "torque much smaller than the friction is estimated well. For a larger one leave the friction "
        "out: the torque then shows it."
    )


def strayed(summary: TorqueSummary, rig: Model) -> str:
    """Describe the error of the linear approximation; empty for a linear rig."""
    every = [course for course in summary.courses if np.isfinite(course.strayed)]
    if not every:
        return ""
    parts = ", ".join(f"{course.strayed:.2g} (`{course.channel}`)" for course in every)
    what, unsure, then = "gravity", "Weight", ""
    if rig.saturation:
        what, unsure = "a servo that saturates", "The loop"
    if rig.frictions:
        what, unsure = "friction", "Friction"
        then = ". Leave the friction out: the torque then shows it"
    said = (
        f"missing torque: with {what} it is an approximation. The rig with {what}, and with this "
        f"torque as an input, moves differently by {parts} sds of the noise, rms"
    )
    if max(course.strayed for course in every) <= HARMLESS:
        return f"{said}, which does little harm"
    return f"{said}. {unsure} and inertia are NOT as sure as their sds say{then}"


def law_sentences(summary: TorqueSummary, rig: Model) -> str:
    """Describe the laws that the torque follows, a line each, and the equivalent parameters."""
    every, torque = summary.follows, rig.roles.motion.torque
    taken = [_line(summary, law, rig) for law in every if law.taken]
    if taken:
        return "\n".join(taken)
    none = f"missing {torque}: it follows no speed, angle, input or time by a law known here"
    if not every:
        return none
    what, _ = _follows(summary, every[0], rig)
    return f"{none} (at most {100 * every[0].share:.0f} %: {what})"


def _line(summary: TorqueSummary, law: TorqueRegression, rig: Model) -> str:
    size, sd = abs(law.size), f"{law.sd:.1g}"
    here, motion = rig.roles.inertia(summary.at), rig.roles.motion
    against, (what, unit) = law.size < 0, _follows(summary, law, rig)
    claim = f"That alone explains {100 * law.share:.0f} % of the {motion.torque}."
    if (turning := summary.turning) < FULL:
        claim += f" That counts the {100 * turning:.0f} % of the samples in which it {motion.verb}."
    said = f"missing {motion.torque}: it follows {what}. {claim} It looks like"
    if law.kind == "sign" and against:
        said += f" dry friction {here.at} of {size:.3g} {motion.newtons} (sd {sd})"
    elif law.kind == "speed" and against:
        said += f" viscous damping {here.at} of {size:.3g} {unit} (sd {sd})"
    else:
        said += f" {law.size:.3g} {unit} (sd {sd})"
    # The parameter that replaces the torque in a config.
    name = {"sign": here.sliding, "speed": here.damping}.get(law.kind)
    if not name or law.of != here.speed or not against:
        return said
    prior = f"{{prior: log_uniform, low: {size / WIDE:.2g}, high: {size * WIDE:.2g}}}"
    return f"{said}. To have it in the equations, write `parameters: {{{name}: {prior}}}`"


def _follows(summary: TorqueSummary, law: TorqueRegression, rig: Model) -> tuple[str, str]:
    here, newtons = rig.roles.inertia(summary.at), rig.roles.motion.newtons
    angle = rig.roles.motion.angle
    inertia = here if here.speed == law.of else rig.roles.at_friction(law.of)
    speed = f"the speed of {inertia.words if inertia else law.of}"
    return {
        "sign": (f"the sign of {speed}", f"{newtons} with its sign"),
        "speed": (speed, f"{newtons} s/{angle}"),
        "square": (f"the square of {speed}", f"{newtons} s^2/{angle}^2"),
        "turn": ("the angle within a turn", f"{newtons}, once a turn"),
        "input": (f"the input {law.of}", f"{newtons} per SI unit of it"),
        "constant": ("nothing, and is constant", newtons),
        "drift": ("the time", f"{newtons}/s"),
    }[law.kind]


def stand_ins(study: IdentifiabilityStudy, rig: Model) -> str:
    """Describe what a missing torque can replace, a line each; empty if there is nothing."""
    lines = []
    for *others, size in study.scaled:
        every = listed(others)
        lines.append(
            f"missing torque: {every} and {size} can be changed together without changing any measured "
            "signal. A stiffer spring with a larger torque cannot be distinguished from a "
            f"softer one with a smaller torque. Hold one of {every}, or measure the torque."
        )
    do = {"hold": "holding", "measure": "a sensor of"}
    for confounding in study.stand_ins:
        ways = [
            f"{do[h.kind]} {h.name} (sd {h.shrink:.2g} times smaller)" for h in confounding.helps
        ]
        would = f" What would show it: {', or '.join(ways)}." if ways else ""
        lines.append(
            f"missing torque: {_where(confounding.at, rig)} it can stand in for {confounding.name}: the "
            f"sd of log {confounding.name} is {confounding.sd:.2g} with the torque, "
            f"{confounding.alone:.2g} without it, {confounding.before:.2g} by the prior.{would}"
        )
    return "\n".join(lines)


def torque_table(summary: TorqueSummary) -> Table:
    """Return the table of residuals of each channel with and without the torque."""
    lines = []
    for course in summary.courses:
        sizes = (course.without, course.left, course.moved)
        lines.append((course.channel, *(f"{100 * x / course.spread:.3g} %" for x in sizes)))
    return Table(HEADS, tuple(lines), frozenset(HEADS[:1]))


def torque_csv(estimates: Sequence[TorqueEstimate]) -> str | None:
    """Return CSV of the torque with a line for each sample, in SI units, or None."""
    if not estimates:
        return None
    names = list(dict.fromkeys(n for course in estimates for n in (*course.states, *course.inputs)))
    lines: list[Sequence[object]] = [["experiment", "t", "torque", "sd", "low", "high", *names]]
    for course in estimates:
        sds, (low, high) = course.draws.std(axis=0), course.band
        columns = [course.states.get(n, course.inputs.get(n)) for n in names]
        for k, t in enumerate(course.t):
            row = [course.label, t, course.expected[k], sds[k], low[k], high[k]]
            lines.append([*row, *(None if c is None else c[k] for c in columns)])
    return section.lines_as_csv(lines)


TORQUE_POINTS = 1200  # largest number of points of a line over time, and of dots in a panel


def torque_figure(torque: TorqueEstimate, width: float = scales.DOUBLE, *, clock: Unit) -> Figure:
    """Draw a missing torque over time, and against each quantity that it may follow."""
    band, against = torque.band, list(regressors(torque))
    y = scales.scale(float(band[0].min()), float(band[1].max()), margin=0.04)
    with style.styled(width):
        figure, (panel, *panels) = build_page(len(against), 2, 2.0, width, narrow=1, first=2.0)
        x = scales.scale(float(torque.t[0] / clock.factor), float(torque.t[-1] / clock.factor))
        drawn = style.thin(len(torque.t), TORQUE_POINTS)
        t = x(torque.t[drawn] / clock.factor)
        panel.fill_between(t, *y(band[:, drawn]), **style.BAND)
        panel.plot(t, y(torque.expected[drawn]), **style.BLACK_LINE)
        _finish(panel, x, y, time_symbol(clock))
        for panel, regressor in zip(panels, against, strict=True):
            x = scales.scale(
                float(regressor.values.min()), float(regressor.values.max()), margin=0.02
            )
            drawn = style.thin(len(regressor.values), TORQUE_POINTS)
            panel.plot(x(regressor.values[drawn]), y(torque.expected[drawn]), **style.DOTS)
            panel.fill_between(x(regressor.centres), *y(regressor.band), zorder=1, **style.BAND)
            panel.plot(x(regressor.centres), y(regressor.means), zorder=3, **style.BLACK_LINE)
            _finish(panel, x, y, regressor.label)
            if not is_first_column(panel):
                panel.set_ylabel("")
                panel.tick_params(labelleft=False)
        samples = {**style.DOTS, "markersize": 3, "rasterized": False}
        looks = {"mean": style.BLACK_LINE, f"{CREDIBLE} posterior": style.BAND}
        return legend_above(figure, looks | {"samples": samples})


def _finish(panel: Axes, x: scales.Scale, y: scales.Scale, across: Symbol) -> None:
    style.scale_axis(panel.xaxis, x, f"{across.meaning}, {x.label(across)}", 5)
    style.scale_axis(panel.yaxis, y, y.label(TORQUE, "\n"))
    if y.low < 0.0 < y.high:
        panel.axhline(float(y(0.0)), color=style.MIDDLE, linewidth=0.5, zorder=0)
    if x.low < 0.0 < x.high:
        panel.axvline(float(x(0.0)), color=style.MIDDLE, linewidth=0.5, zorder=0)


def _draw_torque(run: ReportContext) -> tuple[Drawing, ...]:
    shown = ((torque.label, torque) for torque in run.chain.torque_estimates)
    figure = partial(torque_figure, clock=run.problem.clock)
    says = "The missing torque over time, and against what the rig did: speeds, angle, inputs."
    return for_each_experiment(figure, shown, run.width, says)


def _sections(run: ReportContext, pictures: Sequence[Picture]) -> Iterator[Section]:
    for k, torque in enumerate(run.analysis.torques):
        where = f" of {torque.label}" if torque.label else ""
        parts = (torque_sentence, law_sentences, strayed)
        said = "\n".join(filter(None, (words_of(torque, run.problem.model) for words_of in parts)))
        picture = pictures[k : k + 1]
        yield build(f"The missing torque{where}", said, torque_table(torque), Note(READ), *picture)


PART = ReportPart(
    sections=_sections,
    figures={"torque": _draw_torque},
    files={"torque.csv": lambda run: torque_csv(run.chain.torque_estimates)},
)
