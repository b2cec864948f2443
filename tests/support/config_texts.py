"""Configs of small rigs as text, which tests change by replacements, and records beside them."""

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.command_line import CONFIGS, replaced

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.record.experiment import Experiment

RPM, DEG = 2 * np.pi / 60, np.pi / 180


def write(folder: Path, text: str, *changes: tuple[str, str]) -> Path:
    """Write a config whose `changes` replace text that stands in it once."""
    path = folder / "config.yaml"
    path.write_text(replaced(text, *changes), encoding="utf-8")
    return path


def save(folder: Path, name: str, **columns: np.ndarray | list[str]) -> None:
    """Write columns of numbers, or of cells as they stand."""
    texts = [
        [x if isinstance(x, str) else f"{x:.12g}" for x in column] for column in columns.values()
    ]
    lines = [",".join(columns), *(",".join(row) for row in zip(*texts, strict=True))]
    (folder / name).write_text("\n".join(lines) + "\n")


# A speed and an angle of the paper's rig, of which only the stiffness is unknown.

MEASURED = (CONFIGS / "measured.yaml").read_text(encoding="utf-8")
T = 0.3 + np.arange(240) * 0.01
RNG = np.random.default_rng(6)
SPEED = 9.0 + 4.0 * np.sin(7.0 * T) + 0.01 * RNG.standard_normal(len(T))
ANGLE = 20.0 * T - np.cos(5.0 * T) + 0.01 * RNG.standard_normal(len(T))
SUPPLY = 8.0 + np.round(np.sin(3.0 * T), 1)


def read_measured(
    folder: Path, record: str = "", w_1: str = "", channel: str = "", v: str = "8"
) -> Experiment:
    """Read the record of `MEASURED` with further entries.

    `record`: a line in `record:`; `w_1`: entries of that channel; `channel`: another channel;
    `v`: the input.
    """
    changes = [("inputs: {v: 8}", f"inputs: {{v: {v}}}")]
    if record:
        changes.append(("  file: r.csv\n", f"  file: r.csv\n  {record}\n"))
    if w_1 or channel:
        more = f", {w_1}}}" if w_1 else "}"
        changes.append(
            ("sigma: 0.1}", f"sigma: 0.1{more}" + (f"\n    {channel}" if channel else ""))
        )
    case = loading.load(write(folder, MEASURED, *changes))
    return reading.read(case.experiments[0])


def load_measured(folder: Path, *changes: tuple[str, str]) -> Experiment:
    """Read `MEASURED`, changed, whose record has all columns; times of `odd.csv` decrease."""
    save(folder, "r.csv", t=T, w=SPEED, u=SUPPLY, phi=ANGLE)
    save(folder, "odd.csv", x=-T, phi=ANGLE)
    return reading.read(loading.load(write(folder, MEASURED, *changes)).experiments[0])


def refused(folder: Path, **entries: str) -> str:
    """Return why `read_measured` refuses a record."""
    with pytest.raises(InputError) as caught:
        read_measured(folder, **entries)
    return str(caught.value)


# The small experiment with further physics.

LAST_PARAMETER = "  t_f: nominal\n"


def write_composed(folder: Path, *lines: str, **sections: str) -> Path:
    """Write the small experiment with `lines` in `parameters:`, and other or further sections."""
    more = "".join(f"  {line}\n" for line in lines)
    text = command_line.SMALL.replace(LAST_PARAMETER, LAST_PARAMETER + more)
    for name, entry in sections.items():
        kept = [line for line in text.splitlines() if not line.startswith(f"{name}:")]
        text = "\n".join([*kept, f"{name}: {entry}"]) + "\n"
    return write(folder, text)


# A shaft that a speed and a torque drive.

SHAFT = (CONFIGS / "shaft.yaml").read_text(encoding="utf-8")
DRILL_T = 5.0 + 0.01 * np.arange(200)
TOP_SPEED = 9.0 + 3.0 * np.sin(18.0 * DRILL_T)
TOP_ANGLE = 140.0 + 9.0 * (DRILL_T - 5.0) - np.cos(18.0 * DRILL_T) / 6.0
TORQUE = 1.9 + 0.8 * np.sin(18.0 * DRILL_T + 1.0)


def write_shaft(folder: Path, *changes: tuple[str, str], text: str = SHAFT) -> Path:
    """Write the driven shaft with a record of all columns."""
    noise = np.random.default_rng(1).standard_normal(len(DRILL_T))
    save(
        folder,
        "drill.csv",
        t=DRILL_T,
        top=TOP_SPEED / RPM,
        angle=TOP_ANGLE / DEG,
        turned=(TOP_ANGLE / DEG) % 360.0,
        torque=1e3 * TORQUE,
        weight=500 + DRILL_T,
        bit=TOP_SPEED / RPM + noise,
    )
    return write(folder, text, *changes)
