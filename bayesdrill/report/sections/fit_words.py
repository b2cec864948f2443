"""Write what the fit says: its signals in the user's units, what it leaves, what would explain it."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from bayesdrill.analysis.causes import Cause, Causes, EquivalentExplanation, FittedValue
from bayesdrill.analysis.edits import lacks
from bayesdrill.analysis.energy import FrictionMotion
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
from bayesdrill.report.section import Plain, Sentences, Table, aligned
from bayesdrill.report.sections.physics_words import effort_symbol, time_symbol
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.roles import Roles
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
            unit, draws = (
                channel.shown,
                predicted.get(labelled_name(channel.name, observation.label)),
            )
            if draws is not None:
                draws = (
                    draws.reshape(-1, draws.shape[-1])[:, shown].astype(np.float64) / unit.factor
                )
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
    """Time, channels as measured and as predicted without noise, inputs; `w_1 measured [rpm]`."""
    experiment, signals = observation.experiment, observation.signals(full)[0]
    unit = experiment.written.time
    columns = {f"t [{unit.name}]": experiment.t / unit.factor}
    for k, channel in enumerate(experiment.channels):
        name, unit = channel.name, channel.shown
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
    """How much is left; that it looks like the noise, or a line for each way in which it does not.

    `clock`: in which times are said.
    """
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
            "column was filtered or differenced. Do not trust the sds."
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
    said = []
    if large := _worst(doubtful, "large", "rms"):
        said.append(_larger(large))
    if correlated := _worst(doubtful, "correlated", "correlation"):
        said.append(_correlated(correlated))
    return tuple(said)


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
    for name in mode.at_bound:
        value, prior = mode.values[name], priors[name]
        if abs(value - prior.low) < abs(value - prior.high) and prior.low == 0:
            yield f"prior: {name} is at zero, where its prior ends: the record shows none of it."
        else:
            shown = units.format_value(name, value)
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


WIDER = 2.0  # times what was found, of a prior that is proposed
SHOWN = 5  # candidates, or unknowns
WANDERS = 3.0  # sds: more than by chance, from window to window
STEPS = (
    "next: bayesdrill map CONFIG --apply NEW writes the config with these lines; map NEW shows whether "
    "it fits.\n"
    "next: bayesdrill ladder CONFIG samples the best candidates and compares them."
)
LOOK = (
    "next: bayesdrill check CONFIG says what is odd in columns and units.\n"
    "next: look at the inputs and the gear: does something drive the rig that no column has?\n"
    "next: a window (`record: {window: [from, to]}`) shows where in the record the misfit begins."
)


def explained(causes: Causes | None) -> str:
    """What would explain what the fit leaves, for a terminal: best first, and what to do."""
    return "\n".join(
        aligned([part.heads, *part.lines], left={0}) if isinstance(part, Table) else part.text
        for part in candidates(causes)
    )


def candidates(causes: Causes | None) -> tuple[Sentences | Table | Plain, ...]:
    """Return what would explain what the fit leaves, for a page.

    These are candidates, best first, the lines of a config that say the best, and what to do next.
    """
    if causes is None:
        return ()
    refitted = f"fit: {len(causes.ranked)} candidates were refitted"
    notes = "\n".join(filter(None, [_reference(causes), wandering(causes)]))
    if not causes.good:
        tried = (
            f"{refitted}, and none explains the misfit. They were signs, gains, lags and offsets of "
            "columns, clocks, the start, the gear, physics that the rig may lack, and the noise."
        )
        return (Sentences("\n".join(filter(None, [tried, notes, LOOK]))),)
    best = causes.best if causes.explains else None
    said = [
        f"{refitted} from the MAP, each with all unknowns free. The best are listed: log Bayes factor "
        "(by Laplace's approximation), gain of the log posterior, and what stays unexplained of each "
        "channel.",
        *([f"fit: A is the config with {_listed(best.words)}."] if best else []),
    ]
    if doubts := [cause for cause in causes.good[:SHOWN] if cause.doubts]:
        each = "; ".join(f"{_beside(cause, best)}: {', '.join(cause.doubts)}" for cause in doubts)
        said.append(f"fit: do not trust the Bayes factor of {each}.")
    if caution := _absorbing(causes.good, best):
        said.append(f"fit: {caution} It names no cause.")
    table = (Sentences("\n".join(filter(None, [*said, notes]))), _candidate_table(causes))
    if best is None:
        none = (
            "fit: none of these can be trusted, so that no change of the config is recommended.\n"
        )
        return (*table, Sentences(none + LOOK))
    return (
        *table,
        Sentences(f"next: add these lines to the config (A{_new(best)}). {_left(best)}"),
        Plain(best.lines),
        Sentences(STEPS),
    )


def _absorbing(good: Sequence[Cause], best: Cause | None) -> str:
    """Say what absorbs a misfit, of the recommended candidate or of one that gains more."""
    if best is not None and best.absorbing:
        words = dict(zip(best.parts, best.words, strict=True))
        absorbing = _listed([words[part] for part in best.absorbing])
        return (
            f"{absorbing} absorbs what is left, as it does of any misfit, and does not explain it."
        )
    most = max((c for c in good if c.absorbing == c.parts), key=lambda c: c.bayes, default=None)
    if most is not None and (best is None or most.bayes > best.bayes):
        return f"{most.about} absorbs more, as it does of any misfit, and does not explain it."
    return ""


def _left(best: Cause) -> str:
    """Say what the recommended candidate leaves."""
    if not best.absorbing:
        return f"That leaves {'what looks like the noise' if best.explains_all else 'more than noise'}."
    left = ", ".join(f"{percent(row.simulated)} of {row.name}" for row in best.fit)
    return f"That absorbs, and does not explain: the rig itself leaves {left}."


def _reference(causes: Causes) -> str:
    if causes.reference is None:
        return ""
    name, channel = causes.reference
    return (
        f"fit: {channel} follows {name} as a set point is followed, and not as the rig would. If {name} "
        "is a reference, record what the motor gets instead: its voltage, current or torque."
    )


def _candidate_table(causes: Causes) -> Table:
    channels, best = (row.name for row in causes.given), causes.best if causes.explains else None
    lines = [("as given", "0", "0", *(percent(summary.share) for summary in causes.given))]
    for cause in causes.good[:SHOWN]:
        factors = (f"{cause.bayes:+.1f}", f"{cause.gain:+.1f}")
        left = (percent(summary.share) for summary in cause.fit)
        lines.append((_beside(cause, best), *factors, *left))
    heads = ("model", "log Bayes factor", "log posterior", *channels)
    return Table(heads, tuple(lines), frozenset({"model"}))


def _beside(cause: Cause, best: Cause | None) -> str:
    """A candidate by what it has otherwise than the `best`, which is called A, if that is shorter."""
    if best is None:
        return _listed(cause.words)
    if cause is best:
        return "A"
    pairs = zip(cause.parts, cause.words, strict=True)
    more = [words for part, words in pairs if part not in best.parts]
    less = [w for part, w in zip(best.parts, best.words, strict=True) if part not in cause.parts]
    if len(more) + len(less) >= len(cause.parts):
        return _listed(cause.words)
    parts = [
        f"{how} {_listed(words)}" for how, words in (("with", more), ("without", less)) if words
    ]
    return f"A {' and '.join(parts)}"


def _listed(words: Sequence[str]) -> str:
    *first, last = words
    return f"{', '.join(first)}, and {last}" if first else last


def wandering(causes: Causes) -> str:
    """Say which unknowns change from window to window of the record; empty where none was refitted."""
    if len(causes.windows) < 2:
        return ""
    changes, columns = [], dict[str, list[FittedValue]]()
    for unknown in chain.from_iterable(causes.windows):
        columns.setdefault(unknown.name, []).append(unknown)
    for column in (column for column in columns.values() if len(column) > 1):
        values = [unknown.value for unknown in column]
        sd = float(np.median([unknown.sd for unknown in column]))
        if (sds := float(np.std(values, ddof=1)) / sd if sd > 0 else 0.0) > WANDERS:
            said = f"{min(values):.3g} to {max(values):.3g} {column[0].unit}".strip()
            changes.append((sds, f"{column[0].name} from {said} (sd {sd:.2g})"))
    opening = (
        f"fit: the config as given was refitted on {len(causes.windows)} windows of the record"
    )
    if not changes:
        return f"{opening}. No unknown changes by more than {WANDERS:g} sds."
    most = ", ".join(said for _, said in sorted(changes, reverse=True)[:SHOWN])
    return (
        f"{opening}. What changes most: {most}. Constants of a rig do not: the model lacks something "
        "that changes with time or with the motion."
    )


def _new(cause: Cause) -> str:
    """Values of its further unknowns, where they are few."""
    few = [new for new in cause.new if not new.name.startswith(("sigma_", "rho_"))][:SHOWN]
    said = [f"{new.name} = {new.value:.3g} {new.unit}".strip() for new in few]
    return f": {', '.join(said)}" if said else ""


def lacking(causes: Causes | None, roles: Roles) -> str:
    """What the model misses, for a verdict that stands on it; empty where nothing is known."""
    names = () if causes is None else causes.lacking
    return " and ".join(f"{_lacked(name, roles)} ({name})" for name in names)


def instead(explanation: EquivalentExplanation | None, rig: Model) -> Iterable[str]:
    """A table that may be right after all."""
    if explanation is None:
        return
    how = "better than" if explanation.lost < 0 else "about as well as"
    name, value = explanation.parameter, explanation.value
    missing = f"{_lacked(name, rig.roles)} of {value:.3g} {rig.symbols[name].plain_unit}"
    prior = f"{{prior: uniform, low: 0, high: {WIDER * value:.2g}}}"
    yield (
        f"before you blame the table: its values with {missing} explain the record {how} any without. "
        f"Try it: say `parameters: {{{name}: {prior}}}`."
    )


def _lacked(name: str, roles: Roles) -> str:
    return next(lack.words for lack in lacks(roles) if lack.parameter == name)


def moment(moment: InputTiming | None) -> Iterable[str]:
    """How much half a sample of it matters; nothing where it hardly does."""
    if moment is None or not moment.matters:
        return
    moved = sorted(moment.shifts, key=lambda shift: -abs(shift[1]))
    named = ", ".join(
        f"{name} by {abs(shift):.2g}" for name, shift in moved[:3] if abs(shift) > 0.1
    )
    width = 2 * moment.seconds
    yield (
        f"timing: if the inputs act half a sample ({1e3 * moment.seconds:.3g} ms) later than recorded, "
        f"the fit is as good, and values move: {named} sds. If that is possible, add `inputs: {{t_0: "
        f"{{prior: uniform, low: -{width:.3g}, high: {width:.3g}}}}}`."
    )
