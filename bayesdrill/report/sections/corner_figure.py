"""Draw the joint posterior: all marginals of one and of two unknowns, with a legend."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.derived import HDI_PROBABILITY, hdi
from bayesdrill.inference.display_units import DisplayedUnknowns
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.pages import (
    BINS,
    CENTRAL_SHARE,
    CORNER_GAP,
    INNER_GREY,
    LEVELS,
    OUTER_GREY,
    central,
    contours,
    corner_axes,
    corner_panels,
)
from bayesdrill.report.scales import DOUBLE, SINGLE
from bayesdrill.report.sections import physics_words
from bayesdrill.report.view import Drawing, ReportContext

LARGEST = 2.2  # panel
LEAST = 13.0  # points from one panel to the next: a page grows rather than have less
LABEL = 7.8  # letters across a panel that its label and unit need, one upon the other
UPRIGHT = 2.6  # and where they are turned by a right angle
READABLE = 5.7  # points: below, labels are turned
TITLE = 0.106  # inches of a title, for each point of its letters
LEGEND = 2.35, 0.21  # inches of a legend beside, or above, of 8 points, and of a line of it


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerPage:
    """The layout of a corner: inches, and `letters` in points."""

    n: int
    width: float
    pitch: float
    left: float
    right: float
    bottom: float
    letters: float
    legend_letters: float
    compact: bool
    top: float = 0.0
    above: bool = False

    @classmethod
    def build(cls, n: int, width: float, lines: int) -> CornerPage:
        """Lay out `n` unknowns in at most `width`, with a legend of so many `lines`.

        It stands in the corner or beside a single panel, where it has room there; else above.
        """
        page = cls._fitting(n, width, compact=False)
        if page.letters < READABLE:
            page = cls._fitting(n, width, compact=True)
        across, line = (size * page.legend_letters / 8.0 for size in LEGEND)
        title = 0.02 + 0.028 * page.letters
        alone = page.left + across + page.right + page.pitch if n == 1 else 0.0
        broad = max(page.width, alone)
        beside = min(n, math.ceil((title + lines * line) / page.pitch))
        titled = (beside - 1) * page.pitch + TITLE * page.letters
        occupied = page.left + max(beside * page.pitch, titled)
        has_room = n == 1 or (beside < n and broad - across > occupied)
        if broad <= width and has_room:
            return replace(page, width=broad, top=title)
        rows = math.ceil(lines / 2) + 1
        least = max(page.width, min(width, SINGLE))
        return replace(page, width=least, top=title + rows * 0.75 * line, above=True)

    @classmethod
    def _fitting(cls, n: int, width: float, *, compact: bool) -> CornerPage:
        """With ticks and labels along the panels, or `compact`."""
        letters, pitch, side, edge, foot, across = 10.0, 10.0, 0.088, 0.12, 0.088, LABEL
        ends, most = (0.0, LARGEST * (1 + CORNER_GAP)), 10.0 if width >= DOUBLE else 8.5
        if compact:
            letters, pitch, side, edge, foot, across = 6.0, 0.3, 0.085, 0.06, 0.17, UPRIGHT
            ends, most = (LEAST / 72, math.inf), 6.5
        for _ in range(30):
            left, right = side * letters, max(edge, TITLE * letters - pitch)
            pitch = min(max((width - left - right) / n, ends[0]), ends[1])
            letters = min(most, 72 * pitch / across)
        return cls(
            n=n,
            width=left + n * pitch + right,
            pitch=pitch,
            left=left,
            right=right,
            bottom=foot * letters,
            letters=letters,
            legend_letters=8.0 if width >= DOUBLE else 6.4,
            compact=compact,
        )

    @property
    def inside(self) -> float:
        """The size of all panels, and the gaps between them."""
        return self.n * self.pitch - CORNER_GAP * self.panel

    @property
    def panel(self) -> float:
        """The size of a panel."""
        return self.pitch / (1 + CORNER_GAP)

    @property
    def height(self) -> float:
        """The height of the page."""
        return self.bottom + self.inside + self.top

    @property
    def fine(self) -> float:
        """The factor by which lines and marks are thinner than in a large panel."""
        return min(1.0, max(0.45, self.panel / 1.05))


Handles = list[Line2D | Patch]


def _handles(columns: Sequence[CornerColumn]) -> tuple[Handles, Handles]:
    """Lines, then shades and notes."""
    credible = f"{100 * HDI_PROBABILITY:.0f} %"
    lines: Handles = [
        Line2D([], [], color=style.BLACK, linewidth=0.8, label="posterior"),
        Patch(color=style.FAINT, label=f"narrowest {credible} interval"),
    ]
    if any(column.prior is not None for column in columns):
        lines.append(Line2D([], [], label="prior", **style.PRIOR_LINE))
    lines += style.nominal_handles(
        {column.scale.side(column.nominal) for column in columns if column.nominal is not None}
    )
    if any(column.mode is not None for column in columns):
        both = {**style.CROSS, "linestyle": style.MAP_LINE["linestyle"]}
        lines.append(Line2D([], [], label="MAP", **both))
    shades: Handles = []
    notes = [f"titles: median and {credible} interval, as on the axes"]
    if len(columns) > 1:
        for grey, level, sds in zip((INNER_GREY, OUTER_GREY), LEVELS, (1, 2), strict=True):
            text = rf"{100 * level:.1f} % of the draws (${sds}\sigma$ in two dimensions)"
            shades.append(Patch(facecolor=grey, edgecolor="black", linewidth=0.7, label=text))
        notes.append("no contour where the density is flat")
    if any(column.scale.origin for column in columns):
        notes.append(r"$\delta$: the difference that the axis shows")
    return lines, shades + [Line2D([], [], linestyle="none", label=note) for note in notes]


def legend(figure: Figure, first: Handles, second: Handles, page: CornerPage) -> None:
    """Put the legend in the empty upper right, beside a single panel, or above."""
    size = page.legend_letters
    look: dict[str, Any] = {"fontsize": size, "borderaxespad": 0.0, "handlelength": 2.2}
    edge = 0.5 * min(page.right, 0.2) / page.width
    groups: list[tuple[Any, float, Handles]] = [("upper right", 1 - edge, [*first, *second])]
    if page.above:
        look["labelspacing"] = 0.35
        groups = [("upper left", 0.05 / page.width, first), ("upper right", 1.0, second)]
    for location, x, group in groups:
        at = (x, 1 - 0.07 / page.height)
        figure.legend(handles=group, loc=location, bbox_to_anchor=at, **look)


POINTS = 2000  # drawn in a panel; contours and histograms count all draws
REACH = 1.0  # the axis grows by this share of its width at most to show the nominal value


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerColumn:
    """One unknown on its axis: its draws `(N,)` are at `x`."""

    symbol: Symbol
    scale: scales.Scale
    draws: Array
    x: Array
    prior: Prior | None
    nominal: float | None
    mode: float | None

    @property
    def ends(self) -> tuple[float, float]:
        """Where the prior ends on the axis, or infinite."""
        if self.prior is None:
            return -math.inf, math.inf
        return float(self.scale(self.prior.low)), float(self.scale(self.prior.high))


def corner_figure(draws: Array, shown: DisplayedUnknowns, width: float = scales.DOUBLE) -> Figure:
    """Draw a D by D corner of draws `(N, D)` of what is `shown`, at most `width` wide."""
    columns = [_column(x, symbol, shown) for x, symbol in zip(draws.T, shown.symbols, strict=True)]
    with style.styled(width):
        first, second = _handles(columns)
        page = CornerPage.build(len(columns), width, len(first) + len(second))
        size = (page.width, page.height)
        figure, panels = corner_panels(page.n, size, page.left, page.bottom, page.inside)
        for panel in panels[np.tril_indices(page.n)]:
            panel.tick_params(size=3.0 * page.fine, width=0.6 * page.fine)
            for spine in panel.spines.values():
                spine.set_linewidth(0.6 * page.fine)
        for i, row in enumerate(columns):
            _marginal(panels[i, i], row, page)
            for j, column in enumerate(columns[:i]):
                contours(panels[i, j], (column.x, row.x), (column.ends, row.ends), page.fine)
                _marks(panels[i, j], column, row, page)
        axes = [(column.scale, column.symbol) for column in columns]
        look: dict[str, Any] = {"texts": not page.compact, "small": page.fine == 1.0}
        corner_axes(panels, axes, page.letters, 0.43 * page.letters / (72 * page.pitch), **look)
        if page.n == 1:
            panels[0, 0].set_ylabel("density", fontsize=page.letters)
        if page.compact:
            _upright(panels, columns, page)
        _points(figure, panels, columns, page)
        legend(figure, first, second, page)
    return figure


def _column(x: Array, symbol: Symbol, shown: DisplayedUnknowns) -> CornerColumn:
    """Its axis has nearly all draws, the mode, and the nominal value if it is not too far."""
    name, prior = symbol.name, shown.priors.get(symbol.name)
    nominal, mode, log = shown.nominal.get(name), shown.mode.get(name), flat_in_logs(prior)
    low, high = np.quantile(x, [0.5 - CENTRAL_SHARE / 2, 0.5 + CENTRAL_SHARE / 2]).tolist()
    low, high = scales.reaching(low, high, mode, log=log)
    low, high = scales.reaching(low, high, nominal, REACH, log=log)
    scale = scales.scale(low, high, log=log, margin=0.06)
    return CornerColumn(
        symbol=symbol, scale=scale, draws=x, x=scale(x), prior=prior, nominal=nominal, mode=mode
    )


def _title(column: CornerColumn, interval: Array) -> str:
    """Median and interval, in the numbers of the axis."""
    scale = column.scale
    name = ("" if scale.origin == 0 else r"\delta ") + column.symbol.latex
    middle, near, far = scale.number(np.array([float(np.median(column.draws)), *interval]))
    power = math.floor(math.log10(abs(middle))) if middle and not scale.origin else 0
    if not scale.log or -2 <= power <= 2:
        return f"${name} = {scales.with_spread(middle, near, far)}$"
    spread = scales.with_spread(*(x / 10.0**power for x in (middle, near, far)))
    return rf"${name} = ({spread})\,10^{{{power}}}$"


def _points(
    figure: Figure, panels: NDArray[np.object_], columns: Sequence[CornerColumn], page: CornerPage
) -> None:
    """Some draws below all panels, as one artist: each rasterised one costs a page of pixels."""
    shown = style.thin(len(columns[0].x), round(POINTS * page.fine**2))
    places = []
    for i, j in itertools.combinations(range(len(columns)), 2):
        panel, pair = panels[j, i], (columns[i], columns[j])
        panel.patch.set_visible(False)
        low, high = np.transpose([(column.scale.low, column.scale.high) for column in pair])
        inside = (np.stack([column.x[shown] for column in pair], axis=-1) - low) / (high - low)
        inside = inside[np.all((inside > 0) & (inside < 1), axis=-1)]
        box = panel.get_position()
        places.append(box.p0 + inside * box.size)
    if places:
        x, y = np.concatenate(places).T
        look = style.finer(style.DOTS, page.fine)
        figure.add_artist(Line2D(x, y, transform=figure.transFigure, **look))


def _marginal(panel: Axes, column: CornerColumn, page: CornerPage) -> None:
    """A histogram of all draws, with bins that end where the prior does, and the prior on its scale."""
    x, scale = column.x, column.scale
    interval = np.array(hdi(column.draws))
    near, far = scale(interval).tolist()
    panel.axvspan(near, far, color=style.FAINT, zorder=-2, linewidth=0)
    low, high = central(x)
    across = min(float(BINS), 2.2 * math.cbrt(len(x)))  # fewer bins for few draws
    first = max(column.scale.low, column.ends[0])
    last = min(column.scale.high, column.ends[1])
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
    """Nominal values as lines and the mode as a cross."""
    look: dict[str, Any] = {"arrow": False, "fine": page.fine}
    style.mark_values(panel, column.scale, column.nominal, **look)
    style.mark_values(panel, row.scale, row.nominal, vertical=True, **look)
    if column.mode is not None and row.mode is not None:
        x, y = float(column.scale(column.mode)), float(row.scale(row.mode))
        panel.plot([x], [y], **style.finer(style.CROSS, page.fine))


def _upright(
    panels: NDArray[np.object_], columns: Sequence[CornerColumn], page: CornerPage
) -> None:
    """Where panels are too small for ticks: the ends of each axis under its label."""
    look: dict[str, Any] = {"fontsize": page.letters, "labelpad": 2}
    for k, column in enumerate(columns):
        scale = column.scale
        ends = scale.number(scale.value(np.array([scale.low, scale.high])))
        low, high = (scales.short_number(float(end)) for end in ends)
        text = f"{scale.label(column.symbol)}\n{low} to {high}"
        panels[-1, k].set_xlabel(text, rotation=90, va="top", linespacing=1.0, **look)
        if k:
            name = f"${column.symbol.latex}$"
            panels[k, 0].set_ylabel(name, rotation=0, ha="right", va="center", **look)


def draw_corner(run: ReportContext) -> Drawing:
    """Return the drawing of the joint posterior."""
    names = run.config.output.corner or run.config.output.parameters
    # Where it shows unknowns alone, it does not wait for what follows from them.
    derived = run.chain.nothing_derived if {*(names or ())} <= {*run.problem.names} else run.derived
    at = (run.sampled.draws, derived, run.chain.best[None])
    draws, shown = physics_words.derived_shown(run.problem, names, *at)
    says = "The posterior of each parameter and each pair (corner plot), beside nominal values and MAP."
    return Drawing(corner_figure, (draws, shown, run.width), says)
