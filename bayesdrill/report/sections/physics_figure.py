"""Draw each friction against its speed, and the missing torque over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesdrill.analysis.latent_torque import TorqueEstimate
from bayesdrill.analysis.run_analysis import BAND_DRAWS
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.report import scales, style
from bayesdrill.report.pages import build_page, is_first_column, legend_above
from bayesdrill.report.sections.physics_words import LawShown, laws, time_symbol
from bayesdrill.report.sections.torque_words import TORQUE, regressors
from bayesdrill.report.view import Drawing, ReportContext, for_each_experiment

BINS = 60
FOOT = 0.2  # of a panel: for the speeds of the record
HEAD = 1.12  # of the largest effort
BEST: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.0}
SEEN: dict[str, Any] = {"color": style.MIDDLE}


def friction_figure(laws: Sequence[LawShown], width: float = scales.DOUBLE) -> Figure:
    """Draw a panel for each friction law."""
    with style.styled(width):
        figure, panels = build_page(len(laws), 3, 2.1, width, narrow=1)
        for panel, law in zip(panels, laws, strict=True):
            _law(panel, law)
        handles: list[Line2D | Patch] = [
            Line2D([], [], label="MAP", **BEST),
            Patch(label=f"{100 * HDI_PROBABILITY:.0f} % posterior", **style.BAND),
        ]
        if any(law.nominal is not None for law in laws):
            handles.append(Line2D([], [], label="nominal values", **style.NOMINAL))
        handles.append(Patch(label="speeds of the record", **SEEN))
        legend_above(figure, handles)
    return figure


def _law(panel: Axes, law: LawShown) -> None:
    curves = [law.best, *law.band, *([] if law.nominal is None else [law.nominal])]
    far = HEAD * max(float(np.abs(curve).max()) for curve in curves) or 1.0
    x = scales.scale(float(law.speeds[0]), float(law.speeds[-1]))
    y = scales.scale(-far, far)
    room = FOOT / (1.0 - FOOT) * (y.high - y.low)
    for side, outside, beside in ((law.speeds <= 0, -1, -2), (law.speeds >= 0, 0, 1)):
        band = law.band[:, side]
        band[:, outside] = band[:, beside]  # where a law has both signs
        panel.fill_between(x(law.speeds[side]), *y(band), zorder=1, **style.BAND)
    if law.nominal is not None:
        panel.plot(x(law.speeds), y(law.nominal), zorder=2, **style.NOMINAL)
    panel.plot(x(law.speeds), y(law.best), zorder=3, **BEST)
    counts, edges = np.histogram(x(law.seen), np.linspace(x.low, x.high, BINS + 1))
    heights = y.low - room + 0.85 * room * counts / max(int(counts.max()), 1)
    panel.stairs(heights, edges, baseline=y.low - room, fill=True, zorder=1, **SEEN)
    style.scale_axis(panel.xaxis, x, f"{law.speed.meaning}, {x.label(law.speed)}")
    style.scale_axis(panel.yaxis, y, y.label(law.effort, "\n"))
    panel.set_ylim(y.low - room, y.high)
    panel.axhline(y.low, color=style.MIDDLE, linewidth=0.5)


TORQUE_POINTS = 1200  # of a line over time, and dots of a panel


def torque_figure(torque: TorqueEstimate, width: float = scales.DOUBLE, *, clock: Unit) -> Figure:
    """Draw a missing torque over time, and against each thing that it may follow."""
    band, against = torque.band, list(regressors(torque))
    y = scales.scale(float(band[0].min()), float(band[1].max()), margin=0.04)
    with style.styled(width):
        figure, (panel, *panels) = build_page(len(against), 2, 2.0, width, narrow=1, first=2.0)
        x = scales.scale(float(torque.t[0] / clock.factor), float(torque.t[-1] / clock.factor))
        some = style.thin(len(torque.t), TORQUE_POINTS)
        t = x(torque.t[some] / clock.factor)
        panel.fill_between(t, *y(band[:, some]), **style.BAND)
        panel.plot(t, y(torque.expected[some]), **style.BLACK_LINE)
        _finish(panel, x, y, time_symbol(clock))
        for panel, regressor in zip(panels, against, strict=True):
            x = scales.scale(
                float(regressor.values.min()), float(regressor.values.max()), margin=0.02
            )
            some = style.thin(len(regressor.values), TORQUE_POINTS)
            panel.plot(x(regressor.values[some]), y(torque.expected[some]), **style.DOTS)
            panel.fill_between(x(regressor.centres), *y(regressor.band), zorder=1, **style.BAND)
            panel.plot(x(regressor.centres), y(regressor.means), zorder=3, **style.BLACK_LINE)
            _finish(panel, x, y, regressor.label)
            if not is_first_column(panel):
                panel.set_ylabel("")
                panel.tick_params(labelleft=False)
        handles = [
            Line2D([], [], label="mean", **style.BLACK_LINE),
            Patch(label=f"{100 * HDI_PROBABILITY:.0f} % posterior", **style.BAND),
            Line2D([], [], label="samples", **{**style.DOTS, "markersize": 3, "rasterized": False}),
        ]
        legend_above(figure, handles)
    return figure


def _finish(panel: Axes, x: scales.Scale, y: scales.Scale, across: Symbol) -> None:
    style.scale_axis(panel.xaxis, x, f"{across.meaning}, {x.label(across)}", 5)
    style.scale_axis(panel.yaxis, y, y.label(TORQUE, "\n"))
    if y.low < 0.0 < y.high:
        panel.axhline(float(y(0.0)), color=style.MIDDLE, linewidth=0.5, zorder=0)
    if x.low < 0.0 < x.high:
        panel.axvline(float(x(0.0)), color=style.MIDDLE, linewidth=0.5, zorder=0)


def draw_friction(run: ReportContext) -> tuple[Drawing, ...]:
    """Return drawings of friction laws, of a rig with friction."""
    chain, problem = run.chain, run.problem
    each = zip(problem.observations, chain.friction_motions, strict=False)
    at = (problem, chain.best, chain.some(BAND_DRAWS))
    shown = ((rig.label, tuple(laws(rig, rubs, *at))) for rig, rubs in each)
    says = "Each friction against its speed: its law, where the record saw it, and nominal values."
    return for_each_experiment(friction_figure, shown, run.width, says)


def draw_torque(run: ReportContext) -> tuple[Drawing, ...]:
    """Return drawings of the torque that a rig's equations leave out."""
    shown = ((torque.label, torque) for torque in run.chain.torque_estimates)
    figure = partial(torque_figure, clock=run.problem.clock)
    says = "The missing torque over time, and against what the rig did: speeds, angle, inputs."
    return for_each_experiment(figure, shown, run.width, says)
