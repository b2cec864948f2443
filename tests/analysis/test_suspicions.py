"""What is suspected of columns, and that sound records are left in peace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.analysis import suspicions
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.record.formats import FORMATS, format_of
from bayesdrill.report import words
from bayesdrill.rig import MotorShaft

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
CONFIGS = sorted([*(ROOT / "configs").glob("*.yaml"), *(ROOT / "configs" / "paper").glob("*.yaml")])

DEGREE, RPM = np.pi / 180, np.pi / 30


def experiment(t: np.ndarray, **columns: np.ndarray) -> Experiment:
    """Channels under the names of states, `(T,)` each in SI; `twist` is theta_1 - theta_2."""
    weights = {"twist": {"theta_1": 1.0, "theta_2": -1.0}}
    return Experiment(
        t=t,
        y=np.stack(list(columns.values()), axis=-1),
        channels=tuple(
            Channel(
                name=name,
                weights=weights.get(name, {name: 1.0}),
                unit="rad/s" if name.startswith("w_") else "rad",
                latex="",
                latex_unit="",
            )
            for name in columns
        ),
        constant={},
        series={},
        first_order=False,
        start={},
        t_start=0.0,
    )


def kinds(of: Experiment, *factors: float) -> list[str]:
    found = suspicions.suspicions_of_record(
        of, factors or [1.0] * len(of.channels), MotorShaft(1.0)
    )
    return [one.split(":")[0] for one in found]


def test_there_are_configs() -> None:
    assert len(CONFIGS) >= 6


@run_cases("path", CONFIGS)
def test_nothing_is_suspected_of_the_records_of_the_house(path: Path) -> None:
    job = bd.load(path).job
    assert words.record_suspicions(job.problem) == ()


# --- records of rigs of others ---------------------------------------------------------------------


def columns_of(name: str, *columns: str | int, variable: str | None = None) -> list[np.ndarray]:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"{name} is not here")
    one = FORMATS[format_of(path)]
    table = one.read(path, one.options(), None)
    return [table.pick(column, variable) for column in columns]


@pytest.mark.parametrize("name", ["square", "sweep", "slow"])
def test_nothing_is_suspected_of_a_servo_with_coarse_sensors(name: str) -> None:
    columns = ("time [ms]", "theta [deg]", "alpha [deg]")
    t, theta, alpha = columns_of(f"simulated_servo/{name}.csv", *columns)
    of = experiment(t / 1000, theta_2=theta * DEGREE, twist=alpha * DEGREE)
    assert kinds(of, DEGREE, DEGREE) == []


@pytest.mark.parametrize("name", ["0.06_1", "0.06_3", "0.065_2"])
def test_the_speed_of_a_servo_pair_is_the_difference_quotient_of_its_angle(name: str) -> None:
    """Exactly: so its makers wrote it.  Nothing else is suspected."""
    t, angle, speed = columns_of(f"hsm150_servo/idf_pos_{name}.mat", 1, 3, 4, variable="data")
    assert np.abs(speed[1:] - np.diff(angle) / 1e-3).max() < 1e-9
    assert kinds(experiment(t, theta_1=angle, w_1=speed)) == ["derived"]


def test_nothing_is_suspected_of_a_drill_string() -> None:
    names = ("Time", "Bit_Speed", "Top_Speed")
    columns = (f"{name}_Sample_175_complete" for name in names)
    t, bit, top = columns_of("ufrj_drillstring_rig/175_completo_1.mat", *columns)
    window = (t >= 37) & (t <= 41)
    for used in (window, t >= 0):
        of = experiment(t[used], w_1=bit[used] * RPM, w_2=top[used] * RPM)
        assert kinds(of, RPM, RPM) == []


# --- shapes that are sound, and the same ones spoilt -----------------------------------------------

T = np.arange(2001) * 0.005
RNG = np.random.default_rng(5)
NOISE = 0.01 * RNG.standard_normal(len(T))
SWING = np.sin(3.0 * T) * np.exp(-0.2 * T)
SWING_SPEED = (3.0 * np.cos(3.0 * T) - 0.2 * np.sin(3.0 * T)) * np.exp(-0.2 * T)


@run_cases(
    "angle, speed",
    [
        (SWING, SWING_SPEED),
        (SWING + NOISE, SWING_SPEED + NOISE),
        (np.sin(T), np.cos(T)),  # the integral of each is the other, up to a sign
        (5.0 * T, 5.0 + NOISE),
        (5.0 * T + NOISE, 5.0 + 0.2 * SWING_SPEED),
        (np.exp(T), np.exp(T) + NOISE),
        (NOISE, NOISE[::-1]),
        (np.round(SWING, 1), SWING_SPEED + NOISE),
        (np.minimum(SWING, 0.0) + 1e-9 * T, SWING_SPEED),
        (40.0 * T**2, 80.0 * T),
    ],
)
def test_sound_pairs_are_left_in_peace(angle: np.ndarray, speed: np.ndarray) -> None:
    assert kinds(experiment(T, theta_1=angle, w_1=speed)) == []


@run_cases(
    "factor, name, turn",
    [
        (*case, turn)
        for case in [
            (1 / DEGREE, "57.3"),
            (1 / RPM, "9.55"),
            (2 * np.pi, "6.28"),
            (8.0, "8"),
            (1000.0, "1000"),
        ]
        for turn in [1, -1]
    ],
)
def test_a_wrong_unit_of_one_of_two_columns_shows_without_a_model(
    factor: float, name: str, turn: int
) -> None:
    of = experiment(T, theta_1=SWING * factor**turn + NOISE * factor**turn, w_1=SWING_SPEED + NOISE)
    (said,) = suspicions.suspicions_of_record(of, [1.0, 1.0], MotorShaft(0.125))
    assert said.startswith("unit: theta_1 grows ")
    assert float(said.split()[3]) == pytest.approx(factor**turn, rel=0.01)
    assert f"({name})" in said


def test_swapped_columns_show() -> None:
    assert kinds(experiment(T, theta_1=SWING_SPEED + NOISE, w_1=SWING + NOISE)) == ["columns"]
    assert kinds(experiment(T, theta_1=5.0 + NOISE, w_1=5.0 * T)) == ["columns"]


def test_columns_of_different_things_are_not_compared() -> None:
    of = experiment(T, theta_1=SWING, w_2=60 * SWING_SPEED, twist=9 * SWING)
    assert kinds(of) == []


@run_cases("bits", [12, 16])
def test_a_counter_that_ran_over_shows_in_the_unit_of_its_column(bits: int) -> None:
    unit, half = 0.001, 2 ** (bits - 1)
    counts = np.round(1.5 * half * SWING)
    wrapped = (counts + half) % 2**bits - half
    of = experiment(T, theta_1=unit * wrapped)
    (said,) = suspicions.suspicions_of_record(of, [unit], MotorShaft(1.0))
    assert said.startswith("overflow: theta_1")
    assert f"2^{bits} counts" in said
    np.testing.assert_array_equal(np.unwrap(wrapped, period=2**bits), counts)
    assert kinds(experiment(T, theta_1=unit * counts), unit) == []


@run_cases("unit", [1.0, DEGREE])
def test_an_angle_that_is_wrapped_into_one_turn_shows(unit: float) -> None:
    turned = np.mod(5.0 * T, 2 * np.pi)
    (said,) = suspicions.suspicions_of_record(
        experiment(T, theta_1=turned), [unit], MotorShaft(1.0)
    )
    assert "one turn" in said
    assert f"np.unwrap(x, period={2 * np.pi / unit:.6g})" in said


def test_a_spike_is_no_counter() -> None:
    spiked = SWING.copy()
    spiked[700] += 2 * np.pi
    assert kinds(experiment(T, theta_1=spiked)) == []
