"""Findings on a record before any model name stillness, turned signs, one direction, odd cells."""

from dataclasses import replace

import numpy as np
from support.case_tables import run_cases
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
ANGLE = np.cumsum(BOTH) * DT
SLOW = np.repeat(BOTH[::4], 4)
ZEROS = np.where(np.arange(N) % 3 == 1, BOTH, 0.0)


@run_cases(
    "name, of, unknowns, expected",
    [
        ("sound", record(SQUARE, w_2=BOTH), ("offset_v", "t_f"), []),
        ("an angle of a motor", record(SQUARE, theta_2=ANGLE), ("offset_v",), []),
        ("a constant voltage", record(8.0, w_2=speed_of(np.full(N, 8.0)) + NOISE), ("t_f",), []),
        ("a supply that is off", record(0.0, w_2=BOTH), (), []),
        ("the speed is not that of the voltage", record(SQUARE, w_2=10 * NOISE), (), []),
        ("the speed is turned", record(SQUARE, w_2=-BOTH), (), ["opposite signs"]),
        ("the angle is turned", record(SQUARE, theta_2=-ANGLE), (), ["opposite signs"]),
        ("a constant voltage against the speed",
         record(-8.0, w_2=speed_of(np.full(N, 8.0)) + NOISE), (), ["opposite signs"]),
        ("the other end is turned", record(SQUARE, w_2=BOTH, theta_1=-ANGLE), (),
         ["channel turned"]),
        ("the speed falls", record(STEPS, w_2=speed_of(10 - STEPS) + NOISE), (), ["speed falls"]),
        ("one direction", record(STEPS, w_2=FORWARD), ("offset_v", "t_f"), ["one direction"]),
        ("one direction, and nothing to confuse", record(STEPS, w_2=FORWARD), ("t_f",), []),
        ("one direction, and neither is named", record(STEPS, w_2=FORWARD), (), ["one direction"]),
        ("nothing moves", record(SQUARE, w_2=np.full(N, 2.4e-311)), (), ["nothing moved"]),
        ("one column is still", record(SQUARE, w_2=BOTH, i=np.zeros(N)), (), ["still channel"]),
        ("cells are repeated", record(SQUARE, w_2=SLOW), (), ["repeated cells"]),
        ("cells are zero", record(SQUARE, w_2=ZEROS), (), ["zeros between"]),
        ("a coarse and slow angle", record(SQUARE, theta_1=np.floor(T / (4 * DT))), (), []),
        ("rest between motions", record(SQUARE, theta_1=np.maximum(ANGLE, 3.0)), (), []),
    ],
    ids=str,
)  # fmt: skip
def test_a_record_says_what_is_odd_in_it(
    name: str, of: Experiment, unknowns: tuple[str, ...], expected: list[str]
) -> None:
    assert kinds(of, *unknowns) == expected
