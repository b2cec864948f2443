"""Each unknown before and after the record, the ridge that an exact symmetry draws, and the
products a record shows.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from bayesdrill.analysis.identifiability.structure import Exponents, Structure
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, product_latex
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.pages import AXES, Page, legend_above
from bayesdrill.report.scales import DOUBLE, scale
from bayesdrill.report.sections.corner_figure import corner_figure
from bayesdrill.report.sections.identify_words import product
from bayesdrill.report.view import Drawing, View

PAGE = dataclasses.replace(AXES, row=1.05, top=0.36)
SMALL = dataclasses.replace(
    PAGE, columns=2, width=scales.SINGLE, row=0.66, gap_x=0.16, gap_y=0.43, top=0.42, bottom=0.44
)
TAIL = 0.001  # of a prior without an end: where its axis ends
BINS = 60
HEAD = 1.12  # of the highest density: where a panel ends


def prior_posterior_figure(
    draws: Array,
    symbols: Sequence[Symbol],
    priors: Mapping[str, Prior],
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
    width: float = scales.DOUBLE,
) -> Figure:
    """Of draws `(N, D)` in the units of the symbols, over the range of each prior.

    The axis is logarithmic where a prior is flat in the log.
    """
    page = PAGE if width >= scales.DOUBLE and len(symbols) > 1 else SMALL
    with style.styled(page.width):
        figure, panels = page.build(len(symbols))
        sides = set()
        for panel, x, symbol in zip(panels, draws.T, symbols, strict=True):
            scale = _scale(priors[symbol.name], x)
            known = nominal.get(symbol.name)
            _densities(panel, scale, x, priors[symbol.name])
            _values(panel, scale, known, mode.get(symbol.name))
            _frame(panel, scale, symbol)
            if known is not None:
                sides.add(scale.side(known))
        _prior_posterior_legend(figure, sides, page)
    return figure


def _scale(prior: Prior, x: Array) -> scales.Scale:
    return scales.scale(*_ends(prior, x), log=flat_in_logs(prior), margin=0.04)


def _densities(panel: Axes, scale: scales.Scale, x: Array, prior: Prior) -> None:
    """The posterior fills its panel; of a prior that it dwarfs the line lies low."""
    u = scale(x)
    near, far = float(u.min()), float(u.max())
    across = min(float(BINS), 2.2 * math.cbrt(len(x)))
    edges = np.linspace(near, far, max(2, round(across)))
    heights, edges = np.histogram(u, edges, density=True)
    panel.stairs(heights, edges, fill=True, color=style.LIGHT, zorder=1)
    panel.stairs(heights, edges, color=style.BLACK, linewidth=0.7, zorder=2)
    places = np.linspace(scale.low, scale.high, 801)
    density = scale.density(prior, places)
    panel.plot(places, density, zorder=3, **{**style.PRIOR_LINE, "color": style.DARK})
    sure = density[np.isfinite(density)]
    # A density may grow without bound towards zero; the panel ends at what nearly all of it is below.
    top = max(float(heights.max()), float(np.quantile(sure, 0.99)))
    panel.set_ylim(0, HEAD * top)


def _values(panel: Axes, scale: scales.Scale, nominal: float | None, mode: float | None) -> None:
    side = scale.side(nominal)
    if nominal is not None and side == 0:
        panel.axvline(float(scale(nominal)), zorder=4, **style.NOMINAL)
    if side:
        place, marker = (0.96, ">") if side > 0 else (0.04, "<")
        panel.plot([place], [0.5], transform=panel.transAxes, marker=marker, **style.AWAY)
    if mode is not None:
        panel.axvline(float(scale(mode)), zorder=4, **style.MAP_LINE)


def _frame(panel: Axes, scale: scales.Scale, symbol: Symbol) -> None:
    panel.set_xlim(scale.low, scale.high)
    style.set_numbers(panel.xaxis, scale, 4)
    style.set_ticks(panel.yaxis, np.array([]), None)
    panel.set_xlabel(scale.label(symbol), labelpad=2)


def _prior_posterior_legend(figure: Figure, sides: set[int], page: Page) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="prior", **{**style.PRIOR_LINE, "color": style.DARK}),
        Patch(facecolor=style.LIGHT, edgecolor=style.BLACK, linewidth=0.7, label="posterior"),
        *style.nominal_handles(sides),
        Line2D([], [], label="MAP", **style.MAP_LINE),
    ]
    most = len(handles) if page is PAGE or len(handles) <= 4 else 3
    legend_above(figure, handles, most, 1.6 if page is PAGE else 1.2, 2.4)


LEFT, BOTTOM, RIGHT, TOP = 0.62, 0.5, 0.14, 0.74  # inches
SIZE = 2.6
POINTS = 3000
REACH, CORNERS = 1e4, 4001  # the line is drawn over this factor, and cut by the axes
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 6.0, "solid_capstyle": "butt"}
DOTS: dict[str, Any] = {**style.DOTS, "markersize": 1.8, "alpha": 0.6, "zorder": 3}
LEAST = 0.5  # of a pair worth showing


@dataclass(frozen=True, slots=True)
class Pair:
    """Columns of two unknowns and their exponents in one symmetry."""

    columns: tuple[int, int]
    exponents: tuple[int, int]


def strongest_pair(draws: Array, structure: Structure) -> Pair | None:
    """Of draws `(N, D)`, the two unknowns that follow one symmetry most closely.

    None where none do, for want of a symmetry or because priors hold the unknowns in place.
    """
    spread = np.cov(np.log(draws[:, : len(structure.names)]).T)
    best, found = LEAST, None
    for symmetry in structure.symmetries:
        used = [k for k, exponent in enumerate(symmetry) if exponent]
        for i, j in itertools.combinations(used, 2):
            p, q = symmetry[i], symmetry[j]
            # 1 where draws differ along the symmetry alone, 0 where without regard to it.
            along = 2 * p * q * spread[i, j] / (q**2 * spread[i, i] + p**2 * spread[j, j])
            if along > best:
                best, found = float(along), Pair((i, j), (p, q))
    return found


def ridge_figure(
    draws: Array,
    pair: Pair,
    symbols: Sequence[Symbol],
    priors: Mapping[str, Prior],
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
) -> Figure:
    """Of draws `(N, D)` in the units of the symbols; the exact line passes through the MAP."""
    shown = [symbols[k] for k in pair.columns]
    ends = [
        _ends(priors[symbol.name], draws[:, k])
        for symbol, k in zip(shown, pair.columns, strict=True)
    ]
    scales = [
        scale(*end, log=flat_in_logs(priors[symbol.name]), margin=0.12)
        for symbol, end in zip(shown, ends, strict=True)
    ]
    with style.styled():
        width, height = LEFT + SIZE + RIGHT, BOTTOM + SIZE + TOP
        figure = Figure(figsize=(width, height))
        panel = figure.add_axes((LEFT / width, BOTTOM / height, SIZE / width, SIZE / height))
        (x0, x1), (y0, y1) = (scale(np.array(end)) for scale, end in zip(scales, ends, strict=True))
        box = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, zorder=1, **_box())
        panel.add_patch(box)
        factor = np.geomspace(1 / REACH, REACH, CORNERS)
        line = [
            scale(mode[symbol.name] * factor**power)
            for scale, symbol, power in zip(scales, shown, pair.exponents, strict=True)
        ]
        panel.plot(*line, zorder=2, **BAND)
        kept = style.thin(len(draws), POINTS)
        dots = [scale(draws[kept, k]) for scale, k in zip(scales, pair.columns, strict=True)]
        panel.plot(*dots, **DOTS)
        marked = all(symbol.name in nominal for symbol in shown)
        if marked:
            panel.axvline(float(scales[0](nominal[shown[0].name])), zorder=4, **style.NOMINAL)
            panel.axhline(float(scales[1](nominal[shown[1].name])), zorder=4, **style.NOMINAL)
        at = [float(scale(mode[symbol.name])) for scale, symbol in zip(scales, shown, strict=True)]
        panel.plot([at[0]], [at[1]], zorder=5, **style.CROSS)
        panel.set_xlim(scales[0].low, scales[0].high)
        panel.set_ylim(scales[1].low, scales[1].high)
        style.set_numbers(panel.xaxis, scales[0], 4)
        style.set_numbers(panel.yaxis, scales[1], 4)
        panel.set_xlabel(scales[0].label(shown[0]))
        style.side_label(panel, scales[1].label(shown[1]))
        _ridge_legend(figure, marked=marked)
    return figure


def _ends(prior: Prior, x: Array) -> tuple[float, float]:
    """All of a prior that has ends; nearly all of one that has none, and of the draws."""
    low, high = (float(q) for q in prior.quantile(np.array([TAIL, 1 - TAIL])))
    low = prior.low if prior.low > 0 else min(low, float(x.min()))
    high = prior.high if np.isfinite(prior.high) else max(high, float(x.max()))
    return low, high


def _box() -> dict[str, Any]:
    return {"edgecolor": style.MIDDLE, "linewidth": 0.8, "linestyle": style.PRIOR_LINE["linestyle"]}


def _ridge_legend(figure: Figure, *, marked: bool) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="exact symmetry: no measured signal changes along it", **BAND),
        Line2D([], [], label="posterior draws", **{**DOTS, "markersize": 3}),
        Patch(fill=False, label="prior", **_box()),
        *(style.nominal_handles({0}) if marked else []),
        Line2D([], [], label="MAP", **style.CROSS),
    ]
    columns = handles[:1], handles[1:]
    first = figure.legend(
        handles=columns[0], loc="upper center", borderaxespad=0.3, handlelength=2.2
    )
    figure.add_artist(first)
    second = figure.legend(
        handles=columns[1],
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.22 / float(figure.get_size_inches()[1])),
        ncols=2,
        borderaxespad=0.3,
        handlelength=2.2,
        columnspacing=1.6,
    )
    figure.add_artist(second)


def invariants_figure(
    found: Verdict,
    draws: Array,
    mode: Array,
    symbols: Sequence[Symbol],
    width: float = DOUBLE,
) -> Figure:
    """Of SI draws `(N, D)` and the MAP `(D,)`; determined products, or all where none is.

    In per cent, so that a product known to 1e-5 has as readable an axis as one known to a half.
    """
    sure = [q for q in found.products if q.says != "not determined"]
    chosen = sure or list(found.products)
    shown = [_symbol(found.names, quantity.exponents, symbols) for quantity in chosen]
    powers = np.array([quantity.exponents for quantity in chosen], dtype=float)
    table = np.log([quantity.nominal for quantity in chosen])
    m = len(found.names)
    off = 100 * np.expm1(np.log(draws[:, :m]) @ powers.T - table)
    at = 100 * np.expm1(np.log(mode[:m]) @ powers.T - table)
    return corner_figure(
        off,
        shown,
        {symbol.name: 0.0 for symbol in shown},
        {symbol.name: float(x) for symbol, x in zip(shown, at, strict=True)},
        {},
        width,
    )


def _symbol(names: Sequence[str], exponents: Exponents, symbols: Sequence[Symbol]) -> Symbol:
    return Symbol(
        name=product(names, exponents),
        unit="%",
        latex=rf"\Delta\,{product_latex(exponents, symbols)}",
        latex_unit=r"\%\;of\;nominal",
        meaning="deviation from the nominal value",
    )


INVARIANTS = "The products of parameters that such a record can show (corner plot)."


def draw_invariants(run: View) -> Drawing | None:
    if run.analysis.judged is None or not run.analysis.judged.verdict.products:
        return None
    verdict, symbols = run.analysis.judged.verdict, run.problem.symbols
    return Drawing(
        invariants_figure, (verdict, run.draws, run.chain.best, symbols, run.width), says=INVARIANTS
    )


RIDGE = (
    "The ridge: parameters that no such record can tell apart, and the line along which they go."
)


def draw_ridge(run: View) -> Drawing | None:
    """Where there is a symmetry."""
    judged, shown = run.analysis.judged, run.shown()
    pair = None if judged is None else strongest_pair(run.draws, judged.study.structure)
    if pair is None:
        return None
    given = (shown.of(run.draws), pair, shown.symbols, shown.priors, shown.nominal, shown.mode)
    return Drawing(ridge_figure, given, says=RIDGE)


PRIOR_POSTERIOR = "Prior against posterior of each parameter: what the record has added."


def draw_prior_posterior(run: View) -> Drawing:
    shown = run.shown(run.config.output.parameters)
    values = (shown.priors, shown.nominal, shown.mode, run.width)
    return Drawing(
        prior_posterior_figure, (shown.of(run.draws), shown.symbols, *values), says=PRIOR_POSTERIOR
    )
