"""Records of rigs that rub, made by the oracle of `rubbing`, and their configs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from oracles import NOMINAL
from rubbing import Rig, simulate
from rubbing_cases import SERVO

DEGREE = math.pi / 180

STICK_SLIP = """
name: stick_slip
seed: {seed}
record:
  file: stick_slip.csv
  time: {{column: t, unit: s}}
  channels:
    theta_1: {{column: theta_1, unit: rad, sigma: 0.1}}
    theta_2: {{column: theta_2, unit: rad, sigma: 0.1}}
    w_1: {{column: w_1, unit: rad/s, sigma: 0.1}}
    w_2: {{column: w_2, unit: rad/s, sigma: 0.1}}
inputs:
  v: {{column: v, unit: V}}
nominal: tables_2_3
parameters:
  j_m: {box}
  c_m: {box}
  k_e: {box}
  k_T: {box}
  r_m: {box}
  l_m: {box}
  k_s: {box}
  j_1: {box}
  t_f: 0.0
{friction}
sampler: {{walkers: 256}}
"""

BOX = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
RUBS = """\
  t_cm: {prior: uniform, low: 0, high: 0.2}
  t_c1: {prior: uniform, low: 0, high: 1}
  t_s1: {prior: uniform, low: 0, high: 3}
  w_s1: {prior: log_uniform, low: 0.05, high: 5}
"""

LOOP = """
name: rubbing_servo
seed: {seed}
record:
  file: rubbing_servo.csv
  time: {{column: t, unit: ms}}
  channels:
    theta_2: {{column: theta_2, unit: deg, sigma: {{prior: log_uniform, low: 0.01, high: 1}}}}
    twist:
      column: twist
      unit: deg
      measures: theta_1 - theta_2
      sigma: {{prior: log_uniform, low: 0.01, high: 1}}
inputs:
  v: {{column: v, unit: V}}
model: {{i_m: {i_m}}}
nominal:
  {{table: tables_2_3, j_m: 4.95e-6, c_m: 2.2e-6, k_e: 0.022, k_T: 0.022, r_m: 1.98, l_m: 0.66e-3,
   k_s: 0.99, j_1: 2.64e-3, t_f: 1.0e-3}}
parameters:
  j_m: {box}
  c_m: {{prior: log_uniform, low: 0.1, high: 10, relative: true}}
  k_e: {box}
  k_T: {{tie: k_e}}
  r_m: {box}
  l_m: nominal
  k_s: {box}
  j_1: {box}
  t_f: {t_f}
{friction}
"""


def stick_slip(folder: Path, seed: int, *, told: bool = True) -> tuple[Path, dict[str, float]]:
    """Motor and bit rub; the bit sticks at low voltages. Config, and the truths of its unknowns, SI."""
    rng = np.random.default_rng([seed, 2])
    free = ("j_m", "c_m", "k_e", "k_T", "r_m", "l_m", "k_s", "j_1")
    truth = {name: NOMINAL[name] * rng.uniform(0.8, 1.2) for name in free}
    truth |= {"t_cm": rng.uniform(0.02, 0.06), "t_c1": rng.uniform(0.35, 0.45)}
    truth |= {"t_s1": rng.uniform(0.8, 1.0), "w_s1": rng.uniform(0.8, 1.2)}
    t = np.arange(1001) / 100
    v = np.select([t < 4, t < 6], [1.6, 5.0], -3.0)
    found = simulate(Rig(p={**truth, "t_f": 0.0}), t, v)
    columns = {"t": t}
    for name in ("theta_1", "theta_2", "w_1", "w_2"):
        columns[name] = found.of(name) + 0.1 * rng.standard_normal(len(t))
    _save(folder / "stick_slip.csv", {**columns, "v": v})
    path = folder / "stick_slip.yaml"
    path.write_text(STICK_SLIP.format(seed=seed, box=BOX, friction=RUBS if told else ""))
    return path, truth


def servo(folder: Path, seed: int, *, told: bool = True) -> tuple[Path, dict[str, float]]:
    """A servo in its loop, sampled at 500 Hz, with friction at its motor."""
    rng = np.random.default_rng([seed, 3])
    truth = {name: SERVO[name] * rng.uniform(0.85, 1.15) for name in ("j_m", "c_m", "k_e", "r_m")}
    truth |= {"k_s": SERVO["k_s"] * rng.uniform(0.9, 1.1), "j_1": 2.3e-3}
    truth["t_cm"] = 2.5e-3 * rng.uniform(0.8, 1.2)
    p = {**truth, "k_T": truth["k_e"], "l_m": 0.66e-3, "t_f": 0.0}
    t, i_m = np.arange(2501) / 500, 1 / 14
    seen = 0.05 * DEGREE * rng.standard_normal(len(t))
    wanted = 30 * DEGREE * np.where((t // 1.25) % 2 == 0, 1.0, -1.0)

    def law(k: int, x: np.ndarray) -> float:
        asked = 12.0 * (wanted[k] - x[1] - seen[k]) - 0.6 * x[3]
        return 5e-3 * round(min(max(asked, -10.0), 10.0) / 5e-3)

    found = simulate(Rig(p=p, i_m=i_m), t, law)
    shown = {"theta_2": found.of("theta_2"), "twist": found.of("theta_1") - found.of("theta_2")}
    columns = {"t": 1e3 * t}
    columns |= {n: x / DEGREE + 0.1 * rng.standard_normal(len(t)) for n, x in shown.items()}
    _save(folder / "rubbing_servo.csv", {**columns, "v": found.v})
    path = folder / "rubbing_servo.yaml"
    own = "  t_cm: {prior: uniform, low: 0, high: 0.02}\n" if told else ""
    t_f = "0.0" if told else "{prior: uniform, low: 0, high: 0.02}"
    words = {"seed": seed, "box": BOX, "i_m": f"{i_m:.15g}", "friction": own, "t_f": t_f}
    path.write_text(LOOP.format(**words))
    return path, truth | {"sigma_theta_2": 0.1 * DEGREE, "sigma_twist": 0.1 * DEGREE}


def _save(path: Path, columns: dict[str, np.ndarray]) -> None:
    np.savetxt(
        path,
        np.stack([*columns.values()], axis=-1),
        "%.9g",
        ",",
        header=",".join(columns),
        comments="",
    )
