"""What a config says of noise: entries, units, true values, and what is counted where one is wrong.

Mutants killed: unknowns counted that a mistaken entry was to hold, a step in SI, a true value unheard.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import for_each

from bayesdrill.config import job, loading
from bayesdrill.config.resolve import sensors
from bayesdrill.inference.noise.quantised import Quantised

W_1 = "w_1: {column: w_1, unit: rad/s, sigma: 0.05}"
SIGMA = "{prior: log_uniform, low: 0.001, high: 1}"


def channel(noise: str, sigma: str = "0.05", unit: str = "rad/s") -> tuple[str, str]:
    return W_1, f"w_1: {{column: w_1, unit: {unit}, sigma: {sigma}, noise: {noise}}}"


MISTAKES = {
    "a step that is not known": ("quantised", "record.channels.w_1.noise: of what is quantised"),
    "a correlation of one": ("{name: ar1, rho: 1}", "record.channels.w_1.noise.rho: 1: it should"),
    "a correlation below zero": ("{name: ar1, rho: -0.2}", "noise.rho: -0.2: it should be"),
    "no standard deviation": ("{name: student_t, degrees: 2}", "noise.degrees: 2: it should be"),
    "an entry of another kind": (
        "{name: student_t, rho: 0.5}",
        "record.channels.w_1.noise.rho: the noise student_t has no rho; remove it, or name: ar1",
    ),
    "a kind that is not there": ("{name: ar2, rho: 0.5}", "record.channels.w_1.noise"),
    "an entry that is misspelt": ("{name: ar1, roh: 0.5}", "record.channels.w_1.noise.roh"),
}


def test_a_mistake_is_said_once_and_nothing_is_counted_that_it_was_to_hold(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Four walkers are enough for the two unknowns of the rig, and too few for another one."""

    def check(name: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        noise, says = MISTAKES[name]
        config = command_line.small_config(tmp_path, channel(noise), ("walkers: 8", "walkers: 4"))
        ran = command_line.cli("check", config)
        assert ran.status == 2
        (line,) = ran.err.splitlines()
        assert says in line

    for_each({str(name): (name,) for name in MISTAKES}, check)


def test_what_is_unknown_by_default_is_counted(tmp_path_factory: pytest.TempPathFactory) -> None:
    def check(noise: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        config = command_line.small_config(tmp_path, channel(noise), ("walkers: 8", "walkers: 4"))
        ran = command_line.cli("check", config)
        assert ran.status == 2
        assert "at least twice the 3 unknowns" in ran.err
        entry = {"ar1": "rho: 0.5", "student_t": "degrees: 4"}[noise]
        held = channel(f"{{name: {noise}, {entry}}}")
        assert (
            command_line.cli(
                "check", command_line.small_config(tmp_path, held, ("walkers: 8", "walkers: 4"))
            ).status
            == 0
        )

    for_each({noise: (noise,) for noise in ["ar1", "student_t"]}, check)


def test_a_step_is_in_the_unit_of_its_column(tmp_path: Path) -> None:
    noise = channel("{name: quantised, step: 6.0}", "0.5", "rpm")
    case = loading.load(command_line.small_config(tmp_path, noise))
    made = sensors.build_noise(case.experiments[0].channels, 5)
    kinds = [part.noise for part in made.parts if isinstance(part.noise, Quantised)]  # type: ignore[attr-defined]
    assert kinds[0].steps[0] == pytest.approx(0.2 * np.pi)


TRUTH = "rate: 20, sigma: {w_1: 0.2}, truth: {rho_w_1: 0.9}"


def test_a_record_is_made_with_the_true_correlation(tmp_path: Path) -> None:
    noise = channel("ar1", SIGMA)
    longer = ("duration: 5", "duration: 100")
    config = command_line.small_config(tmp_path, noise, ("rate: 20", TRUTH), longer)
    command_line.simulate_again(config)
    problem = job.prepare(config).problem
    values = {**problem.nominal, "sigma_w_1": 0.2, "rho_w_1": 0.9}
    theta = problem.posterior.space.vector(values)
    one = problem.posterior.likelihood.only_observation
    left = one.residuals(problem.posterior.space.full(theta[None])).samples[0, :, 1]
    found = np.corrcoef(left[1:], left[:-1])[0, 1]
    assert found == pytest.approx(0.9, abs=5 * np.sqrt((1 - 0.9**2) / len(left)))
    white = one.noise.whiten(left[None, :, None] * [0.25, 1.0], theta[None, one.noise_columns])[
        0, :, 1
    ]
    assert white.std() == pytest.approx(1.0, abs=5 / np.sqrt(2 * len(left)))


def test_a_true_value_must_be_one(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        (
            "rho_w_1: 1.5",
            "simulation.truth.rho_w_1: 1.5 is impossible; give a number between 0 and 1",
        ),
        ("rho_w_2: 0.5", "simulation.truth.rho_w_2: a sensor, a start, a noise"),
        ("sigma_w_1: 0.5", "simulation.truth.sigma_w_1: a sensor, a start, a noise"),
    ]

    def check(given: str, says: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        truth = TRUTH.replace("rho_w_1: 0.9", given)
        config = command_line.small_config(tmp_path, channel("ar1", SIGMA), ("rate: 20", truth))
        ran = command_line.cli("simulate", config)
        assert ran.status == 2
        assert says in ran.err

    for_each({case[0]: case for case in cases}, check)
