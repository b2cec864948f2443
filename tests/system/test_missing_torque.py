"""Rigs that do what their equations do not, fitted with a missing torque: what is found and said.

The drill string's record does not come with the project: where it is not, nothing is tested of it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import loadmat
from support.case_tables import run_cases
from support.document_blocks import ROOT
from support.small_problems import points_near

import bayesdrill as bd
from bayesdrill.analysis.identifiability.torque_confounding import scaled_with_torque
from bayesdrill.analysis.latent_torque import TorqueEstimate, regress_torque, torque_estimates
from bayesdrill.analysis.run_analysis import torque_summary
from bayesdrill.basics import seeds
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.sections import torque_words

Array = NDArray[np.float64]

FRICTION = 0.15  # N m, at rotor 1
TRUTH = {"j_m": 4.0e-4, "k_e": 601.6e-4, "k_s": 0.26, "j_1": 28.3e-3}
RUBS = """
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
    """A record of a rig that rubs, and a config that says nothing of it but that a torque is missing."""
    t = 0.01 * np.arange(1001)
    volts = 6 * np.sin(0.5 * np.pi * t) + 4 * np.sin(1.24 * np.pi * t + 0.5)
    rng = np.random.default_rng(seed)
    shape = rng.standard_normal((1001, 4))
    header = "t,v,theta_1,theta_2,w_1,w_2"
    columns = np.column_stack([t, volts, shape])
    np.savetxt(folder / "record.csv", columns, delimiter=",", header=header, comments="")
    (folder / "truth.yaml").write_text(RUBS.replace("t_f: 0.0}", f"t_f: 0.0, t_c1: {FRICTION}}}"))
    done = bd.simulate(folder / "truth.yaml", seed=seed, output=folder / "made.csv")
    assert done
    (folder / "torque.yaml").write_text(RUBS.replace("record.csv", "made.csv") + TORQUE)
    return folder / "torque.yaml"


def inferred(posterior: Posterior, mode: Array, n: int = 200) -> tuple[Array, TorqueEstimate]:
    """Draws of the unknowns by their normal approximation, and the torque with them."""
    rng = seeds.stream(7, "torque")
    drawn = points_near(posterior, mode, n, rng)
    theta = posterior.coordinates.to_physical(drawn)
    return theta, torque_estimates(posterior, theta, rng)[0]


@pytest.mark.slow
@run_cases("seed", [1, 2])
def test_the_torque_of_a_rig_that_rubs_is_its_friction(seed: int, tmp_path: Path) -> None:
    """The law within its band, the parameters within four sds, the friction to 15 %."""
    case = bd.load(rubbing(tmp_path, seed))
    posterior = case.job.problem.posterior
    mode = posterior.space.vector(case.find_map(processes=1).mode.values)
    theta, found = inferred(posterior, mode)
    for k, name in enumerate(TRUTH):
        assert posterior.space.free[k] == name
        assert abs(theta[:, k].mean() - TRUTH[name]) < 4 * theta[:, k].std()
    _, speed = found.speeds[0]
    moving = np.abs(speed) > 1.0
    law, (low, high) = -FRICTION * np.sign(speed), found.band
    assert np.mean(((law > low) & (law < high))[moving]) > 0.85
    first = regress_torque(found)[0]
    assert (first.kind, first.of, first.taken) == ("sign", "w_1", True)
    assert -first.size == pytest.approx(FRICTION, rel=0.15)
    said = torque_words.law_sentences(torque_summary(found), found.rig)
    assert "dry friction at rotor 1" in said
    assert "t_c1: {prior: log_uniform" in said


STRING = ROOT.parent / "shared" / "data" / "ufrj_drillstring_rig" / "175_completo_1.mat"
drill = pytest.mark.skipif(
    not STRING.exists(), reason="a record that does not come with the project"
)
DRILLS = """
name: string
seed: 7
record:
  file: FILE
  time: {column: Time_Sample_175_complete, unit: s}
  window: [37, 41]
  decimate: {factor: 10}
  channels:
    w_1: {column: Bit_Speed_Sample_175_complete, unit: rpm,
          sigma: {prior: log_uniform, low: 0.01, high: 100}}
inputs:
  w_2: {column: Top_Speed_Sample_175_complete, unit: rpm, hold: first}
initial:
  w_1: {prior: normal, mean: 0, sd: 100, unit: rpm}
  theta_1: {prior: normal, mean: 0, sd: 3}
model: {name: driven_shaft}
missing_torque:
  at: rotor_1
  size: {prior: log_uniform, low: 0.01, high: 100}
  time: {prior: log_uniform, low: 0.005, high: 10}
parameters: {k_s: 4.11, j_1: 7.8e-3, c_s: 0.0149}
map: {starts: 1, evaluations: 500}
"""


def drilling(folder: Path, *changes: tuple[str, str]) -> bd.Case:
    text = DRILLS.replace("FILE", str(STRING))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "string.yaml").write_text(text)
    return bd.load(folder / "string.yaml")


@drill
@pytest.mark.slow
def test_the_torque_at_a_bit_is_what_a_load_cell_measured_that_it_was_never_shown(
    tmp_path: Path,
) -> None:
    """Of speeds alone, with spring, damping and inertia as they were fitted with that torque; up to a
    constant, which the unknown twist at the start takes.
    """
    case = drilling(tmp_path)
    posterior = case.job.problem.posterior
    mode = posterior.space.vector(case.find_map(processes=1).mode.values)
    (found,) = torque_estimates(posterior, mode[None], seeds.stream(7, "torque"))
    of = loadmat(STRING)
    t, torque = (
        of[f"{name}_175_complete"].ravel() for name in ("Time_Sample", "Bit_Torque_Sample")
    )
    some = (found.t > 37.3) & (found.t < 40.7)
    ours = -found.expected[some]
    lags = np.arange(0.0, 0.06, 0.001)
    shifted = [np.interp(found.t[some] + lag, t, torque) for lag in lags]
    alike = [np.corrcoef(ours, each)[0, 1] for each in shifted]
    best = int(np.argmax(alike))
    assert 0.025 <= lags[best] <= 0.035
    assert alike[best] > 0.98
    assert np.polyfit(shifted[best], ours, 1)[0] == pytest.approx(1.0, abs=0.05)


@drill
def test_with_a_free_spring_it_is_said_what_cannot_be_told_apart(tmp_path: Path) -> None:
    one = "{prior: log_normal, median: 0.1, sd_log: 2}"
    priors = f"k_s: {one}, j_1: {one}"
    case = drilling(tmp_path, ("k_s: 4.11, j_1: 7.8e-3, c_s: 0.0149", priors))
    rig = case.job.problem.model
    study = case.identify().study
    assert study.scaled == (("k_s", "j_1", "s_d"),)
    assert (
        scaled_with_torque(case.job.problem.posterior, study.structure.symmetries) == study.scaled
    )
    said = torque_words.stand_ins(study, rig)
    assert "k_s and j_1 and s_d can be changed together" in said
    assert "Hold one of k_s and j_1" in said


SERVO = ROOT.parent / "shared" / "data" / "simulated_servo" / "square.csv"
TURNS = """
name: servo
seed: 3
record:
  file: FILE
  window: [0, 4]
  time: {column: "time [ms]", unit: ms}
  channels:
    theta_2: {column: "theta [deg]", unit: deg, sigma: {prior: log_uniform, low: 0.005, high: 30}}
    alpha: {column: "alpha [deg]", unit: deg, measures: theta_1 - theta_2,
            sigma: {prior: log_uniform, low: 0.005, high: 30}}
inputs:
  v: {column: "voltage [V]", unit: V}
model: {name: motor_shaft, i_m: 0.0714285714}
nominal:
  {j_m: 4.95e-6, c_m: 2.2e-6, k_e: 0.022, k_T: 0.022, r_m: 1.98, l_m: 0.66e-3, k_s: 0.99,
   j_1: 2.64e-3}
missing_torque:
  at: motor
  size: {prior: log_uniform, low: 1.0e-5, high: 0.1}
  time: {prior: log_uniform, low: 1.0e-3, high: 10}
parameters:
  {j_m: nominal, c_m: BOX, k_e: BOX, k_s: BOX, j_1: BOX,
   k_T: nominal, r_m: nominal, l_m: nominal, t_f: 0.0}
map: {starts: 2, evaluations: 500}
""".replace("BOX", "{prior: uniform, low: 0.1, high: 10, relative: true}")


@pytest.mark.slow
@pytest.mark.skipif(not SERVO.exists(), reason="a record that does not come with the project")
def test_a_servo_without_a_word_of_its_frictions_has_its_stiffness_over_its_inertia(
    tmp_path: Path,
) -> None:
    """Friction at both ends, an offset of the supply, a late sensor: none of it is modelled."""
    (tmp_path / "servo.yaml").write_text(TURNS.replace("FILE", str(SERVO)))
    best = bd.load(tmp_path / "servo.yaml").find_map(processes=1).mode.values
    assert best["k_s"] / best["j_1"] == pytest.approx(0.9 / 2.4e-3, rel=0.03)


@pytest.mark.slow
@pytest.mark.skipif(not SERVO.exists(), reason="a record that does not come with the project")
@run_cases("window", ["  window: [0, 4]\n", ""], ids=["4 s", "all"])
def test_the_torque_of_a_servo_is_its_friction(window: str, tmp_path: Path) -> None:
    """2.5e-3 N m at the motor, and of rotor 1 0.43e-3 to 0.86e-3 at its side of the gear; a supply that
    is 0.06 V lower is -0.67e-3 N m.  Sensors are as fine as a rig without friction at rotor 1 follows.
    """
    text = TURNS.replace("FILE", str(SERVO)).replace("  window: [0, 4]\n", window)
    for old, sigma in (("low: 0.005, high: 30}}\n", "0.3}"), ("low: 0.005, high: 30}}", "0.5}")):
        text = text.replace(f"{{prior: log_uniform, {old}", sigma + "\n" * old.endswith("\n"), 1)
    damped = "c_s: {prior: log_uniform, low: 1.0e-5, high: 0.1}"
    (tmp_path / "servo.yaml").write_text(
        text.replace("{j_m: nominal,", f"{{{damped}, j_m: nominal,")
    )
    case = bd.load(tmp_path / "servo.yaml")
    posterior = case.job.problem.posterior
    values = case.find_map(processes=1).mode.values
    assert values["k_s"] / values["j_1"] == pytest.approx(0.9 / 2.4e-3, rel=0.03)
    _, found = inferred(posterior, posterior.space.vector(values), 50)
    first = regress_torque(found)[0]
    assert (first.kind, first.of, first.taken) == ("sign", "w_2", True)
    assert 2.4e-3 < -first.size < 3.1e-3
    _, speed = found.speeds[0]
    turns = np.abs(speed) > 5.0  # rad/s; about a jump it is rounded off
    rows = np.column_stack([np.sign(speed), speed, np.ones(len(found.t))])[turns]
    law = np.linalg.lstsq(rows, found.expected[turns])[0]
    left = found.expected[turns] - rows @ law
    assert 1 - np.var(left) / np.var(found.expected[turns]) > 0.9
    assert law[2] == pytest.approx(-0.06 * 0.022 / 1.98, rel=0.1)


def test_what_a_torque_can_stand_in_for_is_said_with_what_would_tell(tmp_path: Path) -> None:
    """At rotor 1, of a rig of which the speed at the gearbox alone is measured: the rotor's own."""
    path = rubbing(tmp_path, 3)
    text = path.read_text()
    kept = [line for line in text.splitlines() if not line.lstrip().startswith(("theta_", "w_1:"))]
    path.write_text(
        "\n".join(kept).replace("size: {prior: log_uniform, low: 1.0e-3, high: 10}", "size: 1")
    )
    found = bd.load(path).identify()
    study = found.study
    assert [one.name for one in study.stand_ins] == ["k_s", "j_1"]
    first = study.stand_ins[0]
    assert first.sd > 0.1
    assert first.alone < 0.02
    assert {(one.kind, one.name) for one in first.helps} >= {("measure", "w_1"), ("hold", "j_1")}
    said = torque_words.stand_ins(study, found.job.problem.model)
    assert "at rotor 1 it can stand in for k_s" in said
    assert "a sensor of w_1" in said
