"""A late input is named, in the words of a config, and nothing that is in time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from together import for_each

from bayesdrill.analysis.causes import Causes, causes
from bayesdrill.config.job import Job, prepare
from bayesdrill.report.sections import fit_words

CONFIG = """\
name: shaft
seed: 4
record:
  file: shaft.csv
  time: {column: t, unit: s}
  channels: {w_1: {column: bit, unit: rad/s, sigma: 0.1}}
inputs:
  w_2: {column: top, unit: rad/s}
  t_1: {column: torque, unit: N*m}
initial: {w_1: 9.0, theta_1: -0.4}
model: {name: driven_shaft}
parameters:
  k_s: {prior: log_normal, median: 4.1, sd_log: 0.5}
  j_1: {prior: log_normal, median: 0.008, sd_log: 0.5}
  c_s: {prior: log_normal, median: 0.02, sd_log: 0.5}
"""
DT, N = 0.005, 500
T = DT * np.arange(N)
TOP = 9.0 + 3.0 * np.sin(18.0 * T) + np.sin(7.0 * T)
TORQUE = 1.8 + 0.8 * np.sin(18.0 * T + 1.0) + 0.4 * np.sign(np.sin(11.0 * T))


def moved(late: float) -> np.ndarray:
    """The bit's speed by small steps, where the torque acts `late` after its record shows it."""
    fine = 20
    h, x, found = DT / fine, np.array([0.4, 9.0]), []
    for k in range(N):
        found.append(x[1])
        for part in range(fine):
            s = T[k] + (part + 0.5) * h
            torque = TORQUE[np.clip(int(np.floor((s - late) / DT)), 0, N - 1)]

            def rate(x: np.ndarray, top: float = TOP[k], torque: float = torque) -> np.ndarray:
                push = 4.1 * x[0] + 0.02 * (top - x[1]) - torque
                return np.array([top - x[1], push / 0.008])

            x = x + h * rate(x + 0.5 * h * rate(x))
    return np.array(found)


def job(folder: Path, late: float) -> Job:
    noisy = moved(late) + 0.1 * np.random.default_rng(3).standard_normal(N)
    head = "t,top,torque,bit"
    rows = np.column_stack([T, TOP, TORQUE, noisy])
    np.savetxt(folder / "shaft.csv", rows, "%.12g", ",", header=head, comments="")
    (folder / "shaft.yaml").write_text(CONFIG)
    return prepare(folder / "shaft.yaml")


def told_of(of: Job) -> Causes | None:
    """At the true values."""
    posterior = of.problem.posterior
    return causes(posterior, posterior.space.vector({"k_s": 4.1, "j_1": 0.008, "c_s": 0.02}))


def test_a_late_torque_is_named_with_the_line_of_a_config(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Mutants killed: the lag of a channel for that of an input, its sign turned."""

    def check(late: float) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        of = job(tmp_path, late)
        told = told_of(of)
        assert told is not None
        assert [(one.kind, one.of) for one in told.found] == [("input lag", "t_1")]
        assert told.found[0].value == pytest.approx(late, abs=2e-3)
        assert told.share > 0.9
        low, high = sorted((0.0, 2e3 * told.found[0].value))
        said = fit_words.explained(told, of.problem)
        assert (
            f"a lag of inputs.t_1: {1e3 * told.found[0].value:.3g} ms: say `lag: {{prior:" in said
        )
        assert f"low: {low / 1e3:.3g}, high: {high / 1e3:.3g}}}`" in said

    for_each({str(late): (late,) for late in [-0.035, 0.02]}, check)


def test_of_inputs_that_are_in_time_no_lag_is_named(tmp_path: Path) -> None:
    told = told_of(job(tmp_path, 0.0))
    assert told is None or not told.explains
