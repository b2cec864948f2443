"""What a config may say of a missing torque, and what it is told where it cannot be.

Mutants killed: a torque beside noise that it cannot be told from, a prior in multiples
of nothing.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import for_each
from support.command_line import cli

from bayesdrill.config import job

TORQUE = """missing_torque:
  at: rotor_1
  size: {prior: log_uniform, low: 1.0e-3, high: 1}
  time: {prior: log_uniform, low: 0.05, high: 5, start: 0.4}
"""
END = "simulation: {duration: 5, rate: 20}\n"


def config(folder: Path, *changes: tuple[str, str], torque: str = TORQUE) -> Path:
    return command_line.small_config(
        folder, (END, END + torque), ("walkers: 8", "walkers: 12"), *changes
    )


def test_size_and_time_are_unknowns_behind_the_noise(tmp_path: Path) -> None:
    path = config(
        tmp_path,
        (
            "w_1, unit: rad/s, sigma: 0.05",
            "w_1, unit: rad/s, sigma: {prior: log_uniform, low: 0.01, high: 1}",
        ),
    )
    posterior = job.prepare(path).problem.posterior
    assert posterior.space.free == ("k_e", "j_1", "sigma_w_1", "s_d", "tau_d")
    start = posterior.space.start
    assert start["tau_d"] == 0.4
    assert start["s_d"] == pytest.approx(10**-1.5)
    assert np.isfinite(posterior.density(posterior.space.vector(start)[None])).all()


def test_numbers_hold_them(tmp_path: Path) -> None:
    path = config(
        tmp_path, torque="missing_torque: {at: motor, size: 0.02, time: 0.5, smoothness: 1/2}\n"
    )
    posterior = job.prepare(path).problem.posterior
    assert posterior.space.free == ("k_e", "j_1")
    assert posterior.likelihood.only_observation.process == {"s_d": 0.02, "tau_d": 0.5}


def test_what_cannot_be_is_said_with_a_way_out(tmp_path_factory: pytest.TempPathFactory) -> None:
    cases = [
        ((), TORQUE.replace("rotor_1", "rotor_9"), "rotor_9"),
        ((), TORQUE.replace("  at", "  smoothness: 5/2\n  at"), "smoothness"),
        ((), TORQUE.replace("high: 1}", "high: 1, relative: true}"), "no nominal value"),
        ((), TORQUE.replace("start: 0.4", "start: 40"), "outside the prior"),
        (
            (("w_1, unit: rad/s, sigma: 0.05", "w_1, unit: rad/s, sigma: 0.05, lag: 0.1"),),
            TORQUE,
            "no gain and no lag",
        ),
        ((("inputs:\n  v: 8.0", "quantities: {s_d: 1.0}\ninputs:\n  v: 8.0"),), TORQUE, "s_d"),
    ]

    def check(changes: tuple[tuple[str, str], ...], torque: str, said: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        done = cli("check", config(tmp_path, *changes, torque=torque))
        assert done.status == 2, done.text
        assert said in done.text
        assert "Traceback" not in done.text

    for_each({str(case): case for case in cases}, check)


def test_beside_friction_it_is_said_to_be_an_approximation(tmp_path: Path) -> None:
    done = cli("check", config(tmp_path, ("  t_f: nominal", "  t_f: nominal\n  t_cm: 0.01")))
    assert done.status == 0, done.text
    assert "beside friction it is an approximation" in done.out
    assert "approximation" not in cli("check", config(tmp_path)).out


def test_beside_gravity_too(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.yaml"
    path.write_text(
        "name: pendulum\nseed: 1\nrecord: {file: p.csv, time: {column: t, unit: s}, channels: "
        "{theta_arm: {column: y, unit: rad, sigma: 0.01}}}\ninputs: {t_arm: 0.1}\n"
        "model: {name: train, inertias: [arm], drives: {arm: torque}, gravity: [arm]}\n"
        "missing_torque: {at: arm, size: 0.1, time: 1.0}\n"
        "parameters: {j_arm: {prior: log_normal, median: 0.01, sd_log: 0.5}, g_arm: 0.5}\n"
    )
    t = 0.01 * np.arange(200)
    y = np.column_stack([t, 0.2 * np.sin(7 * t)])
    np.savetxt(tmp_path / "p.csv", y, delimiter=",", header="t,y", comments="")
    done = cli("check", path)
    assert done.status == 0, done.text
    assert "beside gravity it is an approximation, as if a pendulum were a spring" in done.out


def test_a_record_is_simulated_with_it_and_read_again(tmp_path: Path) -> None:
    """With a large torque residuals spread far beyond the noise."""
    truth = (END, "simulation: {duration: 5, rate: 20, truth: {s_d: 0.5, tau_d: 0.3}}\n" + TORQUE)
    path = command_line.small_config(tmp_path, truth)
    command_line.simulate_again(path)
    posterior = job.prepare(path).problem.posterior
    space = posterior.space
    theta = space.vector({**space.start, "s_d": 0.5, "tau_d": 0.3})
    left = posterior.likelihood.only_observation.residuals(space.full(theta[None])).samples
    assert left.std() > 0.5
    assert posterior.likelihood.mean_square(theta[None])[0] == pytest.approx(1.0, abs=0.35)


def test_a_run_goes_through_and_is_reported(tmp_path: Path) -> None:
    path = config(tmp_path)
    done = cli("posterior", path, "--output", tmp_path / "run", "--processes", "1")
    assert done.status in (0, 3), done.text
    summary = (tmp_path / "run" / "summary.md").read_text()
    assert "tau_d" in summary
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"]
