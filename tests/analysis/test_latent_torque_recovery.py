"""A missing torque of simulated rigs is their friction; what it can stand in for is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.command_line import replace_text
from support.small_problems import points_near

import bayesdrill as bd
from bayesdrill.analysis.latent_torque import regress_torque, torque_estimates
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.basics import seeds
from bayesdrill.report.sections.torque import law_sentences, stand_ins

FRICTION = 0.15  # N m, at rotor 1
TRUTH = {"j_m": 4.0e-4, "k_e": 601.6e-4, "k_s": 0.26, "j_1": 28.3e-3}
CONFIG = """
name: rubs
seed: 1
record:
  file: record.csv
  time: {column: t, unit: s}
  channels:
    theta_1: {column: theta_1, unit: rad, sigma: 0.02}
    theta_2: {column: theta_2, unit: rad, sigma: 0.02}
    w_1: {column: w_1, unit: rad/s, sigma: 0.1}
    w_2: {column: w_2, unit: rad/s, sigma: 0.1}
inputs:
  v: {column: v, unit: V}
parameters:
  {j_m: BOX, c_m: nominal, k_e: BOX, k_T: nominal, r_m: nominal, l_m: nominal, k_s: BOX, j_1: BOX,
   t_f: 0.0}
map: {starts: 1, evaluations: 500}
""".replace("BOX", "{prior: uniform, low: 0.5, high: 1.5, relative: true}")
TORQUE = """
missing_torque:
  at: rotor_1
  smoothness: 1/2
  size: {prior: log_uniform, low: 1.0e-3, high: 10}
  time: {prior: log_uniform, low: 0.01, high: 10}
"""


def rubbing(folder: Path, seed: int) -> Path:
    """Write a record of a rig with friction, and a config that has a missing torque in its place."""
    t = 0.01 * np.arange(1001)
    volts = 6 * np.sin(0.5 * np.pi * t) + 4 * np.sin(1.24 * np.pi * t + 0.5)
    channels = np.random.default_rng(seed).standard_normal((1001, 4))
    columns = np.column_stack([t, volts, channels])
    header = "t,v,theta_1,theta_2,w_1,w_2"
    np.savetxt(folder / "record.csv", columns, delimiter=",", header=header, comments="")
    truth, config = folder / "truth.yaml", folder / "torque.yaml"
    truth.write_text(CONFIG.replace("t_f: 0.0}", f"t_f: 0.0, t_c1: {FRICTION}}}"))
    bd.simulate(truth, seed=seed, output=folder / "made.csv")
    config.write_text(CONFIG.replace("record.csv", "made.csv") + TORQUE)
    return config


@pytest.mark.slow
@run_cases("seed", [1, 2])
def test_the_missing_torque_of_a_rubbing_rig_is_its_friction(seed: int, tmp_path: Path) -> None:
    """The law is within the band, the parameters within four sds, the friction within 15 %."""
    case = bd.load(rubbing(tmp_path, seed))
    posterior = case.job.problem.posterior
    mode = posterior.space.vector(case.find_map(processes=1).mode.values)
    rng = seeds.stream(7, "torque")
    theta = posterior.coordinates.to_physical(points_near(posterior, mode, 200, rng))
    estimate = torque_estimates(posterior, theta, rng)[0]
    for k, name in enumerate(TRUTH):
        assert posterior.space.free[k] == name
        assert abs(theta[:, k].mean() - TRUTH[name]) < 4 * theta[:, k].std()
    _, speed = estimate.speeds[0]
    moving = np.abs(speed) > 1.0
    law, (low, high) = -FRICTION * np.sign(speed), estimate.band
    assert np.mean(((law > low) & (law < high))[moving]) > 0.85
    first = regress_torque(estimate)[0]
    assert (first.kind, first.of, first.taken) == ("sign", "w_1", True)
    assert -first.size == pytest.approx(FRICTION, rel=0.15)
    sentences = law_sentences(torque_summary(estimate), estimate.rig)
    assert "dry friction at rotor 1" in sentences
    assert "t_c1: {prior: log_uniform" in sentences


def test_identify_says_what_a_missing_torque_can_replace_and_what_would_help(
    tmp_path: Path,
) -> None:
    """Where the speed at the gearbox alone is measured, a torque at rotor 1 can replace the rotor's."""
    path = rubbing(tmp_path, 3)
    lines = path.read_text().splitlines()
    kept = [line for line in lines if not line.lstrip().startswith(("theta_", "w_1:"))]
    path.write_text("\n".join(kept))
    replace_text(path, "size: {prior: log_uniform, low: 1.0e-3, high: 10}", "size: 1")
    identified = bd.load(path).identify()
    study = identified.study
    assert [stand_in.name for stand_in in study.stand_ins] == ["k_s", "j_1"]
    first = study.stand_ins[0]
    assert first.sd > 0.1
    assert first.alone < 0.02
    helps = {(way.kind, way.name) for way in first.helps}
    assert helps >= {("measure", "w_1"), ("hold", "j_1")}
    sentences = stand_ins(study, identified.job.problem.model)
    assert "at rotor 1 it can stand in for k_s" in sentences
    assert "a sensor of w_1" in sentences
