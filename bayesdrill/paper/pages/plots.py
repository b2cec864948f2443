"""Figures of the paper's studies: its printed matrix, its two-parameter test and its fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from bayesdrill.basics import PARAMETERS, STATES
from bayesdrill.paper.studies import printed as paper
from bayesdrill.paper.studies.forward import Reading
from bayesdrill.paper.studies.verification import Verification
from bayesdrill.record import Experiment
from bayesdrill.report import LINE, TIME, Page, extremes, set_decades, style, usable

Array = NDArray[np.float64]
Look = Mapping[str, Any]

LEGEND: Look = {"loc": "upper center", "borderaxespad": 0.3, "columnspacing": 1.6}

# The printed matrix

PAIR = Page(
    columns=2,
    width=style.DOUBLE,
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
    time = style.scale(0.0, max(reading.time for reading in readings))
    with style.styled():
        figure, panels = PAIR.build(2)
        for panel, (low, high) in zip(panels, ranges, strict=True):
            speed = style.scale(low, high)
            for k, reading in enumerate(readings):
                looks = CURVES[k % len(CURVES)]
                panel.plot(time(reading.t), speed(reading.curve), zorder=3 - 0.1 * k, **looks)
            panel.set_xlim(time.low, time.high)
            panel.set_ylim(speed.low, speed.high)
            style.set_ticks(panel.xaxis, *style.ticks(time.low, time.high, 6, clear=0.0))
            style.set_ticks(panel.yaxis, *style.ticks(speed.low, speed.high, 5))
            panel.set_xlabel(time.label(TIME))
            style.side_label(panel, speed.label(STATES["w_2"]))
        everything = style.scale(*ranges[0])
        panels[0].axhspan(*(float(everything(x)) for x in near), **BAND)
        panels[1].set_facecolor(BAND["color"])
        handles = [
            Line2D([], [], label=_ending(reading), **CURVES[k % len(CURVES)])
            for k, reading in enumerate(readings)
        ]
        figure.legend(handles=handles, ncols=2, handlelength=3.0, labelspacing=0.25, **LEGEND)
    return figure


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
        figure.legend(handles=handles, ncols=3, handlelength=2.2, labelspacing=0.25, **LEGEND)
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

FIT = Page(
    columns=2,
    width=style.DOUBLE,
    row=1.45,
    left=0.62,
    right=0.12,
    gap_x=0.74,
    gap_y=0.14,
    top=0.32,
    bottom=0.42,
)
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
    time = style.scale(float(t[0]) - margin, float(t[-1]) + margin)
    marks = style.thin(len(t), MARKS)
    with style.styled():
        figure, panels = FIT.build(n)
        for k, (panel, channel) in enumerate(zip(panels, experiment.channels, strict=True)):
            y, model = experiment.y[:, k], estimated[:, k]
            low, high = min(y.min(), model.min()), max(y.max(), model.max())
            room = 0.07 * float(high - low)
            numbers = style.scale(float(low) - room, float(high) + room)
            line = extremes(y, LINE)
            panel.plot(time(t[line]), numbers(y[line]), **MEASURED)
            panel.plot(time(t[marks]), numbers(model[marks]), zorder=3, **ESTIMATED)
            panel.set_xlim(time.low, time.high)
            panel.set_ylim(numbers.low, numbers.high)
            style.set_ticks(panel.xaxis, *style.ticks(time.low, time.high, 6, clear=0.0))
            style.set_ticks(panel.yaxis, *style.ticks(numbers.low, numbers.high, 5))
            style.side_label(panel, numbers.label(channel))
            lowest = k + FIT.columns >= n
            panel.tick_params(labelbottom=lowest)
            if lowest:
                panel.set_xlabel(time.label(TIME))
        handles = [
            Line2D([], [], label="record", **MEASURED),
            Line2D([], [], label="estimated", **ESTIMATED),
        ]
        figure.legend(handles=handles, ncols=2, **LEGEND)
    return figure
