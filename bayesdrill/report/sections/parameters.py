"""Report the unknowns: their tables, and figures that compare priors with posteriors."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np

from bayesdrill.analysis.causes import FittedValue
from bayesdrill.analysis.diagnostics import ParameterRow, Word
from bayesdrill.analysis.identifiability.structure import ScalingStructure
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol, plain
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.display_units import DisplayedUnknowns, DisplayUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.pages import NARROW_ROW, build_page, legend_above
from bayesdrill.report.scales import unit_of
from bayesdrill.report.section import (
    CSV_HEADS,
    HDI,
    WORDS,
    Block,
    IntervalBar,
    Note,
    Picture,
    Section,
    Sentences,
    Table,
    build,
    records_as_csv,
    table_of,
)
from bayesdrill.report.sections.corner import draw_corner
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart
from bayesdrill.sampling.mode_search import Mode

# Heads of the columns in the table of unknowns, with functions that return the text of a cell.
COLUMNS: Mapping[str, Callable[[ParameterRow], str]] = {
    "": lambda row: row.name,
    "unit": lambda row: plain(row.unit),
    "nominal": lambda row: "" if row.nominal is None else f"{row.nominal:.4g}",
    "MAP": lambda row: f"{row.map:.4g}",
    "mean": lambda row: f"{row.mean:.4g}",
    "sd": lambda row: f"{row.sd:.2g}",
    HDI: lambda row: f"{row.hdi_low:.4g} to {row.hdi_high:.4g}",
    "dev. %": lambda row: "" if row.deviation is None else f"{100 * row.deviation:+.2f}",
    "R-hat": lambda row: f"{row.r_hat:.4f}",
    "ESS bulk": lambda row: f"{row.ess_bulk:.0f}",
    "ESS tail": lambda row: f"{row.ess_tail:.0f}",
    "shrinkage": lambda row: f"{round(100 * row.shrinkage)} %",
    "the record says": lambda row: row.word,
}
HEADERS = tuple(COLUMNS)


def as_record(row: ParameterRow) -> dict[str, Any]:
    """Return a row as a line of `summary.csv`."""
    return {CSV_HEADS.get(name, name): value for name, value in dataclasses.asdict(row).items()}


def of_rows(rows: Sequence[ParameterRow], bars: tuple[IntervalBar, ...] = ()) -> Table:
    """Return the summary table of `rows`."""
    left = frozenset((HEADERS[0], HEADERS[1], HEADERS[-1]))
    lines = tuple(tuple(cell(row) for cell in COLUMNS.values()) for row in rows)
    return Table(HEADERS, lines, left, bars=bars).filled()


SANDWICH_EXPLAINED = (
    "Correlated residuals contain less information than equally many independent residuals. Sandwich "
    "sds allow for that: they are sds of the MAP over repeated records if only the noise model is wrong."
)


def sandwich_table(
    rows: Sequence[ParameterRow],
    sds: Mapping[str, float],
    windows: Sequence[Sequence[FittedValue]],
    display_units: DisplayUnits,
) -> Table:
    """Build a table of posterior sds, sandwich `sds` [SI], and ranges of MAPs over `windows`."""
    refits = (f"MAP of {len(windows)} windows",) if any(windows) else ()
    heads = ("", "unit", "sd", "sd if residuals remember (sandwich)", "over sd", *refits)
    lines = []
    for row, shown in zip(rows, display_units.rows(rows), strict=True):
        sd, factor = sds[row.name], display_units.factor(row.name)
        cells = [f"{sd / factor:.2g}", f"{sd / row.sd:.3g}" if row.sd else ""]
        if refits:
            values = [x.value for window in windows for x in window if x.name == row.name]
            cells.append(
                f"{min(values) / factor:.3g} to {max(values) / factor:.3g}" if values else ""
            )
        lines.append((row.name, plain(shown.unit), f"{shown.sd:.2g}", *cells))
    return Table(heads, tuple(lines), frozenset(heads[:2]))


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeRow:
    """A mode row is a line of `map.csv`."""

    name: str
    unit: str
    nominal: float | None
    map: float


def mode_rows(problem: Problem, mode: Mode) -> tuple[ModeRow, ...]:
    """Return the lines of `map.csv`, SI."""
    nominal, best = problem.nominal, mode.values
    return tuple(
        ModeRow(name=s.name, unit=s.unit, nominal=nominal.get(s.name), map=best[s.name])
        for s in problem.symbols
    )


def of_mode(rows: Sequence[ModeRow]) -> Table:
    """Return a table of the MAP and the nominal values."""
    columns: dict[str, Callable[[ModeRow], str]] = {
        "": lambda row: row.name,
        "unit": lambda row: plain(row.unit),
        "nominal": lambda row: "" if row.nominal is None else f"{row.nominal:.4g}",
        "MAP": lambda row: f"{row.map:.6g}",
        "dev. %": lambda row: f"{100 * (row.map / row.nominal - 1):+.2f}" if row.nominal else "",
    }
    lines = ({head: cell(row) for head, cell in columns.items()} for row in rows)
    return table_of(lines, "", "unit").filled()


MEANING: Mapping[Word, str] = {
    "determined": "the record, with the priors of the others, narrows the prior to less than half",
    "weak": "the record narrows the prior, but to no less than half",
    "through others": "narrower only by the priors of other unknowns: the record determines ratios",
    "prior only": "the posterior is just the prior: this record does not determine it",
}


def in_words(rows: Sequence[ParameterRow]) -> list[str]:
    """Describe which unknowns the record determines, and which it cannot."""
    named = {word: [row.name for row in rows if row.word == word] for word in MEANING}
    return [f"{word}: {', '.join(named[word])} ({MEANING[word]})" for word in named if named[word]]


def describe_dependence(priors_of: Mapping[str, tuple[str, ...]]) -> str:
    """Describe unknowns that are known only with the priors of others; empty if there are none."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, others in priors_of.items():
        groups.setdefault(others, []).append(name)
    return "\n".join(
        f"leaning: {', '.join(names)} on the prior of {', '.join(others)}. The record does not "
        "determine the latter, so the former are only as certain as this prior."
        for others, names in groups.items()
    )


def believed_columns(run: ReportContext, table: Table) -> Table:
    """Return the table, without its columns of judgements if the run must not be believed."""
    return table.only([head for head in table.heads if not (run.reasons and head in WORDS)])


TAIL = 0.001  # probability of a prior beyond each end of its bar
DECADES = 1.5  # width in decades above which the bar of a log-uniform prior is logarithmic


def interval_bar(row: ParameterRow, prior: Prior) -> IntervalBar:
    """Return the bar that shows the interval of an unknown within its prior."""
    shown = [row.hdi_low, row.hdi_high, row.map]
    ends = [float(x) for x in prior.quantile(np.array([TAIL, 1 - TAIL]))]
    every = [*shown, *ends, *([] if row.nominal is None else [row.nominal])]
    low, high = min(every), max(every)
    logs = flat_in_logs(prior) and low > 0 and math.log10(high / low) > DECADES

    def share(x: float) -> float:
        if logs:
            return math.log(x / low) / math.log(high / low)
        return (x - low) / (high - low) if high > low else 0.5

    nominal = None if row.nominal is None else share(row.nominal)
    return IntervalBar(share(row.hdi_low), share(row.hdi_high), nominal, share(row.map))


_HEADS = (
    *("", "unit", "nominal", "MAP", "mean (sd)"),
    rf"{100 * HDI_PROBABILITY:.0f}\,\% HDI",
    "the record says",
)
_NOMINAL = _HEADS.index("nominal")
_USUAL = range(-1, 3)  # exponents of numbers that are written without a power of ten
_BEYOND = re.compile(r"[^\x00-\x7f]+")  # characters beyond ASCII, which need \text in formulas


def latex_table(
    rows: Sequence[ParameterRow], symbols: Sequence[Symbol], *, believed: bool = True
) -> str:
    """Return a LaTeX `tabular` of the unknowns, with two digits of each sd.

    The column of judgements is left out if the run must not be `believed`.
    """
    named = {symbol.name: symbol for symbol in symbols}
    shown = [True] * len(_HEADS)
    shown[_NOMINAL] = any(row.nominal is not None for row in rows)
    shown[-1] = believed
    lines_of_cells = (_HEADS, *(_cells(row, named[row.name]) for row in rows))
    lines = [" & ".join(compress(line, shown)) + r" \\" for line in lines_of_cells]
    columns = "".join(compress("llrrrrl", shown))
    table = (
        r"% needs \usepackage{booktabs,siunitx}",
        rf"\begin{{tabular}}{{@{{}}{columns}@{{}}}}",
        *(r"\toprule", lines[0], r"\midrule", *lines[1:]),
        *(r"\bottomrule", r"\end{tabular}"),
    )
    return "\n".join(table) + "\n"


def _cells(row: ParameterRow, symbol: Symbol) -> tuple[str, ...]:
    power = _exponent(max(abs(row.hdi_low), abs(row.hdi_high)))
    power = 0 if power in _USUAL else power
    sd = row.sd / 10.0**power
    places = max(0, 1 - _exponent(sd)) if sd > 0 else 3

    def number(x: float) -> str:
        return f"{x / 10.0**power:.{places}f}"

    return (
        f"${_BEYOND.sub(lambda beyond: rf'\text{{{beyond[0]}}}', symbol.latex)}$",
        unit_of(power, symbol.latex_unit),
        "--" if row.nominal is None else rf"\num{{{number(row.nominal)}}}",
        rf"\num{{{number(row.map)}}}",
        rf"\num{{{number(row.mean)} \pm {number(row.sd)}}}",
        rf"\numrange{{{number(row.hdi_low)}}}{{{number(row.hdi_high)}}}",
        row.word,
    )


def _exponent(x: float) -> int:
    return math.floor(math.log10(x)) if x > 0 else 0


TAIL = 0.001  # prior probability beyond the axis, if the prior has no end
BINS = 60
HEAD = 1.12  # upper end of a panel, relative to the highest density
DARK_PRIOR: dict[str, Any] = {**style.PRIOR_LINE, "color": style.DARK}
BOX = style.fix_look(
    facecolor="none",
    edgecolor=style.MIDDLE,
    linewidth=0.8,
    linestyle=style.PRIOR_LINE["linestyle"],
)


def prior_posterior_figure(
    draws: Array, displayed: DisplayedUnknowns, width: float = scales.DOUBLE
) -> Figure:
    """Draw priors and draws `(N, D)` of the `displayed` unknowns, over the range of each prior."""
    symbols = displayed.symbols
    width = width if len(symbols) > 1 else scales.SINGLE
    with style.styled(width):
        figure, panels = build_page(len(symbols), 3, 1.45, width)
        sides = set()
        for panel, x, symbol in zip(panels, draws.T, symbols, strict=True):
            prior, known = displayed.priors[symbol.name], displayed.nominal.get(symbol.name)
            scale = scales.scale(*prior_ends(prior, x), log=flat_in_logs(prior), margin=0.04)
            _densities(panel, scale, x, prior)
            style.mark_values(panel, scale, known, displayed.mode.get(symbol.name), zorder=4)
            style.scale_axis(panel.xaxis, scale, scale.label(symbol))
            style.set_ticks(panel.yaxis, ())
            if known is not None:
                sides.add(scale.side(known))
        looks = {"prior": DARK_PRIOR, "posterior": style.FILLED, **style.nominal_looks(sides)}
        return legend_above(figure, looks | {"MAP": style.MAP_LINE})


def _densities(panel: Axes, scale: scales.Scale, x: Array, prior: Prior) -> None:
    """Draw the posterior as high as its panel, so that a much wider prior is a low line."""
    u = scale(x)
    across = min(float(BINS), 2.2 * math.cbrt(len(x)))
    edges = np.linspace(float(u.min()), float(u.max()), max(2, round(across)))
    heights, edges = np.histogram(u, edges, density=True)
    panel.stairs(heights, edges, fill=True, zorder=1, **style.FILLED)
    places = np.linspace(scale.low, scale.high, 801)
    density = scale.density(prior, places)
    panel.plot(places, density, zorder=3, **DARK_PRIOR)
    sure = density[np.isfinite(density)]
    # A density may be infinite at zero, so the panel ends above nearly all of it.
    top = max(float(heights.max()), float(np.quantile(sure, 0.99)))
    panel.set_ylim(0, HEAD * top)


def prior_ends(prior: Prior, x: Array) -> tuple[float, float]:
    """Return the ends of a prior, or else of a range with nearly all its mass and all draws."""
    low, high = (float(q) for q in prior.quantile(np.array([TAIL, 1 - TAIL])))
    low = prior.low if prior.low > 0 else min(low, float(x.min()))
    high = prior.high if np.isfinite(prior.high) else max(high, float(x.max()))
    return low, high


def _draw_prior_posterior(run: ReportContext) -> Drawing:
    shown = run.shown(run.config.output.parameters)
    says = "Prior against posterior of each parameter: what the record has added."
    return Drawing(prior_posterior_figure, (shown.select(run.draws), shown, run.width), says)


def _sections(run: ReportContext, pictures: Sequence[Picture]) -> Iterator[Section]:
    unknowns, causes = run.analysis.unknowns, run.analysis.causes
    read = (
        "`shrinkage` is one minus the ratio of the posterior's to the prior's standard deviation."
    )
    if any(row.nominal is not None for row in unknowns):
        nominal = run.problem.compared_with
        read = f"`dev. %` is the deviation of the posterior mean from {nominal}. {read}"
    priors = run.problem.posterior.space.priors
    bars = tuple(interval_bar(row, priors[row.name]) for row in unknowns)
    table = believed_columns(run, of_rows(run.units.rows(unknowns), bars))
    depending = describe_dependence(run.analysis.leaning).splitlines()
    known = [] if run.reasons else [*in_words(unknowns), *depending]
    # `Sentences` are kept even if they are empty, for an empty line on the terminal.
    blocks: list[Block] = [table, Note(read), Sentences("\n".join([*known, *run.notes]))]
    if sds := run.analysis.sandwich:
        windows = causes.windows if causes else ()
        blocks += [sandwich_table(unknowns, sds, windows, run.units), Note(SANDWICH_EXPLAINED)]
    yield build("Parameters", *blocks, *pictures)


SIZE = 3.4  # size of the figure in inches
POINTS = 3000
REACH, CORNERS = 1e4, 4001  # factor from the MAP to the line's ends; number of the line's points
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 6.0, "solid_capstyle": "butt"}
DOTS: dict[str, Any] = {**style.DOTS, "markersize": 1.8, "alpha": 0.6, "zorder": 3}
MIN_CORRELATION = 0.5  # a pair is shown if its correlation along a symmetry exceeds this


@dataclass(frozen=True, slots=True)
class CorrelatedPair:
    """A correlated pair has the columns of two unknowns, and their exponents in one symmetry."""

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
            # `along` is 1 if draws differ only along the symmetry, and 0 if they do not follow it.
            along = 2 * p * q * spread[i, j] / (q**2 * spread[i, i] + p**2 * spread[j, j])
            if along > best:
                best, strongest = float(along), CorrelatedPair((i, j), (p, q))
    return strongest


def ridge_figure(draws: Array, pair: CorrelatedPair, displayed: DisplayedUnknowns) -> Figure:
    """Draw a pair of unknowns in draws `(N, D)`, and the line of their symmetry through the MAP."""
    factor, drawn = np.geomspace(1 / REACH, REACH, CORNERS), style.thin(len(draws), POINTS)
    box, line, dots, cross, marks = [], [], [], [], []
    with style.styled():
        figure, (panel,) = build_page(1, 1, SIZE / NARROW_ROW, SIZE)
        marked = all(displayed.symbols[k].name in displayed.nominal for k in pair.columns)
        axes = (panel.xaxis, panel.yaxis)
        for column, power, axis in zip(pair.columns, pair.exponents, axes, strict=True):
            symbol, x = displayed.symbols[column], draws[:, column]
            prior, best = displayed.priors[symbol.name], displayed.mode[symbol.name]
            ends = prior_ends(prior, x)
            scale = scales.scale(*ends, log=flat_in_logs(prior), margin=0.12)
            box.append(scale(np.array(ends)))
            line.append(scale(best * factor**power))
            dots.append(scale(x[drawn]))
            cross.append([float(scale(best))])
            marks.append((scale, displayed.nominal[symbol.name] if marked else None))
            style.scale_axis(axis, scale, scale.label(symbol))
        (x0, x1), (y0, y1) = box
        panel.fill([x0, x1, x1, x0], [y0, y0, y1, y1], zorder=1, **BOX)
        panel.plot(*line, zorder=2, **BAND)
        panel.plot(*dots, **DOTS)
        for (scale, known), vertical in zip(marks, (False, True), strict=True):
            style.mark_values(panel, scale, known, vertical=vertical, arrow=False, zorder=4)
        panel.plot(*cross, zorder=5, **style.CROSS)
        looks = {
            "exactly the same signals": BAND,
            "posterior draws": {**DOTS, "markersize": 3},
            "prior": BOX,
            **style.nominal_looks({0} if marked else ()),
            "MAP": style.CROSS,
        }
        return legend_above(figure, looks)


def _draw_ridge(run: ReportContext) -> Drawing | None:
    judged, shown = run.analysis.judged, run.shown()
    pair = None if judged is None else strongest_pair(run.draws, judged.study.structure)
    if pair is None:
        return None
    says = (
        "The ridge: parameters that no such record can distinguish, and the line on which they lie."
    )
    return Drawing(ridge_figure, (shown.select(run.draws), pair, shown), says)


PART = ReportPart(
    sections=_sections,
    figures={"corner": draw_corner, "ridge": _draw_ridge, "prior_posterior": _draw_prior_posterior},
    files={
        "summary.csv": lambda run: records_as_csv(ParameterRow, run.analysis.unknowns),
        "table.tex": lambda run: latex_table(
            run.units.rows(run.analysis.unknowns),
            run.units.symbols(run.problem.symbols),
            believed=not run.reasons,
        ),
    },
)
