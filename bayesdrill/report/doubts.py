"""Describe the residuals of a fit, and the reasons not to believe a result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.analysis.suspicions import InputTiming
from bayesdrill.basics.units import Unit
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.inference.step_error import MAX_ERROR_OVER_NOISE, TRUTH_REFINEMENT, StepError
from bayesdrill.record.clocks import median_step
from bayesdrill.report.findings import finding_sentences
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.mode_search import Mode


def run_doubts(
    sampled: SamplingResult, residuals: Sequence[ResidualSummary], unsupported: Mapping[str, float]
) -> tuple[str, ...]:
    """Return reasons not to believe a run (it did not converge, or does not fit), or none."""
    fit = (*residual_reasons(residuals), *sandwich_reasons(unsupported))
    return (*finding_sentences(sampled.convergence.reasons), *fit)


def figure_warning(sampled: SamplingResult, residuals: Sequence[ResidualSummary]) -> str:
    """Return the warning that every figure of a run carries; empty if there is none."""
    return misfit(residuals) if sampled.convergence.converged else "NOT CONVERGED"


def misfit(residuals: Sequence[ResidualSummary]) -> str:
    """Return the warning that figures of a fit carry; it is empty if the residuals look like noise."""
    if any(summary.far_too_large for summary in residuals):
        return "DOES NOT FIT: the residuals are far larger than the noise"
    if any(summary.unbelievable for summary in residuals):
        return "DOES NOT FIT: the residuals are far from white"
    return "" if like_noise(residuals) else "THE RESIDUALS ARE MORE THAN NOISE"


def unbelievable(reasons: Sequence[str], *, converged: bool) -> str:
    """Return a warning that lists `reasons` not to believe a posterior, or an empty string."""
    if not reasons:
        return ""
    though = ", though the ensembles converged" if converged else ""
    listed = (f"  - {reason}" for reason in reasons)
    return "\n".join([f"DO NOT BELIEVE these numbers{though}:", *listed])


SHOWN = 5  # largest number of unknowns that a sentence names
MAX_SHARE = 10.0  # (rms of residuals / sd of a channel) above which the channel hardly changes


def residual_sentences(summaries: Sequence[ResidualSummary], clock: Unit) -> str:
    """Describe the size of residuals and how they differ from noise, with times in the unit `clock`."""
    still = [summary for summary in summaries if summary.share > MAX_SHARE]
    moving = [summary for summary in summaries if summary.share <= MAX_SHARE]
    unexplained = ", ".join(f"{percent(summary.share)} of {summary.name}" for summary in moving)
    lines = [f"fit: the MAP leaves unexplained {unexplained or 'nothing to speak of'}."]
    lines += [
        f"fit: {summary.name} hardly changes in the record, and the model moves it far more. Is its "
        "column the right one?"
        for summary in still
    ]
    # Prediction and simulation differ only for correlated noise or a missing torque. The percentages
    # are NRMSE fits: one minus the unexplained share, negative if a constant would fit better.
    each = ", ".join(
        f"{summary.name} {100 * (1 - summary.simulated):.4g} % and {100 * (1 - summary.ahead):.4g} %"
        for summary in moving
        if summary.ahead != summary.simulated
    )
    if each:
        lines.append(
            "fit: explained by the simulation alone, and by predictions one step ahead, which use all "
            f"previous samples: {each}."
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
            "column was filtered or differenced. Sandwich sds in the report of a posterior allow for it."
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
    """Return reasons not to believe a fit (large or correlated residuals), or none."""
    doubtful = [summary for summary in summaries if summary.unbelievable]
    large = _worst(doubtful, "large", "rms")
    correlated = _worst(doubtful, "correlated", "correlation")
    return (
        *([_larger(large)] if large else []),
        *([_correlated(correlated)] if correlated else []),
    )


def sandwich_reasons(unsupported: Mapping[str, float]) -> tuple[str, ...]:
    """Return a reason if quantities are `unsupported` (by sandwich sd / sd of draws), or none."""
    worst = sorted(unsupported.items(), key=lambda pair: -pair[1])
    each = ", ".join(f"{name} (sd {times:.3g} times as large)" for name, times in worst[:SHOWN])
    more = ", ..." if len(worst) > SHOWN else ""
    allowed = "with the sds that allow for correlated residuals (sandwich), the record"
    return (f"{allowed} does not determine {each}{more}",) if worst else ()


def _larger(large: Sequence[ResidualSummary]) -> str:
    return f"the residuals are larger than the noise: {_each_channel(large, 'rms')} times sigma"


def _correlated(correlated: Sequence[ResidualSummary]) -> str:
    each = _each_channel(correlated, "correlation")
    return f"the residuals are correlated from one sample to the next: {each}"


def _worst(summaries: Sequence[ResidualSummary], flag: str, by: str) -> list[ResidualSummary]:
    """Return the summaries whose `flag` is set, sorted by `by`, the worst first."""
    chosen = [summary for summary in summaries if getattr(summary, flag)]
    return sorted(chosen, key=lambda summary: abs(getattr(summary, by)), reverse=flag != "small")


def _each_channel(summaries: Sequence[ResidualSummary], attribute: str) -> str:
    return ", ".join(f"{summary.name} {getattr(summary, attribute):.3g}" for summary in summaries)


def percent(fraction: float) -> str:
    """Return (rms of residuals / sd of a channel) as text; above `MAX_SHARE`, only that limit."""
    if fraction > MAX_SHARE:
        return f"> {100 * MAX_SHARE:.0f} %"
    return f"{100 * fraction:.2g} %" if not fraction >= 0.995 else f"{100 * fraction:.0f} %"


EARLY = 0.1  # smallest reported lead of an input over its recorded time, in samples


def map_notes(problem: Problem, mode: Mode) -> Iterator[str]:
    """Yield notes on unknowns at ends of priors, and on inputs that act before they are recorded."""
    units, priors = problem.units, problem.posterior.space.priors
    si = {symbol.name: symbol for symbol in problem.symbols}
    for name in mode.at_bound:
        value, prior = mode.values[name], priors[name]
        if abs(value - prior.low) < abs(value - prior.high) and prior.low == 0:
            yield f"prior: {name} is at zero, where its prior ends: the record shows no sign of it."
        else:
            symbol = units.symbol(si[name])
            shown = f"{value / units.factor(name):.4g} {symbol.plain_unit}".removesuffix(" 1")
            yield (
                f"prior: {name} is at an end of its prior, {shown}. That is normal if the record does "
                "not determine it (`bayesdrill identify`). Otherwise widen the prior or check its unit."
            )
    for observation in problem.observations:
        sensing, step = observation.response.sensing, median_step(observation.experiment.t)
        lags = [name for name in (sensing.delay, *sensing.input_lags.values()) if name]
        called = observation.named(observation.response.parameters)
        for name in dict.fromkeys(called[lag] for lag in lags):
            if (early := mode.values.get(name, 0.0)) < -EARLY * step:
                yield (
                    f"timing: by {name} the inputs act {-1e3 * early:.3g} ms before they are recorded. "
                    "Their column is late, for instance by a filter, or the clocks do not agree."
                )


def describe_timing(moment: InputTiming | None) -> Iterable[str]:
    """Yield a sentence if half a sample of input delay would shift the estimates much."""
    if moment is None or not moment.is_reported:
        return
    moved = sorted(moment.shifts, key=lambda shift: -abs(shift[1]))
    far = [(name, abs(shift)) for name, shift in moved[:3] if abs(shift) > 0.1]
    named = ", ".join(f"{name} by {shift:.2g}" for name, shift in far)
    width = 2 * moment.seconds
    yield (
        f"timing: if the inputs act half a sample ({1e3 * moment.seconds:.3g} ms) later than recorded, "
        f"these values shift, in sds: {named}. Residuals may not show it. If that is possible, "
        f"add `inputs: {{t_0: {{prior: uniform, low: -{width:.3g}, high: {width:.3g}}}}}`."
    )


def step_sentences(errors: Sequence[StepError]) -> str:
    """Describe the largest harmless error of time steps, and each error that is not harmless."""
    lines = []
    fine = sorted((error for error in errors if error.fine), key=lambda error: -error.worst)
    for error in (*fine[:1], *(error for error in errors if not error.fine)):
        where = f" in {error.label}" if error.label else ""
        if error.fine and len(fine) > 1:
            where += f", the worst of {len(fine)} experiments"
        steps = "one step" if error.pieces == 1 else f"{error.pieces} steps"
        named = zip(error.channels, error.errors, strict=True)
        each = ", ".join(f"{name} {size:.2g}" for name, size in named)
        moved = (
            f"{steps} to a sample{where}; {TRUTH_REFINEMENT} times as many would move samples by"
        )
        worst = f"{error.worst:.2g} of the noise ({each})"
        said = f"{moved} at most {worst}. That is harmless."
        if not error.fine:
            said = (
                f"TOO FEW: {moved} up to {worst}. Up to a tenth of the noise is harmless. Say "
                f"`model: {{pieces: {steps_wanted(error)}}}`."
            )
        lines.append(f"steps: {said}")
    return "\n".join(lines)


def steps_wanted(error: StepError) -> int:
    """Return steps per sample that make the error small: the present number times a power of two."""
    return error.pieces << max(1, math.ceil(math.log2(error.worst / MAX_ERROR_OVER_NOISE)))


def prior_notes(rows: Sequence[ParameterRow], display_units: DisplayUnits) -> list[str]:
    """Return notes on unknowns that are pressed against an end of the prior; `rows` are in SI."""
    return [
        f"note: {row.name} is pressed against the end "
        f"{display_units.format_value(row.name, row.pressed_against)} of its prior. The record pulls it "
        "beyond this end. Widen the prior, or check the model, the units and the held values."
        for row in rows
        if row.pressed_against is not None
    ]
