"""What `map` advises where a fit is bad: of records that it once advised wrongly of, and of their kinds.

The first records do not come with the project: where they are not, nothing is tested.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.document_blocks import ROOT
from support.unexplained_records import write

import bayesdrill as bd
from benchmarks import causes

SMALL = ROOT.parent / "shared" / "cases" / "small"
there = pytest.mark.skipif(not SMALL.is_dir(), reason="records that do not come with the project")
SECONDS = 60.0  # that the slowest may take on two processors


def mapped(name: str, config: str = "config.yaml", *options: str) -> command_line.CommandResult:
    return command_line.cli("map", SMALL / name / config, *(options or ("--processes", "1")))


def advice(out: str) -> str:
    """What A is."""
    (line,) = [line for line in out.splitlines() if line.startswith("fit: A is the config with ")]
    return line.removeprefix("fit: A is the config with ").rstrip(".")


@there
@pytest.mark.slow
def test_what_absorbs_a_second_inertia_is_not_advised() -> None:
    out = mapped("ar1_as_noise", "arm.yaml").out
    assert "one more inertia on a spring at the hub" in advice(out)
    assert "noise" not in advice(out)


@there
@pytest.mark.slow
def test_a_slow_clock_is_found() -> None:
    out = mapped("clock_2_percent_slow").out
    assert advice(out).startswith("a clock of the record whose times are 0.98")
    assert "  time: {scale: 0.98" in out
    assert "That leaves what looks like the noise." in out


@there
@pytest.mark.slow
@run_cases("name", ["lag_undriven", "lag_of_only_channel"])
def test_no_lag_is_said_of_the_only_channel_of_a_free_swing(name: str) -> None:
    config = {"lag_undriven": "config.yaml", "lag_of_only_channel": "drop.yaml"}[name]
    out = mapped(name, config).out
    assert "a lag of " not in out
    assert "quadratic drag" in advice(out)


@there
def test_windows_in_which_nothing_moves_say_nothing() -> None:
    out = mapped("rest_windows").out
    assert "windows of the record" not in out
    assert advice(out) == "dry friction at the motor"
    assert "Bayes factor of A:" not in out
    assert "; A:" not in out


@there
def test_a_sign_that_is_turned_is_found() -> None:
    out = mapped("sign_flipped").out
    assert advice(out) == "the sign of w_1 turned"
    assert "    w_1: {gain: -1.0}" in out


@there
def test_columns_that_are_swapped_are_found_soon() -> None:
    begun = time.monotonic()
    out = mapped("swapped_columns", "config.yaml", "--processes", "2").out
    assert time.monotonic() - begun < SECONDS
    assert advice(out) == "the columns of w_1 and w_2 exchanged"
    assert "    w_1: {column: w1}\n    w_2: {column: w2}" in out


@there
def test_a_prior_that_ends_too_early_is_said_first() -> None:
    out = mapped("t0_prior_end").out
    said = out.index("prior: t_0 is at an end of its prior, 0.02 s. Widen it before anything else.")
    assert said < out.index("fit: ")
    assert "a wider prior of t_0" in advice(out)
    assert "  t_0: {high: 0.06}" in out


# Their kinds, of other rigs.

KINDS = {
    "a sign": [("sign", 0), ("sign", 1), ("sign", 2), ("sign", 3)],
    "columns": [("exchange", 0), ("exchange", 1), ("exchange", 2)],
    "a clock": [("clock", 0), ("clock", 1), ("clock", 2)],
    "a second inertia": [("inertia", 0), ("inertia", 1), ("inertia", 2), ("inertia", 3)],
    "drag": [("drag", 0), ("drag", 1), ("drag", 2), ("drag", 3)],
    "a hand": [("held_at_first", 0), ("held_at_first", 1), ("held_at_first", 2)],
    "a load": [("load_friction", 0), ("load_friction", 1), ("load_friction", 2)],
    "memory": [("memory", 0), ("memory", 1), ("memory", 2)],
}
QUICK = (("sign", 3), ("inertia", 2))


def right(kind: str, seed: int) -> None:
    found = causes.find(kind, seed)
    assert found.first == (found.right,), (kind, seed)


@pytest.mark.parametrize(("kind", "seed"), QUICK)
def test_a_lack_of_a_rig_that_nothing_drives_is_named(kind: str, seed: int) -> None:
    right(kind, seed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_lacks_of_several_rigs_are_named(kind: str) -> None:
    for record in KINDS[kind]:
        right(*record)


# Priors that end too early, of a shaft, a load and a sensor.

T = 0.01 * np.arange(400)
U = 5.0 * np.sign(np.sin(4.0 * T)) + np.sin(11.0 * T)
TRAIN = """\
name: early
seed: 1
record:
  file: record.csv
  time: {column: t, unit: s}
  channels:
    w_motor: {column: w_motor, unit: rad/s, sigma: 0.1}
    w_load: {column: w_load, unit: rad/s, sigma: 0.1, lag: LAG}
inputs: {u_motor: {column: u, unit: V}}
model: {name: train, inertias: [motor, load], shafts: {s: [motor, load]}, drives: {motor: voltage}}
parameters: {j_motor: 0.01, j_load: LOAD, k_s: SHAFT, c_s: 0.02, k_T_motor: 0.5, r_motor: 1.0,
  k_e_motor: 0.5}
"""
WIDE = {
    "LOAD": "{prior: uniform, low: 0.005, high: 0.04}",
    "SHAFT": "{prior: log_uniform, low: 0.3, high: 30}",
    "LAG": "{prior: uniform, low: -0.05, high: 0.05}",
}
EARLY = {
    "LOAD": ("prior_j_load", "{prior: uniform, low: 0.005, high: 0.015}"),
    "SHAFT": ("prior_k_s", "{prior: log_uniform, low: 0.3, high: 2.0}"),
    "LAG": ("prior_lag_w_load", "{prior: uniform, low: -0.05, high: 0.01}"),
}


@pytest.mark.parametrize(
    "name", ["LOAD", *(pytest.param(x, marks=pytest.mark.slow) for x in ("SHAFT", "LAG"))]
)
def test_a_prior_that_ends_too_early_is_widened(name: str, tmp_path: Path) -> None:
    """And the config that `--apply` writes fits.  Mutants killed: lines of nothing, the other end."""
    rig = bd.Train(
        inertias=("motor", "load"),
        shafts={"s": ["motor", "load"]},
        drives={"motor": "voltage"},
        added=("c_s", "k_e_motor"),
    )
    truth = {"j_motor": 0.01, "j_load": 0.02, "k_s": 3.0, "c_s": 0.02, "k_T_motor": 0.5}
    truth |= {"r_motor": 1.0, "k_e_motor": 0.5}
    moved = bd.respond(rig, truth, T, {"u_motor": U}, ["w_motor", "w_load"])
    late = np.concatenate([np.zeros(2), moved["w_load"][:-2]])
    rng = np.random.default_rng(4)
    noisy = {"w_motor": moved["w_motor"], "w_load": late}
    noisy = {channel: y + 0.1 * rng.standard_normal(len(T)) for channel, y in noisy.items()}
    text = TRAIN
    for key, prior in {**WIDE, name: EARLY[name][1]}.items():
        text = text.replace(key, prior)
    path = write(tmp_path, text, {"t": T, "u": U, **noisy})
    new = tmp_path / "new.yaml"
    ran = command_line.cli("map", path, "--processes", "1", "--apply", new)
    unknown = EARLY[name][0].removeprefix("prior_")
    assert advice(ran.out) == f"a wider prior of {unknown}"
    assert f"prior: {unknown} is at an end of its prior" in ran.out
    again = command_line.cli("map", new, "--processes", "1")
    assert "the residuals look like the noise" in again.out
    assert again.status == 0


def test_a_config_is_written_once_and_never_over_what_is_read(tmp_path: Path) -> None:
    """Mutants killed: the config itself, a file that is there, a name of another kind."""
    config = command_line.small_config(tmp_path)
    before = command_line.listing(tmp_path)
    other = tmp_path / "there.yaml"
    other.write_text("mine: 1\n")
    for new, says in (
        (config, "is the config that is mapped"),
        (tmp_path / "small.csv", "a config is a .yaml file"),
        (other, "exists already"),
        (tmp_path / "no" / "new.yaml", "this folder does not exist"),
    ):
        ran = command_line.cli("map", config, "--processes", "1", "--apply", new)
        assert ran.status == 2
        assert says in ran.err, ran.err
    ran = command_line.cli("map", config, "--quick", "--apply", tmp_path / "new.yaml")
    assert ran.status == 2
    other.unlink()
    fits = command_line.cli("map", config, "--processes", "1", "--apply", tmp_path / "new.yaml")
    assert fits.status == 0
    assert "nothing to write: the fit leaves what looks like the noise" in fits.out
    assert command_line.listing(tmp_path) == before
