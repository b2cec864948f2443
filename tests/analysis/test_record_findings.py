"""Findings on a record before any model name stillness, turned signs, one direction, odd cells."""

from dataclasses import replace
from typing import Any

import numpy as np
from support.case_tables import read_table, run_cases
from support.small_problems import experiment as experiment_of

from bayesdrill.analysis.record_findings import findings_of_record
from bayesdrill.record.experiment import Experiment
from bayesdrill.report.findings import finding_sentences
from bayesdrill.rig.models.motor_shaft import MotorShaft

RNG = np.random.default_rng(3)
N, DT = 1200, 0.01
T = DT * np.arange(N)
SQUARE = 6.0 * np.sign(np.sin(2 * np.pi * 0.4 * T + 0.1))
STEPS = np.where(T < 3.0, 0.0, 4.0 + SQUARE / 3.0)  # of one sign, after a rest
NOISE = RNG.normal(0.0, 0.2, N)


def speed_of(voltage: np.ndarray, gain: float = 10.0, tau: float = 0.08, drop: float = 0.0):
    """Return the speed of a motor with dry friction that takes `drop` volts."""
    w = np.zeros(len(voltage))
    for k in range(len(w) - 1):
        u = voltage[k] - drop * np.sign(w[k])
        w[k + 1] = w[k] + DT / tau * (gain * u - w[k])
    return w


def record(voltage: np.ndarray | float, **columns: np.ndarray) -> Experiment:
    given = {"v": voltage} if isinstance(voltage, float) else {}
    y = np.stack(list(columns.values()), axis=-1)
    of = experiment_of(N, constant=given, y=y, measures={name: {name: 1.0} for name in columns})
    series = {} if given else {"v": np.asarray(voltage)}
    return replace(of, t=T, series=series)


def kinds(of: Experiment, *unknowns: str) -> list[str]:
    found = [*findings_of_record(of, MotorShaft(), unknowns)]
    assert all(finding_sentences(found))
    return [finding.kind for finding in found]


FORWARD, BOTH = speed_of(STEPS) + NOISE, speed_of(SQUARE, drop=1.0) + NOISE
ANGLE, STEADY = np.cumsum(BOTH) * DT, speed_of(np.full(N, 8.0)) + NOISE
SLOW = np.repeat(BOTH[::4], 4)
ZEROS = np.where(np.arange(N) % 3 == 1, BOTH, 0.0)


CASES = read_table("analysis/record_findings.yaml")


@run_cases("case", CASES, [case["name"] for case in CASES])
def test_a_record_says_what_is_odd_in_it(case: dict[str, Any]) -> None:
    of = eval(f"record({case['record']})")
    assert kinds(of, *case.get("unknown", ())) == case["finds"]
