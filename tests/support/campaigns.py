"""Small campaigns: runs of the small experiment, with records that are simulated once."""

import functools
import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from support import command_line
from support.command_line import CONFIGS, CommandResult, cli

from bayesdrill.campaigns import population, study
from bayesdrill.campaigns.population import PopulationSettings
from bayesdrill.sampling.convergence import Targets

CAMPAIGN = (CONFIGS / "campaign.yaml").read_text(encoding="utf-8")
SOON_MET = Targets(r_hat=1.1, n_tau=5.0, ess=50.0)
QUICK = CAMPAIGN.replace("noted:", "effort: 100\nnoted:", 1).replace("runs: 6", "runs: 4")


@functools.cache
def simulated(campaign: str) -> dict[str, str]:
    """Return the files of a simulated campaign by their names below its folder."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command_line.small_config(folder)
        (folder / "campaign.yaml").write_text(campaign)
        result = command_line.cli("simulate", folder / "campaign.yaml")
        assert result.status == 0, result.err
        return {file.name: file.read_text() for file in (folder / "runs").iterdir()}


def campaign(folder: Path, *changes: tuple[str, str], text: str = CAMPAIGN) -> Path:
    """Write a small campaign with its records; `changes` replace texts of its file."""
    files = simulated(text)
    (folder / "runs").mkdir(parents=True, exist_ok=True)
    command_line.small_config(folder)
    for name, content in files.items():
        (folder / "runs" / name).write_text(content)
    path = folder / "campaign.yaml"
    path.write_text(command_line.replaced(text, *changes))
    return path


def run(*arguments: str | Path) -> CommandResult:
    """Run a command whose population is sampled until targets that are soon met."""
    with pytest.MonkeyPatch.context() as patch:
        quick = functools.partial(PopulationSettings, targets=SOON_MET, chains=2)
        patch.setattr(study, "PopulationSettings", quick)
        patch.setattr(population, "FIRST_CHECK", 200)
        return cli(*arguments)


@dataclass(frozen=True)
class Finished:
    path: Path
    folder: Path
    result: CommandResult

    def command(self, name: str, *options: str) -> CommandResult:
        return run(name, self.path, "-o", self.folder, "--processes", "1", *options)

    def copied(self, folder: Path) -> "Finished":
        shutil.copytree(self.path.parent, folder)
        return Finished(folder / self.path.name, folder / self.folder.name, self.result)

    @property
    def draws(self) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in (self.folder / "draws").iterdir()}

    @property
    def times(self) -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in (self.folder / "draws").iterdir()}

    @property
    def record(self) -> dict[str, Any]:
        return dict(json.loads((self.folder / "campaign.json").read_text()))


@functools.cache
def finished(base: Path) -> Finished:
    """Return a finished campaign of four runs in the folder `base`; it is not to be changed."""
    path = campaign(base / "finished_campaign", text=QUICK)
    folder = path.parent / "out"
    return Finished(path, folder, run("campaign", path, "-o", folder, "--processes", "1"))
