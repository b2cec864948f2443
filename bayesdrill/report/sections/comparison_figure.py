"""Draw several runs in one corner, as rows of intervals, and as models of one record.

Log odds, what each leaves of each channel, and where it has each unknown.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from bayesdrill.analysis.comparison import SURE_LOG_ODDS, OverlayRow, PosteriorSummary, RunSummary
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.residual_checks import ResidualSummary
from bayesdrill.report import scales, style
from bayesdrill.report.pages import (
    LEVELS,
    build_page,
    contours,
    is_first_column,
    legend_above,
)
from bayesdrill.report.sections.comparison_words import elided, in_logs, overlay_shown
from bayesdrill.report.sections.corner_figure import CornerPage

MAX_NAME_LETTERS = 48  # letters of a name in a legend


@dataclass(frozen=True, slots=True)
class RunStyle:
    """Colours that print as different greys."""

    color: str
    linestyle: Any
    marker: str
    linewidth: float = 1.0
    size: float = 4.0  # of the marker

    @property
    def line(self) -> dict[str, Any]:
        """Options of a line."""
        return {"color": self.color, "linestyle": self.linestyle, "linewidth": self.linewidth}


# Thin and thick, dark and light in turn; none has the dashes of a nominal value.
RUN_STYLES = (
    RunStyle("0.0", "-", "o", 0.9),
    RunStyle("#e0832b", "-", "s", 1.7),
    RunStyle("#1d6b58", (0, (6, 1, 1, 1)), "^", 1.1),
    RunStyle("#7b4fb0", (0, (1, 1)), "D", 1.5),
    RunStyle("0.72", "-", "v", 2.2),
    RunStyle("#6b3d1e", (0, (10, 2)), "P"),
)


def run_handles(layers: Sequence[PosteriorSummary]) -> list[Line2D]:
    """Return legend handles: the name of each run, with its warning."""
    names = [f"{run.name} ({run.warning})" if run.warning else run.name for run in layers]
    return [
        Line2D([], [], label=elided(name, MAX_NAME_LETTERS).replace("$", r"\$"), **look.line)
        for name, look in zip(names, RUN_STYLES, strict=False)
    ]


CENTRAL_SHARE = 0.998  # of the draws of each run, inside an axis
CORNER_REACH = 0.5  # the axis grows by this share of its width at most to show the nominal value
BINS = 40  # across an axis
MIN_FILLED_SHARE = 0.02  # of an axis that a run fills less of, its histogram would be a spike


@dataclass(frozen=True, slots=True)
class _Column:
    """An unknown on the axis that all runs share; `draws` of each run, None where it has none."""

    row: OverlayRow
    scale: scales.Scale
    draws: tuple[Array | None, ...]
    ends: tuple[tuple[float, float], ...]


def overlay_corner_figure(
    layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow], display_units: DisplayUnits
) -> Figure:
    """Draw a corner of the unknowns that two runs or more have, `rows` in SI.

    A run is left out of panels of what it has not.
    """
    columns = [_column(row, layers, display_units) for row in rows if row.shared]
    with style.styled():
        page = CornerPage.build(
            [(column.scale, column.row.symbol) for column in columns], scales.DOUBLE
        )
        for i, row in enumerate(columns):
            _histograms(page.panels[i, i], row, page.fine)
            for j, column in enumerate(columns[:i]):
                _contours(page.panels[i, j], column, row, page.fine)
        page.finish(_corner_handles(layers, columns))
    return page.figure


def _column(
    si: OverlayRow, layers: Sequence[PosteriorSummary], display_units: DisplayUnits
) -> _Column:
    row, log = overlay_shown(si, display_units), in_logs(si, layers)
    name, factor = si.symbol.name, display_units.factor(si.symbol.name)
    every = [layer.draws_of(si.symbol) for layer in layers]
    draws = [None if x is None else x / factor for x in every]
    tails = [0.5 - CENTRAL_SHARE / 2, 0.5 + CENTRAL_SHARE / 2]
    quantiles = np.array([np.quantile(x, tails) for x in draws if x is not None])
    low, high = float(quantiles[:, 0].min()), float(quantiles[:, 1].max())
    low, high = scales.reaching(low, high, row.agreed, CORNER_REACH, log=log)
    scale = scales.scale(low, high, log=log, margin=0.06)
    shown = tuple(None if x is None else scale(x) for x in draws)
    priors = (layer.problem.posterior.space.priors.get(name) for layer in layers)
    ends = tuple(
        (float(scale(prior.low / factor)), float(scale(prior.high / factor)))
        if prior is not None
        else (-math.inf, math.inf)
        for prior in priors
    )
    return _Column(row=row, scale=scale, draws=shown, ends=ends)


def _histograms(panel: Axes, column: _Column, fine: float) -> None:
    """Each as high as its panel: a narrow posterior would dwarf a wide one."""
    for x, ends, look in zip(column.draws, column.ends, RUN_STYLES, strict=False):
        if x is None:
            continue
        first, last = max(float(x.min()), ends[0]), min(float(x.max()), ends[1])
        share = max((last - first) / (column.scale.high - column.scale.low), MIN_FILLED_SHARE)
        edges = np.linspace(first, last, max(12, round(BINS * share)) + 1)
        counts, _ = np.histogram(x, edges)
        panel.stairs(counts / counts.max(), edges, **style.finer(look.line, fine))
    style.mark_values(panel, column.scale, column.row.agreed, arrow=False, fine=fine)
    panel.set_ylim(0, 1.1)
    panel.set_yticks([])


def _contours(panel: Axes, column: _Column, row: _Column, fine: float) -> None:
    pairs = zip(column.draws, row.draws, column.ends, row.ends, RUN_STYLES, strict=False)
    for x, y, x_ends, y_ends, look in pairs:
        if x is not None and y is not None:
            lines: dict[str, Any] = {"colors": look.color, "linestyles": [look.linestyle]}
            lines["linewidths"] = 0.9 * fine * look.linewidth
            contours(panel, (x, y), (x_ends, y_ends), lines=lines)
    marks: dict[str, Any] = {"arrow": False, "fine": fine}
    style.mark_values(panel, column.scale, column.row.agreed, **marks)
    style.mark_values(panel, row.scale, row.row.agreed, vertical=True, **marks)


def _corner_handles(layers: Sequence[PosteriorSummary], columns: Sequence[_Column]) -> list[Line2D]:
    handles = run_handles(layers)
    sides = {c.scale.side(c.row.agreed) for c in columns if c.row.agreed is not None}
    handles += style.nominal_handles(sides & {0})
    notes = ["histograms: each as high as its panel"]
    if len(columns) > 1:
        inner, outer = (f"{100 * level:.1f} %" for level in LEVELS)
        levels = f"contours: {inner} and {outer} of the draws of a run;"
        notes = [levels, "none where the density is flat", *notes]
    return handles + [Line2D([], [], linestyle="none", label=note) for note in notes]


INTERVALS_REACH = 1.0  # how far an axis may grow for the nominal value, in widths
INTERVAL_BAR: dict[str, Any] = {"linewidth": 1.2, "marker": "|", "markersize": 5}
FIXED_MARKER: dict[str, Any] = {"marker": "x", "markersize": 5, "markeredgewidth": 1.2}
CREDIBLE = f"narrowest {100 * HDI_PROBABILITY:.0f} % interval"
RUN_HEIGHT, AXIS_HEIGHT = 0.18, 0.65  # inches: of a run in a panel, and of its axis and margins
MARGIN = 1.1  # above and below the runs of a panel, in heights of one


def intervals_figure(
    layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow], display_units: DisplayUnits
) -> Figure:
    """Draw intervals of all unknowns, `rows` in SI; a run without one leaves a gap."""
    scaled_rows = [_scaled(row, layers, display_units) for row in rows]
    n = len(layers)
    with style.styled():
        figure, panels = build_page(len(rows), 3, AXIS_HEIGHT + n * RUN_HEIGHT)
        for panel, (row, scale) in zip(panels, scaled_rows, strict=True):
            _intervals(panel, row, scale, range(n), RUN_STYLES)
            _below_each_other(panel, n)
        legend_above(figure, _handles(layers, scaled_rows), handlelength=2.6)
    return figure


def _scaled(
    si: OverlayRow, layers: Sequence[PosteriorSummary], display_units: DisplayUnits
) -> tuple[OverlayRow, scales.Scale]:
    """Return a row as it is shown, and an axis that holds all its intervals."""
    row, log = overlay_shown(si, display_units), in_logs(si, layers)
    estimates = [estimate for estimate in row.places if estimate is not None]
    low, high = min(place.low for place in estimates), max(place.high for place in estimates)
    low, high = scales.reaching(low, high, row.agreed, INTERVALS_REACH, log=log)
    return row, scales.scale(low, high, log=log, margin=0.08)


def _intervals(
    panel: Axes,
    row: OverlayRow,
    scale: scales.Scale,
    order: Sequence[int],
    looks: Sequence[RunStyle],
    *,
    arrow: bool = True,
) -> None:
    """Where each run has an unknown, the first of the `order` on top; `arrow`: to nominal values."""
    style.mark_values(panel, scale, row.agreed, arrow=arrow, zorder=1)
    for y, run, look in zip(range(len(order) - 1, -1, -1), order, looks, strict=False):
        estimate, nominal = row.places[run], row.nominal[run]
        if row.agreed is None and nominal is not None and scale.side(nominal) == 0:
            panel.plot([float(scale(nominal))] * 2, [y - 0.5, y + 0.5], zorder=1, **style.NOMINAL)
        if estimate is None:
            continue
        mark: dict[str, Any] = FIXED_MARKER
        if not estimate.fixed:
            ends = scale(np.array([estimate.low, estimate.high]))
            panel.plot(ends, [y, y], zorder=2, color=look.color, **INTERVAL_BAR)
            mark = {"marker": look.marker, "markersize": look.size, "linestyle": "none"}
        panel.plot([float(scale(estimate.mean))], [y], zorder=3, color=look.color, **mark)
    style.scale_axis(panel.xaxis, scale, scale.label(row.symbol))


def _below_each_other(panel: Axes, n: int, names: Sequence[str] | None = None) -> None:
    panel.set_ylim(-MARGIN, n - 1 + MARGIN)
    places = np.arange(n, dtype=np.float64)[::-1]
    style.set_ticks(panel.yaxis, places if names else np.array([]), names)


def _handles(
    layers: Sequence[PosteriorSummary], scaled_rows: Sequence[tuple[OverlayRow, scales.Scale]]
) -> list[Line2D]:
    handles = run_handles(layers)
    for handle, look in zip(handles, RUN_STYLES, strict=False):
        handle.set(marker=look.marker, markersize=4, linestyle="-")
    rows = [row for row, _ in scaled_rows]
    sides = {scale.side(row.agreed) for row, scale in scaled_rows if row.agreed is not None}
    if any(row.agreed is None and any(v is not None for v in row.nominal) for row in rows):
        sides.add(0)
    handles += style.nominal_handles(sides)
    if any(estimate is not None and estimate.fixed for row in rows for estimate in row.places):
        held = {"color": style.DARK, "linestyle": "none", **FIXED_MARKER}
        handles.append(Line2D([], [], label="held there", **held))
    return [*handles, Line2D([], [], linestyle="none", label=f"mean and {CREDIBLE}")]


FEW_MODELS, MAX_UNKNOWNS = 4, 12  # models of which all is shown, and unknowns
SCORE_PANELS = 3  # panels that are not of unknowns
MAX_MODEL_LETTERS = 42  # letters of a name
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")  # of channels
MARK: dict[str, Any] = {"markersize": 4.2, "linestyle": "none"}
LIMIT: dict[str, Any] = {"color": style.MIDDLE, "linewidth": 0.7, "linestyle": (0, (1, 1.5))}
READ = (
    f"the most probable model on top; shaded: odds of 20 to 1 or less; bars: means and {CREDIBLE}s"
)


def comparison_figure(
    models: Sequence[RunSummary], rows: Sequence[OverlayRow], display_units: DisplayUnits
) -> Figure:
    """Draw models, the most probable on top and black; `rows` of unknowns in SI."""
    order = sorted(range(len(models)), key=lambda k: -models[k].log_z)
    layers = [model.layer for model in models]
    # Unknowns that two models share, and of many models half of them; the table has all.
    least = max(2, len(models) / 2) if len(models) > FEW_MODELS else 2
    common = [row for row in rows if sum(p is not None and p.sd > 0 for p in row.places) >= least]
    shared = [_scaled(row, layers, display_units) for row in common[:MAX_UNKNOWNS]]
    names = [_name(models[k]) for k in order]
    channels = dict.fromkeys(row.name for model in models for row in model.residuals)
    marks = dict(zip(channels, itertools.cycle(MARKS), strict=False))
    with style.styled():
        height = AXIS_HEIGHT + len(models) * RUN_HEIGHT
        figure, panels = build_page(SCORE_PANELS + len(shared), 3, height)
        ordered = [models[k] for k in order]
        _odds(panels[0], ordered)
        rms, correlation = "rms of residuals over noise", "their correlation"
        _residual_panel(panels[1], ordered, marks, lambda row: row.rms, 1.0, rms)
        _residual_panel(panels[2], ordered, marks, lambda row: row.correlation, 0.0, correlation)
        looks = [RunStyle(_colour(k), "-", "o", size=3.6) for k in range(len(order))]
        for panel, (row, scale) in zip(panels[SCORE_PANELS:], shared, strict=True):
            _intervals(panel, row, scale, order, looks, arrow=False)
        for panel in panels:
            side = is_first_column(panel)
            _below_each_other(panel, len(models), names if side else None)
            panel.tick_params(axis="y", length=0)
        figure.supxlabel(READ, fontsize=8.0, color=style.DARK)
        legend_above(figure, _model_handles(models))
    return figure


def _name(model: RunSummary) -> str:
    name = elided(model.name, MAX_MODEL_LETTERS)
    return (name if model.converged else f"{name} *").replace("$", r"\$")


def _odds(panel: Axes, models: Sequence[RunSummary]) -> None:
    """Against the most probable, on an axis that is straight as long as they are not sure."""
    off = np.array([models[0].log_z - model.log_z for model in models])
    panel.set_xscale("symlog", linthresh=SURE_LOG_ODDS, linscale=0.8)
    panel.axvspan(0.0, SURE_LOG_ODDS, **style.CHANCE)
    for k, (model, x) in enumerate(zip(models, off, strict=True)):
        y, colour = len(models) - 1 - k, _colour(k)
        panel.plot([0.0, x], [y, y], color=colour, linewidth=1.4, solid_capstyle="butt")
        panel.plot([x], [y], marker="o", markersize=4, color=colour, linestyle="none")
        panel.plot([x - model.evidence.error, x + model.evidence.error], [y, y], color=colour)
    most = max(1.6 * float(off.max()), 2.0 * SURE_LOG_ODDS)
    panel.set_xlim(-0.3, most)
    # Two of three decades at most, so that numbers keep apart.
    far = [k for k in range(1, 9) if 10.0**k < most][:: 1 + int(np.log10(most) > 3.5)]
    ticks = np.array([0.0, SURE_LOG_ODDS, *(10.0**k for k in far)])
    texts = ["0", f"{SURE_LOG_ODDS:.0f}"]
    texts += [f"{10**k}" if k < 4 else rf"$10^{{{k}}}$" for k in far]
    style.set_ticks(panel.xaxis, ticks, texts)
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xlabel("log odds against the best", labelpad=2)


def _residual_panel(
    panel: Axes,
    models: Sequence[RunSummary],
    marks: Mapping[str, str],
    value_of: Callable[[ResidualSummary], float],
    wanted: float,
    label: str,
) -> None:
    """Of each channel a mark for each model; `wanted`: where noise alone would be."""
    log = wanted == 1.0
    least, most = (0.8, 1.25) if log else (-0.1, 0.1)
    values = [value_of(row) for model in models for row in model.residuals]
    scale = scales.scale(min(*values, least), max(*values, most), log=log, margin=0.08)
    panel.axvline(float(scale(wanted)), zorder=1, **LIMIT)
    for k, model in enumerate(models):
        for row in model.residuals:
            look = {**MARK, "marker": marks[row.name], "color": _colour(k)}
            face = _colour(k) if row.like_noise else "white"
            x, y = float(scale(value_of(row))), len(models) - 1 - k
            panel.plot([x], [y], markerfacecolor=face, **look)
    style.scale_axis(panel.xaxis, scale, label)


def _colour(k: int) -> str:
    return style.BLACK if k == 0 else style.MIDDLE


def _model_handles(models: Sequence[RunSummary]) -> list[Line2D]:
    symbols = {}
    for model in models:
        for observation in model.layer.problem.observations:
            where = " in " + observation.label.replace("$", r"\$") if observation.label else ""
            for channel in observation.experiment.channels:
                symbols[channel.name, observation.label] = f"${channel.latex}${where}"
    look = {**MARK, "color": style.DARK}
    marks = zip(symbols.values(), itertools.cycle(MARKS), strict=False)
    return [
        *(Line2D([], [], marker=mark, label=symbol, **look) for symbol, mark in marks),
        Line2D([], [], marker="o", markerfacecolor="white", label="not like noise", **look),
        Line2D([], [], label="nominal value", **style.NOMINAL),
    ]
