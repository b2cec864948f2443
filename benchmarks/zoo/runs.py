"""One run of the command line, as a user would start it, and what it left behind."""

from __future__ import annotations

import csv
import dataclasses
import json
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from benchmarks.zoo.makers import ROOT

Array = NDArray[np.float64]

LAST = 10.0  # seconds that a run has to end in when it is told to
LARGE = ("chain.h5", "posterior.nc")


@dataclass(frozen=True, slots=True, kw_only=True)
class Importance:
    """Means by weighted independent draws, and their standard errors; `share`: effective draws."""

    draws: int
    share: float
    mean: Mapping[str, float]
    error: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What `run.json` and `summary.csv` say; empty where the run did not get that far.

    `status` is None where it was stopped; `wall`, `seconds` in s; `mean`, `sd`, `draws` (effective)
    and `tau` by the names of the unknowns, SI.
    """

    status: int | None
    wall: float
    said: str = ""
    converged: bool = False
    reasons: tuple[str, ...] = ()
    seconds: Mapping[str, float]
    steps: int = 0
    tau: Mapping[str, float]
    acceptance: tuple[float, ...] = ()
    ess: float = 0.0
    fit: tuple[Mapping[str, Any], ...] = ()
    maxima: tuple[Mapping[str, Any], ...] = ()
    importance: Importance | None = None
    mean: Mapping[str, float]
    sd: Mapping[str, float]
    draws: Mapping[str, float]

    @property
    def rate(self) -> float:
        """Effective draws of the worst unknown per second of sampling; 0 where there are none."""
        sampling = self.seconds.get("sampling", 0.0)
        return self.ess / sampling if sampling > 0 else 0.0


def start(config: Path, folder: Path, most: float) -> Run:
    """`bayesdrill posterior`, told to end after `most` seconds; its words go beside `folder`."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "bayesdrill", "posterior", str(config)]
    began = time.perf_counter()
    with folder.with_suffix(".txt").open("w+", encoding="utf-8") as log:
        process = subprocess.Popen(
            [*command, "--output", str(folder), "--force"],
            cwd=ROOT,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        status = _ended(process, most)
        wall = time.perf_counter() - began
        log.seek(0)
        said = log.read()
    return read(folder, status, wall, said)


def _ended(process: subprocess.Popen[bytes], most: float) -> int | None:
    """The exit status; None where it had to be stopped."""
    try:
        return process.wait(timeout=most)
    except subprocess.TimeoutExpired:
        process.terminate()
    try:
        process.wait(timeout=LAST)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    return None


def read(folder: Path, status: int | None, wall: float, said: str = "") -> Run:
    """Of a results folder; what stands there of an earlier run does not count."""
    found = _json(folder / "run.json") if status in (0, 3) else {}
    rows = _summary(folder / "summary.csv") if found.get("status") == "finished" else []
    weighted, analysis = found.get("importance"), found.get("analysis", {})
    names = [unknown["name"] for unknown in analysis.get("unknowns", ())]
    convergence = analysis.get("convergence", {})
    return Run(
        status=status,
        wall=wall,
        said=said,
        converged=bool(found.get("converged", False)),
        reasons=tuple(found.get("reasons", ())),
        seconds=found.get("seconds", {}),
        steps=int(convergence.get("steps", 0)),
        tau=dict(zip(names, convergence.get("tau", ()), strict=True)),
        acceptance=tuple(analysis.get("acceptance", ())),
        ess=float(min(convergence.get("ess_bulk", ()), default=0.0)),
        fit=tuple(analysis.get("fit", ())),
        maxima=tuple(found.get("maxima") or ()),
        importance=None if weighted is None else _importance(weighted),
        mean={row["name"]: float(row["mean"]) for row in rows},
        sd={row["name"]: float(row["sd"]) for row in rows},
        draws={row["name"]: float(row["ess_bulk"]) for row in rows},
    )


def _importance(found: Mapping[str, Any]) -> Importance:
    names = [field.name for field in dataclasses.fields(Importance)]
    return Importance(**{name: found[name] for name in names})


def draws(folder: Path, names: Iterable[str]) -> dict[str, Array]:
    """Of each unknown, `(N,)`; none where the run has left none."""
    path = folder / "posterior.nc"
    if not path.exists():
        return {}
    with h5py.File(path, "r") as file:
        return {name: np.ravel(file[f"posterior/{name}"][:]) for name in names}


def lighten(folder: Path) -> None:
    """Chains take most of the room, and a run that did well is not looked at again."""
    for name in LARGE:
        (folder / name).unlink(missing_ok=True)


def _json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _summary(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
