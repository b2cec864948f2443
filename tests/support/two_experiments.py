"""Two experiments with one rig, simulated: what sensors add, how they begin, what they share."""

import functools
import tempfile
from pathlib import Path

from support.command_line import CONFIGS, replaced

from bayesdrill.config import loading
from bayesdrill.config.job import Job, prepare
from bayesdrill.config.records import simulation
from bayesdrill.config.yaml_source import parse

# Both in users' units; a lag and an offset in common, noise known.
PAIR = (CONFIGS / "pair.yaml").read_text(encoding="utf-8")
TRUTH = {"lag_theta_1": 0.015, "offset_theta_1": -0.10471975511965977}

# All kinds of numbers that may be unknown beside the rig; one experiment moves at its start.
RICH = (CONFIGS / "rich.yaml").read_text(encoding="utf-8")


@functools.cache
def records(text: str) -> dict[str, str]:
    """Return what `simulate` makes of the config `text`, once, by the names of files."""
    case = loading.validate(parse(Path("all.yaml"), text))
    simulated = simulation.simulate_all(case, case.config.seed)
    return {path.name: record for path, record in simulated.items()}


def write(folder: Path, *changes: tuple[str, str], text: str = PAIR) -> Path:
    """Write the config `text` with each text replaced that stands in it once, and its records."""
    for name, record in records(text).items():
        (folder / name).write_text(record, encoding="utf-8")
    (folder / "all.yaml").write_text(replaced(text, *changes), encoding="utf-8")
    return folder / "all.yaml"


@functools.cache
def rich_job() -> Job:
    """Return the job of `RICH`, with samples missing in the twist of the first experiment."""
    with tempfile.TemporaryDirectory() as folder:
        config = write(Path(folder), text=RICH)
        record = config.parent / "late.csv"
        lines = record.read_text().splitlines()
        for row in (12, 13, 14, 40):
            t, _, w = lines[row].split(",")
            lines[row] = f"{t},,{w}"
        record.write_text("\n".join(lines) + "\n")
        return prepare(config)
