"""Design the next experiment of a config or a run (`bayesdrill design`), and write its files."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.equality import Value
from bayesdrill.basics.errors import InputError, did_you_mean
from bayesdrill.basics.progress import Reporter
from bayesdrill.config.building.initial import state_name
from bayesdrill.config.job import Job
from bayesdrill.config.schema.numbers import SensorFields
from bayesdrill.config.schema.records import DELAY
from bayesdrill.config.yaml_source import as_yaml
from bayesdrill.design.knowledge import posterior_knowledge, prior_knowledge
from bayesdrill.design.limits import parse_limits
from bayesdrill.design.rivals import design_against
from bayesdrill.design.source import SourceLimits
from bayesdrill.design.study import DesignRequest, ExperimentDesign, design_experiment
from bayesdrill.design.waveforms import FAMILIES, FREE
from bayesdrill.output_files import DESIGN, RECORD, numbered
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import lines_as_csv
from bayesdrill.report.sections.design import describe_design, design_csv, design_figure
from bayesdrill.sampling.workers import ONE_THREAD
from bayesdrill.tasks.text_folder import save_text

WAVEFORM, COMING, SDS = "waveform.csv", "coming.yaml", "design.csv"
LEVELS = 40  # number of levels of a waveform, unless a hold time is given
CHECKED_DRAWS = 200  # number of draws at which the limits are checked
DIGITS = 6  # significant digits of a level in the waveform's file


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Designed(Value):
    """A designed experiment is the result of `design`: `print` shows it, and `save` writes it.

    Parameters
    ----------
    job : Job
        The config with its record.
    design : ExperimentDesign
        Levels, expected standard deviations and the expected response, in SI.
    """

    job: Job
    design: ExperimentDesign

    @property
    def text(self) -> str:
        """Return the whole text for the terminal."""
        return describe_design(self.design)

    @property
    def times(self) -> Array:
        """Return the start times of the S levels, and the end of the last [s], `(S + 1,)`."""
        source = self.design.request.source
        starts = np.arange(source.count) * source.interval
        return np.append(starts, source.t[-1])

    @property
    def levels(self) -> Array:
        """Return the levels of the input in SI, `(S,)`; `(E, S)` for E > 1 experiments."""
        return self.design.levels[0] if len(self.design.levels) == 1 else self.design.levels

    def save(self, folder: str | Path, *, force: bool = False) -> str:
        """Save the waveform, the config of the next record, a text and a figure in a folder.

        Parameters
        ----------
        folder : str or path
            The folder, which is made if needed.
        force : bool
            Whether to replace the files of an earlier design.

        Returns
        -------
        str
            A line that names the files.

        Raises
        ------
        InputError
            If other files have these names, or an earlier design is there and `force` is false.
        """
        job, width = self.job, WIDTHS[self.job.config.output.size]
        title = f"The next experiment of {job.config.name}"
        others = {WAVEFORM: self.waveform_csv(), COMING: coming_config(job, self.design)}
        if self.design.targets:
            others[SDS] = design_csv(self.design)
        place = save_text(
            folder,
            DESIGN,
            job,
            title,
            self.text,
            lambda: {"design": design_figure(self.design, job.problem, width)},
            others,
            force=force,
        )
        return f"{place}/ ({', '.join(others)}, {DESIGN.mark}, figures/)"

    def waveform_csv(self) -> str:
        """Return the waveform as CSV: the time at which each level begins [s], and the level.

        If there are several experiments, each has its own column of levels.
        """
        levels, name = self.design.levels, self.design.request.source.input
        held = np.hstack([levels, levels[:, -1:]])
        # Levels that differ from zero by rounding alone are written as zero.
        held[np.abs(held) < 10.0**-DIGITS * np.abs(held).max()] = 0.0
        numbers = [[f"{u:.{DIGITS}g}" for u in row] for row in held.T]
        rows = [[f"{t:.9g}", *row] for t, row in zip(self.times, numbers, strict=True)]
        return lines_as_csv([["t", *numbered(name, [*levels])], *rows])

    def __str__(self) -> str:
        return self.text


def design(
    job: Job,
    chain: Array | None,
    learn: Sequence[str],
    options: dict[str, Any],
    limits: Sequence[str],
    draws: int,
    report: Reporter,
    rival: Job | None = None,
) -> Designed:
    """Design an experiment for a job from posterior draws `chain (N, D)`, or else from its prior.

    `options` has the fields of `SourceLimits`, a `family` and a number of `experiments`; options
    that are not given are None.  If there is a `rival`, the experiment is to distinguish its model
    from that of the job.  Raises `InputError` for invalid options.
    """
    problem, seed = job.problem, job.config.seed
    family, experiments = options.pop("family", None) or FREE, options.pop("experiments", 1)
    if family not in (FREE, *FAMILIES):
        hint = did_you_mean(family, [FREE, *FAMILIES])
        raise InputError.at("--family", f"no family of waveforms is called {family}{hint}")
    if rival is not None and learn:
        raise InputError.at(
            "--tell", "a design either distinguishes models or learns targets; give only one"
        )
    request = DesignRequest(
        source=_source(job, options),
        limits=parse_limits(
            limits, problem.model.states, problem.model.inputs, problem.posterior.space.model
        ),
        learn=tuple(learn),
        family=family,
        experiments=experiments,
        seed=seed,
    )
    if chain is None:
        known = prior_knowledge(problem, draws, CHECKED_DRAWS, seed)
    else:
        known = posterior_knowledge(problem, chain, draws, CHECKED_DRAWS)
    with ONE_THREAD:  # the matrices are so small that several threads would be slower
        if rival is None:
            made = design_experiment(problem, request, known, job.config.identify, report)
        else:
            made = design_against(problem, rival.problem, request, known, report)
    return Designed(job=job, design=made)


def _source(job: Job, options: dict[str, Any]) -> SourceLimits:
    """Return the limits of the source from the options, with defaults from the record."""
    experiment, model = job.problem.observations[0].experiment, job.problem.model
    given = {name: value for name, value in options.items() if value is not None}
    driven = [n for n in model.inputs if n in experiment.drives] or [*model.inputs]
    name = given.pop("input", driven[0])
    if name not in model.inputs:
        hint = did_you_mean(name, model.inputs)
        raise InputError.at("--input", f"{name} is no input of the rig{hint}")
    recorded = experiment.series.get(name, np.array([experiment.constant.get(name, 0.0)]))
    low, high = min(0.0, float(recorded.min())), max(0.0, float(recorded.max()))
    if low == high and not {"low", "high"} <= {*given}:
        message = f"the record does not show which levels {name} may have; give --low and --high"
        raise InputError.at("--high", message)
    duration = given.pop("duration", float(experiment.t[-1] - experiment.t[0]))
    defaults = {"low": low, "high": high, "hold": duration / LEVELS, "rate": 1.0 / experiment.dt}
    return SourceLimits(input=name, duration=duration, **{**defaults, **given})


def coming_config(job: Job, design: ExperimentDesign) -> str:
    """Return the config of the next record, whose columns have the names of channels and input."""
    first, source = job.case.experiments[0], design.request.source
    data = copy.deepcopy(dict(first.source.data))
    channels = {}
    for name, spec in data["record"]["channels"].items():
        place = ("file", "time", "variable")
        channels[name] = {k: x for k, x in spec.items() if k not in place} | {"column": name}
    count = len(design.levels)
    records = [name + ".csv" for name in numbered(RECORD.removesuffix(".csv"), [*design.levels])]
    data["record"] = {"file": RECORD, "time": {"column": "t", "unit": "s"}, "channels": channels}
    inputs = {**(data.get("inputs") or {})}
    for name, value in design.experiment.constant.items():
        if name != source.input and isinstance(inputs.get(name), dict):
            inputs[name] = value
    unit = job.problem.model.symbols[source.input].plain_unit
    given = inputs[source.input] if isinstance(inputs.get(source.input), dict) else {}
    kept = {key: given[key] for key in ("unit", *SensorFields.model_fields) if key in given}
    column = {"column": source.input, "unit": unit, "hold": "zero"}
    inputs[source.input] = column | kept
    data["inputs"] = inputs
    simulation = data.pop("simulation", None) or {}
    kept_truth = {k: x for k, x in simulation.items() if k not in ("duration", "rate")}
    data |= {"simulation": kept_truth} if kept_truth else {}
    if count > 1:
        del data["record"]["file"]
        parts = {f"coming_{k}": {"record": {"file": f}} for k, f in enumerate(records, start=1)}
        data["experiments"] = parts
        starts = {*map(state_name, first.model.states), DELAY}  # each record has its own
        shared = [name for name in first.local_numbers.unknown if name not in starts]
        data |= {"shared": shared} if shared else {}
    data["name"] = f"{job.config.name}_designed"
    about = (
        f"# Measure {WAVEFORM} ({source.input} in {unit}) at {source.rate:g} Hz into "
        f"{', '.join(records)}, with the columns\n"
        f"# t, {source.input} [{inputs[source.input]['unit']}], {', '.join(channels)}; "
        f"then run `bayesdrill posterior {COMING}`.\n"
        f"# Until then no command can use this config; {DESIGN.mark} has the expected record.\n"
    )
    if len(job.case.experiments) > 1:
        label = job.problem.observations[0].label
        about += f"# Channels, sensors and noise are those of the first experiment, {label}.\n"
    return about + as_yaml(data)
