"""Draw the record against the model: inputs, channels, residuals, and prediction checks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.special import ndtri
from scipy.stats import norm

from bayesdrill.analysis.latent_torque import TAILS
from bayesdrill.analysis.prediction import (
    FALSE_ALARM,
    FrequencyResponse,
    PredictionCheck,
    frequency_responses,
    prediction_checks,
)
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.derived import HDI_PROBABILITY
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import (
    BAND_PROBABILITY,
    ResidualCorrelation,
    ResidualSummary,
    correlations,
    like_noise,
    residual_summaries,
)
from bayesdrill.output_files import numbered
from bayesdrill.report import scales, style, words
from bayesdrill.report.pages import (
    build_page,
    departures,
    label_outside,
    legend_above,
    ranks_panel,
)
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections import fit_words
from bayesdrill.report.sections.fit_words import Course, Fit, Signal, corners, every_fit, extremes
from bayesdrill.report.view import Drawing, ReportContext, for_each_experiment
from bayesdrill.rig.models.linear import Model

# Heights in inches, each with its numbers: of inputs or frictions, of signals, and of the residuals
# below these where a figure is as wide as one column of text; of the legends.
WIDE_HEIGHTS, NARROW_HEIGHTS, LEGENDS = (0.85, 1.55), (0.65, 1.05, 0.65), 0.6
SHARES = (0.6, 0.4)  # of the width, of signals and of the residuals beside them


def build_fit_page(fit: Fit, width: float) -> tuple[Figure, list[Axes], list[tuple[Axes, Axes]]]:
    """Build a page for a fit; times are written at the foot of each column only.

    Panels of inputs and frictions; of each channel those of its signals and of its residuals.
    """
    beside = width >= scales.DOUBLE
    strip, *channel = WIDE_HEIGHTS if beside else NARROW_HEIGHTS
    n, n_courses, n_rubs = len(fit.signals), len(fit.courses), len(fit.rubs)
    heights = [*[strip] * n_courses, *channel * n, *[strip] * n_rubs]
    figure = Figure(figsize=(width, LEGENDS + sum(heights)), layout="constrained")
    shares = SHARES if beside else (1.0,)
    grid = figure.add_gridspec(
        len(heights), len(shares), height_ratios=heights, width_ratios=shares
    )
    courses = [figure.add_subplot(grid[k, 0]) for k in range(n_courses)]
    rows = []
    for top in range(n_courses, len(heights) - n_rubs, len(channel)):
        below = grid[top, 1] if beside else grid[top + 1, 0]
        rows.append((figure.add_subplot(grid[top, 0]), figure.add_subplot(below)))
    rubs = [figure.add_subplot(grid[k - n_rubs, 0]) for k in range(n_rubs)]
    signals, residuals = zip(*rows, strict=True)
    for column in ((*courses, *signals, *rubs), residuals) if beside else (figure.axes,):
        figure.align_ylabels(column)
        for panel in column[:-1]:
            panel.tick_params(labelbottom=False)
    return figure, [*courses, *rubs], rows


LINE_POINTS = 2000  # corners of a line

SHARE = f"{100 * HDI_PROBABILITY:.0f} %"
SIGMAS = float(ndtri(TAILS[1]))  # 1.88: half the width of the band of the noise


def fit_figure(fit: Fit, width: float = scales.DOUBLE, at: str = "the MAP") -> Figure:
    """Draw inputs, and the signals and residuals of each channel of a fit `at` a point, in words."""
    t = fit.t
    time = scales.scale(float(t[0]), float(t[-1]), margin=0.01)
    with style.styled(width):
        figure, strips, rows = build_fit_page(fit, width)
        for panel, course in zip(strips, (*fit.courses, *fit.rubs), strict=True):
            _course(panel, course, time, t)
        for signal, (left, right) in zip(fit.signals, rows, strict=True):
            _signals(left, signal, time, t)
            _residuals(right, signal, time, t, beside=width >= scales.DOUBLE)
        for panel in figure.axes:
            panel.set_xlim(time.low, time.high)
            style.set_ticks(panel.xaxis, *time.ticks(4))
            if panel.xaxis.get_tick_params()["labelbottom"]:
                panel.set_xlabel(time.label(fit.time))
        _legends(figure, rows[0], strips, fit, at, beside=width >= scales.DOUBLE)
    return figure


def record_figure(fit: Fit) -> Figure:
    """Draw channels and inputs over time, without the model."""
    t, time = fit.t, scales.scale(float(fit.t[0]), float(fit.t[-1]), margin=0.01)
    with style.styled():
        figure, panels = build_page(len(fit.signals) + len(fit.courses), 1, 1.35)
        for panel, signal in zip(panels, fit.signals, strict=False):
            y = signal.y[signal.dots]
            scale = _numbers(panel, signal.label, float(y.min()), float(y.max()))
            _dots(panel, time(t[signal.dots]), scale(y))
        for panel, course in zip(panels[len(fit.signals) :], fit.courses, strict=True):
            _course(panel, course, time, t)
        for panel in panels:
            style.scale_axis(panel.xaxis, time, time.label(fit.time) if panel is panels[-1] else "")
    return figure


def save_record(problem: Problem, path: Path) -> list[Path]:
    """Draw the record of each experiment into a file, in the format that its name ends with."""
    start = problem.posterior.space.vector(problem.posterior.space.start)
    fits = every_fit(problem, start, residual_summaries(problem.posterior.likelihood, start))
    look: dict[str, Any] = {"metadata": {"Title": "record"}, "formats": (path.suffix[1:],)}
    figures = numbered(path.stem, [*map(record_figure, fits)]).items()
    return [style.save(figure, path.parent, stem, **look)[0] for stem, figure in figures]


DOT: dict[str, Any] = {**style.DOTS, "color": "0.45", "alpha": 0.8, "zorder": 1}
EDGE: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.6, "linestyle": (0, (4, 2))}
STICKS: dict[str, Any] = {**style.HATCHED, "hatch": "/////"}


def _dots(panel: Axes, x: Array, y: Array) -> None:
    """So small that they leave something to see of what is behind them."""
    panel.plot(x, y, **(DOT | {"markersize": min(3.0, max(1.0, 40 / math.sqrt(len(x))))}))


def _course(panel: Axes, course: Course, time: scales.Scale, t: Array) -> None:
    """As the model takes it between samples; where a friction sticks the panel is hatched."""
    u, band = course.values, course.band
    drawn = (extremes if course.straight or band is not None else corners)(u, LINE_POINTS)
    low, high = float(u.min()), float(u.max())
    if band is not None:
        high = max(float(np.abs(band).max()), float(np.abs(u).max()))
        low = -high
    scale = _numbers(panel, course.label, low, high, 3)
    for begin, end in course.sticks:
        panel.axvspan(float(time(begin)), float(time(end)), zorder=0, **STICKS)
    if band is not None:
        first, last = scale(band[:, drawn])
        panel.fill_between(time(t[drawn]), first, last, step="post", zorder=1, **style.BAND)
    style_of = "default" if course.straight else "steps-post"
    panel.plot(time(t[drawn]), scale(u[drawn]), drawstyle=style_of, **style.BLACK_LINE)


def _signals(panel: Axes, signal: Signal, time: scales.Scale, t: Array) -> None:
    y, model = signal.y, signal.model
    drawn = extremes(model, LINE_POINTS)
    if signal.predictive is None:
        band = model[drawn] + SIGMAS * signal.sigma * np.array([[-1.0], [1.0]])
    else:
        band = np.asarray(np.quantile(signal.predictive[:, drawn], TAILS, axis=0))
    low = min(float(np.nanmin(y)), float(model.min()), float(band.min()))
    high = max(float(np.nanmax(y)), float(model.max()), float(band.max()))
    scale = _numbers(panel, signal.label, low, high)
    panel.fill_between(time(t[drawn]), *scale(band), zorder=0, **style.BAND)
    _dots(panel, time(t[signal.dots]), scale(y[signal.dots]))
    panel.plot(time(t[drawn]), scale(model[drawn]), zorder=2, **style.BLACK_LINE)


def _residuals(panel: Axes, signal: Signal, time: scales.Scale, t: Array, *, beside: bool) -> None:
    residual, sigma = signal.y - signal.model, signal.sigma
    label = Symbol("rest", "", r"\mathrm{residual}", signal.label.latex_unit, "")
    far = max(float(np.nanmax(np.abs(residual))), SIGMAS * sigma)
    scale = _numbers(panel, label, -far, far)
    ends = scale(np.array([-1.0, 1.0]) * SIGMAS * sigma)
    panel.axhspan(*ends, zorder=0, **style.BAND)
    for end in ends:
        panel.axhline(end, zorder=2, **EDGE)
    _dots(panel, time(t[signal.dots]), scale(residual[signal.dots]))
    panel.axhline(float(scale(0.0)), zorder=2, **style.BLACK_LINE)
    if not math.isnan(signal.share):
        gap = " " if beside else "\n"
        share = f"unexplained:{gap}{fit_words.percent(signal.share)}"
        look: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
        look |= {"rotation": 90, "ha": "left", "va": "center"}
        panel.annotate(share, (1.0, 0.5), (4, 0), size=style.letters("legend.fontsize"), **look)


def _numbers(
    panel: Axes, what: scales.Labelled, low: float, high: float, most: int = 4
) -> scales.Scale:
    scale = scales.scale(low, high, margin=0.06)
    style.scale_axis(panel.yaxis, scale, scale.label(what, "\n"), most)
    return scale


def _legends(
    figure: Figure,
    first: tuple[Axes, Axes],
    strips: Sequence[Axes],
    fit: Fit,
    at: str,
    *,
    beside: bool,
) -> None:
    dot = Line2D([], [], **{**DOT, "markersize": 3, "rasterized": False})
    line, band = Line2D([], [], **style.BLACK_LINE), Patch(**style.BAND)
    edged = Patch(facecolor=style.LIGHT, edgecolor=style.BLACK, linewidth=0.6, linestyle="--")
    what = "of the noise" if fit.signals[0].predictive is None else "posterior predictive"
    at_point = f" at {at}" if beside else ""
    noise = rf"{SHARE} of the noise ($\pm${SIGMAS:.2f} $\sigma${at_point})"
    signals = {
        f"measured ({fit.label})" if fit.label else "measured": dot,
        f"model at {at}": line,
        f"{SHARE} {what}": band,
    }
    residual_handles = {
        noise: edged,
        "unexplained: rms over spread": Line2D([], [], linestyle="none"),
    }
    left, right = first
    if beside:
        _legend(left, signals, 3)
        _legend(right, {f"measured minus model at {at}": dot, **residual_handles}, 1)
    else:
        _legend(left, signals | residual_handles, 2, -0.25)
    if fit.rubs:
        rubs = {f"friction at {at}": line, "it sticks": Patch(**STICKS)}
        _legend(strips[len(fit.courses)], {**rubs, f"{SHARE} posterior": band}, 3)
    if fit.courses:
        how = "straight" if fit.courses[0].straight else "held"
        _legend(strips[0], {f"input, {how} from each sample to the next": line}, 1)
    if fit.constant:
        each = []
        for label, value in fit.constant:
            number = scales.latex_number(float(f"{value:.5g}"))
            unit = rf"\,\mathrm{{{label.latex_unit}}}" if label.latex_unit else ""
            each.append(f"${label.latex} = {number}{unit}$")
        text, size = f"constant input: {', '.join(each)}", style.letters("legend.fontsize")
        figure.suptitle(text, x=0.02, ha="left", size=size)


def _legend(panel: Axes, entries: dict[str, Any], columns: int, x: float = 0.0) -> None:
    panel.legend(
        list(entries.values()),
        list(entries),
        loc="lower left",
        bbox_to_anchor=(x, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        borderpad=0.2,
        handlelength=1.4,
        handletextpad=0.4,
        columnspacing=0.8,
        labelspacing=0.2,
    )


FARTHEST = 4.5  # sds shown; what lies beyond stands in the last bin
BINS = 36
FOUND: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.BLACK, "linewidth": 0.7}


def predictive_figure(checks: Sequence[PredictionCheck], width: float = scales.DOUBLE) -> Figure:
    """Draw samples in standard deviations of their prediction, and their PIT, by channel."""
    away = [100 * departures(check.band, check.ranks) for check in checks]
    most = max(float(np.abs(each).max()) for each in away)
    wide = width >= scales.DOUBLE
    with style.styled(width):
        chance = f"{100 * (1 - FALSE_ALARM):g} % of chance, together"
        handles: list[Any] = [
            Patch(label="record", **FOUND),
            Line2D([], [], label="as predicted", **style.NOMINAL),
            Patch(label=chance, **style.CHANCE),
        ]
        if any(check.holds for check in checks):
            handles.append(Line2D([], [], label="record", **style.BLACK_LINE))
        if not all(check.holds for check in checks):
            handles.append(Line2D([], [], label="record, leaves the band", **style.OUTSIDE))
        figure, panels = build_page(2 * len(checks), 2, 1.55, width)
        for k, check in enumerate(checks):
            left, right = panels[2 * k : 2 * k + 2]
            _densities(left, check)
            ranks_panel(right, check.band, away[k], most, check.says)
            right.set_ylabel("ECDF difference [%]")
        label_outside(panels, "", "", share_y=False)
        panels[-2].set_xlabel("measured less predicted" + ", in sds of the prediction" * wide)
        panels[-1].set_xlabel("share of the prediction below (PIT)" if wide else "PIT")
        legend_above(figure, handles)
    return figure


def _densities(panel: Axes, check: PredictionCheck) -> None:
    edges = np.linspace(-FARTHEST, FARTHEST, BINS + 1)
    tail = norm.cdf(-FARTHEST)
    heights, _ = np.histogram(ndtri(np.clip(check.pit, tail, 1 - tail)), edges, density=True)
    panel.stairs(heights, edges, fill=True, color=FOUND["facecolor"], zorder=1)
    panel.stairs(heights, edges, color=FOUND["edgecolor"], linewidth=0.7, zorder=2)
    places = np.linspace(-FARTHEST, FARTHEST, 401)
    panel.plot(places, norm.pdf(places), zorder=3, **style.NOMINAL)
    panel.set_xlim(-FARTHEST, FARTHEST)
    panel.set_ylim(0, 1.25 * max(0.4, float(heights.max())))
    style.set_ticks(panel.xaxis, np.arange(-4.0, 5.0, 2.0), ["\u22124", "\u22122", "0", "2", "4"])
    style.set_ticks(panel.yaxis, np.array([]), None)
    panel.set_ylabel("density")
    style.corner_text(panel, f"${check.channel.latex}$")


POINT: dict[str, Any] = {
    "color": style.DARK,
    "marker": "o",
    "markersize": 2.4,
    "markeredgewidth": 0,
    "linestyle": "none",
}
STEM: dict[str, Any] = {"color": style.DARK, "linewidth": 1.1}


def residuals_figure(
    correlations: Sequence[ResidualCorrelation],
    width: float = scales.DOUBLE,
    *,
    latex: Mapping[str, str],
) -> Figure:
    """Draw correlations of residuals with themselves and inputs, whose `latex` is by name."""
    beside = [c for c in correlations if c.channel == correlations[0].channel]
    high = 1.1 * max(float(np.maximum(c.values, c.band).max()) for c in correlations)
    low = 1.1 * min(float(np.minimum(c.values, -c.band).min()) for c in correlations)
    with style.styled(width):
        handles: list[Any] = [
            Patch(label=f"{100 * BAND_PROBABILITY:g} % of chance, each lag", **style.CHANCE),
            Line2D([], [], label="inside", **STEM),
        ]
        if any((np.abs(c.values) > c.band).any() for c in correlations):
            handles.append(Line2D([], [], label="outside", **style.OUTSIDE))
        columns = len(beside)
        figure, panels = build_page(len(correlations), columns, 1.35, width, narrow=columns)
        for panel, c in zip(panels, correlations, strict=True):
            panel.fill_between(c.lags, -c.band, c.band, zorder=0, **style.CHANCE)
            panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
            for inside, look in ((True, STEM), (False, dict(style.OUTSIDE))):
                shown = (np.abs(c.values) <= c.band) == inside
                panel.vlines(c.lags[shown], 0.0, c.values[shown], zorder=2, **look)
            panel.set_ylim(low, high + 0.3 * (high - low))  # the name is above
            style.set_ticks(panel.yaxis, *scales.Scale(0.0, 0, low, high).ticks(4))
            panel.xaxis.set_major_locator(MaxNLocator(4, integer=True, prune="both"))
            panel.set_xlim(c.lags[0] - 1, c.lags[-1] + 1)
            style.corner_text(panel, f"${c.channel.latex}$")
            driver = latex.get(c.input, c.input)
            other = f"with ${driver}$" if driver else "with itself"
            style.corner_text(panel, other, "right", fontsize=style.letters("legend.fontsize"))
        label_outside(panels, "lag [samples]", "correlation")
        legend_above(figure, handles)
    return figure


RESIDUALS = "Whether residuals are white, and whether they follow an input (positive lags)."


def draw_residuals(run: ReportContext) -> tuple[Drawing, ...] | None:
    """Return drawings of the residuals' correlations."""
    asked = "residuals" in (run.config.output.figures or ())
    if like_noise(run.analysis.fit) and not asked:
        return None
    results = correlations(run.problem.posterior.likelihood, run.chain.best)
    return _residual_drawings(results, run.width, run.problem.model)


def _residual_drawings(
    correlations: Sequence[ResidualCorrelation], width: float, rig: Model
) -> tuple[Drawing, ...]:
    latex = {name: rig.symbols[name].latex for name in rig.inputs}
    each = groupby(correlations, lambda correlation: correlation.experiment)
    shown = ((label, tuple(group)) for label, group in each)
    return for_each_experiment(partial(residuals_figure, latex=latex), shown, width, RESIDUALS)


def frequency_figure(
    responses: Sequence[FrequencyResponse], width: float = scales.DOUBLE
) -> Figure:
    """Draw magnitude and phase of the frequency response, by channel and input."""
    with style.styled(width):
        measured = r"measured, where the input excites ($\pm$2 sd)"
        handles: list[Any] = [
            Line2D([], [], label="model at the MAP", **style.BLACK_LINE),
            Line2D([], [], label=measured, **POINT),
        ]
        figure, panels = build_page(2 * len(responses), 2, 1.5, width)
        for k, panel in enumerate(panels):
            _bode(panel, responses[k // 2], phase=bool(k % 2))
        label_outside(panels, "frequency [Hz]", "", share_y=False)
        legend_above(figure, handles)
    return figure


def _bode(panel: Axes, response: FrequencyResponse, *, phase: bool) -> None:
    there, shown = np.isfinite(response.measured), response.channel.display_unit
    model, measured = (
        np.abs(values) * response.unit.factor / shown.factor
        for values in (response.modelled, response.measured)
    )
    error = measured * response.error
    if phase:
        model = np.degrees(np.unwrap(np.angle(response.modelled)))
        measured = model + np.degrees(np.angle(response.measured / response.modelled))
        error = np.degrees(response.error)
    magnitudes = np.concatenate([model, measured[there]])
    x = scales.scale(response.frequencies[0], response.frequencies[-1], log=True, margin=0.03)
    y = scales.scale(float(magnitudes.min()), float(magnitudes.max()), log=not phase, margin=0.2)
    ends = y(np.stack([measured - 2 * error, measured + 2 * error])[:, there])
    panel.plot(x(response.frequencies), y(model), zorder=1, **style.BLACK_LINE)
    places = x(response.frequencies[there])
    panel.vlines(places, *ends, color=POINT["color"], linewidth=0.6, zorder=2)
    panel.plot(places, y(measured[there]), zorder=3, **POINT)
    unit = f"{shown.latex}/{response.unit.latex}"
    what, unit = (r"\arg\, G", r"^\circ") if phase else ("|G|", unit)
    style.scale_axis(panel.xaxis, x, "", 5)
    style.scale_axis(panel.yaxis, y, y.label(Symbol("", "", what, unit, "")), 4)
    style.corner_text(panel, rf"${response.input.latex} \to {response.channel.latex}$", "right")


def draw_frequency_response(run: ReportContext) -> tuple[Drawing, ...]:
    """Return drawings of frequency responses, where there are any."""
    responses = frequency_responses(run.problem.posterior, run.chain.best)
    each = groupby(responses, lambda response: response.label)
    shown = ((label, tuple(group)) for label, group in each)
    says = "How inputs move channels: measured, where they excite, and by the model."
    return for_each_experiment(frequency_figure, shown, run.width, says)


FIT = "Record, model at the MAP and posterior predictive band; beside them what is left, and the noise."
FIT_ALONE = "Record and model at the MAP; beside them what is left, and the noise."


def draw_fit(run: ReportContext) -> tuple[Drawing, ...]:
    """Return drawings of record and model."""
    group = run.tree.children.get("posterior_predictive")
    predicted = {} if group is None else group.data_vars
    draws = {str(name): np.asarray(values) for name, values in predicted.items()}
    best, rubbing = run.chain.best, run.chain.friction_motions
    fits = every_fit(run.problem, best, run.analysis.fit, draws, rubbing)
    said = FIT if predicted else FIT_ALONE
    says = f"{said} Below: what rubs, and when it sticks." if rubbing else said
    return for_each_experiment(fit_figure, ((fit.label, fit) for fit in fits), run.width, says)


def draw_predictive_check(run: ReportContext) -> Drawing:
    """Return the drawing of prediction checks."""
    draws = run.sampled.draws
    each = words.predictive_draws(run.problem, run.config)
    columns = np.unique(np.linspace(0, draws.shape[1] - 1, max(1, each)).astype(int))
    theta = draws[:, columns].reshape(-1, draws.shape[-1])
    results = prediction_checks(run.problem.posterior.likelihood, theta)
    says = "Whether the record is as the posterior predicts it, channel by channel."
    return Drawing(predictive_figure, (results, run.width), says=says)


def fits_alone(
    problem: Problem,
    config: Config,
    best: Array,
    residual_rows: Sequence[ResidualSummary],
    correlations: Sequence[ResidualCorrelation],
) -> dict[str, Drawing]:
    """Return drawings of the MAP `best (D,)`, without draws, by stem.

    `residual_rows`: what it leaves; `correlations`: of that, where it is more than noise.
    """
    width = WIDTHS[config.output.size]
    shown = ((fit.label, fit) for fit in every_fit(problem, best, residual_rows))
    fits = numbered("fit", for_each_experiment(fit_figure, shown, width, FIT_ALONE))
    return fits | numbered("residuals", _residual_drawings(correlations, width, problem.model))
