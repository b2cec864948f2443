"""Records in files with configs, what would explain what their fit leaves, and configs that say so."""

import json
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

import bayesdrill as bd
from bayesdrill.analysis.causes import Causes
from bayesdrill.inference import residual_checks
from bayesdrill.selection.candidates import CandidateModel, CandidateModels
from bayesdrill.tasks import conclusions


def write(folder: Path, config: str, columns: Mapping[str, np.ndarray]) -> Path:
    """Write a config, with `record.csv` beside it."""
    rows, head = np.column_stack([*columns.values()]), ",".join(columns)
    np.savetxt(folder / "record.csv", rows, "%.15g", ",", header=head, comments="")
    path = folder / "given.yaml"
    path.write_text(config)
    return path


def causes_of(case: bd.Case) -> Causes | None:
    """Return what explains the fit at the maximum that one search finds, in this process."""
    mode = case.find_map(quick=True).mode
    job = case.job.with_steps_at(mode)
    return conclusions.causes(job, mode, conclusions.residuals(job, mode))


def try_only(parts: Collection[str], patch: pytest.MonkeyPatch) -> None:
    """Let no candidates be refitted but those of these parts; of all where none is named."""
    rungs = CandidateModels.rungs

    def some(models: CandidateModels, every: Iterable[tuple[str, ...]]) -> list[CandidateModel]:
        return rungs(models, [names for names in every if not parts or {*names} <= {*parts}])

    patch.setattr(CandidateModels, "rungs", some)


def fits(case: bd.Case) -> bool:
    """Return whether its maximum leaves what looks like noise."""
    mode = case.find_map(quick=True).mode
    posterior = case.job.with_steps_at(mode).problem.posterior
    theta = posterior.space.vector(mode.values)
    return residual_checks.like_noise(
        residual_checks.residual_summaries(posterior.likelihood, theta)
    )


def amended(config: Path, lines: str) -> bd.Case:
    """Return the case of a config to which a reader has added `lines`."""
    yaml = YAML(typ="safe")
    path = config.with_name("amended.yaml")
    path.write_text(json.dumps(merged(yaml.load(config), yaml.load(lines))))
    return bd.load(path)


def merged(given: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    entries = dict(given)
    for key, value in more.items():
        inside = isinstance(value, dict) and isinstance(entries.get(key), dict)
        entries[key] = merged(entries[key], value) if inside else value
    return entries
