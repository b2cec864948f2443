"""Lay out pages of panels below a legend, and draw contours of two unknowns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesdrill.analysis.calibration import RankBand
from bayesdrill.basics.arrays import Array, Counts
from bayesdrill.report import style
from bayesdrill.report.scales import DOUBLE, Scale
from bayesdrill.report.style import Axes, Figure

NARROW_ROW = 0.85  # height of a row in figures of single width, relative to double width


def build_page(
    n: int,
    columns: int,
    row: float,
    width: float = DOUBLE,
    *,
    narrow: int = 2,
    first: float = 0,
    last: float = 0,
) -> tuple[Figure, list[Axes]]:
    """Build a figure and its `n` panels, row by row; matplotlib prevents overlapping texts.

    `row` is the height in inches of a row of panels and their tick labels.  A figure of single width
    has at most `narrow` panels in a row.  If a height `first` or `last` is given, a panel of the
    figure's width is added at the top or at the bottom.
    """
    if width < DOUBLE:
        columns, row = min(columns, narrow), NARROW_ROW * row
    columns = min(n, columns)
    heights = [*([first] if first else []), *[row] * math.ceil(n / columns)]
    heights += [last] if last else []
    figure = style.new_figure(width, sum(heights), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, wspace=0.01, hspace=0.01)  # type: ignore[union-attr, call-arg]
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    top = 1 if first else 0
    panels = [figure.add_subplot(grid[top + k // columns, k % columns]) for k in range(n)]
    if first:
        panels.insert(0, figure.add_subplot(grid[0, :]))
    if last:
        panels.append(figure.add_subplot(grid[-1, :]))
    figure.align_ylabels(panels)
    return figure, panels


def is_first_column(panel: Axes) -> bool:
    """Return whether a panel is at the left of its page."""
    spec = panel.get_subplotspec()
    return spec is None or spec.is_first_col()


def label_outside(panels: Sequence[Axes], x: str, y: str, *, share_y: bool = True) -> None:
    """Label equal panels: `x` below each column and, if `share_y`, `y` to the left of each row."""
    specs = [panel.get_subplotspec() for panel in panels]
    feet = {spec.colspan.start: k for k, spec in enumerate(specs) if spec is not None}
    for k, panel in enumerate(panels):
        foot = k in feet.values()
        panel.tick_params(labelbottom=foot)
        panel.set_xlabel(x if foot else "", labelpad=2)
        if share_y:
            side = is_first_column(panel)
            panel.tick_params(labelleft=side)
            panel.set_ylabel(y if side else "")


LEGEND = style.fix_look(
    loc="outside upper center",
    borderaxespad=0.3,
    labelspacing=0.3,
    columnspacing=1.4,
    handlelength=2.2,
)


def legend_above(figure: Figure, looks: Mapping[str, style.Look], **options: Any) -> Figure:
    """Put a legend above all panels in as few rows as possible, and make room; return the figure.

    `looks` has the styles of the entries by their labels.
    """
    handles = style.legend_handles(looks)
    for rows in range(1, len(handles) + 1):
        columns = math.ceil(len(handles) / rows)
        legend = figure.legend(handles=handles, ncols=columns, **{**LEGEND, **options})
        box = legend.get_window_extent()
        if box.width <= figure.bbox.width or columns == 1:
            break
        legend.remove()
    figure.set_figheight(figure.get_figheight() + box.height / figure.dpi)
    return figure


def departures(band: RankBand, ranks: Counts) -> Array:
    """Return band edges (low, high) and ECDF of the ranks, minus the uniform CDF: `(3, L + 2)`."""
    counts = np.stack([band.low, band.high, band.count_below(ranks)])
    return np.pad(counts / max(band.n, 1) - band.shares, ((0, 0), (1, 1)))


# Upper limit and -1 * lower limit of a panel / largest difference; the panel's name is on top.
HEAD_ROOM, FOOT_ROOM = 1.7, 1.12


def ranks_panel(
    panel: Axes,
    band: RankBand,
    away: Array,
    limit: float,
    wrong: str,
    numbers: int = 5,
    look: style.Look = style.CHANCE,
) -> None:
    """Draw `away`, the result of `departures`, up to `limit`; `wrong` says that ranks leave the band."""
    places, (low, high, ranks) = np.pad(band.shares, 1, constant_values=(0, 1)), away
    difference_panel(panel, places, (low, high), limit, numbers, look)
    panel.plot(places, ranks, zorder=2, **(style.OUTSIDE if wrong else style.BLACK_LINE))
    if wrong:
        style.corner_text(panel, wrong, "right", fontsize=style.letters("legend.fontsize"))


def difference_panel(
    panel: Axes,
    levels: Array,
    band: tuple[Array, Array],
    limit: float,
    numbers: int = 5,
    look: style.Look = style.CHANCE,
) -> None:
    """Draw the zero line and the `band` of chance at `levels (S,)`; the axis shows up to `limit`."""
    panel.fill_between(levels, *band, zorder=0, **look)
    panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
    panel.set_xlim(0, 1)
    panel.set_ylim(-FOOT_ROOM * limit, HEAD_ROOM * limit)
    style.set_ticks(panel.xaxis, (0.0, 0.5, 1.0), ["0", "0.5", "1"])
    style.set_ticks(
        panel.yaxis, *Scale(0.0, 0, -FOOT_ROOM * limit, FOOT_ROOM * limit).ticks(numbers)
    )


Ends = tuple[float, float]
LEVELS = tuple(1.0 - math.exp(-0.5 * sigma**2) for sigma in (1.0, 2.0))  # 39.3 %, 86.5 % in 2D
BINS = 52  # number of bins across the draws of an unknown, with a margin for the smoothing
CENTRAL_SHARE = 0.999  # fraction of the draws that an axis shows
# Above this correlation, bins are sheared, and the density is not reflected at priors' ends.
MIN_SHEARED_CORRELATION = 0.9
BANDWIDTH_FACTOR = 1.3  # relative to Scott's rule, which suits normal distributions but not boxes
# A contour needs a larger change of density per bandwidth [sds of its noise]; noise alone has 0.8.
MIN_SLOPE_SDS = 2.0
CONTOUR = {"colors": style.BLACK}
INNER_GREY, OUTER_GREY = "0.68", "0.85"  # greys inside the inner and the outer contour


def contours(
    panel: Axes,
    xy: tuple[Array, Array],
    limits: tuple[Ends, Ends],
    fine: float = 1.0,
    lines: style.Look | None = None,
) -> None:
    """Draw filled contours with `corner`; the smoothed density is reflected at ends of priors.

    If the draws are nearly on a line, bins are sheared along the regression of y on x: upright bins
    would show a ridge as wide as the bins.  A contour is omitted where the density is so flat that
    noise determines the contour.  `xy` are draws `(N,)` of two unknowns, `limits` the ends of their
    priors.  `fine` scales line widths.  With a style `lines`, contours are lines without a fill.
    """
    import corner
    from matplotlib.transforms import Affine2D

    x, y = xy
    correlation = float(np.corrcoef(x, y)[0, 1]) if np.ptp(x) > 0 and np.ptp(y) > 0 else 0.0
    slanted = abs(correlation) > MIN_SHEARED_CORRELATION
    slope = float(np.cov(x, y)[0, 1] / max(np.var(x), 1e-300)) if slanted else 0.0
    shear = Affine2D(np.array([[1.0, 0.0, 0.0], [slope, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    transform = shear + panel.transData
    across = y - slope * x
    ranges = [central(x, limits[0]), central(across, None if slanted else limits[1])]
    smooth = [_bandwidth(values, span) for values, span in zip((x, across), ranges, strict=True)]
    counts, *edges = np.histogram2d(x, across, BINS, ranges)
    levels = _resolved_levels(counts, smooth)
    if not levels and lines is None:
        (left, right), (low, high) = ranges
        panel.fill(
            [left, right, right, left], [low, low, high, high], color=OUTER_GREY, linewidth=0
        )
    if not levels:
        return
    fills = dict(zip(LEVELS, (INNER_GREY, OUTER_GREY), strict=True))
    middles = np.meshgrid(*(0.5 * (edge[:-1] + edge[1:]) for edge in edges), indexing="ij")
    corner.hist2d(
        *middles,
        weights=counts.ravel(),
        ax=panel,
        range=ranges,
        bins=BINS,
        smooth=smooth,
        levels=levels,
        plot_datapoints=False,
        plot_density=False,
        no_fill_contours=True,
        fill_contours=lines is None,
        contour_kwargs={**(lines or CONTOUR | {"linewidths": 0.7 * fine}), "transform": transform},
        contourf_kwargs={
            "colors": [(1, 1, 1, 0), *(fills[level] for level in reversed(levels))],
            "transform": transform,
        },
        quiet=True,
    )


def _bandwidth(x: Array, limits: Ends) -> float:
    return (
        float(BANDWIDTH_FACTOR * np.std(x) * len(x) ** (-1 / 6) / (limits[1] - limits[0]) * BINS)
        or 1.0
    )


def _resolved_levels(counts: Array, smooth: Sequence[float]) -> tuple[float, ...]:
    """Return those of the `LEVELS` at whose contours the density is steeper than its noise."""
    from scipy.ndimage import gaussian_filter

    density = gaussian_filter(counts, smooth)
    ordered = np.sort(density, axis=None)[::-1]
    cumulative = np.cumsum(ordered) / ordered.sum()
    slope = np.hypot(*np.gradient(density)) * math.sqrt(smooth[0] * smooth[1])
    kernel = 4.0 * math.pi * smooth[0] * smooth[1]  # number of bins that the smoothing averages
    levels = []
    for level in LEVELS:
        height = ordered[np.searchsorted(cumulative, level)]
        noise = math.sqrt(height / kernel)
        on_contour = np.abs(density - height) <= max(2.0 * noise, np.abs(density - height).min())
        if np.median(slope[on_contour]) > MIN_SLOPE_SDS * noise:
            levels.append(level)
    return tuple(levels)


def central(x: Array, limits: Ends | None = None) -> Ends:
    """Return a range of nearly all draws, with a margin for the smoothing, inside `limits`."""
    low, high = np.quantile(x, [0.5 - CENTRAL_SHARE / 2, 0.5 + CENTRAL_SHARE / 2])
    margin = 0.15 * float(high - low) or 1e-9
    first, last = limits or (-math.inf, math.inf)
    return max(float(low) - margin, first), min(float(high) + margin, last)
