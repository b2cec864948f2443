"""Show several runs together: in a table, a corner plot, and rows of intervals."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.analysis.comparison import MarginalEstimate, OverlayRow, PosteriorSummary
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.priors import flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.pages import LEVELS, build_page, contours, legend_above
from bayesdrill.report.section import CREDIBLE, HDI_ENDS, Table, lines_as_csv
from bayesdrill.report.sections.corner import CornerPage
from bayesdrill.report.style import Axes, Figure


def overlay_shown(row: OverlayRow, units: DisplayUnits) -> OverlayRow:
    """Return a row in the display unit of its symbol."""
    factor = units.factor(row.symbol.name)
    return dataclasses.replace(
        row,
        symbol=units.symbol(row.symbol),
        places=tuple(
            place
            and MarginalEstimate(**{k: x / factor for k, x in dataclasses.asdict(place).items()})
            for place in row.places
        ),
        nominal=tuple(None if value is None else value / factor for value in row.nominal),
    )


def in_logs(row: OverlayRow, layers: Sequence[PosteriorSummary]) -> bool:
    """Return whether the first run that has this unknown has a prior that is flat in logs."""
    priors = (
        layer.problem.posterior.space.priors.get(row.symbol.name)
        for layer in layers
        if row.symbol in layer.problem.symbols
    )
    return flat_in_logs(next(priors, None))


LONGEST = 60  # largest number of letters of a setting
SAID = 3  # largest number of unknowns that are named
FAR = 0.5  # distance in sds below which no unknown is named
APART = "apart [sd]"
OVERLAY_READ = (
    "Mean and sd of each run, in the unit of the first. "
    f"`{APART}` is the largest difference of two means, divided by the root mean square of their sds. "
    "For two independent records of one rig, chance exceeds 2.8 in one of twenty cases. Runs of one "
    "record differ by their priors, held values and models."
)
COLUMNS = ("name", "unit", "run", "nominal", "mean", "sd", *HDI_ENDS, "held", "apart")


def overlay_csv(layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow]) -> str:
    """Return CSV in SI, a line for each unknown and run; `apart` is the largest distance of two runs."""
    lines: list[Sequence[object]] = [COLUMNS]
    for row in rows:
        for layer, place, nominal in zip(layers, row.places, row.nominal, strict=True):
            if place is not None:
                sd = (place.sd, place.low, place.high)
                numbers = (nominal, place.mean, *((None,) * 3 if place.fixed else sd))
                last = ("yes" if place.fixed else "no", row.distance)
                lines.append((row.symbol.name, row.symbol.unit, layer.name, *numbers, *last))
    return lines_as_csv(lines)


def doubt(layer: PosteriorSummary) -> str:
    """Describe the warning of a run, and the reasons to doubt its result."""
    because = "".join(f"\n  - {reason}" for reason in layer.reasons)
    return f"{layer.name}: {layer.warning}{because}"


def overlay_table(layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow]) -> Table:
    """Return the table of unknowns, a column for each run."""
    heads = ("", "unit", "nominal", *(layer.name for layer in layers), APART)
    lines = []
    for row in rows:
        known = [value for value in row.nominal if value is not None]
        nominal = "" if not known else "differs" if row.agreed is None else f"{row.agreed:.4g}"
        apart = "" if row.distance is None else f"{row.distance:.2f}"
        if row.pair is not None and len(layers) > 2:
            apart += f" ({', '.join(layers[k].name for k in row.pair)})"
        cells = []
        for place in row.places:
            sure = f"\N{PLUS-MINUS SIGN} {place.sd:.2g}" if place and not place.fixed else "held"
            cells.append("" if place is None else f"{place.mean:.4g} {sure}")
        lines.append((row.symbol.name, row.symbol.plain_unit, nominal, *cells, apart))
    return Table(heads, tuple(lines), frozenset(heads[:2])).filled("nominal", APART)


def farthest(layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow]) -> Iterator[str]:
    """Describe the unknowns whose means in two runs are farthest apart."""
    pairs = [(row.distance, row) for row in rows if row.distance is not None]
    ordered = sorted(pairs, key=lambda pair: -pair[0])
    if not ordered:
        yield "no unknown is shared by two of the runs"
        return
    far = [(apart, row) for apart, row in ordered if apart >= FAR]
    if not far:
        yield f"no two of them are more than {ordered[0][0]:.2g} sd apart"
    for apart, row in far[:SAID]:
        assert row.pair is not None
        first, other = (layers[k].name for k in row.pair)
        yield f"{row.symbol.name}: {first} and {other} are {apart:.2g} sd apart"


def what_differs(
    layers: Sequence[PosteriorSummary], differs: dict[str, tuple[str | None, ...]]
) -> str:
    """Describe the settings, priors and held values in which the runs differ."""
    spaces = [layer.problem.posterior.space for layer in layers]
    unknown = {name for s in spaces for name in (*s.free, *s.fixed, *s.relations)}
    believed = [name for name in differs if name in unknown]
    # One word stands for all channels, and one for all noises.
    kinds = {"the channel ": "the channels", "the noise of ": "the noise"}
    others = dict.fromkeys(
        next((kind for start, kind in kinds.items() if name.startswith(start)), name)
        for name in differs
        if name not in unknown
    )
    listed = [*([f"priors or values of {', '.join(believed)}"] if believed else []), *others]
    if not listed:
        return "record, noise, priors and seed are the same"
    return f"not the same: {'; '.join(listed)}"


def elided(text: str, max_letters: int) -> str:
    """Shorten a text to `max_letters` in its middle, because names differ at their ends."""
    left = max_letters - 3
    return (
        text if len(text) <= max_letters else f"{text[: left // 2]}...{text[-(left - left // 2) :]}"
    )


MAX_NAME_LETTERS = 48  # largest number of letters of a name in a legend


@dataclass(frozen=True, slots=True)
class RunStyle:
    """A style distinguishes a run; colours of different runs print as different greys."""

    color: str
    linestyle: Any
    marker: str
    linewidth: float = 1.0
    size: float = 4.0  # size of the marker [points]

    @property
    def line(self) -> dict[str, Any]:
        """Return the style of a line, as matplotlib takes it."""
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


def run_looks(layers: Sequence[PosteriorSummary], *, marked: bool = False) -> dict[str, style.Look]:
    """Return legend entries: the name of each run, its warning and, if `marked`, its marker."""
    looks: dict[str, style.Look] = {}
    for run, look in zip(layers, RUN_STYLES, strict=False):
        name = f"{run.name} ({run.warning})" if run.warning else run.name
        mark = {"marker": look.marker, "markersize": 4, "linestyle": "-"} if marked else {}
        looks[elided(name, MAX_NAME_LETTERS).replace("$", r"\$")] = look.line | mark
    return looks


CENTRAL_SHARE = 0.998  # share of the draws of each run inside an axis
CORNER_REACH = 0.5  # largest growth of an axis to show the nominal value, in widths of the axis
BINS = 40  # number of bins across an axis


@dataclass(frozen=True, slots=True)
class _Column:
    """The column is an unknown on an axis for all runs, with `draws` and prior `limits` by run."""

    row: OverlayRow
    scale: scales.Scale
    draws: tuple[Array | None, ...]
    limits: tuple[tuple[float, float], ...]


def overlay_corner_figure(
    layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow], display_units: DisplayUnits
) -> Figure:
    """Draw a corner plot of the unknowns that two or more runs have; `rows` are in SI.

    A panel omits runs that lack one of its unknowns.
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
        page.finish(_corner_looks(layers, columns))
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
    return _Column(row=row, scale=scale, draws=shown, limits=ends)


def _histograms(panel: Axes, column: _Column, fine: float) -> None:
    """Draw each histogram as high as its panel, because narrow ones would dwarf wide ones."""
    for x, ends, look in zip(column.draws, column.limits, RUN_STYLES, strict=False):
        if x is None:
            continue
        first, last = max(float(x.min()), ends[0]), min(float(x.max()), ends[1])
        filled_fraction = (last - first) / (column.scale.high - column.scale.low)
        edges = np.linspace(first, last, max(12, round(BINS * filled_fraction)) + 1)
        counts, _ = np.histogram(x, edges)
        panel.stairs(counts / counts.max(), edges, **style.finer(look.line, fine))
    style.mark_values(panel, column.scale, column.row.agreed, arrow=False, fine=fine)
    panel.set_ylim(0, 1.1)
    panel.set_yticks([])


def _contours(panel: Axes, column: _Column, row: _Column, fine: float) -> None:
    pairs = zip(column.draws, row.draws, column.limits, row.limits, RUN_STYLES, strict=False)
    for x, y, x_ends, y_ends, look in pairs:
        if x is not None and y is not None:
            lines: dict[str, Any] = {"colors": look.color, "linestyles": [look.linestyle]}
            lines["linewidths"] = 0.9 * fine * look.linewidth
            contours(panel, (x, y), (x_ends, y_ends), lines=lines)
    marks: dict[str, Any] = {"arrow": False, "fine": fine}
    style.mark_values(panel, column.scale, column.row.agreed, **marks)
    style.mark_values(panel, row.scale, row.row.agreed, vertical=True, **marks)


def _corner_looks(
    layers: Sequence[PosteriorSummary], columns: Sequence[_Column]
) -> dict[str, style.Look]:
    sides = {c.scale.side(c.row.agreed) for c in columns if c.row.agreed is not None}
    notes = ["histograms: each as high as its panel"]
    if len(columns) > 1:
        inner, outer = (f"{100 * level:.1f} %" for level in LEVELS)
        levels = f"contours: {inner} and {outer} of the draws of a run;"
        notes = [levels, "none where the density is flat", *notes]
    nominal = style.nominal_looks(sides & {0})
    return run_looks(layers) | nominal | dict.fromkeys(notes, style.WORDS)


INTERVALS_REACH = 1.0  # largest growth of an axis to show the nominal value, in widths of the axis
INTERVAL_BAR: dict[str, Any] = {"linewidth": 1.2, "marker": "|", "markersize": 5}
FIXED_MARKER: dict[str, Any] = {"marker": "x", "markersize": 5, "markeredgewidth": 1.2}
NARROWEST = f"narrowest {CREDIBLE} interval"
RUN_HEIGHT, AXIS_HEIGHT = 0.18, 0.65  # heights [in] of a run, and of a panel's axis and margins
MARGIN = 1.1  # free height above and below the runs of a panel, in heights of a run


def intervals_figure(
    layers: Sequence[PosteriorSummary], rows: Sequence[OverlayRow], display_units: DisplayUnits
) -> Figure:
    """Draw intervals of all unknowns, `rows` in SI; a run without an unknown leaves a gap."""
    scaled_rows = [scaled_row(row, layers, display_units) for row in rows]
    n = len(layers)
    with style.styled():
        figure, panels = build_page(len(rows), 3, AXIS_HEIGHT + n * RUN_HEIGHT)
        for panel, (row, scale) in zip(panels, scaled_rows, strict=True):
            draw_intervals(panel, row, scale, range(n), RUN_STYLES)
            stack_runs(panel, n)
        return legend_above(figure, _legend(layers, scaled_rows), handlelength=2.6)


def scaled_row(
    si: OverlayRow, layers: Sequence[PosteriorSummary], display_units: DisplayUnits
) -> tuple[OverlayRow, scales.Scale]:
    """Return a row as it is shown, and an axis that holds all its intervals."""
    row, log = overlay_shown(si, display_units), in_logs(si, layers)
    estimates = [estimate for estimate in row.places if estimate is not None]
    low, high = min(place.low for place in estimates), max(place.high for place in estimates)
    low, high = scales.reaching(low, high, row.agreed, INTERVALS_REACH, log=log)
    return row, scales.scale(low, high, log=log, margin=0.08)


def draw_intervals(
    panel: Axes,
    row: OverlayRow,
    scale: scales.Scale,
    order: Sequence[int],
    looks: Sequence[RunStyle],
    *,
    arrow: bool = True,
) -> None:
    """Draw intervals of runs, the first of `order` on top; an `arrow` shows a far nominal value."""
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


def stack_runs(panel: Axes, n: int, names: Sequence[str] | None = None) -> None:
    """Place the runs of a panel below each other, perhaps with their names."""
    panel.set_ylim(-MARGIN, n - 1 + MARGIN)
    places = range(n - 1, -1, -1)
    style.set_ticks(panel.yaxis, places if names else (), names)


def _legend(
    layers: Sequence[PosteriorSummary], scaled_rows: Sequence[tuple[OverlayRow, scales.Scale]]
) -> dict[str, style.Look]:
    rows = [row for row, _ in scaled_rows]
    sides = {scale.side(row.agreed) for row, scale in scaled_rows if row.agreed is not None}
    if any(row.agreed is None and any(v is not None for v in row.nominal) for row in rows):
        sides.add(0)
    looks = run_looks(layers, marked=True) | style.nominal_looks(sides)
    if any(estimate is not None and estimate.fixed for row in rows for estimate in row.places):
        looks["held there"] = {"color": style.DARK, "linestyle": "none", **FIXED_MARKER}
    return looks | {f"mean and {NARROWEST}": style.WORDS}
