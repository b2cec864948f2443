"""Records of a servo with a pendulum (BAM), JSON with a jittered clock, as CSV on an even clock.

`load` is the duty as an unsigned number of 16 bits, in 885ths.  The angle is straight between its
samples; the voltage, duty times supply, is held until the next, and a step has its mean.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

STEP = 0.01  # s; the clock of the records: 5.1 to 7.1 ms


def convert(source: Path, target: Path) -> None:
    """Write `t [s]`, angle [rad] and voltage [V] of the stretch in which the motor is on."""
    entries = json.loads(source.read_text(encoding="utf-8"))["entries"]
    on = [entry for entry in entries if entry["torque_enable"]]
    t, angle, load, supply = (
        np.array([entry[name] for entry in on], float)
        for name in ("timestamp", "position", "load", "input_volts")
    )
    voltage = np.where(load > 32767, load - 65536, load) / 885 * supply
    grid = np.arange(t[0], t[-1], STEP)
    charge = np.concatenate([[0.0], np.cumsum(voltage[:-1] * np.diff(t))])
    mean = np.diff(np.interp(np.append(grid, grid[-1] + STEP), t, charge)) / STEP
    table = np.column_stack([grid - grid[0], np.interp(grid, t, angle), mean])
    target.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(target, table[:-1], "%.6f", ",", header="t,angle,voltage", comments="")
