"""Records in files with configs, what would explain what their fit leaves, and configs that say so."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

import bayesdrill as bd
from bayesdrill.analysis.causes import Causes
from bayesdrill.inference import residual_checks
from bayesdrill.tasks import conclusions


def write(folder: Path, config: str, columns: Mapping[str, np.ndarray]) -> Path:
    """A config, with `record.csv` beside it."""
    rows, head = np.column_stack([*columns.values()]), ",".join(columns)
    np.savetxt(folder / "record.csv", rows, "%.15g", ",", header=head, comments="")
    path = folder / "given.yaml"
    path.write_text(config)
    return path


def causes_of(case: bd.Case) -> Causes | None:
    """At the maximum that one search finds, in this process."""
    found = case.find_map(quick=True).mode
    job = case.job.with_steps_at(found)
    return conclusions.causes(job, found, conclusions.residuals(job, found))


def fits(case: bd.Case) -> bool:
    """Whether its maximum leaves what looks like noise."""
    found = case.find_map(quick=True).mode
    posterior = case.job.with_steps_at(found).problem.posterior
    theta = posterior.space.vector(found.values)
    return residual_checks.like_noise(
        residual_checks.residual_summaries(posterior.likelihood, theta)
    )


def amended(config: Path, lines: str) -> bd.Case:
    """A config to which a reader has added `lines`."""
    yaml = YAML(typ="safe")
    path = config.with_name("amended.yaml")
    path.write_text(json.dumps(merged(yaml.load(config), yaml.load(lines))))
    return bd.load(path)


def merged(given: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    found = dict(given)
    for key, value in more.items():
        inside = isinstance(value, dict) and isinstance(found.get(key), dict)
        found[key] = merged(found[key], value) if inside else value
    return found
