"""What the terminal and the summary say of record, search and draws, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesdrill import output_files
from bayesdrill.analysis import plausibility
from bayesdrill.analysis import suspicions as suspected
from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.config.resolve import quantities
from bayesdrill.config.resolve.case import ResolvedCase
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import ColumnSpec, TimeColumn
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import ResidualSummary, like_noise
from bayesdrill.record import clocks
from bayesdrill.report.section import aligned
from bayesdrill.report.sections import fit_words
from bayesdrill.rig.models.linear import Model, constants
from bayesdrill.rig.simulators import COMPRESSED_FROM
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.mode_search import SAME_POINT, Mode

FEW, ALL = 3, 50  # places of what is odd that a report names, and `check`

HEADERS = ("", "measures", "column", "unit", "first", "from", "to")


def record_columns(problem: Problem, case: ResolvedCase) -> str:
    """Of each record: time, channels and measured inputs, in the units of their columns."""
    return "\n".join(
        _columns(observation, case.experiment(observation.label).config)
        for observation in problem.all_observations
    )


def _columns(observation: Observation, config: Config) -> str:
    experiment = observation.experiment
    lines: list[tuple[str, ...]] = [HEADERS]
    time = config.record.time
    if isinstance(time, TimeColumn):
        lines.append(_line("time", "time", time, experiment.t / units.factor(time.unit, "s")))
    for channel, values in zip(experiment.channels, experiment.y.T, strict=True):
        name, spec = channel.name, config.record.channels[channel.name]
        lines.append(_line(name, spec.measures or name, spec, values / channel.factor))
    held = "first" if experiment.first_order else "zero"
    for entry, given, values in quantities.inputs_as_given(config, experiment):
        how = f"hold: {held}" if entry in experiment.series else "angle"
        lines.append(_line(entry, f"input, {how}", given, values))
    sampling = clocks.describe_times(experiment.t)
    return f"{observation.entitled('columns')} ({sampling}):\n{aligned(lines, left={0, 1, 2, 3})}"


def record_made(problem: Problem) -> tuple[str, ...]:
    """What times each record has, where its steps are not equal, and what was done to its numbers."""
    apart = problem.posterior.likelihood.held_out
    sentences: list[str] = []
    for observation in problem.observations:
        experiment, total = observation.experiment, len(observation.experiment.t)
        times = [] if experiment.uniform else [f"times: {clocks.describe_times(experiment.t)}"]
        seen = zip(experiment.counts, experiment.names, strict=True)
        every = ", ".join(f"{count} of {name}" for count, name in seen)
        partly = set(experiment.counts) != {total}
        some = [f"measured: {every}, at {total} times"] if partly else []
        sentences += _of_experiment(observation, [*times, *some, *experiment.told])
    for observation in apart:
        sentences.append(
            f"{observation.label}, its {observation.n_measured} samples are held out, "
            "and are no evidence"
        )
    return tuple(sentences)


def _of_experiment(observation: Observation, sentences: Sequence[str]) -> list[str]:
    return [f"{observation.label}, {each}" if observation.label else each for each in sentences]


def record_suspicions(problem: Problem, most: int = FEW) -> tuple[str, ...]:
    """Say what looks wrong in columns and units; of what is odd, at most `most` places each."""
    sentences: list[str] = []
    for observation in problem.observations:
        odd = [each.in_words(most) for each in observation.experiment.odd]
        factors = [channel.factor for channel in observation.experiment.channels]
        said = suspected.suspicions_of_record(observation.experiment, factors, problem.model)
        sentences += _of_experiment(observation, [*odd, *said])
    return (*sentences, *suspected.suspicions_of_start(problem))


def _line(name: str, measures: str, spec: ColumnSpec, values: Array) -> tuple[str, ...]:
    where = [text for text in (spec.variable, spec.column) if text is not None]
    known = values[~np.isnan(values)]
    return (
        f"  {name}",
        measures,
        " ".join(map(str, where)),
        spec.unit,
        *(f"{x:.5g}" for x in (known[0], known.min(), known.max())),
    )


def headline(problem: Problem, config: Config) -> str:
    """Return what a run is of, in one line."""
    experiments = problem.observations
    samples = sum(len(experiment.experiment.t) for experiment in experiments)
    channels = ", ".join(
        dict.fromkeys(name for each in experiments for name in each.experiment.names)
    )
    several = f" in {len(experiments)} experiments" if len(experiments) > 1 else ""
    return (
        f"{config.name}: {samples} samples of {channels}{several}; rig {problem.model.name}; "
        f"{len(problem.names)} unknowns"
    )


def opening(problem: Problem) -> str:
    """What goes in."""
    space, shown = problem.posterior.space, problem.units.format_value
    held = ", ".join(f"{name} = {shown(name, value)}" for name, value in space.fixed.items())
    tied = ", ".join(f"{name} = {relation.text}" for name, relation in space.relations.items())
    return (
        f"{records(problem)}\nmodel: {model(problem)}\n"
        f"unknown: {', '.join(space.free)}"
        + (f"\ntied: {tied}" if tied else "")
        + (f"\nheld: {held}" if held else "")
    )


def records(problem: Problem) -> str:
    """A line for each."""
    lines = []
    for observation in problem.observations:
        experiment = observation.experiment
        ending = f" {observation.label}" if observation.label else ""
        length = experiment.t[-1] - experiment.t[0]
        channels = ", ".join(experiment.names)
        lines.append(f"record{ending}: {len(experiment.t)} samples of {channels} over {length:g} s")
        if len(experiment.t) > COMPRESSED_FROM:
            reason = observation.exact_reason
            said = f"by all samples, as {reason}" if reason else "compressed to sample it"
            lines.append(f"likelihood{ending}: {said}")
    return "\n".join(lines)


def model(problem: Problem) -> str:
    """Its name, what was added to it, and what it holds beside parameters: the gear."""
    rig = problem.model
    if rig.has_private_names:
        return _parts(rig)
    held = constants(rig)
    added = held.pop("added", ())
    name = f"{rig.name} with {', '.join(added)}" if added else rig.name
    said = [f"{n} = {x:.6g}" if isinstance(x, float) else f"{n} = {x}" for n, x in held.items()]
    gear = f"; the motor turns {1 / rig.gear_ratio:.4g} times as fast" if rig.geared else ""
    return f"{name} ({', '.join(said)}{gear})" if said else name


def _parts(rig: Model) -> str:
    roles, added = rig.roles, ", ".join(rig.added)
    shafts = ", ".join(f"{shaft.name} ({' to '.join(shaft.ends)})" for shaft in roles.shafts)
    geared = ", ".join(
        f"{i.name} ({1 / i.reduction:.4g} times as fast as {i.speed})"
        for i in roles.inertias
        if i.reduction != 1.0
    )
    parts = {
        "": ", ".join(inertia.name for inertia in roles.inertias),
        "shafts ": shafts,
        "geared ": geared,
        "driven by ": ", ".join(n for n in rig.inputs if rig.symbols[n].drives),
    }
    said = "; ".join(f"{what}{names}" for what, names in parts.items() if names)
    return f"{rig.name}{f' with {added}' if added else ''} ({said})"


def preview(problem: Problem, config: Config) -> str:
    """What would run."""
    posterior, sampler, units = problem.posterior, config.sampler, problem.units
    start = posterior.space.vector(posterior.space.start)
    priors = "\n".join(
        f"  {symbol.name}{f' [{symbol.plain_unit}]' if symbol.unit not in ('', '1') else ''}: "
        f"{units.prior(symbol.name, prior).describe()}"
        for symbol, prior in zip(
            units.symbols(problem.symbols), posterior.space.priors.values(), strict=True
        )
    )
    doubts = plausibility.plausibility_of_nominal(problem)
    kind = "nominal" if problem.nominal else "start"
    findings = (  # what makes table, priors, gear or record doubtful before anything is sampled
        *(f"{kind} values, {doubt}" for doubt in doubts),
        *plausibility.plausibility_of_priors(problem),
        *plausibility.of_roles(problem),
        *plausibility.plausibility_of_gear(problem),
        *(f"record: {note}" for note in record_made(problem)),
        *(f"record, {note}" for note in record_suspicions(problem, ALL)),
    )
    return (
        f"priors:\n{priors}\n"
        f"log posterior at the start: {posterior.density(start[None])[0]:.2f}{_misfit(problem)}\n"
        f"would run: {config.map.starts} searches by {config.map.method}, then "
        f"{sampler.ensembles} ensembles of {sampler.walkers} walkers for at most {sampler.max_steps} "
        f"steps. They end when R-hat <= {sampler.r_hat:g}, N/tau >= {sampler.n_tau:g} and "
        f"ESS >= {sampler.ess:g}\n" + "\n".join([size(problem, config), *findings])
    )


def predictive_draws(problem: Problem, config: Config) -> int:
    """Of each ensemble: as many as the config asks for, or as there is room for."""
    wanted = config.output.predictive_draws
    return output_files.predictive_draws(wanted, config.sampler.ensembles, _numbers(problem))


def _numbers(problem: Problem) -> int:
    return sum(observation.experiment.y.size for observation in problem.observations)


def size(problem: Problem, config: Config) -> str:
    """What the results will hold at most."""
    sampler, unknowns = config.sampler, len(problem.names)
    steps = min(
        sampler.max_steps, output_files.steps_of_chain(sampler.ensembles, sampler.walkers, unknowns)
    )
    chain = 8 * steps * sampler.ensembles * sampler.walkers * (unknowns + 1)
    draws, wanted = predictive_draws(problem, config), config.output.predictive_draws
    predicted = 8 * draws * sampler.ensembles * _numbers(problem)
    fewer = f", not {wanted}: those are too many for this record" if draws < wanted else ""
    kept = f"{draws} predictive draws of each ensemble {predicted / 1e6:.3g} MB{fewer}"
    if not draws:
        kept = f"no predictive draws: {wanted} of each ensemble are too many for this record"
    return f"size at most: chain {chain / 1e6:.3g} MB ({steps} steps), {kept}"


def _misfit(problem: Problem) -> str:
    """Of the start, where sigma is known; it may be large, if the rig is not as the table says."""
    likelihood, space = problem.posterior.likelihood, problem.posterior.space
    if any(observation.unknowns for observation in likelihood.observations):
        return ""
    mean_square = likelihood.mean_square(space.vector(space.start)[None])[0]
    return f"; misfit per number there {mean_square:.4g}, and 1 where only noise is left"


def maxima(mode: Mode, weights: NDArray[np.float64] | None, units: DisplayUnits) -> str:
    """Say where the maxima are, and that they hold the shares `weights (M,)`; empty for one."""
    if not mode.others or weights is None:
        return ""
    names = [
        name
        for name, x in mode.values.items()
        if any(_apart(other.values[name], x) for other in mode.others)
    ][:MOST_NAMED]
    if not names:
        shares = ", ".join(f"{weight:.1%}" for weight in weights)
        return (
            f"{len(weights)} maxima of the posterior, within {SAME_POINT:.0%} of each other in every "
            f"unknown, between which the walkers pass: {shares} of the draws belong to them"
        )
    lines = [f"{len(weights)} maxima of the posterior, between which the walkers pass:"]
    order = np.argsort(-weights, kind="stable")
    for k in order[:MOST_LISTED]:
        values = mode.maxima[k].values
        places = ", ".join(f"{name} {units.format_value(name, values[name])}" for name in names)
        lines.append(f"  {weights[k]:.1%} of the draws belong to the one at {places}")
    if len(rest := order[MOST_LISTED:]):
        lines.append(f"  {weights[rest].sum():.1%} of the draws belong to the other {len(rest)}")
    return "\n".join(lines)


def reasons(
    sampled: SamplingResult, left: Sequence[ResidualSummary], unsupported: Mapping[str, float]
) -> tuple[str, ...]:
    """Why a run must not be believed: it did not converge, or does not fit; empty where it may be."""
    fit = (*fit_words.residual_reasons(left), *fit_words.sandwich_reasons(unsupported))
    return (*sampled.convergence.reasons, *fit)


def warning(sampled: SamplingResult, left: Sequence[ResidualSummary]) -> str:
    """What every figure must carry; empty where there is nothing to warn of."""
    return misfit(left) if sampled.convergence.converged else "NOT CONVERGED"


def misfit(left: Sequence[ResidualSummary]) -> str:
    """The same of a fit alone."""
    if any(summary.far_too_large for summary in left):
        return "DOES NOT FIT: far more than the noise is left"
    if any(summary.unbelievable for summary in left):
        return "DOES NOT FIT: what is left is far from white"
    return "" if like_noise(left) else "MORE THAN NOISE IS LEFT by the fit"


def unbelievable(reasons: Sequence[str], *, converged: bool) -> str:
    """Why a posterior must not be believed, converged or not; empty where it may be."""
    if not reasons:
        return ""
    though = ", though the ensembles converged" if converged else ""
    listed = (f"  - {reason}" for reason in reasons)
    return "\n".join([f"DO NOT BELIEVE these numbers{though}:", *listed])


DIAGNOSTICS = (
    "R-hat compares the independent ensembles with each other: it is 1 where they have forgotten where "
    "they started. An autocorrelation time is the number of steps that one fresh draw costs. Effective "
    "draws are the number of fresh ones: a mean is known to the sd over their square root. Acceptance "
    "is the share of proposed steps that were taken."
)


def leaning(priors_of: Mapping[str, tuple[str, ...]]) -> str:
    """What is known only with the priors of others; empty where nothing is."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, others in priors_of.items():
        groups.setdefault(others, []).append(name)
    return "\n".join(
        f"leaning: {', '.join(names)} on the prior of {', '.join(others)}. The record says nothing of "
        "that, and they are known only as far as it is."
        for others, names in groups.items()
    )


MOST_NAMED, MOST_LISTED = 4, 6  # unknowns of a maximum elsewhere, and maxima


def _apart(value: float, other: float) -> bool:
    return abs(value - other) > SAME_POINT * abs(other)


def mode(mode: Mode, units: DisplayUnits) -> str:
    """How the searches for the MAP went."""
    n, same = len(mode.searches), len(mode.highest)
    lines = [
        f"MAP: log posterior {mode.log_posterior:.2f}; {same} of {n} searches reached it within "
        f"{mode.tolerance:.0e}"
    ]
    if mode.wandering:
        lines.append(
            f"     they ended more than {100 * SAME_POINT:g} % apart in {', '.join(mode.wandering)}: "
            "the posterior is flat there"
        )
    elif same == 0:
        lines.append(
            "     it was reached from a point of the prior, or from around another maximum; give "
            "map.starts or map.evaluations more"
        )
    elif same < 2 and n > 1:
        lines.append("     no second search confirms it; give map.starts or map.evaluations more")
    for other in mode.others[:MOST_LISTED]:
        moved = {n: abs(x - other.values[n]) / max(abs(x), 1e-300) for n, x in mode.values.items()}
        apart = [name for name, x in other.values.items() if _apart(x, mode.values[name])]
        apart = apart or [max(moved, key=moved.__getitem__)]
        places = ", ".join(
            f"{name} {units.format_value(name, other.values[name])}" for name in apart[:MOST_NAMED]
        )
        lower = mode.log_posterior - other.log_posterior
        height = f"{lower:.3g} lower" if lower > mode.tolerance else "as high"
        lines.append(
            f"     another maximum, {height}: {places}"
            + (", ..." if len(apart) > MOST_NAMED else "")
        )
    if rest := mode.others[MOST_LISTED:]:
        lowest = mode.log_posterior - rest[-1].log_posterior
        lines.append(f"     and {len(rest)} more, at most {lowest:.3g} lower")
    lines.append(
        f"     gradient: a Newton step would raise the log posterior by {mode.gain:.1g}"
        + (f"; at the bound of its prior: {', '.join(mode.at_bound)}" if mode.at_bound else "")
    )
    return "\n".join(lines)


def search(mode: Mode) -> str:
    """Return how the searches for the MAP went, in one line, and what is to be known of it."""
    n, same = len(mode.searches), len(mode.highest)
    said = f"MAP: {same} of {n} searches reached the same maximum"
    if not same:
        said = "MAP: draws from the priors led higher than the searches from the starts"
    if same < 2 and n > 1:
        said += "; no second one confirms it (more: map.starts, map.evaluations)"
    if mode.others:
        said += f"; {len(mode.others)} other maxima were found"
    if mode.at_bound:
        said += f"; at an end of their priors: {', '.join(mode.at_bound)}"
    return said


def sampling(sampled: SamplingResult) -> str:
    """Return in one line whether the ensembles converged; more where they did not."""
    c = sampled.convergence
    if not c.converged:
        return convergence(sampled)
    n_ensembles, _, n_walkers, _ = sampled.theta.shape
    return (
        f"sampling: converged after {c.steps} steps of {n_ensembles} x {n_walkers} walkers (R-hat at "
        f"most {c.r_hat.max():.4f}, at least {c.ess_bulk.min():.0f} effective draws)"
    )


def convergence(sampled: SamplingResult) -> str:
    """Whether the ensembles may be believed."""
    c = sampled.convergence
    n_ensembles, _, n_walkers, _ = sampled.theta.shape
    lines = [
        f"{n_ensembles} ensembles of {n_walkers} walkers, {c.steps} steps, of which the first "
        f"{c.burn_in} are dropped ({c.burn_in_rule})",
        f"R-hat at most {c.r_hat.max():.4f}, {c.n_tau:.0f} autocorrelation times of "
        f"{c.tau.max():.0f} steps, at least {c.ess_bulk.min():.0f} effective draws, "
        f"acceptance {sampled.acceptance.mean():.2f}",
    ]
    if sampled.failures:
        lines.append(f"{sampled.failures} proposals had no finite response and were refused")
    if (check := sampled.compression) is not None:
        exact = f" {check.exact} of these draws needed all samples." if check.exact else ""
        lines.append(
            f"The record of {check.samples} samples was compressed into {check.functions} functions. "
            f"For {check.draws} draws the log likelihood differs from the exact one by at most "
            f"{check.difference:.1g}.{exact}"
        )
    if c.converged:
        lines.append("converged: all targets are met")
    else:
        lines.append("NOT CONVERGED, do not use these numbers:")
        lines += [f"  - {reason}" for reason in c.reasons]
        if c.enough is not None:
            lines.append(
                f"  only length is missing: about {c.enough} steps should do. Raise sampler.max_steps "
                "to that in the config, and go on with --resume."
            )
        lines.append(
            f"  {c.slowest} moves slowest. Fewer steps do if you hold it, give its prior nearer ends, "
            "or add what `bayesdrill identify` proposes. figures/trace shows the walkers."
        )
    return "\n".join(lines)
