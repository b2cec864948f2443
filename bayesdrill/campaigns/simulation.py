"""Simulate the records of a campaign; its section `simulation:` sets the true parameters."""

from __future__ import annotations

import glob
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics import seeds
from bayesdrill.basics.errors import InputError, did_you_mean
from bayesdrill.campaigns.records import run_case
from bayesdrill.campaigns.runs import CampaignPlan, CampaignRun, read_spec
from bayesdrill.config import loading
from bayesdrill.config.records import simulation
from bayesdrill.config.schema.campaign import CampaignSimulation, CampaignSpec
from bayesdrill.config.yaml_source import Location, Source, read
from bayesdrill.report.section import mappings_as_csv

TRUTH = "truth.csv"
DIGITS = 8  # significant digits of true parameters


def simulate_campaign(path: Path, seed: int | None, *, force: bool = False) -> dict[Path, int]:
    """Write records, table of runs and `truth.csv` of a campaign; return sample counts by file.

    `runs:` names the table.  Raises `InputError` with all mistakes before anything is written.
    """
    source, spec = read_spec(path)
    asked, table = _asked(source, spec)
    base = read(path.parent / spec.base)
    case = loading.validate(base)
    (resolved,) = case.experiments
    nominal = simulation.truth(resolved)
    _check_names(source, asked, nominal)
    rng = seeds.stream(spec.seed if seed is None else seed, "campaign")
    truths, rows = _truths(asked, nominal, rng)
    folder, names = table.parent, [str(row["name"]) for row in rows]
    files = [folder / f"{name}.csv" for name in names]
    output_files.refuse_unwritable(folder)
    if not force and folder.is_dir():
        for file in (table, folder / TRUTH, *files):
            output_files.refuse_existing(file, (path, base.path), force=False)
    folder.mkdir(parents=True, exist_ok=True)
    samples, plan = dict[Path, int](), CampaignPlan(spec=spec, source=source, base=base)
    for truth, file in zip(truths, files, strict=True):
        run = CampaignRun(
            name=file.stem,
            path=file,
            changes={"simulation": {n: x for n, x in truth.items() if x != nominal[n]}},
        )
        made = run_case(plan, run, case)
        text = simulation.simulate(made, int(rng.integers(2**32)), file)
        output_files.write_text(file, text)
        samples[file] = len(text.splitlines()) - 1
    output_files.write_text(table, mappings_as_csv(rows))
    every = [{"name": name, **truth} for name, truth in zip(names, truths, strict=True)]
    output_files.write_text(folder / TRUTH, mappings_as_csv(every))
    return samples


def _asked(source: Source, spec: CampaignSpec) -> tuple[CampaignSimulation, Path]:
    if spec.simulation is None:
        message = "is missing; it says how many runs are simulated, and how they differ"
        raise source.error(("simulation",), message)
    if not isinstance(spec.runs, str) or glob.has_magic(spec.runs) or spec.runs[-4:] != ".csv":
        message = (
            "a simulated campaign has a table of runs, as CSV; name one, such as runs/runs.csv"
        )
        raise source.error(("runs",), message)
    return spec.simulation, source.path.parent / spec.runs


def _check_names(source: Source, asked: CampaignSimulation, known: Mapping[str, float]) -> None:
    """Raise `InputError` for names that are not parameters of the rig."""
    parts = ("spread", "rig_spread", "drift")
    places: dict[str, Location] = {
        name: ("simulation", part, name) for part in parts for name in getattr(asked, part)
    }
    for part, change in (("jump", asked.jump), ("foreign", asked.foreign)):
        places |= {n: ("simulation", part, "change", n) for n in (change.change if change else ())}
    for column, effects in asked.noted.items():
        places |= {name: ("simulation", "noted", column, name) for name in effects}
    issues = [
        source.issue(place, f"the rig has no parameter {name}{did_you_mean(name, known)}")
        for name, place in places.items()
        if name not in known
    ]
    if issues:
        raise InputError(issues)


def _truths(
    asked: CampaignSimulation, nominal: Mapping[str, float], rng: np.random.Generator
) -> tuple[list[dict[str, float]], list[dict[str, object]]]:
    """Return the true parameters of each run, and its row in the table."""
    count, width = asked.runs, len(str(asked.runs))
    foreign = set[int]()
    if asked.foreign is not None:
        chosen = rng.choice(count, min(asked.foreign.count, count), replace=False)
        foreign = {int(k) for k in chosen}
    levels = [
        {n: sd * rng.normal() for n, sd in asked.rig_spread.items()} for _ in range(asked.rigs)
    ]
    truths, rows = list[dict[str, float]](), list[dict[str, object]]()
    for k in range(count):
        noted = {name: round(float(rng.normal()), 3) for name in asked.noted}
        changes = [{name: sd * rng.normal() for name, sd in asked.spread.items()}]
        changes.append(levels[k % asked.rigs])
        changes.append({n: x * k / max(count - 1, 1) for n, x in asked.drift.items()})
        changes += [{n: x * noted[c] for n, x in each.items()} for c, each in asked.noted.items()]
        jumps = asked.jump is not None and k >= asked.jump.after
        changes += [asked.jump.change] if asked.jump is not None and jumps else []
        changes += [asked.foreign.change] if asked.foreign is not None and k in foreign else []
        truth = dict(nominal)
        for change in changes:
            for name, x in change.items():
                truth[name] *= math.exp(math.log1p(x) if x > -1.0 else x)
        truths.append({n: float(f"{x:.{DIGITS}g}") for n, x in truth.items()})
        name = f"run_{k + 1:0{width}d}"
        row: dict[str, object] = {"file": f"{name}.csv", "name": name}
        row |= {"rig": f"rig_{k % asked.rigs + 1}"} if asked.rigs > 1 else {}
        rows.append(row | {"time": round(k * asked.interval, 9), **noted})
    return truths, rows
