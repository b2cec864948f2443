"""Figures of the paper's searches for nine unknowns: where they end, and the heuristic's path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from bayesdrill.paper.studies.heuristic import Heuristic
from bayesdrill.paper.studies.simultaneous import End
from bayesdrill.report import set_decades, set_factors, style, usable

Array = NDArray[np.float64]
Look = Mapping[str, Any]

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
    width = style.DOUBLE if shown else style.SINGLE
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
    width, top = style.DOUBLE * 0.72, 0.46
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
    scale = style.Scale(0.0, 0, -before * last, 1.06 * last)
    panel.set_xlim(scale.low, scale.high)
    style.set_ticks(panel.xaxis, *style.ticks(scale.low, scale.high, 8, clear=0.0))
