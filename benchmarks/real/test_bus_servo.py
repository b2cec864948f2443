"""A bus servo that swings known pendulums (Feetech STS3215): what its log of the duty cycle shows.

The register `torque` counts the duty cycle in 1/250 (written as 0.04 each) and has its sign in bit 8.
So the voltage is known, and the law of the firmware need not be.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.first_configs import shared

import bayesdrill as bd

FILES = {
    "light_short": ("184447", 6.745e-3, 0.5422),  # inertia [kg m^2] and m g l [N m] of the pendulum
    "light_long": ("191341", 13.69e-3, 0.8236),
    "heavy_short": ("164706", 14.61e-3, 1.1630),
    "heavy_long": ("225421", 29.47e-3, 1.7549),  # its motor was at 45 deg C, those above at 36
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
parameters: {{{parameters}}}
quantities: {{{quantities}}}
map: {{starts: 2}}
"""
RATIO = "r_arm: 1.0, k_T_arm: K, c_arm: C, t_c_arm: {prior: half_normal, scale: 0.5}"  # K: k_T/R
BOTH = (
    "r_arm: {prior: log_uniform, low: 0.5, high: 50}, k_T_arm: {prior: log_uniform, low: 0.2, "
    "high: 20}, k_e_arm: {tie: k_T_arm}, c_arm: {prior: log_uniform, low: 0.05, high: 5}, "
    "t_c_arm: {prior: half_normal, scale: 0.5}"
)
INERTIA = "J: {prior: log_uniform, low: 0.003, high: 0.3, unit: kg*m**2}"
QUANTITIES = (
    f"{INERTIA}, K: {{prior: log_uniform, low: 0.05, high: 5, unit: N*m/V}}, "
    "C: {prior: log_uniform, low: 0.05, high: 5, unit: N*m*s/rad}"
)
WARM = ", cooler: {prior: log_uniform, low: 0.5, high: 2, unit: '1'}"  # R when cold over R
FREE = {
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
        warm = ", k_T_arm: cooler*K, c_arm: cooler*C" * (name == "heavy_long")
        own = f"{{j_arm: J + {inertia}, g_arm: {weight}{warm}}}"
        lines.append(f"  {name}: {{record: {{file: {name}.csv}}, parameters: {own}}}")
    path = folder / "servo.yaml"
    path.write_text(CONFIG.format(experiments="\n".join(lines), **entries))
    return bd.load(path)


def fitted(folder: Path, *names: str) -> dict[str, float]:
    """The resistance of the warm motor is an unknown, as `k_T/R` and `k_T^2/R` have it alike."""
    case = servo(folder, [*names], parameters=RATIO, quantities=QUANTITIES + WARM, **FREE)
    return dict(case.find_map(quick=True).values)


@pytest.mark.slow
def test_four_records_of_a_servo_are_fitted_jointly(tmp_path: Path) -> None:
    """Fits by others have a damping of 1.18 to 1.38 N m s/rad."""
    values = fitted(tmp_path, *FILES)
    assert 1.1 < values["C"] < 1.5
    assert 0.8 < values["cooler"] < 0.95
    assert values["sigma_theta_arm"] < 0.016


@pytest.mark.slow
def test_pendulums_of_another_length_are_predicted(tmp_path: Path) -> None:
    """The longer pendulums predict both masses; the mutant without `cooler` leaves twice as much."""
    values = fitted(tmp_path, "light_long", "heavy_long")
    assert 1.1 < values["C"] < 1.5
    units = {"J": "kg*m**2", "K": "N*m/V", "C": "N*m*s/rad"}
    held = (f"{n}: {{value: {values[n]:.6g}, unit: {unit}}}" for n, unit in units.items())
    free = "{prior: half_normal, scale: 0.5}"
    other = servo(
        tmp_path,
        ["light_short", "heavy_short"],
        parameters=RATIO.replace(free, f"{values['t_c_arm']:.6g}"),
        quantities=", ".join(held),
        shared="",
        t_0=f"{values['t_0']:.6g}",
    ).find_map(quick=True)
    for name in ("light_short", "heavy_short"):
        assert other.values[f"sigma_theta_arm_{name}"] < 1.3 * values["sigma_theta_arm"] < 0.021


def test_torque_constant_and_resistance_of_a_servo_are_not_determined(tmp_path: Path) -> None:
    names = ["light_short", "heavy_short"]
    case = servo(tmp_path, names, parameters=BOTH, quantities=INERTIA, **FREE)
    said = str(case.identify())
    rows = {line.split()[0]: line for line in said.splitlines() if line.startswith("  ")}
    assert all("not at all" in rows[name] for name in ("k_T_arm", "r_arm", "c_arm"))
    assert rows["k_T_arm/r_arm"].endswith("  determined")
    assert "1 exact symmetry" in said
