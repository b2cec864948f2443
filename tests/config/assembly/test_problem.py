"""A described drive train becomes a posterior: its density is that of its equations, typed anew."""

from pathlib import Path

import numpy as np
import pytest
from support.command_line import CONFIGS
from support.config_texts import DEG, RPM, save, write
from support.described_rigs import (
    CURRENT,
    FORCE,
    LINEAR,
    ROTARY,
    T,
    arm_rates,
    cart_rates,
    integrated,
    log_density,
    save_records,
)

from bayesdrill.config.job import Job, prepare
from bayesdrill.inference import derived


def likelihood(job: Job) -> tuple[dict[str, float], float]:
    """Return a point beside the start, by name, and its log likelihood."""
    posterior = job.problem.posterior
    theta = posterior.space.vector(posterior.space.start)[None] * 1.07
    (observation,) = posterior.likelihood.observations
    by_channel = observation.by_channel(posterior.space.full(theta), theta)
    named = posterior.space.named(theta)
    return {name: float(np.ravel(x)[0]) for name, x in named.items()}, float(np.sum(by_channel))


def test_the_density_of_a_train_is_that_of_its_equations(tmp_path: Path) -> None:
    y = save_records(tmp_path)
    p, found = likelihood(prepare(write(tmp_path, ROTARY)))
    x = integrated(arm_rates, p, CURRENT, [0.0, 0.0, 0.0, 30 * RPM])
    expected = log_density(y["w"] * RPM, x[:, 3], 2 * RPM)
    expected += log_density(y["twist"] * DEG, x[:, 0] - x[:, 2], 0.2 * DEG)
    expected += log_density(y["motor"] * 2 * np.pi, 8 * x[:, 0], 0.05 * 2 * np.pi)
    assert found == pytest.approx(expected, rel=1e-8)


def test_the_density_of_masses_that_a_wall_holds_is_that_of_their_equations(tmp_path: Path) -> None:
    """From a steady start, which holds the first force."""
    y = save_records(tmp_path)
    steady = ("{state: given, x_second: {value: 2, unit: mm}}", "steady")
    p, found = likelihood(prepare(write(tmp_path, LINEAR, steady)))
    wall = FORCE[0] / p["k_wall"]
    x = integrated(cart_rates, p, FORCE, [wall + FORCE[0] / p["k_spring"], 0.0, wall, 0.0])
    expected = log_density(y["x"] * 1e-3, x[:, 2], 5e-4) + log_density(y["v"] * 1e-3, x[:, 1], 3e-3)
    assert found == pytest.approx(expected, rel=1e-8)


CHAIN = (CONFIGS / "chain.yaml").read_text(encoding="utf-8")


def test_a_chain_of_gears_turns_steadily(tmp_path: Path) -> None:
    """Its angles do not turn alike: a load behind a second gear goes half as far."""
    w, y = np.random.default_rng(8).normal(size=(2, len(T)))
    save(tmp_path, "chain.csv", t=T, w=w, y=y)
    chain = prepare(write(tmp_path, CHAIN))
    _, found = likelihood(chain)
    torque = 0.6 / 0.25  # at the arm, and at the pinion
    end = torque / -0.5 / 0.4  # of the load, where the damper takes what the second gear gives
    motor = 4 * (0.2 / -0.5 + torque / 3.0 + end / -0.5 * T)
    expected = log_density(w, np.full(len(T), end), 1.0) + log_density(y, motor, 1.0)
    space = chain.problem.posterior.space
    values = derived.values_at(chain.problem, space.vector(space.start)[None])
    assert values["w_end"] == pytest.approx(end / -0.5)
    assert found == pytest.approx(expected, rel=1e-8)
