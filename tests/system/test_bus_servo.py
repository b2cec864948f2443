"""A bus servo that swings known pendulums (Feetech STS3215): what its log of the duty cycle shows.

The register `torque` counts the duty cycle in 1/250 (written as 0.04 each) and has its sign in bit 8.
So the voltage is known, and the law of the firmware need not be.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from support.first_configs import shared

import bayesdrill as bd

FILES = {
    "light_short": ("184447", 6.745e-3, 0.5422),  # inertia [kg m^2] and m g l [N m] of the pendulum
    "light_long": ("191341", 13.69e-3, 0.8236),
    "heavy_short": ("164706", 14.61e-3, 1.1630),
}
CONFIG = """
name: servo
seed: 1
record:
  time: {{column: t, unit: s}}
  channels:
    theta_arm:
      column: theta
      unit: rad
      offset: {{prior: normal, mean: 0, sd: 0.1}}
      sigma: {{prior: log_uniform, low: 0.0005, high: 0.5}}
inputs:
  u_arm: {{column: u, unit: V, hold: zero}}
  t_0: {t_0}
initial: free
experiments:
{experiments}
shared: [{shared}]
model: {{name: train, inertias: [arm], drives: {{arm: voltage}}, gravity: [arm]}}
parameters: {parameters}
quantities: {{J: {J}}}
map: {{starts: 2}}
"""
RATIO = "r_arm: 1.0, k_T_arm: {prior: log_uniform, low: 0.05, high: 5}"  # of k_T and R
BOTH = (
    "r_arm: {prior: log_uniform, low: 0.5, high: 50}, k_T_arm: {prior: log_uniform, low: 0.2, "
    "high: 20}, k_e_arm: {tie: k_T_arm}"
)
REST = (
    ", c_arm: {prior: log_uniform, low: 0.05, high: 5}, t_c_arm: {prior: half_normal, scale: 0.5}}"
)
FREE = {
    "J": "{prior: log_uniform, low: 0.003, high: 0.3, unit: kg*m**2}",
    "t_0": "{prior: uniform, low: -60, high: 30, unit: ms}",
    "shared": "t_0, sigma_theta_arm",
}


def servo(folder: Path, names: list[str], **entries: str) -> bd.Case:
    lines = []
    for name in names:
        time, inertia, weight = FILES[name]
        stem = f"sysid_sts3215_sin_time_square_2025-03-17_{time}.json"
        rows = json.loads((shared("cases/kscale_sts3215") / stem).read_text())["entries"]
        keys = ("timestamp", "position", "torque", "input_volts")
        t, theta, torque, volts = np.array([[row[key] for key in keys] for row in rows]).T
        counts = np.round(torque / 0.04).astype(int)
        u = volts * (counts & 255) / 250 * np.where(counts & 256, 1, -1)
        table = np.column_stack([t, theta, u])
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header="t,theta,u", comments="")
        own = f"{{j_arm: J + {inertia}, g_arm: {weight}}}"
        lines.append(f"  {name}: {{record: {{file: {name}.csv}}, parameters: {own}}}")
    path = folder / "servo.yaml"
    path.write_text(CONFIG.format(experiments="\n".join(lines), **entries))
    return bd.load(path)


def test_a_logged_duty_cycle_shows_the_damping_of_a_servo(tmp_path: Path) -> None:
    """Fits by others have 1.18 to 1.38 N m s/rad for it.  A longer pendulum is predicted as well."""
    short = ["light_short", "heavy_short"]
    found = servo(tmp_path, short, parameters="{" + RATIO + REST, **FREE).find_map(quick=True)
    values = found.values
    assert 1.1 < values["c_arm"] < 1.5
    held = {name: f"{values[name]:.6g}" for name in ("k_T_arm", "c_arm", "t_c_arm")}
    parameters = "{r_arm: 1.0, " + ", ".join(f"{name}: {x}" for name, x in held.items()) + "}"
    known = {"J": f"{{value: {values['J']:.6g}, unit: kg*m**2}}", "t_0": f"{values['t_0']:.6g}"}
    names = ["light_long", "light_short"]
    other = servo(tmp_path, names, parameters=parameters, shared="", **known).find_map(quick=True)
    left = other.values["sigma_theta_arm_light_long"]
    assert left < 1.2 * values["sigma_theta_arm"] < 0.02


def test_torque_constant_and_resistance_of_a_servo_are_not_determined(tmp_path: Path) -> None:
    case = servo(tmp_path, ["light_short", "heavy_short"], parameters="{" + BOTH + REST, **FREE)
    said = str(case.identify())
    rows = {line.split()[0]: line for line in said.splitlines() if line.startswith("  ")}
    assert all("not at all" in rows[name] for name in ("k_T_arm", "r_arm", "c_arm"))
    assert rows["k_T_arm/r_arm"].endswith("  determined")
    assert "1 exact symmetry" in said
