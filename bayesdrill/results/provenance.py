"""Write the provenance of a result: versions, fingerprint, and the config with its defaults.

The provenance is written when a job begins. If the job is interrupted, `run.json` says so.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import bayesdrill
from bayesdrill import output_files
from bayesdrill.basics import software
from bayesdrill.basics.arrays import PART, Array
from bayesdrill.basics.errors import InputError, Interrupted, was_stopped
from bayesdrill.basics.software import DECISIVE, installed_versions, versions_text
from bayesdrill.basics.symbols import noise_name
from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.building.experiments import EXPERIMENTS, SECTIONS, SHARING_KEYS, joint_name
from bayesdrill.config.job import Job
from bayesdrill.config.records import sources
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import as_yaml
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.output_files import CONFIG_FILE, RECORD, RESOLVED_FILE
from bayesdrill.record.experiment import Experiment
from bayesdrill.results.run_folder import VERSION_OF, Folder, mark
from bayesdrill.rig.models.linear import Model, constants

RESUME = "continue with --resume"  # how a command goes on after an interruption
RUN_MARK = "Run"  # key of the run's mark (a digest) in the metadata of a file
# Entries of `map:` that no longer exist. Every fingerprint lists these entries as not given, so
# that runs of earlier versions can be continued.
FORMER_ENTRIES = ("map.pairs", "map.iterations", "map.steady")


def fingerprint(config: Config, problem: Problem) -> dict[str, str]:
    """Return all values that determine the chain, by names that messages can use."""
    posterior, sampler = problem.posterior, config.sampler
    space = posterior.space
    search = {f"map.{name}": repr(value) for name, value in config.map}
    versions = installed_versions()
    return {
        **_of_experiments(problem),
        "the model": _model(problem.model),
        **{f"the prior of {name}": repr(prior) for name, prior in space.priors.items()},
        **{f"{name}, which is held,": repr(value) for name, value in space.fixed.items()},
        **{f"the relation of {name}": r.text for name, r in space.relations.items()},
        "the start of the MAP search": repr(dict(space.start)),
        **search,
        **{name: "None" for name in FORMER_ENTRIES if name not in search},
        "sampler.ensembles": str(sampler.ensembles),
        "sampler.walkers": str(sampler.walkers),
        "sampler.moves": repr(dict(sorted(sampler.moves.items()))),
        "the seed": str(config.seed),
        f"{VERSION_OF}bayesdrill": bayesdrill.__version__,
        **{f"{VERSION_OF}{name}": versions[name] for name in DECISIVE},
    }


def settings(config: Config, problem: Problem, display_units: DisplayUnits) -> dict[str, str]:
    """Return the settings of a run that `compare` compares, by name.

    They are the entries of the fingerprint without those of MAP search, sampler and versions. The
    entry of a parameter has the parameter's name and is in display units.
    """
    posterior = problem.posterior
    space = posterior.space
    return {
        **_of_experiments(problem),
        "the model": _model(problem.model),
        **{name: display_units.describe_prior(name, prior) for name, prior in space.priors.items()},
        **{
            name: f"held at {display_units.format_value(name, value, 6)}"
            for name, value in space.fixed.items()
        },
        **{name: r.text for name, r in space.relations.items()},
        **_noise_held(config, problem, display_units),
        "the seed": str(config.seed),
    }


def marks(config: Config, problem: Problem, burn_in: str = "") -> dict[str, str]:
    """Return the metadata by which figures and the ArviZ `DataTree` identify their run."""
    return {
        RUN_MARK: mark(fingerprint(config, problem)),
        "Record": ", ".join(records(problem).values()),
        "Seed": str(config.seed),
        **({"Burn-in": burn_in} if burn_in else {}),
        "Versions": versions_text(),
    }


def records(problem: Problem) -> dict[str, str]:
    """Return the length and a digest of each record, by the labels of experiments."""
    return {
        experiment.label: _of_experiment(experiment.experiment)["the record"]
        for experiment in problem.all_observations
    }


def _model(rig: Model) -> str:
    """Return the model as a Python expression, without default arguments."""
    constants_text = ", ".join(f"{name}={value!r}" for name, value in constants(rig).items())
    return f"{type(rig).__name__}({constants_text})"


def _of_experiments(problem: Problem) -> dict[str, str]:
    """Return the entries of all experiments; with several, entries are named with their labels."""
    entries: dict[str, str] = {}
    for observation in problem.all_observations:
        names, sensing = observation.experiment.names, observation.response.sensing
        facts = _of_experiment(observation.experiment)
        if not sensing.empty:
            sensors = {"the sensors": sensing.summary, "the start": sensing.start_summary}
            facts |= {name: text for name, text in sensors.items() if text}
        if observation.key is not None:
            facts["the kind of noise"] = str(observation.key)
        for k, sigma in observation.noise.fixed_values().items():
            facts[f"the noise of {names[k]}"] = repr(sigma)
        entries |= {observation.title(name): value for name, value in facts.items()}
    for observation in problem.posterior.likelihood.held_out:
        entries[observation.title("what counts")] = "nothing: it is held out"
    return entries


def _of_experiment(experiment: Experiment) -> dict[str, str]:
    digest = hashlib.sha256()
    for values in (experiment.t, experiment.y):
        digest.update(np.ascontiguousarray(values))
    hold = "first" if experiment.first_order else "zero"
    return {
        "the record": f"{len(experiment.t)} samples ({digest.hexdigest()[:12]})",
        **{
            f"the channel {channel.name}": f"{dict(channel.weights)} in {channel.unit}"
            for channel in experiment.channels
        },
        **{f"the input {name}": repr(value) for name, value in experiment.constant.items()},
        **{
            f"the input {name}": f"measured, hold: {hold} ({_digest(series)})"
            for name, series in experiment.series.items()
        },
        "the initial state": f"{dict(experiment.start)} at {experiment.t_start!r} s",
    }


def _noise_held(config: Config, problem: Problem, display_units: DisplayUnits) -> dict[str, str]:
    """Return the fixed sigmas of channels, in display units."""
    entries = {}
    for observation in problem.observations:
        for k, sigma in observation.noise.fixed_values().items():
            if isinstance(sigma, float):
                channel = observation.experiment.names[k]
                shown = joint_name(config, noise_name(channel), observation.label)
                text = display_units.format_value(shown, sigma, 6)
                entries[observation.title(f"the noise of {channel}")] = text
    return entries


def resolved(case: ResolvedCase, folder: Path) -> str:
    """Return the config with all defaults, paths relative to `folder`, and versions as comments."""
    config = case.config
    data: dict[str, Any] = config.model_dump(exclude_none=True)
    for experiment in case.experiments:
        sections = data
        if experiment.label:
            entries = experiment.config.model_dump(exclude_none=True)
            sections = {key: entries[key] for key in SECTIONS}
            spec, its_sections = config.experiments[experiment.label], {"parameters", "held_out"}
            own_entries = spec.model_dump(include=its_sections, exclude_defaults=True)
            data["experiments"][experiment.label] = sections | own_entries
        _remove_defaults(sections, experiment.config, case.model)
        sources.rebase(sections, case.source.path.parent, folder)
    # With several experiments, the top level repeats entries of the first experiment.
    for key in SECTIONS if config.experiments else (EXPERIMENTS, *SHARING_KEYS):
        del data[key]
    made_by = "".join(f"# {name} {number}\n" for name, number in installed_versions().items())
    opening = "# Every entry of the config with its default filled in, and versions:\n"
    return f"{opening}{made_by}{as_yaml(data)}"


def _remove_defaults(sections: dict[str, Any], config: Config, rig: Model) -> None:
    """Remove defaults that would change the meaning of the config if they were written as entries.

    If written, inputs that the rig lacks and states of a steady start would be refused, and states
    of a free start would be fixed.
    """
    removed = {
        "inputs": {*config.vocabulary.inputs} - {*rig.inputs} - config.inputs.model_fields_set
    }
    if config.initial.state != "given":
        states = {*sections["initial"]} - {"state", "time"}
        removed["initial"] = states - config.initial.model_fields_set
    for section, names in removed.items():
        for name in names & {*sections[section]}:
            del sections[section][name]


def _digest(series: Array) -> str:
    """Return the digest of the `repr` of a list of numbers, without the whole text in memory."""
    digest = hashlib.sha256(b"[")
    for first in range(0, len(series), PART):
        text = ", ".join(map(repr, series[first : first + PART].tolist()))
        digest.update((", " * (first > 0) + text).encode())
    digest.update(b"]")
    return digest.hexdigest()[:12]


def check_record(job: Job, output: Path, record: str | None = None) -> None:
    """Raise `InputError` if a file of the record is in `output`, unless `record` is in memory."""
    paths = (path for experiment in job.case.experiments for path in sources.paths(experiment))
    places = [path.parent.resolve() for path in paths]
    if record is None and output.resolve() in places:
        raise InputError.at(str(output), "holds the record of this run; give another folder")


def begin(job: Job, folder: Folder, record: str | None = None, **more: Any) -> None:
    """Write the config as given and with defaults, and the text `record` of arrays from Python."""
    if record is None:
        outputs = output_files.output_names(folder.path, folder.kind)
        replaced = [folder.path / name for name in outputs]
        output_files.refuse_replacing(sources.files(job.case)[1:], replaced)
    versions = software.installed_versions()
    folder.begin(status="running", seed=job.config.seed, versions=versions, **more)
    folder.write_text(CONFIG_FILE, job.source.text)
    case = job.case
    if record is not None:
        folder.write_text(RECORD, record)
        beside = dataclasses.replace(job.source, path=folder.path / CONFIG_FILE)
        case = dataclasses.replace(case, source=beside)
    folder.write_text(RESOLVED_FILE, resolved(case, folder.path))


@contextmanager
def interruptions(
    folder: Folder,
    progress: Callable[[], str],
    errors: tuple[type[Exception], ...] = (),
    way_out: str = RESUME,
) -> Iterator[None]:
    """Record an interruption in `run.json`; after a signal, raise `Interrupted` with `progress`."""
    stops: tuple[type[Exception], ...] = (BrokenProcessPool, *errors)
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        stopped = isinstance(error, KeyboardInterrupt) or was_stopped(error)
        if stopped or isinstance(error, stops):
            folder.write_run(status="interrupted")
        if stopped:
            raise Interrupted(f"stopped; {progress()}; {way_out}") from None
        raise
