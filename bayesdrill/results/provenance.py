"""Where a result comes from: versions, what a resumed run must share, the config with defaults."""

from __future__ import annotations

import hashlib
import io
import os
from importlib.metadata import version
from pathlib import Path
from typing import Any

import bayesdrill
from bayesdrill.basics.software import DECISIVE, in_words, versions
from bayesdrill.inference.problem import Problem
from bayesdrill.record.experiment import Experiment
from bayesdrill.results.run_folder import VERSION_OF
from bayesdrill.setup import sources
from bayesdrill.setup.config import Config
from bayesdrill.setup.yaml_source import Source

RUN_MARK = "Run"  # by which a file says whose it is
BURN_IN_MARK = "Burn-in"


def fingerprint(config: Config, problem: Problem) -> dict[str, str]:
    """What decides the chain, by names and values that a user knows from the config."""
    posterior, sampler = problem.posterior, config.sampler
    space = posterior.space
    return {
        **_of_experiment(problem.experiment),
        "the model": repr(posterior.likelihood.response.model),
        **{f"the prior of {name}": repr(prior) for name, prior in space.priors.items()},
        **{f"{name}, which is held,": repr(value) for name, value in space.fixed.items()},
        **{f"the relation of {name}": r.text for name, r in space.relations.items()},
        "the start of the MAP search": repr(dict(space.start)),
        **_of_noise(problem),
        **{f"map.{name}": repr(value) for name, value in config.map},
        "sampler.ensembles": str(sampler.ensembles),
        "sampler.walkers": str(sampler.walkers),
        "sampler.moves": repr(dict(sorted(sampler.moves.items()))),
        "the seed": str(config.seed),
        f"{VERSION_OF}bayesdrill": bayesdrill.__version__,
        **{f"{VERSION_OF}{name}": version(name) for name in DECISIVE},
    }


def settings(config: Config, problem: Problem) -> dict[str, str]:
    """What a reader compares of two runs: as the fingerprint, with all that is said of a parameter under
    its own name, and without what only finds the posterior.
    """
    posterior = problem.posterior
    space = posterior.space
    return {
        **_of_experiment(problem.experiment),
        "the model": repr(posterior.likelihood.response.model),
        **{name: prior.describe() for name, prior in space.priors.items()},
        **{name: f"held at {value:.6g}" for name, value in space.fixed.items()},
        **{name: r.text for name, r in space.relations.items()},
        **_of_noise(problem),
        "the seed": str(config.seed),
    }


def marks(config: Config, problem: Problem, burn_in: str) -> dict[str, str]:
    """What figures and tree carry inside, so that each says by itself which run it is of."""
    every = fingerprint(config, problem)
    return {
        RUN_MARK: _short("\n".join(f"{name}: {value}" for name, value in sorted(every.items()))),
        "Record": every["the record"],
        "Seed": str(config.seed),
        BURN_IN_MARK: burn_in,
        "Versions": in_words(),
    }


def _of_experiment(experiment: Experiment) -> dict[str, str]:
    digest = hashlib.sha256()
    for values in (experiment.t, experiment.y):
        digest.update(values.tobytes())
    held = "first" if experiment.first_order else "zero"
    return {
        "the record": f"{len(experiment.t)} samples ({digest.hexdigest()[:12]})",
        **{
            f"the channel {channel.name}": f"{dict(channel.weights)} in {channel.unit}"
            for channel in experiment.channels
        },
        **{f"the input {name}": repr(value) for name, value in experiment.constant.items()},
        **{
            f"the input {name}": f"measured, hold: {held} ({_short(repr(series.tolist()))})"
            for name, series in experiment.series.items()
        },
        "the initial state": f"{dict(experiment.start)} at {experiment.t_start!r} s",
    }


def _of_noise(problem: Problem) -> dict[str, str]:
    noise, names = problem.posterior.likelihood.noise, problem.experiment.names
    kind = {} if noise.white else {"the kind of noise": _short(repr(noise))}
    return kind | {f"the noise of {names[k]}": repr(sigma) for k, sigma in noise.held().items()}


def resolved(config: Config, source: Source, folder: Path) -> str:
    """The config with every default, its record relative to `folder`, versions as comments."""
    from ruamel.yaml import YAML

    data: dict[str, Any] = config.model_dump(exclude_none=True)
    for section, key in sources.named_in(data):
        # Links are resolved first: `..` in a path goes up from where a link leads to.
        record = (source.path.parent / section[key]).resolve()
        section[key] = Path(os.path.relpath(record, folder.resolve())).as_posix()
    out = io.StringIO()
    yaml = YAML()
    yaml.width = 120
    yaml.default_flow_style = None
    yaml.dump(data, out)
    made_by = "".join(f"# {name} {number}\n" for name, number in versions().items())
    opening = "# Every entry of the config with its default filled in, and what read it:\n"
    return f"{opening}{made_by}{out.getvalue()}"


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]
