"""Models of one record: log odds, what each leaves of each channel, and where it has each unknown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesdrill.analysis.comparison import SURE, Contender, Row
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.display_units import OwnUnits
from bayesdrill.report import scales, style
from bayesdrill.report.pages import Page
from bayesdrill.report.sections.comparison_words import elided, in_logs, overlay_shown

FEW, MOST_UNKNOWNS = 4, 12  # models of which all is shown, and unknowns
COLUMNS, TOP = 3, 3  # panels of a row; those that are not of unknowns
ROW, FRAME = 0.19, 0.22  # inches of a model and of the margins of a panel
LETTER, LEAST_LEFT, MOST_LEFT = 0.058, 0.5, 2.2  # inches of a letter of a name, and of all of them
LONGEST = 42  # letters of a name
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")  # of channels
LIMIT: dict[str, Any] = {"color": style.MIDDLE, "linewidth": 0.7, "linestyle": (0, (1, 1.5))}
PER_LINE, PER_LONG_LINE = 6, 4  # of the legend; with names of experiments
READ = (
    "the most probable model on top; shaded: odds of 20 to 1 or less; bars: means and narrowest "
    f"{100 * HDI_PROBABILITY:.0f} % intervals"
)


def comparison_figure(models: Sequence[Contender], rows: Sequence[Row], own: OwnUnits) -> Figure:
    """The most probable on top and black; `rows` of unknowns in SI."""
    order = sorted(range(len(models)), key=lambda k: -models[k].log_z)
    layers = [one.layer for one in models]
    shared = [(overlay_shown(row, own), in_logs(row, layers)) for row in _common(rows, len(models))]
    names = [_name(models[k]) for k in order]
    channels = list(dict.fromkeys(one.name for model in models for one in model.left))
    with style.styled():
        handles = _handles(models)
        several = any(one.label for one in layers[0].problem.observations)
        per_line = min(PER_LONG_LINE if several else PER_LINE, len(handles))
        page = _page(len(models), max(map(len, names)), -(-len(handles) // per_line))
        figure, panels = page.build(TOP + len(shared))
        _odds(panels[0], [models[k] for k in order])
        _left(panels[1], [models[k] for k in order], channels, lambda one: one.rms, 1.0)
        panels[1].set_xlabel("rms of residuals over noise", labelpad=2)
        _left(panels[2], [models[k] for k in order], channels, lambda one: one.correlation, 0.0)
        panels[2].set_xlabel("their correlation", labelpad=2)
        for panel, (row, log) in zip(panels[TOP:], shared, strict=True):
            _unknown(panel, row, order, log=log)
        for k, panel in enumerate(panels):
            _models(panel, names if k % COLUMNS == 0 else None, len(models))
        figure.legend(
            handles=handles,
            loc="upper center",
            ncols=per_line,
            borderaxespad=0.3,
            columnspacing=1.4,
            handletextpad=0.5,
        )
        height = 1.0 - (page.top - 0.24) / figure.get_figheight()
        figure.text(0.5, height, READ, ha="center", va="center", fontsize=8.0, color=style.DARK)
    return figure


def _common(rows: Sequence[Row], n_models: int) -> list[Row]:
    """Those that two models share, and of many models half of them; the table has all."""
    least = max(2, n_models / 2) if n_models > FEW else 2
    return [row for row in rows if sum(p is not None and p.sd > 0 for p in row.places) >= least][
        :MOST_UNKNOWNS
    ]


def _page(n_models: int, letters: int, lines: int) -> Page:
    return Page(
        columns=COLUMNS,
        width=scales.DOUBLE,
        row=FRAME + n_models * ROW,
        left=float(np.clip(0.14 + LETTER * letters, LEAST_LEFT, MOST_LEFT)),
        right=0.14,
        gap_x=0.18,
        gap_y=0.56,
        top=0.44 + 0.17 * lines,
        bottom=0.5,
    )


def _name(one: Contender) -> str:
    name = elided(one.name, LONGEST)
    return (name if one.converged else f"{name} *").replace("$", r"\$")


def _models(panel: Axes, names: Sequence[str] | None, n: int) -> None:
    """One below the other, from the top."""
    panel.set_ylim(-0.5 - 0.5 * FRAME / ROW, n - 0.5 + 0.5 * FRAME / ROW)
    places = np.arange(n, dtype=np.float64)[::-1]
    style.set_ticks(panel.yaxis, places if names else np.array([]), names)
    panel.tick_params(axis="y", length=0)


def _odds(panel: Axes, models: Sequence[Contender]) -> None:
    """Against the most probable, on an axis that is straight as long as they are not sure."""
    off = np.array([models[0].log_z - one.log_z for one in models])
    panel.set_xscale("symlog", linthresh=SURE, linscale=0.8)
    panel.axvspan(0.0, SURE, **style.CHANCE)
    for k, (one, x) in enumerate(zip(models, off, strict=True)):
        y, colour = len(models) - 1 - k, _colour(k)
        panel.plot([0.0, x], [y, y], color=colour, linewidth=1.4, solid_capstyle="butt")
        panel.plot([x], [y], marker="o", markersize=4, color=colour, linestyle="none")
        panel.plot([x - one.evidence.error, x + one.evidence.error], [y, y], color=colour)
    most = max(1.6 * float(off.max()), 2.0 * SURE)
    panel.set_xlim(-0.3, most)
    decades = 10.0 ** np.arange(1, 9)
    # Two of three decades at most, so that numbers keep apart.
    far = decades[decades < most][:: 1 + int(np.log10(most) > 3.5)]
    ticks = np.array([0.0, SURE, *far])
    style.set_ticks(panel.xaxis, ticks, [f"{x:.0f}" if x < 1e4 else _power(x) for x in ticks])
    panel.xaxis.set_minor_locator(_none())
    panel.set_xlabel("log odds against the best", labelpad=2)


def _power(x: float) -> str:
    return rf"$10^{{{int(np.log10(x) + 0.5)}}}$"


def _none() -> Any:
    from matplotlib.ticker import NullLocator

    return NullLocator()


def _left(
    panel: Axes,
    models: Sequence[Contender],
    channels: Sequence[str],
    of: Callable[[Any], float],
    wanted: float,
) -> None:
    """Of each channel a mark for each model; `wanted`: where noise alone would be."""
    log = wanted == 1.0
    values = [of(one) for model in models for one in model.left]
    low, high = min(*values, wanted), max(*values, wanted)
    if log:
        low, high = min(low, 0.8), max(high, 1.25)
    else:
        low, high = min(low, -0.1), max(high, 0.1)
    scale = scales.scale(low, high, log=log, margin=0.08)
    panel.axvline(float(scale(wanted)), zorder=1, **LIMIT)
    for k, model in enumerate(models):
        for one in model.left:
            mark = MARKS[channels.index(one.name) % len(MARKS)]
            look: dict[str, Any] = {"marker": mark, "markersize": 4.2, "linestyle": "none"}
            y = len(models) - 1 - k
            face = _colour(k) if one.like_noise else "white"
            x = float(scale(of(one)))
            panel.plot([x], [y], color=_colour(k), markerfacecolor=face, **look)
    panel.set_xlim(scale.low, scale.high)
    style.set_numbers(panel.xaxis, scale, 4)


def _unknown(panel: Axes, row: Row, order: Sequence[int], *, log: bool) -> None:
    found = [place for place in row.places if place is not None]
    low, high = min(place.low for place in found), max(place.high for place in found)
    low, high = scales.reaching(low, high, row.agreed, 1.0, log=log)
    scale = scales.scale(low, high, log=log, margin=0.08)
    if row.agreed is not None and scale.side(row.agreed) == 0:
        panel.axvline(float(scale(row.agreed)), zorder=1, **style.NOMINAL)
    for k, model in enumerate(order):
        place, y, colour = row.places[model], len(order) - 1 - k, _colour(k)
        if place is None:
            continue
        if place.held:
            panel.plot([float(scale(place.mean))], [y], marker="x", markersize=5, color=colour)
            continue
        ends = scale(np.array([place.low, place.high]))
        panel.plot(ends, [y, y], color=colour, linewidth=1.2, marker="|", markersize=5)
        panel.plot([float(scale(place.mean))], [y], marker="o", markersize=3.6, color=colour)
    panel.set_xlim(scale.low, scale.high)
    style.set_numbers(panel.xaxis, scale, 4)
    panel.set_xlabel(scale.label(row.symbol), labelpad=2)


def _colour(k: int) -> str:
    return style.BLACK if k == 0 else style.MIDDLE


def _of(experiment: str) -> str:
    return " in " + experiment.replace("$", r"\$") if experiment else ""


def _handles(models: Sequence[Contender]) -> list[Line2D]:
    """Of all channels of any model, and what a hollow mark says."""
    symbols = {
        (channel.name, one.label): f"${channel.latex}$" + _of(one.label)
        for model in models
        for one in model.layer.problem.observations
        for channel in one.experiment.channels
    }
    marks = [
        Line2D([], [], marker=MARKS[k % len(MARKS)], color=style.DARK, label=symbol)
        for k, symbol in enumerate(symbols.values())
    ]
    hollow = Line2D([], [], marker="o", color=style.DARK, markerfacecolor="white")
    hollow.set_label("not like noise")
    for one in (*marks, hollow):
        one.set(markersize=4.2, linestyle="none")
    return [*marks, hollow, Line2D([], [], label="nominal value", **style.NOMINAL)]
