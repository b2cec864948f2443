"""Where a result comes from: versions, what a resumed run must share, the config with defaults."""

from __future__ import annotations

import hashlib
import io
import os
from importlib.metadata import version
from pathlib import Path
from typing import Any

import bayesdrill
from bayesdrill import config as records
from bayesdrill import recording
from bayesdrill.build import Problem
from bayesdrill.experiment import Experiment
from bayesdrill.yaml_source import Source

PACKAGES = (
    "numpy",
    "scipy",
    "emcee",
    "scikit-learn",
    "arviz-stats",
    "arviz-base",
    "llvmlite",
    "h5py",
)


def versions() -> dict[str, str]:
    return {"bayesdrill": bayesdrill.__version__, **{name: version(name) for name in PACKAGES}}


def fingerprint(config: records.Config, problem: Problem) -> dict[str, str]:
    """What decides the chain, in words that name it when it has changed."""
    space, sampler = problem.posterior.space, config.sampler
    return {
        "the record": _hash_record(problem.experiment),
        "the model": repr(problem.posterior.likelihood.response.model),
        "the priors": _short(repr((space.priors, space.fixed, space.start))),
        "the noise": _short(repr(problem.posterior.likelihood.noise)),
        "the coordinates": _short(repr(problem.posterior.coordinates)),
        "the MAP search": repr(config.map),
        "the ensembles": repr((sampler.ensembles, sampler.walkers, sorted(sampler.moves.items()))),
        "the pilot": str(sampler.pilot),
        "the seed": str(config.seed),
        "the version of emcee": version("emcee"),
        "the version of scikit-learn": version("scikit-learn"),
        "the version of bayesdrill": bayesdrill.__version__,
    }


def resolved(config: records.Config, source: Source, folder: Path) -> str:
    """The config with every default, its record relative to `folder`, versions as comments."""
    from ruamel.yaml import YAML

    data: dict[str, Any] = config.model_dump(exclude_none=True)
    record = recording.path_of(config, source)
    # Links are resolved first: `..` in a path goes up from where a link leads to.
    data["record"]["file"] = Path(os.path.relpath(record.resolve(), folder.resolve())).as_posix()
    out = io.StringIO()
    yaml = YAML()
    yaml.width = 120
    yaml.default_flow_style = None
    yaml.dump(data, out)
    made_by = "".join(f"# {name} {number}\n" for name, number in versions().items())
    opening = "# Every entry of the config with its default filled in, and what read it:\n"
    return f"{opening}{made_by}{out.getvalue()}"


def _hash_record(experiment: Experiment) -> str:
    digest = hashlib.sha256()
    for values in (experiment.t, experiment.y, *experiment.series.values()):
        digest.update(values.tobytes())
    rest = (
        experiment.channels,
        dict(experiment.constant),
        list(experiment.series),
        experiment.first_order,
        dict(experiment.start),
        experiment.t_start,
    )
    digest.update(repr(rest).encode())
    return digest.hexdigest()[:16]


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
