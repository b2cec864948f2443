"""A servo that other code simulated, fitted without its friction: what is said of that.

The whole records do not come with the project: where they are not, nothing is tested.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.case_tables import run_cases
from support.unexplained_records import causes_of

import bayesdrill as bd

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data" / "simulated_servo"
TRUTH = {"t_cm": 2.5e-3, "t_c1": 6e-3}  # rotor 1 has 12e-3 N m at rest

CONFIG = """
name: servo
seed: 3
record:
  file: {file}
  time: {{column: "time [ms]", unit: ms}}
  channels:
    theta_2: {{column: "theta [deg]", unit: deg, sigma: 0.05}}
    alpha: {{column: "alpha [deg]", unit: deg, measures: theta_1 - theta_2, sigma: 0.03}}
inputs:
  v: {{column: "voltage [V]", unit: V}}
model: {{name: motor_shaft, i_m: 0.0714285714}}
nominal:
  {{j_m: 4.95e-6, c_m: 2.2e-6, k_e: 0.022, k_T: 0.022, r_m: 1.98, l_m: 0.66e-3, k_s: 0.99,
   j_1: 2.64e-3}}
parameters:
  {{j_m: {box}, c_m: {box}, k_e: {box}, k_s: {box}, j_1: {box},
   k_T: nominal, r_m: nominal, l_m: nominal, t_f: 0.0}}
map: {{starts: 2, evaluations: 500}}
"""
BOX = "{prior: uniform, low: 0.1, high: 10, relative: true}"


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="records that do not come with the project")
@run_cases("name", ["square", "sweep", "slow"])
def test_the_offset_of_the_supply_and_both_frictions_are_named(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{name}.yaml"
    path.write_text(CONFIG.format(file=SHARED / f"{name}.csv", box=BOX))
    case = bd.load(path)
    found = causes_of(case)
    assert found is not None
    assert max(one.rms for one in found.given) > 100
    assert {"friction_both", "offset_v"} <= {*found.best.parts}
    sizes = {one.name: one.value for one in found.best.new}
    assert sizes["offset_v"] == pytest.approx(-0.06, abs=0.002)
    assert sizes["t_cm"] == pytest.approx(TRUTH["t_cm"], rel=0.15)
    assert TRUTH["t_c1"] < 1.05 * sizes["t_c1"] < 2.2 * TRUTH["t_c1"]
    assert max(one.rms for one in found.best.fit) < 5


DAMPED = """
name: damped
seed: 3
record:
  window: [0, 2]
  time: {column: "time [ms]", unit: ms}
  channels:
    theta_2: {column: "theta [deg]", unit: deg, sigma: {prior: log_uniform, low: 0.005, high: 50}}
    alpha: {column: "alpha [deg]", unit: deg, measures: theta_1 - theta_2,
            sigma: {prior: log_uniform, low: 0.005, high: 50},
            lag: {prior: uniform, low: -4, high: 12, unit: ms}}
inputs:
  v: {column: "voltage [V]", unit: V, offset: {prior: normal, mean: 0, sd: 0.1}}
experiments:
  square: {record: {file: FOLDER/square.csv}}
  sweep: {record: {file: FOLDER/sweep.csv}}
  slow: {record: {file: FOLDER/slow.csv}}
shared: [offset_v, lag_alpha, sigma_alpha, sigma_theta_2]
model: {name: motor_shaft, i_m: 0.07142857142857142}
nominal:
  {j_m: 4.95e-6, c_m: 2.2e-6, k_e: 0.022, k_T: 0.022, r_m: 1.98, l_m: 0.66e-3, k_s: 0.99,
   j_1: 2.64e-3}
parameters:
  {c_m: {prior: log_uniform, low: 0.1, high: 10, relative: true}, k_T: {tie: k_e}, l_m: nominal,
   t_f: 0.0, c_s: {prior: uniform, low: 0.0, high: 0.05},
   j_m: BOX, k_e: BOX, r_m: BOX, k_s: BOX, j_1: BOX}
map: {starts: 1}
sampler: {walkers: 40, ess: 400, n_tau: 20, max_steps: 500}
"""


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="records that do not come with the project")
def test_a_damped_rig_that_does_not_rub_fits_badly_and_is_sampled_all_the_same(
    tmp_path: Path,
) -> None:
    """Its maximum is at the ends of three priors, where ridges lead out of them."""
    half = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
    path = tmp_path / "damped.yaml"
    path.write_text(DAMPED.replace("FOLDER", str(SHARED)).replace("BOX", half))
    run = bd.load(path).sample(seed=1)
    assert set(run.draws) >= {"c_s", "k_s"}
