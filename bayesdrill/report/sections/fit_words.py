"""Write what the fit says: its signals in the user's units, and what it leaves."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.friction_motion import FrictionMotion
from bayesdrill.analysis.latent_torque import TAILS
from bayesdrill.analysis.suspicions import InputTiming
from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import Unit
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.inference.unknowns import labelled_name
from bayesdrill.output_files import numbered
from bayesdrill.record.clocks import median_step
from bayesdrill.report.sections.physics_words import effort_symbol, time_symbol
from bayesdrill.sampling.mode_search import Mode


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A channel, measured (NaN where it was not) and modelled `(T,)`.

    `predictive (N, T)`: with noise, None where there are no draws; `sigma`: of the noise; `share`: what
    the model leaves, of the channel's spread; NaN where it has none.  `dots`: which samples are drawn
    one by one, spaced evenly over the record.
    """

    label: Symbol
    y: Array
    model: Array
    predictive: Array | None
    sigma: float
    dots: Indices
    share: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """A measured input or a friction `(T,)`; `straight` from one sample to the next, or held.

    Of a friction at the MAP, `band (2, T)`: of draws; it `sticks` between these times.
    """

    label: Symbol
    values: Array
    straight: bool = False
    band: Array | None = None
    sticks: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """The fit of an experiment at times `t (T,)`, each part in the unit of its label.

    `constant`: inputs that do not change; `rubs`: frictions; `label`: of the experiment, where there
    are several.
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
    """Of each experiment, at the MAP `(D,)` and what it leaves.

    `predictive`: `(..., T)` of each channel, SI, by the name that it has among all; `rubbing`: of each
    experiment, or nothing.
    """
    clock, full = problem.clock, problem.posterior.space.full(best[None])
    each, predicted = rubbing or [()] * len(problem.observations), predictive or {}
    for observation, rubbings in zip(problem.observations, each, strict=True):
        experiment, courses, constant = observation.experiment, [], []
        models, rig = observation.predict(full, best[None])[0], observation.response.model
        loads = {inertia.load for inertia in rig.roles.inertias}
        shown = _shown_samples(observation, models, [rubbing.effort for rubbing in rubbings])
        for name in (n for n in rig.inputs if n in {*experiment.series, *experiment.constant}):
            unit = experiment.unit_of_input(name)
            label = dataclasses.replace(rig.symbols[name], latex_unit=unit.latex)
            if name in experiment.series:
                values = experiment.series[name][shown] / unit.factor
                courses.append(Course(label=label, values=values, straight=experiment.first_order))
            elif name not in loads or experiment.constant[name]:  # no load need not be said
                constant.append((label, experiment.constant[name] / unit.factor))
        sigmas, signals = observation.scales(best[None])[0], []
        shares = {row.channel: row.share for row in left if row.experiment == observation.label}
        for k, channel in enumerate(experiment.channels):
            unit, name = channel.display_unit, labelled_name(channel.name, observation.label)
            if (draws := predicted.get(name)) is not None:
                draws = draws.reshape(-1, draws.shape[-1])[:, shown].astype(float) / unit.factor
            signals.append(
                Signal(
                    dots=np.searchsorted(shown, measured(experiment.y[:, k])),
                    label=Symbol(channel.name, channel.unit, channel.latex, unit.latex, "channel"),
                    y=experiment.y[shown, k] / unit.factor,
                    model=models[shown, k] / unit.factor,
                    predictive=draws,
                    sigma=float(sigmas[k]) / unit.factor,
                    share=shares[channel.name],
                )
            )
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
            signals=tuple(signals),
            courses=tuple(courses),
            constant=tuple(constant),
            rubs=tuple(rubs),
            label=observation.label,
        )


DOTS = 3000  # measured samples drawn in a panel
SHOWN = 5  # unknowns that a sentence names
SHOWN_STRETCHES = 20_000  # stretches of a long record, of which a figure is given both extremes


def _shown_samples(observation: Observation, models: Array, efforts: Sequence[Array]) -> Indices:
    """All samples of a record that is not long; else the extremes, in short stretches.

    Those of the record, of `models (T, K)`, of what these leave, of inputs, of `efforts (T,)`.
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


def extremes(y: Array, most: int) -> Indices:
    """Return at most `most` indices, with the extremes of each stretch: no peak is lost."""
    n = len(y)
    if n <= most:
        return np.arange(n)
    length = -(-n // ((most - 2) // 2))
    starts = np.arange(0, n, length)
    padded = np.concatenate([y, np.full(len(starts) * length - n, y[-1])]).reshape(-1, length)
    indices = np.stack([starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)])
    return np.unique(np.concatenate([[0, n - 1], np.minimum(indices, n - 1).ravel()]))


def corners(u: Array, most: int) -> Indices:
    """Return where stairs through `u` begin, rise and end; of too many, the `extremes`."""
    changes = np.flatnonzero(np.diff(u)) + 1
    indices = np.unique(np.concatenate([[0, len(u) - 1], changes]))
    return indices if len(indices) <= most else extremes(u, most)


DIGITS = 12


def prediction_csv(problem: Problem, theta: Array) -> dict[str, str]:
    """At `theta (D,)`, by the names of files: one, or one with a number for each experiment."""
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


MAX_SHARE = 10.0  # of a channel's spread: more is left only of one that hardly changes


def residual_sentences(summaries: Sequence[ResidualSummary], clock: Unit) -> str:
    """Say how much is left, and how it differs from noise, with times in the unit of `clock`."""
    still = [summary for summary in summaries if summary.share > MAX_SHARE]
    shared = [summary for summary in summaries if summary.share <= MAX_SHARE]
    seen = ", ".join(f"{percent(summary.share)} of {summary.name}" for summary in shared)
    lines = [f"fit: the MAP leaves unexplained {seen or 'nothing to speak of'}."]
    lines += [
        f"fit: {summary.name} hardly changes in the record, and the model moves it far more. Is its "
        "column the right one?"
        for summary in still
    ]
    # Where noise remembers, or a torque is missing; elsewhere both are what was said above.
    # NRMSE fits, the complements of what is left: below zero where a mean would do better.
    each = ", ".join(
        f"{summary.name} {100 * (1 - summary.simulated):.4g} % and {100 * (1 - summary.ahead):.4g} %"
        for summary in shared
        if summary.ahead != summary.simulated
    )
    if each:
        lines.append(
            "fit: explained by the simulation alone, and by predictions one step ahead, which know all "
            f"samples before: {each}."
        )
    if large := _worst(summaries, "large", "rms"):
        lines.append(
            f"fit: {_larger(large)} (noise gives at most {large[0].limits.most:.3g}). A unit, an input, "
            "a sigma, the end of a prior or the model is wrong. Every sd and verdict here is too sure."
        )
    if far := _worst(summaries, "far", "farthest"):
        each = ", ".join(
            f"{summary.name} {summary.farthest:.3g} at {summary.time / clock.factor:.4g} {clock.name}"
            for summary in far
        )
        lines.append(
            f"fit: single samples are too far off, in sigmas: {each} (noise gives at most "
            f"{far[0].limits.farthest:.2g}). They are outliers, or the model misses something short."
        )
    if correlated := _worst(summaries, "correlated", "correlation"):
        lines.append(
            f"fit: {_correlated(correlated)} (white noise gives at most "
            f"{correlated[0].limits.correlation:.2g} either way). The model misses something, or the "
            "column was filtered or differenced. Sandwich sds, in the report of a posterior, count that."
        )
    if small := _worst(summaries, "small", "rms"):
        lines.append(
            f"fit: the residuals are smaller than the noise: {_each_channel(small, 'rms')} times sigma "
            f"(noise gives at least {small[0].limits.least:.3g}). These sigmas are too large, or the "
            "column was filtered."
        )
    if like_noise(summaries) and not small:
        sizes = [summary.rms for summary in summaries]
        sigmas = f"rms {min(sizes):.3f} to {max(sizes):.3f} sigma"
        lines.append(f"fit: the residuals look like the noise ({sigmas}).")
    return "\n".join(lines)


def residual_reasons(summaries: Sequence[ResidualSummary]) -> tuple[str, ...]:
    """Why nothing here must be believed, though the ensembles converge; empty where it may be."""
    doubtful = [summary for summary in summaries if summary.unbelievable]
    large = _worst(doubtful, "large", "rms")
    correlated = _worst(doubtful, "correlated", "correlation")
    return (
        *([_larger(large)] if large else []),
        *([_correlated(correlated)] if correlated else []),
    )


def sandwich_reasons(unsupported: Mapping[str, float]) -> tuple[str, ...]:
    """Why a fit must not be believed that leaves only a little more than noise."""
    worst = sorted(unsupported.items(), key=lambda pair: -pair[1])
    each = ", ".join(f"{name} ({times:.3g} times as large)" for name, times in worst[:SHOWN])
    more = ", ..." if len(worst) > SHOWN else ""
    allowed = "with the sds that allow for what the fit leaves (sandwich), the record"
    return (f"{allowed} does not determine {each}{more}",) if worst else ()


def _larger(large: Sequence[ResidualSummary]) -> str:
    return f"the residuals are larger than the noise: {_each_channel(large, 'rms')} times sigma"


def _correlated(correlated: Sequence[ResidualSummary]) -> str:
    each = _each_channel(correlated, "correlation")
    return f"the residuals are correlated from one sample to the next: {each}"


def _worst(summaries: Sequence[ResidualSummary], which: str, by: str) -> list[ResidualSummary]:
    """Those of which it is true, the worst first."""
    chosen = [summary for summary in summaries if getattr(summary, which)]
    return sorted(chosen, key=lambda summary: abs(getattr(summary, by)), reverse=which != "small")


def _each_channel(summaries: Sequence[ResidualSummary], what: str) -> str:
    return ", ".join(f"{summary.name} {getattr(summary, what):.3g}" for summary in summaries)


def percent(share: float) -> str:
    """Of a channel's spread about its mean; of one that hardly changes it says nothing."""
    if share > MAX_SHARE:
        return f"> {100 * MAX_SHARE:.0f} %"
    return f"{100 * share:.2g} %" if not share >= 0.995 else f"{100 * share:.0f} %"


EARLY = 0.1  # of a sample: inputs that act so much before they are recorded are worth a word


def map_notes(problem: Problem, mode: Mode) -> Iterator[str]:
    """Yield unknowns at ends of their priors, and inputs that would act before they are recorded."""
    units, priors = problem.units, problem.posterior.space.priors
    si = {symbol.name: symbol for symbol in problem.symbols}
    for name in mode.at_bound:
        value, prior = mode.values[name], priors[name]
        if abs(value - prior.low) < abs(value - prior.high) and prior.low == 0:
            yield f"prior: {name} is at zero, where its prior ends: the record shows none of it."
        else:
            symbol = units.symbol(si[name])
            shown = f"{value / units.factor(name):.4g} {symbol.plain_unit}".removesuffix(" 1")
            yield f"prior: {name} is at an end of its prior, {shown}. Widen it before anything else."
    for observation in problem.observations:
        sensing, step = observation.response.sensing, median_step(observation.experiment.t)
        lags = [name for name in (sensing.delay, *sensing.input_lags.values()) if name]
        called = observation.named(observation.response.parameters)
        for name in dict.fromkeys(called[lag] for lag in lags):
            if (early := mode.values.get(name, 0.0)) < -EARLY * step:
                yield (
                    f"timing: by {name} the inputs act {-1e3 * early:.3g} ms before they are recorded. "
                    "Their column is late, as one that was filtered, or the clocks do not agree."
                )


def moment(moment: InputTiming | None) -> Iterable[str]:
    """How much half a sample of it matters; nothing where it hardly does."""
    if moment is None or not moment.matters:
        return
    moved = sorted(moment.shifts, key=lambda shift: -abs(shift[1]))
    far = [(name, abs(shift)) for name, shift in moved[:3] if abs(shift) > 0.1]
    named = ", ".join(f"{name} by {shift:.2g}" for name, shift in far)
    width = 2 * moment.seconds
    yield (
        f"timing: if the inputs act half a sample ({1e3 * moment.seconds:.3g} ms) later than recorded, "
        f"the fit is as good, and values move: {named} sds. If that is possible, add `inputs: {{t_0: "
        f"{{prior: uniform, low: -{width:.3g}, high: {width:.3g}}}}}`."
    )
