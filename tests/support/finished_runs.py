"""Make finished runs of the small experiment once for all tests; what makes them is loaded late."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pytest

if TYPE_CHECKING:
    from support.command_line import CommandResult

# Drawing takes longer than all the rest of a small run.
ALL_FIGURES = ("figures: []", "figures: null")
# Targets that cannot be met, so that a run uses all of its steps.
UNREACHABLE = ("ess: 100, max_steps: 500", "ess: 1000000, max_steps: 700")
PICTURES = ("corner", "fit", "invariants", "prior_posterior", "trace")
FIGURES = {"figures/corner.pdf", "figures/invariants.pdf"} | {f"figures/{p}.png" for p in PICTURES}
FILES = {  # of a run without figures
    *(".lock", "chain.h5", "config.resolved.yaml", "config.yaml", "derived.csv", "map.json"),
    *("posterior.nc", "report.html", "run.json", "summary.csv", "summary.md", "table.tex"),
    *("verdict.csv", "figures"),
}


@dataclass(frozen=True)
class FinishedRun:
    """A config, the folder of its results, and what the command printed."""

    config: Path
    folder: Path
    result: CommandResult | None = None

    @property
    def json(self) -> dict[str, Any]:
        run = json.loads((self.folder / "run.json").read_text())
        return {**run.get("analysis", {}).get("convergence", {}), **run}

    def chains(self) -> dict[str, np.ndarray]:
        """Return all that `chain.h5` holds of the four ensembles."""
        from emcee.backends import HDFBackend

        arrays = {}
        for k in range(4):
            backend = HDFBackend(
                str(self.folder / "chain.h5"), name=f"ensemble_{k}", read_only=True
            )
            arrays[f"z {k}"] = backend.get_chain()
            arrays[f"log p {k}"] = backend.get_log_prob()
            arrays[f"accepted {k}"] = backend.accepted
            arrays[f"random {k}"] = backend.random_state[1]
        return arrays

    def assert_same_chains(self, other: Self) -> None:
        theirs = other.chains()
        for name, values in self.chains().items():
            assert np.array_equal(values, theirs[name]), name

    def copy(self, place: Path) -> Self:
        """Copy config, record and results into the new folder `place`."""
        shutil.copytree(self.config.parent, place)
        name = self.folder.relative_to(self.config.parent)
        return replace(self, config=place / self.config.name, folder=place / name)


def copied_run(converged: FinishedRun, tmp_path: Path) -> FinishedRun:
    """Return a copy of a run, to be changed."""
    return converged.copy(tmp_path / "copy")


def run(factory: pytest.TempPathFactory, *changes: tuple[str, str]) -> FinishedRun:
    """Return a copy of the shared run of this config, in a folder of its own."""
    place = factory.mktemp("run")
    result = posterior(factory, place, "out", *changes)
    return FinishedRun((place / "out.yaml").rename(place / "small.yaml"), place / "out", result)


def posterior(
    factory: pytest.TempPathFactory,
    place: Path,
    name: str,
    *changes: tuple[str, str],
    causes: bool = True,
) -> CommandResult:
    """Put config, record and results of `bayesdrill posterior` into `place`; return what it printed.

    The results are in the folder `name`, the config in `name`.yaml.  The first worker that needs a
    config makes its run, while others wait; the run of another config is another one.  Without
    `causes` those of a bad fit are not ranked, which takes a minute.
    """
    from support import command_line

    from bayesdrill.tasks import conclusions

    text = command_line.small_config(place, *changes, name=f"{name}.yaml").read_bytes()
    shared = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # each worker has a folder of its own in that of all
        shared = shared.parent
    finished = shared / "finished" / hashlib.sha256(text + bytes([causes])).hexdigest()[:16]
    finished.mkdir(parents=True, exist_ok=True)
    with (finished / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (finished / "status").exists():
            config = command_line.small_config(finished, *changes)
            with pytest.MonkeyPatch.context() as patch:
                if not causes:
                    patch.setattr(conclusions, "causes", lambda *_: None)
                result = command_line.cli(
                    "posterior", config, "-o", finished / "out", "--processes", "1"
                )
            for part in ("out", "err"):
                (finished / f"{part}.txt").write_text(getattr(result, part), encoding="utf-8")
            (finished / "status").write_text(str(result.status))
    shutil.copytree(finished / "out", place / name)
    out, err = (
        (finished / f"{part}.txt")
        .read_text("utf-8")
        .replace(str(finished / "out"), str(place / name))
        for part in ("out", "err")
    )
    return command_line.CommandResult(int((finished / "status").read_text()), out, err)


def copied(finished: Path, tmp_path: Path) -> Path:
    """Return a copy of a folder of runs, to be changed."""
    shutil.copytree(finished, tmp_path / "rig")
    return tmp_path / "rig"
