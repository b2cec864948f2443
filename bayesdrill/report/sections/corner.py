"""Draw the joint posterior: all marginals of one and of two unknowns, with a legend."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import hdi
from bayesdrill.inference.display_units import DisplayedUnknowns
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.pages import (
    BINS,
    CENTRAL_SHARE,
    INNER_GREY,
    LEVELS,
    OUTER_GREY,
    central,
    contours,
)
from bayesdrill.report.scales import DOUBLE, Scale
from bayesdrill.report.section import CREDIBLE
from bayesdrill.report.sections.products import derived_shown
from bayesdrill.report.style import Axes, Axis, Figure
from bayesdrill.report.view import Drawing, ReportContext

GAP = 0.06  # gap between panels, relative to a panel
LARGEST = 2.2 * (1 + GAP)  # largest distance of a panel from the next, in inches
LEAST = 13.0 / 72  # smallest distance of a panel from the next, in inches; pages grow to keep it
READABLE = 5.7  # font size [points] below which labels are turned, and show the range of their axis
SMALLEST = 5.2  # smallest font size of numbers at an axis, in points
BELOW = 0.11  # inches for the gap above a turned label and the margin under it
CLEAR = 0.1  # share of an axis at each end that has no numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerLayout:
    """Panels are `pitch` font sizes apart; margins are in inches per point of font size."""

    pitch: float
    left: float
    right: float

    def sizes(self, n: int, width: float) -> tuple[float, float]:
        """Return the font size [points] and the panels' pitch [inches] for `n` unknowns."""
        most, margins = 10.0 if width >= DOUBLE else 8.5, self.left + self.right
        letters = min(most, width / (n * self.pitch / 72 + margins))
        pitch = min(max((width - margins * letters) / n, LEAST), LARGEST)
        return min(most, 72 * pitch / self.pitch), pitch


NUMBERED = CornerLayout(pitch=7.8, left=0.088, right=0.012)
TURNED = CornerLayout(pitch=2.6, left=0.085, right=0.075)


def _label_with_ends(scale: Scale, symbol: Symbol) -> str:
    """Return the text for an axis that has no room for numbers: label, and range on a second line."""
    ends = scale.axis_numbers(scale.value(np.array([scale.low, scale.high])))
    low, high = (f"{end:.3g}".replace("-", "\N{MINUS SIGN}") for end in ends)
    return f"{scale.label(symbol)}\n{low} to {high}"


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerPage:
    """The page has `panels (n, n)` for pairs of `axes`; they are None above the diagonal.

    A legend may widen the page up to `width` [inches]. `letters` [points] is the font size of
    labels, and `pitch` [inches] the distance from panel to panel. Small panels have thinner lines
    and marks, by the factor `fine`. Labels are `turned` if numbers would be too small.
    """

    figure: Figure
    panels: NDArray[np.object_]
    axes: Sequence[tuple[Scale, Symbol]]
    width: float
    letters: float
    pitch: float
    fine: float
    turned: bool

    @classmethod
    def build(cls, axes: Sequence[tuple[Scale, Symbol]], width: float) -> CornerPage:
        """Lay out these axes within `width`, or wider if panels would be smaller than `LEAST`."""
        n, layout = len(axes), NUMBERED
        letters, pitch = layout.sizes(n, width)
        if letters < READABLE:
            layout = TURNED
            letters, pitch = layout.sizes(n, width)
        inside, title = pitch * (n - GAP / (1 + GAP)), 0.02 + 0.028 * letters
        left, right, bottom = layout.left * letters, layout.right * letters, layout.left * letters
        if layout is TURNED:
            page = style.new_figure(1.0, 1.0)
            texts = [page.text(0, 0, _label_with_ends(*each), size=letters) for each in axes]
            longest = max(text.get_window_extent().width / text.figure.dpi for text in texts)
            bottom = longest + BELOW
        figure = style.new_figure(left + inside + right, bottom + inside + title)
        across, up = figure.get_size_inches()
        ends = {"left": left / across, "right": (left + inside) / across}
        ends |= {"bottom": bottom / up, "top": (bottom + inside) / up}
        grid = figure.add_gridspec(n, n, wspace=GAP, hspace=GAP, **ends)
        panels = np.full((n, n), None)
        fine = min(1.0, max(0.45, pitch / 1.11))
        for i, j in np.argwhere(np.tri(n)):
            panel = panels[i, j] = figure.add_subplot(grid[i, j])
            panel.tick_params(size=3.0 * fine, width=0.6 * fine)
            for spine in panel.spines.values():
                spine.set_linewidth(0.6 * fine)
        sizes: dict[str, float] = {"width": width, "letters": letters, "pitch": pitch, "fine": fine}
        turned = layout is TURNED
        return cls(figure=figure, panels=panels, axes=axes, turned=turned, **sizes)

    def finish(self, looks: Mapping[str, style.Look]) -> None:
        """Set limits, numbers and labels of panels that are drawn, and add the legend."""
        self._set_numbers()
        if self.turned:
            self._label_ends()
        self._add_legend(style.legend_handles(looks))

    def _set_numbers(self) -> None:
        letter = 0.43 * self.letters / (72 * self.pitch)  # width of a letter, relative to a panel

        def number(axis: Axis, k: int, outer: bool) -> None:
            scale, symbol = self.axes[k]
            places, values = scale.ticks(clear=CLEAR, letter=letter)
            between = scale.minor_ticks if self.fine == 1 else style.NONE
            style.set_ticks(axis, places, values if outer else None, between)
            if outer:
                size = max(0.85 * self.letters, SMALLEST)
                axis.set_tick_params(labelsize=size, pad=0.4 * self.letters)
                for text in axis.get_ticklabels():
                    text.set(rotation=45, ha="right", va="center_baseline", rotation_mode="anchor")
                axis.set_label_text(scale.label(symbol, "\n"), fontsize=self.letters)
                axis.labelpad = 0.2 * self.letters

        shown, panels, n = self.axes, self.panels, len(self.axes)
        for i, j in np.argwhere(np.tri(n)):
            panels[i, j].set_xlim(shown[j][0].low, shown[j][0].high)
            number(panels[i, j].xaxis, j, not self.turned and i == n - 1)
            if i > j:
                panels[i, j].set_ylim(shown[i][0].low, shown[i][0].high)
                number(panels[i, j].yaxis, i, not self.turned and j == 0)
        self.figure.align_xlabels(list(panels[-1]))
        self.figure.align_ylabels(list(panels[1:, 0]))

    def _label_ends(self) -> None:
        """Write the ends of each axis under its label, where panels are too small for numbers."""
        look: dict[str, Any] = {"fontsize": self.letters, "labelpad": 2}
        for k, (scale, symbol) in enumerate(self.axes):
            text = _label_with_ends(scale, symbol)
            self.panels[-1, k].set_xlabel(text, rotation=90, va="top", linespacing=1.0, **look)
            if k:
                name = f"${symbol.latex}$"
                self.panels[k, 0].set_ylabel(name, rotation=0, ha="right", va="center", **look)

    def _add_legend(self, handles: Sequence[Any]) -> None:
        """Put a legend in the upper right; the page grows sideways up to `width`, then upwards."""
        figure = self.figure
        look: dict[str, Any] = {"loc": "upper right", "borderaxespad": 0.3}
        legend = figure.legend(handles=handles, **look)
        box = legend.get_window_extent().padded(0.04 * figure.dpi)
        legend.remove()
        panels = [panel.get_tightbbox() for panel in self.panels.diagonal()]
        across, up = figure.get_size_inches()
        beside = [panel.x1 for panel in panels if panel.y1 > box.y0]
        missing = (max(beside, default=0.0) - box.x0) / figure.dpi
        wider = min(max(missing, 0.0), max(self.width - across, 0.0))
        below = [panel.y1 for panel in panels if panel.x1 > box.x0 + wider * figure.dpi]
        higher = max((max(below, default=0.0) - box.y0) / figure.dpi, 0.0)
        figure.set_size_inches(across + wider, up + higher)
        style.shrink(figure, across / (across + wider), up / (up + higher))
        figure.legend(handles=handles, **look)


def _legend(columns: Sequence[CornerColumn]) -> dict[str, style.Look]:
    looks: dict[str, style.Look] = {
        "posterior": {"color": style.BLACK, "linewidth": 0.8},
        f"narrowest {CREDIBLE} interval": style.FAINT_BAND,
    }
    if any(column.prior is not None for column in columns):
        looks["prior"] = style.PRIOR_LINE
    known = [column for column in columns if column.nominal is not None]
    looks |= style.nominal_looks({column.scale.side(column.nominal) for column in known})
    if any(column.mode is not None for column in columns):
        looks["MAP"] = {**style.CROSS, "linestyle": style.MAP_LINE["linestyle"]}
    notes = [f"titles: median and {CREDIBLE} interval, in axis units"]
    if len(columns) > 1:
        for grey, level, sds in zip((INNER_GREY, OUTER_GREY), LEVELS, (1, 2), strict=True):
            text = rf"{100 * level:.1f} % of the draws (${sds}\sigma$ in two dimensions)"
            looks[text] = {"facecolor": grey, "edgecolor": "black", "linewidth": 0.7}
        notes.append("no contour where the density is flat")
    if any(column.scale.origin for column in columns):
        notes.append(r"$\delta$: difference from the number in the label")
    return looks | dict.fromkeys(notes, style.WORDS)


POINTS = 2000  # largest number of points in a panel; contours and histograms use all draws
REACH = 1.0  # largest extension of an axis to show the nominal value, in widths of the axis


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerColumn:
    """The column has one unknown, its draws `(N,)`, and their positions `x (N,)` on the axis."""

    symbol: Symbol
    scale: scales.Scale
    draws: Array
    x: Array
    prior: Prior | None
    nominal: float | None
    mode: float | None

    @property
    def prior_ends(self) -> tuple[float, float]:
        """Return the ends of the prior on the axis; they may be infinite."""
        if self.prior is None:
            return -math.inf, math.inf
        return float(self.scale(self.prior.low)), float(self.scale(self.prior.high))


def corner_figure(
    draws: Array, displayed: DisplayedUnknowns, width: float = scales.DOUBLE
) -> Figure:
    """Draw a corner plot of draws `(N, D)` of `displayed` quantities, about `width` inches wide."""
    columns = [
        _column(x, symbol, displayed) for x, symbol in zip(draws.T, displayed.symbols, strict=True)
    ]
    with style.styled(width):
        page = CornerPage.build([(column.scale, column.symbol) for column in columns], width)
        for i, row in enumerate(columns):
            _marginal(page.panels[i, i], row, page)
            for j, column in enumerate(columns[:i]):
                xy, ends = (column.x, row.x), (column.prior_ends, row.prior_ends)
                contours(page.panels[i, j], xy, ends, page.fine)
                _marks(page.panels[i, j], column, row, page)
        if len(columns) == 1:
            page.panels[0, 0].set_ylabel("density", fontsize=page.letters)
        page.finish(_legend(columns))
        _points(columns, page)
    return page.figure


def _column(x: Array, symbol: Symbol, displayed: DisplayedUnknowns) -> CornerColumn:
    """Return a column whose axis shows nearly all draws, the MAP, and the nominal value if near."""
    name, prior = symbol.name, displayed.priors.get(symbol.name)
    nominal, mode, log = displayed.nominal.get(name), displayed.mode.get(name), flat_in_logs(prior)
    low, high = np.quantile(x, [0.5 - CENTRAL_SHARE / 2, 0.5 + CENTRAL_SHARE / 2]).tolist()
    low, high = scales.reaching(low, high, mode, log=log)
    low, high = scales.reaching(low, high, nominal, REACH, log=log)
    scale = scales.scale(low, high, log=log, margin=0.06)
    return CornerColumn(
        symbol=symbol, scale=scale, draws=x, x=scale(x), prior=prior, nominal=nominal, mode=mode
    )


def _title(column: CornerColumn, interval: Array) -> str:
    scale = column.scale
    name = ("" if scale.origin == 0 else r"\delta ") + column.symbol.latex
    middle, low, high = scale.axis_numbers(np.array([float(np.median(column.draws)), *interval]))
    power = math.floor(math.log10(abs(middle))) if middle and not scale.origin else 0
    if not scale.log or -2 <= power <= 2:
        return f"${name} = {scales.with_spread(middle, low, high)}$"
    spread = scales.with_spread(*(x / 10.0**power for x in (middle, low, high)))
    return rf"${name} = ({spread})\,10^{{{power}}}$"


def _points(columns: Sequence[CornerColumn], page: CornerPage) -> None:
    """Plot some draws as one artist, because each rasterised artist takes memory for a whole page."""
    from matplotlib.lines import Line2D

    shown = style.thin(len(columns[0].x), round(POINTS * page.fine**2))
    places = []
    for i, j in itertools.combinations(range(len(columns)), 2):
        panel, pair = page.panels[j, i], (columns[i], columns[j])
        panel.patch.set_visible(False)
        low, high = np.transpose([(column.scale.low, column.scale.high) for column in pair])
        inside = (np.stack([column.x[shown] for column in pair], axis=-1) - low) / (high - low)
        inside = inside[np.all((inside > 0) & (inside < 1), axis=-1)]
        box = panel.get_position()
        places.append(box.p0 + inside * box.size)
    if places:
        x, y = np.concatenate(places).T
        look = style.finer(style.DOTS, page.fine)
        page.figure.add_artist(Line2D(x, y, transform=page.figure.transFigure, **look))


def _marginal(panel: Axes, column: CornerColumn, page: CornerPage) -> None:
    """Draw a histogram of all draws, cut at ends of the prior, and the prior to the same scale."""
    x, scale = column.x, column.scale
    interval = np.array(hdi(column.draws))
    begin, end = scale(interval).tolist()
    panel.axvspan(begin, end, color=style.FAINT, zorder=-2, linewidth=0)
    low, high = central(x)
    across = min(float(BINS), 2.2 * math.cbrt(len(x)))  # fewer bins for few draws
    first = max(column.scale.low, column.prior_ends[0])
    last = min(column.scale.high, column.prior_ends[1])
    n = round(across * (last - first) / (high - low))
    edges = np.linspace(first, last, max(1, min(n, 4 * BINS)) + 1)
    counts, _ = np.histogram(x, edges)
    panel.stairs(counts, edges, color=style.BLACK, linewidth=0.8 * page.fine)
    top = max(1.0, float(counts.max()))
    if column.prior is not None:
        places = np.linspace(scale.low, scale.high, 401)
        height = scale.density(column.prior, places) * len(x) * float(edges[1] - edges[0])
        panel.plot(places, height, **style.finer(style.PRIOR_LINE, page.fine))
        top = max(top, float(height.max()))
    panel.set_ylim(0, 1.1 * top)
    panel.set_yticks([])
    style.mark_values(panel, scale, column.nominal, column.mode, fine=page.fine)
    title, pad = _title(column, interval), 0.6 * page.letters - 1
    panel.set_title(title, fontsize=page.letters, loc="left", pad=pad)


def _marks(panel: Axes, column: CornerColumn, row: CornerColumn, page: CornerPage) -> None:
    look: dict[str, Any] = {"arrow": False, "fine": page.fine}
    style.mark_values(panel, column.scale, column.nominal, **look)
    style.mark_values(panel, row.scale, row.nominal, vertical=True, **look)
    if column.mode is not None and row.mode is not None:
        x, y = float(column.scale(column.mode)), float(row.scale(row.mode))
        panel.plot([x], [y], **style.finer(style.CROSS, page.fine))


def draw_corner(run: ReportContext) -> Drawing:
    """Return the drawing of the joint posterior."""
    names = run.config.output.corner or run.config.output.parameters
    # A figure of unknowns alone does not wait until derived quantities are computed.
    derived = run.chain.nothing_derived if {*(names or ())} <= {*run.problem.names} else run.derived
    at = (run.sampled.draws, derived, run.chain.best[None])
    draws, shown = derived_shown(run.problem, names, *at)
    says = "The posterior of each parameter and each pair (corner plot), beside nominal values and MAP."
    return Drawing(corner_figure, (draws, shown, run.width), says)
