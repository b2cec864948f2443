"""Figures of the paper's studies: printed matrix, two-parameter test, fit, searches, and Table 3."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesdrill.basics import PARAMETERS, STATES, Array, own_symbol
from bayesdrill.inference import HDI_PROBABILITY, hdi
from bayesdrill.paper import printed as paper
from bayesdrill.paper.forward import Reading
from bayesdrill.paper.searches import End, Heuristic, Verification
from bayesdrill.record import Experiment
from bayesdrill.report import (
    LINE_POINTS,
    TIME,
    Page,
    extremes,
    scales,
    set_decades,
    set_factors,
    style,
    usable,
)

Look = Mapping[str, Any]

FIT_LEGEND: Look = {"loc": "upper center", "borderaxespad": 0.3, "columnspacing": 1.6}

# The printed matrix

PAIR = Page(
    columns=2,
    width=scales.DOUBLE,
    row=2.0,
    left=0.62,
    right=0.12,
    gap_x=0.74,
    gap_y=0.0,
    top=0.46,
    bottom=0.42,
)
SHORT = {
    "right": r"corrected: $A_{51}$ over $j_m$, $i_n = 1/i_m$",
    "a_51": r"$A_{51}$ over $j_1$ (printed), $i_n = 1/i_m$",
    "i_n": r"$A_{51}$ over $j_m$, $i_n = i_m$",
    "printed": r"$A_{51}$ over $j_1$ (printed), $i_n = i_m$",
}
CURVES: tuple[Look, ...] = (
    {"color": style.BLACK, "linestyle": "-", "linewidth": 1.4},
    {"color": style.NOMINAL["color"], "linestyle": (0, (4, 2)), "linewidth": 1.1},
    {"color": style.MAP_COLOUR, "linestyle": (0, (1, 1.2)), "linewidth": 1.4},
    {"color": style.MIDDLE, "linestyle": (0, (6, 1.5, 1, 1.5)), "linewidth": 1.0},
)
BAND: Look = {"color": "0.95", "linewidth": 0, "zorder": -2}  # that range, in both panels
BELOW, ABOVE = 0.25, 1.3  # what the near panel shows, over the largest of the right speed


def readings_figure(readings: Sequence[Reading]) -> Figure:
    """Speeds of theta_2 over time: all of them, and those near the first, which is the right one."""
    far = np.concatenate([reading.curve for reading in readings])
    right = float(np.abs(readings[0].curve).max())
    near = (-BELOW * right, ABOVE * right)
    margin = 0.06 * float(far.max() - far.min())
    ranges = ((float(far.min()) - margin, float(far.max()) + margin), near)
    time = scales.scale(0.0, max(reading.time for reading in readings))
    with style.styled():
        figure, panels = PAIR.build(2)
        for panel, (low, high) in zip(panels, ranges, strict=True):
            speed = scales.scale(low, high)
            for k, reading in enumerate(readings):
                looks = CURVES[k % len(CURVES)]
                panel.plot(time(reading.t), speed(reading.curve), zorder=3 - 0.1 * k, **looks)
            _axes(panel, time, speed)
            panel.set_xlabel(time.label(TIME))
            style.side_label(panel, speed.label(STATES["w_2"]))
        everything = scales.scale(*ranges[0])
        panels[0].axhspan(*(float(everything(x)) for x in near), **BAND)
        panels[1].set_facecolor(BAND["color"])
        handles = [
            Line2D([], [], label=_ending(reading), **CURVES[k % len(CURVES)])
            for k, reading in enumerate(readings)
        ]
        figure.legend(handles=handles, ncols=2, handlelength=3.0, labelspacing=0.25, **FIT_LEGEND)
    return figure


def _axes(panel: Axes, time: scales.Scale, numbers: scales.Scale) -> None:
    panel.set_xlim(time.low, time.high)
    panel.set_ylim(numbers.low, numbers.high)
    style.set_ticks(panel.xaxis, *scales.ticks(time.low, time.high, 6, clear=0.0))
    style.set_ticks(panel.yaxis, *scales.ticks(numbers.low, numbers.high, 5))


def _ending(reading: Reading) -> str:
    end = f"{round(reading.w_end, 1) + 0.0:g}".replace("-", "\N{MINUS SIGN}")
    return rf"{SHORT[reading.name]}; settles at {end} rad/s"


# Table 2

BOUND: Look = {"color": style.BLACK, "linestyle": "-", "linewidth": 1.0}
FMINSEARCH: Look = {
    "color": style.NOMINAL["color"],
    "marker": "o",
    "markersize": 6.5,
    "markerfacecolor": "none",
    "markeredgewidth": 1.1,
    "linestyle": "none",
}
SCALED: Look = {
    "color": style.BLACK,
    "marker": "+",
    "markersize": 6,
    "markeredgewidth": 1.0,
    "linestyle": "none",
}
PRINTED: Look = {
    "color": style.MAP_COLOUR,
    "marker": "D",
    "markersize": 4,
    "linestyle": (0, (1, 1.5)),
    "linewidth": 0.9,
}
SINGLES: Look = {**style.DOTS, "color": style.MIDDLE, "markersize": 1.6, "alpha": 0.4}
BIG: Look = {**SINGLES, "markersize": 2.5, "alpha": 0.8, "rasterized": False}
ASIDE = 0.14  # decades, between a sigma and the single estimates of each way
LEAST_SHARE = 0.02  # of the single estimates may be below the panel


def verification_figure(
    v: Verification, printed: Mapping[float, Mapping[str, paper.Estimate]]
) -> Figure:
    """A panel for each unknown, relative errors in per cent; `printed` by sigma and name."""
    with style.styled():
        figure, panels = PAIR.build(len(v.names))
        for k, (panel, name) in enumerate(zip(panels, v.names, strict=True)):
            _errors(panel, v, k, {s: row[name] for s, row in printed.items() if name in row})
            panel.set_xlabel(r"$\sigma_n$ [rad, rad/s]")
            style.side_label(panel, rf"relative error of ${PARAMETERS[name].latex}$ [%]")
        handles = [
            Line2D([], [], label="Cramér-Rao bound of the sd", **BOUND),
            Line2D([], [], label=f"sd of {v.records} estimates, fminsearch", **FMINSEARCH),
            Line2D([], [], label=f"sd of {v.records} estimates, scaled search", **SCALED),
            Line2D([], [], label="reported in the paper", **PRINTED),
            Line2D([], [], label="single estimates (fminsearch left)", **BIG),
        ]
        figure.legend(handles=handles, ncols=3, handlelength=2.2, labelspacing=0.25, **FIT_LEGEND)
    return figure


def _errors(panel: Axes, v: Verification, k: int, printed: Mapping[float, paper.Estimate]) -> None:
    name, truth = v.names[k], abs(float(v.truth[k]))
    sigmas = np.array(v.sigmas)
    cells = [v.cell(sigma, name) for sigma in v.sigmas]

    def percent(values: Sequence[float] | Array) -> Array:
        return np.asarray(100.0 * np.abs(values) / truth, dtype=np.float64)

    bound = percent([cell.bound for cell in cells])
    spreads = {
        "fminsearch": percent([cell.sd_fminsearch for cell in cells]),
        "scaled": percent([cell.sd_scaled for cell in cells]),
    }
    singles = []
    for side, way in ((-1, "fminsearch"), (1, "scaled")):
        for sigma in v.sigmas:
            off = percent(v.estimates[way][sigma][:, k] - v.truth[k])
            off = off[off > 0]
            panel.plot(np.full(len(off), sigma * 10 ** (side * ASIDE)), off, **SINGLES)
            singles.append(off)
    shown = np.array([[s, cell.deviation] for s, cell in sorted(printed.items())]).reshape(-1, 2)
    panel.plot(sigmas, bound, zorder=2, **BOUND)
    panel.plot(sigmas, spreads["fminsearch"], zorder=3, **FMINSEARCH)
    panel.plot(sigmas, spreads["scaled"], zorder=4, **SCALED)
    panel.plot(*shown.T, zorder=5, **PRINTED)
    every = usable(np.concatenate([bound, *spreads.values(), shown[:, 1]]))
    low = min([every.min(), *(np.quantile(off, LEAST_SHARE) for off in singles if len(off))])
    high = max([every.max(), *(off.max() for off in singles if len(off))])
    set_decades(panel.yaxis, low / 1.6, high * 1.6)
    set_decades(panel.xaxis, sigmas.min() / 2.2, sigmas.max() * 2.2)


# The fit

FIT = dataclasses.replace(PAIR, row=1.45, gap_y=0.14, top=0.32)
MEASURED: Look = {"color": style.NOMINAL["color"], "linestyle": "-", "linewidth": 0.8}
ESTIMATED: Look = {
    "color": style.MAP_COLOUR,
    "marker": "o",
    "markersize": 3,
    "markerfacecolor": "white",
    "markeredgewidth": 0.8,
    "linestyle": "none",
}
MARKS = 41


def fit_paper_figure(experiment: Experiment, estimated: Array) -> Figure:
    """A panel for each channel, SI: the record as a line, `estimated (T, K)` as marks."""
    t, n = experiment.t, len(experiment.channels)
    margin = 0.015 * float(t[-1] - t[0])
    time = scales.scale(float(t[0]) - margin, float(t[-1]) + margin)
    marks = style.thin(len(t), MARKS)
    with style.styled():
        figure, panels = FIT.build(n)
        for k, (panel, channel) in enumerate(zip(panels, experiment.channels, strict=True)):
            y, model = experiment.y[:, k], estimated[:, k]
            low, high = min(y.min(), model.min()), max(y.max(), model.max())
            room = 0.07 * float(high - low)
            numbers = scales.scale(float(low) - room, float(high) + room)
            line = extremes(y, LINE_POINTS)
            panel.plot(time(t[line]), numbers(y[line]), **MEASURED)
            panel.plot(time(t[marks]), numbers(model[marks]), zorder=3, **ESTIMATED)
            _axes(panel, time, numbers)
            style.side_label(panel, numbers.label(channel))
            lowest = k + FIT.columns >= n
            panel.tick_params(labelbottom=lowest)
            if lowest:
                panel.set_xlabel(time.label(TIME))
        handles = [
            Line2D([], [], label="record", **MEASURED),
            Line2D([], [], label="estimated", **ESTIMATED),
        ]
        figure.legend(handles=handles, ncols=2, **FIT_LEGEND)
    return figure


FLOOR: Look = {"color": style.MIDDLE, "linestyle": (0, (4, 2)), "linewidth": 0.9, "zorder": 1}

# Where searches end

LEFT, RIGHT, GAP, TOP, BOTTOM, ROW = 0.62, 0.14, 0.72, 0.32, 0.42, 2.3  # inches
WAYS: Mapping[str, tuple[str, Look]] = {
    "fminsearch": ("fminsearch", {"color": style.NOMINAL["color"], "marker": "o"}),
    "scaled": ("scaled search", {"color": style.MAP_COLOUR, "marker": "^"}),
}
TRUTH: Look = {
    "color": style.BLACK,
    "marker": "+",
    "markersize": 10,
    "markeredgewidth": 1.2,
    "linestyle": "none",
    "zorder": 5,
}


def simultaneous_figure(ends: Sequence[End], symmetries: Sequence[str]) -> Figure:
    """Ends along the first two symmetries, and their misfits against their distance from the truth.

    `symmetries`: the parameters that each scales, in LaTeX without dollars.
    """
    shown = symmetries[:2]
    width = scales.DOUBLE if shown else scales.SINGLE
    height = TOP + ROW + BOTTOM + (0.0 if shown else 0.2)
    with style.styled():
        figure = Figure(figsize=(width, height))
        inside = (width - LEFT - RIGHT - GAP) / 2 if shown else width - LEFT - RIGHT

        def place(x: float) -> Axes:
            return figure.add_axes((x / width, BOTTOM / height, inside / width, ROW / height))

        if shown:
            _scales(place(LEFT), ends, shown)
        _misfits(place(width - RIGHT - inside), ends)
        figure.legend(
            handles=_handles(ends, truth=bool(shown)),
            loc="upper center",
            ncols=6 if shown else 2,
            borderaxespad=0.3,
            columnspacing=1.4,
            handletextpad=0.5,
            labelspacing=0.25,
        )
    return figure


def _scales(panel: Axes, ends: Sequence[End], symmetries: Sequence[str]) -> None:
    """Factors on logarithmic axes, the truth at 1; of one symmetry a row for each way."""
    factors = np.exp([end.scales[: len(symmetries)] for end in ends]).reshape(len(ends), -1)
    strip = len(symmetries) == 1
    for k, way in enumerate(_ways(ends)):
        chosen = [end.way == way for end in ends]
        x = factors[chosen, 0]
        y = np.full(len(x), float(k)) if strip else factors[chosen, 1]
        _marks(panel, x, y, [end for end in ends if end.way == way])
    panel.plot([1.0], [0.5 * (len(_ways(ends)) - 1) if strip else 1.0], **TRUTH)
    for axis, factor, latex in zip((panel.xaxis, panel.yaxis), factors.T, symmetries, strict=False):
        set_factors(axis, factor)
        axis.set_label_text(f"common factor of ${latex}$")
    if strip:
        panel.axvline(1.0, color=style.LIGHT, linewidth=0.7, zorder=0)
        panel.set_ylim(-0.8, len(_ways(ends)) - 0.2)
        panel.set_yticks([])
    else:
        panel.axvline(1.0, color=style.LIGHT, linewidth=0.7, zorder=0)
        panel.axhline(1.0, color=style.LIGHT, linewidth=0.7, zorder=0)


def _misfits(panel: Axes, ends: Sequence[End]) -> None:
    for way in _ways(ends):
        chosen = [end for end in ends if end.way == way]
        x, y = (np.array([getattr(e, what) for e in chosen]) for what in ("distance", "misfit"))
        _marks(panel, x, y, chosen)
    panel.axhline(1.0, **FLOOR)
    finite = [end.distance for end in ends if np.isfinite(end.distance)]
    _from_zero(panel, max([0.1, *finite]), 0.03)
    _misfit_axis(panel, np.array([end.misfit for end in ends]))
    panel.set_xlabel("distance from the truth (rms of logarithms)")


def _marks(panel: Axes, x: Array, y: Array, ends: Sequence[End]) -> None:
    """Filled where the noise floor was reached, open where it was not."""
    for reached in (True, False):
        chosen = np.array([end.reached is reached for end in ends], dtype=bool)
        if chosen.any():
            panel.plot(x[chosen], y[chosen], **_mark(ends[0].way, reached=reached))


def _mark(way: str, *, reached: bool) -> dict[str, Any]:
    look = WAYS[way][1]
    return {
        **look,
        "markersize": 4.5,
        "markeredgewidth": 0.9,
        "markeredgecolor": look["color"],
        "markerfacecolor": (look["color"], 0.45) if reached else "none",
        "linestyle": "none",
        "zorder": 3,
    }


def _ways(ends: Sequence[End]) -> list[str]:
    return [way for way in WAYS if any(end.way == way for end in ends)]


def _handles(ends: Sequence[End], *, truth: bool) -> list[Line2D]:
    handles = [
        Line2D([], [], label=WAYS[way][0], **_mark(way, reached=True)) for way in _ways(ends)
    ]
    if not all(end.reached for end in ends):
        grey = {**_mark("fminsearch", reached=False), "marker": "s", "markeredgecolor": style.DARK}
        handles.append(Line2D([], [], label="open: noise floor not reached", **grey))
    if truth:
        handles.append(Line2D([], [], label="truth", **{**TRUTH, "markersize": 7}))
    handles.append(Line2D([], [], label="noise floor", **FLOOR))
    return handles


# The path of the heuristic

PATHS: tuple[Look, ...] = (
    {"color": style.BLACK, "linestyle": "-", "linewidth": 1.2},
    {"color": style.NOMINAL["color"], "linestyle": (0, (4, 1.5)), "linewidth": 1.2},
    {"color": style.MAP_COLOUR, "linestyle": (0, (1, 1.2)), "linewidth": 1.4},
    {"color": style.MIDDLE, "linestyle": (0, (6, 1.5, 1, 1.5)), "linewidth": 1.2},
)


def convergence_figure(found: Sequence[tuple[str, Heuristic]]) -> Figure:
    """Misfit per number after each iteration, by name of the record."""
    width, top = scales.DOUBLE * 0.72, 0.46
    height = top + ROW - 0.3 + BOTTOM
    with style.styled():
        figure = Figure(figsize=(width, height))
        panel = figure.add_axes(
            (
                LEFT / width,
                BOTTOM / height,
                (width - LEFT - RIGHT) / width,
                (height - BOTTOM - top) / height,
            )
        )
        handles = []
        for k, (name, heuristic) in enumerate(found):
            look = PATHS[k % len(PATHS)]
            misfits = heuristic.misfits
            panel.step(np.arange(len(misfits)), misfits, where="post", zorder=3, **look)
            panel.plot(len(misfits) - 1, misfits[-1], marker="o", markersize=4, color=look["color"])
            handles.append(Line2D([], [], label=f"record {name}".replace("$", r"\$"), **look))
        last = max(len(heuristic.misfits) - 1 for _, heuristic in found)
        panel.axhline(1.0, **FLOOR)
        handles.append(Line2D([], [], label="noise floor", **FLOOR))
        _misfit_axis(panel, np.concatenate([heuristic.misfits for _, heuristic in found]))
        _from_zero(panel, max(last, 1), 0.02)
        panel.set_xlabel("iteration of the heuristic")
        figure.legend(
            handles=handles, loc="upper center", ncols=2, borderaxespad=0.3, labelspacing=0.25
        )
    return figure


def _misfit_axis(panel: Axes, misfits: Array) -> None:
    """Shows the noise floor, and nearly a decade above it."""
    sure = usable(misfits)
    low, high = 0.6 * min(1.0, sure.min(initial=1.0)), 1.8 * max(6.0, sure.max(initial=1.0))
    set_decades(panel.yaxis, low, high)
    panel.set_ylabel("misfit per measured number")


def _from_zero(panel: Axes, last: float, before: float) -> None:
    """The horizontal axis: from 0 to `last`, with some room, `before` 0 in shares of `last`."""
    scale = scales.Scale(0.0, 0, -before * last, 1.06 * last)
    panel.set_xlim(scale.low, scale.high)
    style.set_ticks(panel.xaxis, *scales.ticks(scale.low, scale.high, 8, clear=0.0))


LINE, FOOT = 0.34, 0.42  # inches
KEY, COLUMNS = 0.165, 3  # height of a row of the legend, and its columns
UP, DOWN = -0.13, 0.22  # rows: the posterior, and below it the heuristic
MIDDLE = (0.25, 0.75)  # quantiles: the thick bar
THIN: Look = {"color": style.DARK, "linewidth": 1.1, "solid_capstyle": "butt"}
THICK: Look = {"color": style.DARK, "linewidth": 4.0, "solid_capstyle": "butt"}
ESTIMATE: Look = {
    "color": style.MAP_COLOUR,
    "marker": "D",
    "markersize": 4.5,
    "linestyle": "none",
    "zorder": 4,
}
OTHERS: Look = {
    "color": style.MAP_COLOUR,
    "marker": "o",
    "markersize": 2.4,
    "markeredgewidth": 0,
    "alpha": 0.4,
    "linestyle": "none",
    "zorder": 3,
}
TABLE_3_LEGEND: Look = {"loc": "upper center", "borderaxespad": 0.3, "labelspacing": 0.3}
GUESS: Look = {"color": style.MIDDLE, "linestyle": (0, (4, 2)), "linewidth": 0.8, "zorder": 0}
TICK: Look = {
    "color": style.NOMINAL["color"],
    "marker": "|",
    "markersize": 17,
    "markeredgewidth": 1.6,
    "linestyle": "none",
    "zorder": 5,
}
PAPER: Look = {
    "color": style.BLACK,
    "marker": "x",
    "markersize": 5.5,
    "markeredgewidth": 1.2,
    "linestyle": "none",
    "zorder": 6,
}


def table_3_figure(
    names: Sequence[str],
    guess: Array,
    estimate: Array,
    others: Array,
    truth: Array | None,
    draws: Array,
    paper: Array,
) -> Figure:
    """A row for each of `names`, over its guess: posterior above, the heuristic's estimates below.

    SI: guess, estimate and truth `(D,)`, others `(S, D)`, draws `(N, D)`; `paper (D,)`: what it
    prints, NaN where it has nothing, not drawn if it is the truth itself.
    """
    n = len(names)
    printed = np.isfinite(paper)
    other = bool(printed.any()) and (
        truth is None or not np.allclose(paper[printed], truth[printed])
    )
    keys = _keys(truth=truth is not None, others=len(others) > 0, paper=other)
    head = 0.13 + KEY * math.ceil(len(keys) / COLUMNS)
    width, height = scales.DOUBLE * 0.72, head + n * LINE + FOOT
    ratios = draws / guess
    with style.styled():
        figure = Figure(figsize=(width, height))
        inside = (width - LEFT - RIGHT) / width
        panel = figure.add_axes((LEFT / width, FOOT / height, inside, n * LINE / height))
        ends: list[float] = []
        for row in range(n):
            whole = np.exp(hdi(np.log(ratios[:, row])))
            for interval, look in ((whole, THIN), (np.quantile(ratios[:, row], MIDDLE), THICK)):
                panel.plot(interval, [row + UP] * 2, **look)
            ends += whole.tolist()
            if row:
                panel.axhline(row - 0.5, color=style.FAINT, linewidth=0.6, zorder=-1)
        rows = np.arange(n)
        starts = (others / guess).reshape(-1, n)
        for start in starts:
            panel.plot(start, rows + DOWN, **OTHERS)
        panel.plot(estimate / guess, rows + DOWN, **ESTIMATE)
        shown = [np.array(ends), starts.ravel(), estimate / guess]
        if truth is not None:
            panel.plot(truth / guess, rows + 0.04, **TICK)
            shown.append(truth / guess)
        if other:
            panel.plot(paper / guess, rows + 0.04, **PAPER)
            shown.append((paper / guess)[printed])
        panel.axvline(1.0, **GUESS)
        set_factors(panel.xaxis, np.concatenate(shown))
        panel.set_yticks(rows, [f"${_latex(name)}$" for name in names])
        panel.tick_params(axis="y", length=0)
        panel.set_ylim(n - 0.5, -0.5)
        panel.set_xlabel("value over initial guess")
        figure.legend(handles=keys, ncols=COLUMNS, **TABLE_3_LEGEND)
    return figure


def _keys(*, truth: bool, others: bool, paper: bool) -> list[Line2D]:
    percent = f"{100 * HDI_PROBABILITY:.0f}"
    handles = [
        Line2D([], [], label="posterior, middle half", **THICK),
        Line2D([], [], label=f"posterior, {percent} % HDI", **THIN),
        Line2D([], [], label="heuristic", **ESTIMATE),
    ]
    if others:
        handles.append(Line2D([], [], label="heuristic, other starts", **OTHERS))
    handles.append(Line2D([], [], label="initial guess", **GUESS))
    if paper:
        handles.append(Line2D([], [], label="the paper's estimate", **PAPER))
    if truth:
        handles.append(Line2D([], [], label="truth", **{**TICK, "markersize": 9}))
    return handles


def _latex(name: str) -> str:
    """Of a parameter, or of a noise level."""
    return PARAMETERS[name].latex if name in PARAMETERS else own_symbol(name, "", None, "").latex
