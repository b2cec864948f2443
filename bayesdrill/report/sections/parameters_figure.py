"""Draw unknowns before and after the record, the ridge of a symmetry, and products."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from bayesdrill.analysis.identifiability.structure import ScalingStructure
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, product_latex
from bayesdrill.inference.display_units import DisplayedUnknowns
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.pages import NARROW_ROW, build_page, legend_above
from bayesdrill.report.scales import DOUBLE
from bayesdrill.report.sections.corner_figure import corner_figure
from bayesdrill.report.sections.identify_words import product
from bayesdrill.report.view import Drawing, ReportContext

TAIL = 0.001  # of a prior without an end: where its axis ends
BINS = 60
HEAD = 1.12  # of the highest density: where a panel ends
DARK_PRIOR: dict[str, Any] = {**style.PRIOR_LINE, "color": style.DARK}
BOX: dict[str, Any] = {
    "edgecolor": style.MIDDLE,
    "linewidth": 0.8,
    "linestyle": style.PRIOR_LINE["linestyle"],
}


def prior_posterior_figure(
    draws: Array, shown: DisplayedUnknowns, width: float = scales.DOUBLE
) -> Figure:
    """Draw priors and draws `(N, D)` of what is `shown`, over the range of each prior."""
    symbols = shown.symbols
    width = width if len(symbols) > 1 else scales.SINGLE
    with style.styled(width):
        figure, panels = build_page(len(symbols), 3, 1.45, width)
        sides = set()
        for panel, x, symbol in zip(panels, draws.T, symbols, strict=True):
            prior, known = shown.priors[symbol.name], shown.nominal.get(symbol.name)
            scale = scales.scale(*_ends(prior, x), log=flat_in_logs(prior), margin=0.04)
            _densities(panel, scale, x, prior)
            style.mark_values(panel, scale, known, shown.mode.get(symbol.name), zorder=4)
            style.scale_axis(panel.xaxis, scale, scale.label(symbol))
            style.set_ticks(panel.yaxis, np.array([]), None)
            if known is not None:
                sides.add(scale.side(known))
        handles: list[Line2D | Patch] = [
            Line2D([], [], label="prior", **DARK_PRIOR),
            Patch(facecolor=style.LIGHT, edgecolor=style.BLACK, linewidth=0.7, label="posterior"),
            *style.nominal_handles(sides),
            Line2D([], [], label="MAP", **style.MAP_LINE),
        ]
        legend_above(figure, handles)
    return figure


def _densities(panel: Axes, scale: scales.Scale, x: Array, prior: Prior) -> None:
    """The posterior fills its panel; of a prior that it dwarfs the line lies low."""
    u = scale(x)
    across = min(float(BINS), 2.2 * math.cbrt(len(x)))
    edges = np.linspace(float(u.min()), float(u.max()), max(2, round(across)))
    heights, edges = np.histogram(u, edges, density=True)
    panel.stairs(heights, edges, fill=True, color=style.LIGHT, zorder=1)
    panel.stairs(heights, edges, color=style.BLACK, linewidth=0.7, zorder=2)
    places = np.linspace(scale.low, scale.high, 801)
    density = scale.density(prior, places)
    panel.plot(places, density, zorder=3, **DARK_PRIOR)
    sure = density[np.isfinite(density)]
    # A density may grow without bound towards zero; the panel ends at what nearly all of it is below.
    top = max(float(heights.max()), float(np.quantile(sure, 0.99)))
    panel.set_ylim(0, HEAD * top)


SIZE = 3.4  # of a ridge with its labels, inches
POINTS = 3000
REACH, CORNERS = 1e4, 4001  # the line is drawn over this factor, and cut by the axes
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 6.0, "solid_capstyle": "butt"}
DOTS: dict[str, Any] = {**style.DOTS, "markersize": 1.8, "alpha": 0.6, "zorder": 3}
MIN_CORRELATION = 0.5  # of a pair worth showing


@dataclass(frozen=True, slots=True)
class CorrelatedPair:
    """Columns of two unknowns and their exponents in one symmetry."""

    columns: tuple[int, int]
    exponents: tuple[int, int]


def strongest_pair(draws: Array, structure: ScalingStructure) -> CorrelatedPair | None:
    """Return the two unknowns of draws `(N, D)` that follow one symmetry most closely."""
    spread = np.cov(np.log(draws[:, : len(structure.names)]).T)
    best, strongest = MIN_CORRELATION, None
    for symmetry in structure.symmetries:
        used = [k for k, exponent in enumerate(symmetry) if exponent]
        for i, j in itertools.combinations(used, 2):
            p, q = symmetry[i], symmetry[j]
            # 1 where draws differ along the symmetry alone, 0 where without regard to it.
            along = 2 * p * q * spread[i, j] / (q**2 * spread[i, i] + p**2 * spread[j, j])
            if along > best:
                best, strongest = float(along), CorrelatedPair((i, j), (p, q))
    return strongest


def ridge_figure(draws: Array, pair: CorrelatedPair, shown: DisplayedUnknowns) -> Figure:
    """Draw the ridge of draws `(N, D)` of what is `shown`; the exact line passes through the MAP."""
    factor, some = np.geomspace(1 / REACH, REACH, CORNERS), style.thin(len(draws), POINTS)
    box, line, dots, cross, marks = [], [], [], [], []
    with style.styled():
        figure, (panel,) = build_page(1, 1, SIZE / NARROW_ROW, SIZE)
        marked = all(shown.symbols[k].name in shown.nominal for k in pair.columns)
        axes = (panel.xaxis, panel.yaxis)
        for column, power, axis in zip(pair.columns, pair.exponents, axes, strict=True):
            symbol, x = shown.symbols[column], draws[:, column]
            prior, best = shown.priors[symbol.name], shown.mode[symbol.name]
            ends = _ends(prior, x)
            scale = scales.scale(*ends, log=flat_in_logs(prior), margin=0.12)
            box.append(scale(np.array(ends)))
            line.append(scale(best * factor**power))
            dots.append(scale(x[some]))
            cross.append([float(scale(best))])
            marks.append((scale, shown.nominal[symbol.name] if marked else None))
            style.scale_axis(axis, scale, scale.label(symbol))
        (x0, x1), (y0, y1) = box
        panel.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, zorder=1, **BOX))
        panel.plot(*line, zorder=2, **BAND)
        panel.plot(*dots, **DOTS)
        for (scale, known), vertical in zip(marks, (False, True), strict=True):
            style.mark_values(panel, scale, known, vertical=vertical, arrow=False, zorder=4)
        panel.plot(*cross, zorder=5, **style.CROSS)
        handles: list[Line2D | Patch] = [
            Line2D([], [], label="exactly the same signals", **BAND),
            Line2D([], [], label="posterior draws", **{**DOTS, "markersize": 3}),
            Patch(fill=False, label="prior", **BOX),
            *(style.nominal_handles({0}) if marked else []),
            Line2D([], [], label="MAP", **style.CROSS),
        ]
        legend_above(figure, handles)
    return figure


def _ends(prior: Prior, x: Array) -> tuple[float, float]:
    """All of a prior that has ends; nearly all of one that has none, and of the draws."""
    low, high = (float(q) for q in prior.quantile(np.array([TAIL, 1 - TAIL])))
    low = prior.low if prior.low > 0 else min(low, float(x.min()))
    high = prior.high if np.isfinite(prior.high) else max(high, float(x.max()))
    return low, high


def invariants_figure(
    verdict: Verdict, draws: Array, mode: Array, symbols: Sequence[Symbol], width: float = DOUBLE
) -> Figure:
    """Draw products of SI draws `(N, D)` at the MAP `(D,)`: determined ones, or all if none is."""
    sure = [q for q in verdict.products if q.says != "not determined"]
    selected = sure or list(verdict.products)
    deviations = tuple(
        Symbol(
            name=product(verdict.names, quantity.exponents),
            unit="%",
            latex=rf"\Delta\,{product_latex(quantity.exponents, symbols)}",
            latex_unit=r"\%\;of\;nominal",
            meaning="deviation from the nominal value",
        )
        for quantity in selected
    )
    names = [symbol.name for symbol in deviations]
    powers = np.array([quantity.exponents for quantity in selected], dtype=float)
    table = np.log([quantity.nominal for quantity in selected])
    m = len(verdict.names)
    off = 100 * np.expm1(np.log(draws[:, :m]) @ powers.T - table)
    at = 100 * np.expm1(np.log(mode[:m]) @ powers.T - table)
    shown = DisplayedUnknowns(
        symbols=deviations,
        nominal=dict.fromkeys(names, 0.0),
        mode=dict(zip(names, at.tolist(), strict=True)),
    )
    return corner_figure(off, shown, width)


def draw_invariants(run: ReportContext) -> Drawing | None:
    """Return the drawing of products, where there is a verdict."""
    if run.analysis.judged is None or not run.analysis.judged.verdict.products:
        return None
    at = (run.draws, run.chain.best, run.problem.symbols, run.width)
    says = "The products of parameters that such a record can show (corner plot)."
    return Drawing(invariants_figure, (run.analysis.judged.verdict, *at), says)


def draw_ridge(run: ReportContext) -> Drawing | None:
    """Return the drawing of the ridge, where there is a symmetry."""
    judged, shown = run.analysis.judged, run.shown()
    pair = None if judged is None else strongest_pair(run.draws, judged.study.structure)
    if pair is None:
        return None
    says = "The ridge: parameters that no such record can tell apart, and the line along which they go."
    return Drawing(ridge_figure, (shown.select(run.draws), pair, shown), says)


def draw_prior_posterior(run: ReportContext) -> Drawing:
    """Return the drawing of priors and posteriors."""
    shown = run.shown(run.config.output.parameters)
    says = "Prior against posterior of each parameter: what the record has added."
    return Drawing(prior_posterior_figure, (shown.select(run.draws), shown, run.width), says)
