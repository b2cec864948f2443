"""Draw record and model over time: inputs, channels and residuals."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from bayesdrill.analysis.friction_motion import FrictionMotion
from bayesdrill.analysis.latent_torque import TAILS
from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, residual_summaries
from bayesdrill.inference.unknowns import labelled_name
from bayesdrill.output_files import numbered
from bayesdrill.report import scales, style
from bayesdrill.report.doubts import percent, residual_sentences, step_sentences
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.pages import build_page, legend_above
from bayesdrill.report.scales import time_symbol
from bayesdrill.report.section import CREDIBLE, Picture, Section, build
from bayesdrill.report.sections.convergence import maxima
from bayesdrill.report.sections.friction import effort_symbol
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart, for_each_experiment


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A channel has measured values `y (T,)`, NaN if missing, and values `model (T,)`.

    `predictive (N, T)` are draws with noise, or None, and `sigma` is the sd of the noise.
    `unexplained` is rms of residuals / sd of the channel, NaN for a constant channel.  `dots` are
    indices of the evenly spaced samples that are drawn as dots.
    """

    label: Symbol
    y: Array
    model: Array
    predictive: Array | None
    sigma: float
    dots: Indices
    unexplained: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """A course over time has `values (T,)` of a measured input, or of a friction at the MAP.

    An input is held or `straight` between samples.  A friction has a `band (2, T)` of draws, and it
    sticks from the first to the second time of each pair in `sticks`.
    """

    label: Symbol
    values: Array
    straight: bool = False
    band: Array | None = None
    sticks: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fit shows an experiment at times `t (T,)`, with each part in the unit of its label.

    `constant` are inputs that do not change, and `rubs` are frictions.  `label` names the experiment
    if there are several.
    """

    t: Array
    time: Symbol
    signals: tuple[Signal, ...]
    courses: tuple[Course, ...] = ()
    constant: tuple[tuple[Symbol, float], ...] = ()
    rubs: tuple[Course, ...] = ()
    label: str = ""


def every_fit(
    problem: Problem,
    best: Array,
    left: Sequence[ResidualSummary],
    predictive: Mapping[str, Array] | None = None,
    rubbing: Sequence[Sequence[FrictionMotion]] = (),
) -> Iterator[Fit]:
    """Yield the fit of each experiment at the MAP `best (D,)`; `left` summarises its residuals.

    `predictive` has draws `(..., T)` of each channel, SI, by its name with the experiment's label.
    `rubbing` has the frictions of each experiment, or is empty.
    """
    clock, full = problem.clock, problem.posterior.space.full(best[None])
    rubbing = rubbing or [()] * len(problem.observations)
    for observation, rubbings in zip(problem.observations, rubbing, strict=True):
        experiment, models = observation.experiment, observation.predict(full, best[None])[0]
        shown = _shown_samples(observation, models, [rubbing.effort for rubbing in rubbings])
        courses, constant = _inputs(observation, shown)
        shares = {row.channel: row.share for row in left if row.experiment == observation.label}
        rubs = (
            Course(
                label=effort_symbol(rubbing.friction),
                values=rubbing.effort[shown],
                band=np.quantile(rubbing.efforts[:, shown], TAILS, axis=0),
                sticks=tuple((a / clock.factor, b / clock.factor) for a, b in rubbing.intervals),
            )
            for rubbing in rubbings
        )
        yield Fit(
            t=experiment.t[shown] / clock.factor,
            time=time_symbol(clock),
            signals=tuple(_channels(observation, best, models, shown, shares, predictive or {})),
            courses=courses,
            constant=constant,
            rubs=tuple(rubs),
            label=observation.label,
        )


def _inputs(
    observation: Observation, indices: Indices
) -> tuple[tuple[Course, ...], tuple[tuple[Symbol, float], ...]]:
    """Return the courses of measured inputs, and the constant inputs with their values."""
    experiment, rig = observation.experiment, observation.response.model
    courses, constant = [], []
    loads = {inertia.load for inertia in rig.roles.inertias}
    for name in (n for n in rig.inputs if n in {*experiment.series, *experiment.constant}):
        unit = experiment.unit_of_input(name)
        label = dataclasses.replace(rig.symbols[name], latex_unit=unit.latex)
        if name in experiment.series:
            values = experiment.series[name][indices] / unit.factor
            courses.append(Course(label=label, values=values, straight=experiment.first_order))
        elif name not in loads or experiment.constant[name]:  # a load of zero is not shown
            constant.append((label, experiment.constant[name] / unit.factor))
    return tuple(courses), tuple(constant)


def _channels(
    observation: Observation,
    best: Array,
    models: Array,
    indices: Indices,
    unexplained: Mapping[str, float],
    predictive: Mapping[str, Array],
) -> Iterator[Signal]:
    """Yield each channel with its model `(T, K)`, at the samples that are shown."""
    experiment, sigmas = observation.experiment, observation.scales(best[None])[0]
    for k, channel in enumerate(experiment.channels):
        unit = channel.display_unit
        draws = predictive.get(labelled_name(channel.name, observation.label))
        if draws is not None:
            draws = draws.reshape(-1, draws.shape[-1])[:, indices].astype(float) / unit.factor
        yield Signal(
            dots=np.searchsorted(indices, measured(experiment.y[:, k])),
            label=Symbol(channel.name, channel.unit, channel.latex, unit.latex, "channel"),
            y=experiment.y[indices, k] / unit.factor,
            model=models[indices, k] / unit.factor,
            predictive=draws,
            sigma=float(sigmas[k]) / unit.factor,
            unexplained=unexplained[channel.name],
        )


DOTS = 3000  # largest number of measured samples that are drawn in a panel
SHOWN_STRETCHES = 20_000  # number of segments of a long record; a figure shows their extremes


def _shown_samples(observation: Observation, models: Array, efforts: Sequence[Array]) -> Indices:
    """Return indices of all samples of a short record, or else of the extremes of short segments.

    Extremes are taken of the record, `models (T, K)`, residuals, inputs and `efforts (T,)`.
    """
    experiment = observation.experiment
    if len(experiment.t) <= 4 * SHOWN_STRETCHES:
        return np.arange(len(experiment.t))
    residuals = np.nan_to_num(experiment.y - models)
    columns = [*models.T, *residuals.T, *(models + residuals).T, *efforts]
    shown = [extremes(column, 2 * SHOWN_STRETCHES) for column in columns]
    shown += [corners(u, 2 * SHOWN_STRETCHES) for u in experiment.series.values()]
    shown += [measured(y) for y in experiment.y.T]
    return np.unique(np.concatenate(shown))


def measured(y: Array) -> Indices:
    """Return at most `DOTS` indices of the samples of a channel `y (T,)` that were measured."""
    sampled = np.flatnonzero(~np.isnan(y))
    places = np.linspace(0, len(sampled) - 1, min(len(sampled), DOTS))
    return sampled[places.round().astype(np.intp)]


def extremes(y: Array, max_count: int) -> Indices:
    """Return at most `max_count` indices, with the extremes of each segment, so that no peak is lost."""
    n = len(y)
    if n <= max_count:
        return np.arange(n)
    length = -(-n // ((max_count - 2) // 2))
    starts = np.arange(0, n, length)
    padded = np.concatenate([y, np.full(len(starts) * length - n, y[-1])]).reshape(-1, length)
    indices = np.stack([starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)])
    return np.unique(np.concatenate([[0, n - 1], np.minimum(indices, n - 1).ravel()]))


def corners(u: Array, max_count: int) -> Indices:
    """Return indices where a held input `u` begins, changes and ends, or `extremes` if too many."""
    changes = np.flatnonzero(np.diff(u)) + 1
    indices = np.unique(np.concatenate([[0, len(u) - 1], changes]))
    return indices if len(indices) <= max_count else extremes(u, max_count)


DIGITS = 12


def prediction_csv(problem: Problem, theta: Array) -> dict[str, str]:
    """Return CSV of predictions at `theta (D,)` by file name, a file for each experiment."""
    full, observations = problem.posterior.space.full(theta[None]), problem.observations
    texts = [_prediction(observation, full) for observation in observations]
    return {f"{stem}.csv": text for stem, text in numbered("prediction", texts).items()}


def _prediction(observation: Observation, full: Array) -> str:
    experiment, signals = observation.experiment, observation.signals(full)[0]
    unit = experiment.written.time
    columns = {f"t [{unit.name}]": experiment.t / unit.factor}
    for k, channel in enumerate(experiment.channels):
        name, unit = channel.name, channel.display_unit
        columns[f"{name} measured [{unit.name}]"] = experiment.y[:, k] / unit.factor
        columns[f"{name} predicted [{unit.name}]"] = signals[:, k] / unit.factor
    constant = {name: np.full(len(experiment.t), x) for name, x in experiment.constant.items()}
    for name, values in {**constant, **experiment.series}.items():
        unit = experiment.unit_of_input(name)
        columns[f"{name} [{unit.name}]"] = values / unit.factor
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(columns)
    np.savetxt(text, np.stack([*columns.values()], axis=-1), f"%.{DIGITS}g", ",")
    return text.getvalue()


# Heights of panels with their axes [in]: of inputs or frictions, and of signals.  Figures of single
# width have residuals below the signals, and the third height is theirs.
WIDE_HEIGHTS, NARROW_HEIGHTS = (0.85, 1.55), (0.65, 1.05, 0.65)
SHARES = (0.6, 0.4)  # fractions of the figure's width, for signals and for residuals


def build_fit_page(fit: Fit, width: float) -> tuple[Figure, list[Axes], list[tuple[Axes, Axes]]]:
    """Build a page for a fit; times are written only below the last panel of each column.

    Returns panels of inputs and frictions, and a pair for the signals and residuals of each channel.
    """
    beside = width >= scales.DOUBLE
    strip, *channel = WIDE_HEIGHTS if beside else NARROW_HEIGHTS
    n, n_courses, n_rubs = len(fit.signals), len(fit.courses), len(fit.rubs)
    heights = [*[strip] * n_courses, *channel * n, *[strip] * n_rubs]
    figure = style.new_figure(width, sum(heights), layout="constrained")
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


LINE_POINTS = 2000  # largest number of points of a line
SIGMAS = NormalDist().inv_cdf(TAILS[1])  # 1.88: half the width of the noise band, in sds


def fit_figure(fit: Fit, width: float = scales.DOUBLE, at: str = "the MAP") -> Figure:
    """Draw inputs, and signals and residuals of each channel of a fit; `at` names the fitted point."""
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
        return legend_above(figure, _legend(fit, at))


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
EDGED: dict[str, Any] = {**style.FILLED, "linewidth": 0.6, "linestyle": "--"}
STICKS: dict[str, Any] = {**style.HATCHED, "hatch": "/////"}


def _dots(panel: Axes, x: Array, y: Array) -> None:
    """Draw samples as dots, smaller for more samples, so that the band behind stays visible."""
    panel.plot(x, y, **(DOT | {"markersize": min(3.0, max(1.0, 40 / math.sqrt(len(x))))}))


def _course(panel: Axes, course: Course, time: scales.Scale, t: Array) -> None:
    """Draw an input or a friction, held or straight between samples; hatching shows sticking."""
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
    limit = max(float(np.nanmax(np.abs(residual))), SIGMAS * sigma)
    scale = _numbers(panel, label, -limit, limit)
    ends = scale(np.array([-1.0, 1.0]) * SIGMAS * sigma)
    panel.axhspan(*ends, zorder=0, **style.BAND)
    for end in ends:
        panel.axhline(end, zorder=2, **EDGE)
    _dots(panel, time(t[signal.dots]), scale(residual[signal.dots]))
    panel.axhline(float(scale(0.0)), zorder=2, **style.BLACK_LINE)
    if not math.isnan(signal.unexplained):
        gap = " " if beside else "\n"
        text = f"unexplained:{gap}{percent(signal.unexplained)}"
        look: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
        look |= {"rotation": 90, "ha": "left", "va": "center"}
        panel.annotate(text, (1.0, 0.5), (4, 0), size=style.letters("legend.fontsize"), **look)


def _numbers(
    panel: Axes, what: scales.Labelled, low: float, high: float, max_count: int = 4
) -> scales.Scale:
    scale = scales.scale(low, high, margin=0.06)
    style.scale_axis(panel.yaxis, scale, scale.label(what, "\n"), max_count)
    return scale


def _legend(fit: Fit, at: str) -> dict[str, style.Look]:
    """Return the entries of the legend, including constant inputs."""
    model = f"model at {at}"
    if fit.courses:
        how = "straight" if fit.courses[0].straight else "held"
        model = f"{model}; inputs, {how} from each sample to the next"
    looks: dict[str, style.Look] = {
        f"measured ({fit.label})" if fit.label else "measured": DOT | {"markersize": 3},
        model: style.BLACK_LINE,
        rf"{CREDIBLE} of the noise ($\pm${SIGMAS:.2f} $\sigma$)": EDGED,
    }
    if fit.signals[0].predictive is not None:
        looks[f"{CREDIBLE} posterior predictive"] = style.BAND
    if fit.rubs:
        looks |= {f"{CREDIBLE} posterior of a friction": style.BAND, "it sticks": STICKS}
    looks["unexplained: rms of the residuals over spread"] = style.WORDS
    each = []
    for label, value in fit.constant:
        number = scales.latex_number(float(f"{value:.5g}"))
        unit = rf"\,\mathrm{{{label.latex_unit}}}" if label.latex_unit else ""
        each.append(f"${label.latex} = {number}{unit}$")
    return looks | ({f"constant input: {', '.join(each)}": style.WORDS} if each else {})


FIT = "Record, model at the MAP and posterior predictive band; beside them residuals and noise."
FIT_ALONE = "Record and model at the MAP; beside them residuals and noise."


def draw_fit(run: ReportContext) -> tuple[Drawing, ...]:
    """Return drawings of record and model."""
    group = run.tree.children.get("posterior_predictive")
    predicted = {} if group is None else group.data_vars
    draws = {str(name): np.asarray(values) for name, values in predicted.items()}
    best, rubbing = run.chain.best, run.chain.friction_motions
    fits = every_fit(run.problem, best, run.analysis.fit, draws, rubbing)
    said = FIT if predicted else FIT_ALONE
    says = f"{said} Below: each friction, and when it sticks." if rubbing else said
    return for_each_experiment(fit_figure, ((fit.label, fit) for fit in fits), run.width, says)


def _sections(run: ReportContext, pictures: Sequence[Picture]) -> Iterator[Section]:
    analysis = run.analysis
    yield build(
        "Fit",
        maxima(run.mode, run.sampled.mode_shares, run.units),
        residual_sentences(analysis.fit, run.problem.clock),
        "\n".join(f"fit: {each}" for each in finding_sentences(analysis.inputs)),
        step_sentences(analysis.step_errors),
        *pictures,
    )


PART = ReportPart(sections=_sections, figures={"fit": draw_fit})
