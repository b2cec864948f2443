"""Draw the runs of a campaign over time, with their population and its history."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, product_latex
from bayesdrill.campaigns.fit import PopulationFit
from bayesdrill.campaigns.runs import CampaignPlan
from bayesdrill.config.schema.campaign import SECONDS
from bayesdrill.report import scales, style
from bayesdrill.report.pages import build_page, label_outside, legend_above
from bayesdrill.report.style import Axes, Figure

MOST_LINKED = 500  # largest number of points that are links to pages
MOST_SHOWN = 2000  # largest number of runs in a chart, in addition to outliers
BAR = style.fix_look(color=style.MIDDLE, linewidth=0.6, zorder=2)
DOT = style.fix_look(color=style.BLACK, marker="o", markersize=2.2, linestyle="none")
FOREIGN = style.fix_look(
    color=style.MAP_COLOUR, marker="x", markersize=4.5, markeredgewidth=1.2, linestyle="none"
)


@dataclass(frozen=True, slots=True)
class Point:
    """A point represents a run, at the data coordinates `x` and `y` of a panel."""

    run_name: str
    panel: Axes
    x: float
    y: float


def runs_figure(
    plan: CampaignPlan,
    population: PopulationFit,
    exponents: Sequence[Sequence[int]],
    symbols: Sequence[Symbol],
    width: float = scales.DOUBLE,
) -> tuple[Figure, tuple[Point, ...]]:
    """Draw a panel for each product: deviations of runs from the centre in percent, over time.

    Without times, the number of the run replaces the time.  Returns the figure and its points.
    """
    points = list[Point]()
    times = {run.name: run.time for run in plan.runs}
    names = [run.name for run in population.runs]
    known = [times[name] for name in names]
    timed = None not in known and len({*known}) > 1
    x, label = np.arange(1.0, len(names) + 1.0), "run"
    if timed:
        x = np.array(known, dtype=float) / SECONDS[plan.spec.time_unit]
        label = f"time [{plan.spec.time_unit}]"
    with style.styled(width):
        figure, panels = build_page(len(population.products), 2, 1.5, width)
        for k, panel in enumerate(panels):
            heights = _panel(panel, population, k, x)
            shown = style.thin(len(names), MOST_LINKED)
            points += [Point(names[i], panel, x[i], heights[i]) for i in shown]
            latex = product_latex(exponents[k], symbols)
            panel.set_ylabel(rf"$\Delta\,{latex}$ [%]")
        label_outside(panels, label, "", share_y=False)
        looks: dict[str, style.Look] = {
            "run by itself": BAR,
            "run in the population": DOT,
            "next run, 50 %": style.BAND,
            "next run, 90 %": style.FAINT_BAND,
        }
        if any(run.outlier for run in population.runs):
            looks["does not belong"] = FOREIGN
        if any(p.table is not None for p in population.populations):
            looks["nominal value"] = style.NOMINAL
        return legend_above(figure, looks), tuple(points)


def relative_positions(
    figure: Figure, points: Sequence[Point]
) -> Iterator[tuple[str, float, float]]:
    """Yield run, x and y of each point: fractions of a drawn figure, from its upper left corner."""
    for point in points:
        pixels = point.panel.transData.transform((point.x, point.y))
        across, up = figure.transFigure.inverted().transform(pixels)
        yield point.run_name, float(across), 1.0 - float(up)


def _panel(panel: Axes, population: PopulationFit, k: int, x: Array) -> Array:
    """Draw product `k` of each run at `x (R,)`, in front of the intervals of a next run.

    The intervals follow the level of the product over time.  Returns the y of the points.
    """
    known, runs = population.populations[k], population.runs
    centre = known.centre.mean

    def relative(log: Array | float) -> Array:
        return np.asarray(100.0 * np.expm1(np.asarray(log) - centre))

    place = {run.name: i for i, run in enumerate(runs)}
    order, level = np.argsort(x, kind="stable"), np.zeros(len(x))
    if population.charts:
        order = np.array([place[name] for name in population.timed])
        level = population.charts[k].history.level_over(x[order])
    ahead = known.next_run
    for low, high, look in (
        (ahead.low_90, ahead.high_90, style.FAINT_BAND),
        (ahead.low_50, ahead.high_50, style.BAND),
    ):
        ends = relative(low + level), relative(high + level)
        panel.fill_between(x[order], *ends, step="mid", zorder=0, **look)
    foreign = np.array([run.outlier for run in runs])
    shown = np.zeros(len(runs), dtype=bool)
    shown[style.thin(len(runs), MOST_SHOWN)] = True
    alone, sd = (np.array([getattr(run, n)[k] for run in runs]) for n in ("alone", "alone_sd"))
    shrunk = np.array([run.shrunk[k] for run in runs])
    bars = shown | foreign
    panel.vlines(x[bars], relative(alone - sd)[bars], relative(alone + sd)[bars], **BAR)
    panel.plot(x[shown & ~foreign], relative(shrunk)[shown & ~foreign], zorder=3, **DOT)
    panel.plot(x[foreign], relative(alone)[foreign], zorder=4, **FOREIGN)
    inside = np.concatenate([relative(alone - sd)[bars], relative(alone + sd)[bars]])
    reach = [*inside, *map(float, (relative(ahead.low_90), relative(ahead.high_90)))]
    low, high = min(reach), max(reach)
    margin = 0.06 * (high - low)
    scale = scales.Scale(0.0, 0, low - margin, high + margin)
    style.scale_axis(panel.yaxis, scale, "", 5)
    if known.table is not None:
        style.mark_values(panel, scale, float(relative(known.table.nominal.value)), vertical=True)
    return np.where(foreign, relative(alone), relative(shrunk))
