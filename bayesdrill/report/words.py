"""Describe record, model and config in sentences, for the terminal and the summary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis import plausibility
from bayesdrill.analysis.suspicions import ALL, suspicions_of_problem
from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import count_noun
from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.records.sources import inputs_as_given
from bayesdrill.config.schema.config import Config
from bayesdrill.config.schema.records import ColumnSpec, TimeColumn
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Problem
from bayesdrill.record import clocks
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.section import aligned
from bayesdrill.rig.models.linear import Model, constants
from bayesdrill.rig.simulators import COMPRESSED_FROM

HEADERS = ("", "measures", "column", "unit", "first", "from", "to")
FAR_FROM_FITTING = -100.0  # log density per recorded number, below which the start does not fit


def record_columns(problem: Problem, case: ResolvedCase) -> str:
    """Describe the time, channels and measured inputs of each record, in the units of its columns."""
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
    for entry, given, values in inputs_as_given(config, experiment):
        how = f"hold: {held}" if entry in experiment.series else "angle"
        lines.append(_line(entry, f"input, {how}", given, values))
    sampling = clocks.describe_times(experiment.t)
    return f"{observation.title('columns')} ({sampling}):\n{aligned(lines, left={0, 1, 2, 3})}"


def record_made(problem: Problem) -> tuple[str, ...]:
    """Describe uneven times, incomplete channels, cleaning and held-out samples of records."""
    sentences: list[str] = []
    for observation in problem.observations:
        experiment, total = observation.experiment, len(observation.experiment.t)
        times = [] if experiment.uniform else [f"times: {clocks.describe_times(experiment.t)}"]
        seen = zip(experiment.counts, experiment.names, strict=True)
        every = ", ".join(f"{count} of {name}" for count, name in seen)
        partly = set(experiment.counts) != {total}
        missing = [f"measured: {every}, at {total} times"] if partly else []
        sentences += _of_experiment(observation, [*times, *missing, *experiment.notes])
    for observation in problem.posterior.likelihood.held_out:
        sentences.append(
            f"{observation.label}, all its {observation.n_measured} samples are held out, "
            "and do not enter the fit"
        )
    return tuple(sentences)


def _of_experiment(observation: Observation, sentences: Sequence[str]) -> list[str]:
    return [f"{observation.label}, {each}" if observation.label else each for each in sentences]


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
    """Describe a run in one line."""
    experiments = problem.observations
    samples = sum(len(experiment.experiment.t) for experiment in experiments)
    channels = ", ".join(
        dict.fromkeys(name for each in experiments for name in each.experiment.names)
    )
    several = f" in {len(experiments)} experiments" if len(experiments) > 1 else ""
    return (
        f"{config.name}: {samples} samples of {channels}{several}; rig {problem.model.name}; "
        f"{count_noun(len(problem.names), 'unknown')}"
    )


def opening(problem: Problem) -> str:
    """Describe the records, the model and the unknowns of a problem."""
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
    """Describe each record in a line, and the likelihood of a long record in a second line."""
    lines = []
    for observation in problem.observations:
        experiment = observation.experiment
        ending = f" {observation.label}" if observation.label else ""
        length = experiment.t[-1] - experiment.t[0]
        channels = ", ".join(experiment.names)
        lines.append(f"record{ending}: {len(experiment.t)} samples of {channels} over {length:g} s")
        if len(experiment.t) > COMPRESSED_FROM:
            reason = observation.exact_reason
            said = f"by all samples, as {reason}" if reason else "compressed for sampling"
            lines.append(f"likelihood{ending}: {said}")
    return "\n".join(lines)


def model(problem: Problem) -> str:
    """Describe the model: its name, what was added to it, its constants and its gear."""
    rig = problem.model
    if rig.has_private_names:
        return _parts(rig)
    held = constants(rig)
    added = held.pop("added", ())
    name = f"{rig.name} with {', '.join(added)}" if added else rig.name
    said = [f"{n} = {x:.6g}" if isinstance(x, float) else f"{n} = {x}" for n, x in held.items()]
    gear = (
        f"; the motor turns {1 / rig.gear_ratio:.4g} times as fast"
        if rig.geared and rig.gear_ratio != 1
        else ""
    )
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
    """Describe the priors, the search and the sampling of a config, and how its record was prepared."""
    posterior, sampler, units = problem.posterior, config.sampler, problem.units
    start = posterior.space.vector(posterior.space.start)
    density = float(posterior.density(start[None])[0])
    is_far = density < FAR_FROM_FITTING * _numbers(problem)
    far = ". Start values seldom fit; `bayesdrill map` finds values that do"
    far = far if is_far else ""
    priors = "\n".join(
        f"  {symbol.name}{f' [{symbol.plain_unit}]' if symbol.unit not in ('', '1') else ''}: "
        f"{units.prior(symbol.name, prior).describe()}"
        for symbol, prior in zip(
            units.symbols(problem.symbols), posterior.space.priors.values(), strict=True
        )
    )
    notes = (f"record: {note}" for note in record_made(problem))
    return (
        f"priors:\n{priors}\n"
        f"log posterior at the start: {density:.2f}{_misfit(problem)}{far}\n"
        f"would run: {count_noun(config.map.starts, 'search', 'searches')} by {config.map.method}, then "
        f"{sampler.ensembles} ensembles of {sampler.walkers} walkers for at most {sampler.max_steps} "
        f"steps. They end when R-hat <= {sampler.r_hat:g}, N/tau >= {sampler.n_tau:g} and "
        f"ESS >= {sampler.ess:g}\n" + "\n".join([size(problem, config), *notes])
    )


def doubts_before_sampling(problem: Problem) -> tuple[str, ...]:
    """Return reasons to doubt table, priors, gear or record before anything is sampled."""
    kind = "nominal" if problem.nominal else "start"
    findings = (
        *plausibility.plausibility_of_priors(problem),
        *plausibility.of_roles(problem),
        *plausibility.plausibility_of_gear(problem),
    )
    values = finding_sentences(plausibility.plausibility_of_nominal(problem))
    suspicions = finding_sentences(suspicions_of_problem(problem, ALL))
    return (
        *(f"{kind} values, {doubt}" for doubt in values),
        *finding_sentences(findings),
        *(f"record, {doubt}" for doubt in suspicions),
    )


def validity(doubts: Sequence[str], text: str) -> str:
    """Return the last sentences of the check of a config that has no mistakes.

    They count `doubts`, and the lines of the config's `text` that are still marked REVIEW.
    """
    lines = count_noun(
        len(doubts), "of the lines above is a doubt", "of the lines above are doubts"
    )
    look = f" {lines} about its values or its record." if doubts else ""
    marks = text.count("# REVIEW")
    todo = f" {count_noun(marks, 'line')} marked REVIEW {'is' if marks == 1 else 'are'} left to look at."
    return f"The config has no mistakes and can be sampled.{look}{todo if marks else ''}"


def predictive_draws(problem: Problem, config: Config) -> int:
    """Return how many draws per ensemble are predicted, fewer than requested if memory is short."""
    wanted = config.output.predictive_draws
    return output_files.predictive_draws(wanted, config.sampler.ensembles, _numbers(problem))


def _numbers(problem: Problem) -> int:
    return sum(observation.experiment.y.size for observation in problem.observations)


def size(problem: Problem, config: Config) -> str:
    """Describe how large the results can become."""
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
    """Describe the misfit at the start values if all sigmas are known; else return no text."""
    likelihood, space = problem.posterior.likelihood, problem.posterior.space
    if any(observation.unknowns for observation in likelihood.observations):
        return ""
    mean_square = likelihood.mean_square(space.vector(space.start)[None])[0]
    return f"; mean square of residuals / sigma: {mean_square:.4g} (1 if only noise is left)"
