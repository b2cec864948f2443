"""Sensors, noise and a missing torque of a config: numbers in SI, unknowns, and what they are beside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import command_line, two_experiments
from support.config_texts import DRILL_T, write_shaft
from support.small_problems import starts_believed

from bayesdrill.analysis.latent_torque import is_approximate
from bayesdrill.config import loading
from bayesdrill.config.building.channels import build_channel, build_noise
from bayesdrill.config.job import prepare
from bayesdrill.config.schema.records import ChannelSpec
from bayesdrill.inference.noise.quantised import Quantised
from bayesdrill.inference.priors import LogNormal, TruncatedNormal, Uniform
from bayesdrill.report.sections.torque import approximation_note
from bayesdrill.rig.models.linear import with_all
from bayesdrill.rig.models.train import Train

W_1 = "w_1: {column: w_1, unit: rad/s, sigma: 0.1"
SMALL_W_1 = "w_1: {column: w_1, unit: rad/s, sigma: 0.05}"
SIGMA = "{prior: log_uniform, low: 0.01, high: 1}"
END = "simulation: {duration: 5, rate: 20}\n"
TORQUE = """missing_torque:
  at: rotor_1
  size: {prior: log_uniform, low: 1.0e-3, high: 1}
  time: {prior: log_uniform, low: 0.05, high: 5, start: 0.4}
"""


def noisy(noise: str, sigma: str = "0.05", unit: str = "rad/s") -> tuple[str, str]:
    return SMALL_W_1, f"w_1: {{column: w_1, unit: {unit}, sigma: {sigma}, noise: {noise}}}"


def shaken(folder: Path, *changes: tuple[str, str], torque: str = TORQUE) -> Path:
    """The small experiment with a missing torque."""
    more = ((END, END + torque), ("walkers: 8", "walkers: 12"))
    return command_line.small_config(folder, *more, *changes)


@starts_believed()
def test_numbers_and_priors_are_in_si(tmp_path: Path) -> None:
    """Each by its own unit: an offset in that of the column, a time in s, a state in SI."""
    gain = "gain: {prior: log_normal, median: 0.9, sd_log: 0.1}, lag: {value: 3, unit: ms}"
    late = "t_0: {prior: uniform, low: -50, high: 100, unit: ms}"
    state = "{prior: truncated_normal, mean: 10, sd: 90, low: -45, high: 90, unit: deg}"
    problem = prepare(
        two_experiments.write(
            tmp_path,
            (W_1, f"{W_1}, {gain}"),
            ("  v: 8.0", f"  v: 8.0\n  {late}"),
            ("experiments:\n  slow", f"initial: {{theta_2: {state}}}\nexperiments:\n  slow"),
            ("walkers: 16", "walkers: 24"),
        )
    ).problem
    priors, degree = problem.posterior.space.priors, np.pi / 180
    assert priors["offset_theta_1"] == TruncatedNormal(0.0, 10 * degree, -np.inf, np.inf)
    assert priors["lag_theta_1"] == TruncatedNormal(0.0, 0.02, -np.inf, np.inf)
    assert priors["gain_w_1_fast"] == LogNormal(0.9, 0.1)
    delay, start = priors["t_0_slow"], priors["theta_2_0_fast"]
    assert isinstance(delay, Uniform)
    assert (delay.low, delay.high) == pytest.approx((-0.05, 0.1))
    assert isinstance(start, TruncatedNormal)
    expected = (-45 * degree, 90 * degree, 10 * degree)
    assert (start.low, start.high, start.mean) == pytest.approx(expected)
    assert problem.posterior.space.fixed["lag_w_1_slow"] == pytest.approx(0.003)
    assert problem.units.format_value("offset_theta_1", 0.1) == "5.73 deg"
    assert problem.units.format_value("t_0_slow", 0.04) == "40 ms"


def test_a_current_is_a_state_only_with_an_inductance() -> None:
    rig = Train(inertias=["motor"], drives={"motor": "voltage"})
    spec = ChannelSpec(column="i", unit="A", sigma=0.1)
    with pytest.raises(ValueError, match=r"i_motor is a state only with l_motor; name it"):
        build_channel("i_motor", spec, rig)
    assert build_channel("i_motor", spec, with_all(rig)).weights == {"i_motor": 1.0}


# Lags of inputs.

LOAD = "t_1: {column: torque, unit: mN*m"
LAGGED = (LOAD, f"{LOAD}, lag: {{prior: uniform, low: -40, high: 60, unit: ms}}")


@starts_believed()
def test_one_measured_input_has_the_delay_of_all(tmp_path: Path) -> None:
    """Of several, each has its own lag."""
    alone = ("w_2: {column: top, unit: rpm}", "w_2: 9.0")
    sensing = prepare(write_shaft(tmp_path, alone, LAGGED)).problem.observations[0].response.sensing
    assert (sensing.delay, sensing.input_lags) == ("lag_t_1", {})
    problem = prepare(write_shaft(tmp_path, LAGGED)).problem
    sensing = problem.observations[0].response.sensing
    assert (sensing.delay, sensing.input_lags) == (None, {"t_1": "lag_t_1"})
    assert sensing.summary == "t_1: lag"
    prior = problem.posterior.space.priors["lag_t_1"]
    assert (prior.low, prior.high) == pytest.approx((-0.04, 0.06))


@starts_believed()
def test_samples_that_a_late_input_leaves_undetermined_are_left_out(tmp_path: Path) -> None:
    """A moving rig's first 60 ms, which a torque from before the record may have moved, and the last 40,
    whose torque may stand after its end.
    """
    start, truth = (
        next(f"{line}\n" for line in write_shaft(tmp_path).read_text().splitlines() if key in line)
        for key in ("initial:", "simulation:")
    )
    for changes, first in (((), 5.06), (((start, ""), (truth, "")), 5.0)):
        experiment = prepare(write_shaft(tmp_path, LAGGED, *changes)).problem.experiment
        seen = experiment.t[experiment.is_measured[:, 0]]
        assert (seen[0], seen[-1]) == pytest.approx((first, DRILL_T[-1] - 0.04))
        begins = any("before the start (lag)" in note for note in experiment.notes)
        assert begins == (first > 5.0)
        assert any("after the end of the record (lag)" in note for note in experiment.notes)


@pytest.mark.parametrize("kind", ["{name: ar1, rho: 0.5}", "{name: student_t, degrees: 4}"])
@starts_believed()
def test_a_number_of_noise_that_is_held_needs_no_walkers(kind: str, tmp_path: Path) -> None:
    """With one unknown more, four walkers are too few (`mistakes.yaml`)."""
    config = command_line.small_config(tmp_path, noisy(kind), ("walkers: 8", "walkers: 4"))
    assert prepare(config).problem.names == ("k_e", "j_1")


def test_a_step_is_in_the_unit_of_its_column(tmp_path: Path) -> None:
    quantised = noisy("{name: quantised, step: 6.0}", "0.5", "rpm")
    case = loading.load(command_line.small_config(tmp_path, quantised))
    noise = build_noise(case.experiments[0].channels, 5)
    parts = [part.noise for part in noise.noises]  # type: ignore[attr-defined]
    (step,) = [part.steps[0] for part in parts if isinstance(part, Quantised)]
    assert step == pytest.approx(0.2 * np.pi)


def test_a_record_is_simulated_with_the_true_correlation(tmp_path: Path) -> None:
    truth = "rate: 20, sigma: {w_1: 0.2}, truth: {rho_w_1: 0.9}"
    longer = ("duration: 5", "duration: 100")
    config = command_line.small_config(tmp_path, noisy("ar1", SIGMA), ("rate: 20", truth), longer)
    command_line.simulate_again(config)
    with starts_believed():
        problem = prepare(config).problem
    space, observation = problem.posterior.space, problem.posterior.likelihood.only_observation
    theta = space.vector({**problem.nominal, "sigma_w_1": 0.2, "rho_w_1": 0.9})[None]
    left = observation.residuals(space.full(theta)).samples[0, :, 1]
    correlation = np.corrcoef(left[1:], left[:-1])[0, 1]
    assert correlation == pytest.approx(0.9, abs=5 * np.sqrt((1 - 0.9**2) / len(left)))
    both = left[None, :, None] * [0.25, 1.0]
    white = observation.noise.whiten(both, theta[:, observation.noise_columns])[0, :, 1]
    assert white.std() == pytest.approx(1.0, abs=5 / np.sqrt(2 * len(left)))


def test_an_impossible_true_correlation_is_refused(tmp_path: Path) -> None:
    truth = "rate: 20, sigma: {w_1: 0.2}, truth: {rho_w_1: 1.5}"
    config = command_line.small_config(tmp_path, noisy("ar1", SIGMA), ("rate: 20", truth))
    ran = command_line.cli("simulate", config)
    assert ran.status == 2
    message = "1.5 is impossible; give a number between 0 and 1"
    assert f"simulation.truth.rho_w_1: {message}" in ran.err


@starts_believed()
def test_a_missing_torque_beside_friction_is_said_to_be_an_approximation(tmp_path: Path) -> None:
    friction = ("  t_f: nominal", "  t_f: nominal\n  t_cm: 0.01")
    given, rubbing = (prepare(shaken(tmp_path, *x)).problem for x in ((), (friction,)))
    assert not is_approximate(given.posterior)
    assert is_approximate(rubbing.posterior)
    assert "with friction it is an approximation" in approximation_note(rubbing.model)
    pendulum = Train(inertias=("arm",), drives={"arm": "torque"}, gravity=("arm",))
    assert (
        "with gravity it is an approximation, as if a pendulum were a spring"
        in approximation_note(pendulum)
    )


def test_a_record_is_simulated_with_a_missing_torque(tmp_path: Path) -> None:
    """With a large torque residuals spread far beyond the noise."""
    simulated = "simulation: {duration: 5, rate: 20, truth: {s_d: 0.5, tau_d: 0.3}}\n"
    four = f"theta_2: {{column: theta_2, unit: rad, sigma: 0.05}}\n    {SMALL_W_1}"
    four += f"\n    {SMALL_W_1.replace('w_1', 'w_2')}"
    path = command_line.small_config(tmp_path, (END, simulated + TORQUE), (SMALL_W_1, four))
    command_line.simulate_again(path)
    with starts_believed():
        posterior = prepare(path).problem.posterior
    theta = posterior.space.vector({**posterior.space.start, "s_d": 0.5, "tau_d": 0.3})[None]
    observation = posterior.likelihood.only_observation
    assert observation.residuals(posterior.space.full(theta)).samples.std() > 0.5
    assert posterior.likelihood.mean_square(theta)[0] == pytest.approx(1.0, abs=0.35)
