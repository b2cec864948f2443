"""The records of a servo with a pendulum (BAM) as CSV.

Records are JSON with a clock of 5.1 to 7.1 ms.  `load` is the duty in 885ths, as an unsigned number
of 16 bits.  On the even clock of a CSV the angle is straight between its samples; a step has the
mean of the voltage, duty times supply, which is held between samples.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.real.bench import HERE, Bench

STEP = 0.02  # s
FOLDER = HERE / "build" / "bam"


def convert(source: Path, folder: Path) -> Path:
    """Write time [s], angle [rad] and voltage [V] of the stretch in which the motor is on."""
    record = json.loads(source.read_text(encoding="utf-8"))
    on = [entry for entry in record["entries"] if entry["torque_enable"]]
    t, angle, load, supply = (
        np.array([entry[name] for entry in on], float)
        for name in ("timestamp", "position", "load", "input_volts")
    )
    voltage = np.where(load > 32767, load - 65536, load) / 885 * supply
    grid = np.arange(t[0], t[-1], STEP)
    area = np.interp(grid, t, np.concatenate([[0.0], np.cumsum(voltage[:-1] * np.diff(t))]))
    table = np.column_stack([grid - grid[0], np.interp(grid, t, angle)])[:-1]
    target = folder / f"kp{record['kp']}_{record['trajectory']}.csv"
    target.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack([table, np.diff(area) / STEP])
    np.savetxt(target, table, "%.6f", ",", header="t,angle,voltage", comments="")
    return target


def convert_all(bench: Bench) -> None:
    for file in bench.files:
        convert(bench.place(file), FOLDER)
