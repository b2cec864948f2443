"""A described drive train becomes a posterior: its density is that of its equations, typed anew."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import for_each, run_cases
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

from bayesdrill.config import job
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


def carts_density(y: dict[str, np.ndarray], x: np.ndarray) -> float:
    positions = log_density(y["x"] * 1e-3, x[:, 2], 5e-4)
    return positions + log_density(y["v"] * 1e-3, x[:, 1], 3e-3)


def test_the_density_of_a_train_is_that_of_its_equations(tmp_path: Path) -> None:
    y = save_records(tmp_path)
    p, found = likelihood(prepare(write(tmp_path, ROTARY)))
    x = integrated(arm_rates, p, CURRENT, [0.0, 0.0, 0.0, 30 * RPM])
    expected = log_density(y["w"] * RPM, x[:, 3], 2 * RPM)
    expected += log_density(y["twist"] * DEG, x[:, 0] - x[:, 2], 0.2 * DEG)
    expected += log_density(y["motor"] * 2 * np.pi, 8 * x[:, 0], 0.05 * 2 * np.pi)
    assert found == pytest.approx(expected, rel=1e-8)


def test_the_density_of_masses_along_a_line_is_that_of_their_equations(tmp_path: Path) -> None:
    """From a given start, and from a steady one, which holds the first force."""
    y = save_records(tmp_path)
    given = prepare(write(tmp_path, LINEAR))
    p, found = likelihood(given)
    x = integrated(cart_rates, p, FORCE, [0.0, 0.0, 2e-3, 0.0])
    assert found == pytest.approx(carts_density(y, x), rel=1e-8)
    channels = given.problem.observations[0].experiment.channels
    assert [(c.unit, c.display_unit.name) for c in channels] == [("m", "mm"), ("m/s", "mm/s")]
    symbols = {symbol.name: symbol.unit for symbol in derived.derived_symbols(given.problem)}
    assert symbols["w_end"] == "m/s"
    steady = ("{state: given, x_second: {value: 2, unit: mm}}", "steady")
    p, found = likelihood(prepare(write(tmp_path, LINEAR, steady)))
    wall = FORCE[0] / p["k_wall"]
    x = integrated(cart_rates, p, FORCE, [wall + FORCE[0] / p["k_spring"], 0.0, wall, 0.0])
    assert found == pytest.approx(carts_density(y, x), rel=1e-8)


@run_cases(
    "motion, letter, unit, size, inertia, stiffness",
    [("", "theta", "deg", DEG, "j", 0.5), ("motion: linear, ", "x", "mm", 1e-3, "m", 30.0)],
)
def test_an_imposed_angle_or_position_moves_the_load(
    motion: str, letter: str, unit: str, size: float, inertia: str, stiffness: float, tmp_path: Path
) -> None:
    """Its speed is held between samples; all begins where it does."""
    angle = 0.3 + np.sin(4 * T)
    save(tmp_path, "moved.csv", t=T, a=angle / size, y=np.cos(T) / size)
    path = write(
        tmp_path,
        "name: moved\nseed: 1\nrecord:\n  file: moved.csv\n  time: {column: t, unit: s}\n"
        f"  channels: {{{letter}_load: {{column: y, unit: {unit}, sigma: 1.0}}}}\n"
        f"inputs: {{{letter}_top: {{column: a, unit: {unit}}}}}\ninitial: {{{letter}_load: 0.3}}\n"
        f"model: {{name: train, {motion}inertias: [top, load], shafts: {{rope: [top, load]}}, "
        f"drives: {{top: speed}}}}\nparameters: {{k_rope: {stiffness}, {inertia}_load: {{prior: "
        "log_normal, median: 0.02, sd_log: 0.1}}\n",
    )
    p, found = likelihood(prepare(path))

    def rates(t: float, x: np.ndarray, p: dict[str, float], w: float) -> list[float]:
        return [w, 0.0, x[3], stiffness * (x[0] - x[2]) / p[f"{inertia}_load"]]

    speeds = np.append(np.diff(angle) / 0.01, 0.0)
    x = integrated(rates, p, speeds, [angle[0], 0.0, 0.3, 0.0])
    assert found == pytest.approx(log_density(np.cos(T), x[:, 2], size), rel=1e-8)


def test_arrays_and_a_model_are_such_a_config(tmp_path: Path) -> None:
    save_records(tmp_path)
    read = prepare(write(tmp_path, ROTARY))
    columns = np.genfromtxt(tmp_path / "arm.csv", delimiter=",", names=True)
    entries = {**read.source.data, "model": job.model_entry(read.case.model)}
    entries["record"] = {"channels": entries["record"]["channels"]}
    in_memory = job.job_in_memory({name: columns[name] for name in columns.dtype.names}, entries)
    assert in_memory.case.model == read.case.model
    assert likelihood(in_memory) == likelihood(read)
    copy = pickle.loads(pickle.dumps(read.config))
    assert copy == read.config
    assert copy.model_fields_set == read.config.model_fields_set


def test_a_torque_may_be_missing_at_any_inertia(tmp_path: Path) -> None:
    save_records(tmp_path)

    def check(text: str, name: str, unit: str) -> None:
        size = "{prior: log_uniform, low: 0.01, high: 1.0}"
        torque = f"missing_torque: {{at: {name}, size: {size}, time: 1.0}}\n"
        problem_job = prepare(write(tmp_path, text + torque))
        symbols = {symbol.name: symbol.unit for symbol in problem_job.problem.symbols}
        assert symbols["s_d"] == unit
        assert np.isfinite(likelihood(problem_job)[1])

    cases = {name: (ROTARY, name, "N*m") for name in ("motor", "arm", "load")}
    for_each(cases | {name: (LINEAR, name, "N") for name in ("first", "second")}, check)


CHAIN = """\
name: chain
seed: 1
record:
  file: chain.csv
  time: {column: t, unit: s}
  channels:
    w_load: {column: w, unit: rad/s, sigma: 1.0}
    theta_motor: {column: y, unit: rad, sigma: 1.0}
inputs: {t_motor: 0.6}
initial: {state: steady, theta_load: 0.2}
model:
  name: train
  inertias: [motor, arm, pinion, load]
  gears: {first: {between: [motor, arm], ratio: 0.25}, second: {between: [pinion, load], ratio: -0.5}}
  shafts: {coupling: [arm, pinion]}
  drives: {motor: torque}
parameters:
  j_motor: 0.001
  j_arm: 0.01
  j_pinion: 0.01
  j_load: {prior: log_normal, median: 0.02, sd_log: 0.1}
  k_coupling: 3.0
  c_load: 0.4
"""


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
