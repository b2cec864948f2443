"""Small campaigns: runs of the small experiment, with records that are simulated once."""

import functools
from pathlib import Path

from support import command_line

CAMPAIGN = """\
name: many
base: small.yaml
runs: runs/runs.csv
time_unit: d
noted: [temperature]
simulation:
  runs: 6
  spread: {j_1: 0.04, k_e: 0.02}
  noted: {temperature: {k_e: 0.01}}
"""


@functools.cache
def simulated(campaign: str) -> dict[str, str]:
    """Return the files of a simulated campaign by their names below its folder."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "runs").mkdir()
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
