"""What is suspected of columns, and what half a sample of an input would move."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import read_table, run_cases
from support.command_line import ROOT
from support.missing_physics import DT, SIGMA, N, best
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment as experiment_of
from support.small_problems import posterior_of, starts_believed, vector

import bayesdrill as bd
from bayesdrill.analysis import suspicions
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.suspicions import half_sample_shift, suspicions_of_problem
from bayesdrill.inference.priors import Uniform
from bayesdrill.record.experiment import Experiment
from bayesdrill.report.findings import finding_sentences
from bayesdrill.rig import MotorShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.linear import Response
from bayesdrill.rig.simulators.sensors import ObservationModel

CONFIGS = [*(ROOT / "configs").glob("*.yaml"), *(ROOT / "configs" / "paper").glob("*.yaml")]
DEGREE, RPM = np.pi / 180, np.pi / 30


def experiment(t: np.ndarray, **columns: np.ndarray) -> Experiment:
    """Return channels under the names of states, `(T,)` each in SI; `twist` is theta_1 - theta_2."""
    weights = {"twist": {"theta_1": 1.0, "theta_2": -1.0}}
    measures = {name: weights.get(name, {name: 1.0}) for name in columns}
    y = np.stack(list(columns.values()), axis=-1)
    of = experiment_of(len(t), constant={}, y=y, measures=measures)
    channels = tuple(
        replace(one, unit="rad/s" if one.name.startswith("w_") else "rad") for one in of.channels
    )
    return replace(of, t=t, channels=channels)


def said(of: Experiment, *factors: float, gear: float = 1.0) -> list[str]:
    factors = factors or (1.0,) * len(of.channels)
    return [*finding_sentences(suspicions.suspicions_of_record(of, factors, MotorShaft(gear)))]


def kinds(of: Experiment, *factors: float) -> list[str]:
    return [text.split(":")[0] for text in said(of, *factors)]


@run_cases("path", CONFIGS)
@starts_believed()
def test_nothing_is_suspected_of_the_bundled_records(path: Path) -> None:
    assert tuple(suspicions_of_problem(bd.load(path).job.problem)) == ()


TIMES = np.arange(2001) * 0.005
NOISE = 0.01 * np.random.default_rng(5).standard_normal(len(TIMES))
FADING = np.exp(-0.2 * TIMES)
SWING = np.sin(3.0 * TIMES) * FADING
SPEED = (3.0 * np.cos(3.0 * TIMES) - 0.2 * np.sin(3.0 * TIMES)) * FADING


@run_cases("angle, speed", read_table("analysis/sound_pairs.yaml"))
def test_nothing_is_suspected_of_sound_pairs(angle: str, speed: str) -> None:
    assert kinds(experiment(TIMES, theta_1=eval(angle), w_1=eval(speed))) == []


FACTORS = {"57.3": 1 / DEGREE, "9.55": 1 / RPM, "6.28": 2 * np.pi, "8": 8.0, "1000": 1000.0}


@run_cases("name, turn", [(name, turn) for name in FACTORS for turn in (1, -1)])
def test_a_wrong_unit_of_one_of_two_columns_shows_without_a_model(name: str, turn: int) -> None:
    factor = FACTORS[name] ** turn  # below one, each sample of one is between two of the other
    blank = np.where(np.arange(len(TIMES)) % 2, np.nan if turn < 0 else 0.0, 0.0)
    angle, speed = factor * (SWING + NOISE) + blank, SPEED + NOISE + np.roll(blank, 1)
    record = experiment(TIMES, theta_1=angle, w_1=speed)
    (text,) = said(record, gear=0.125)
    assert text.startswith("unit: theta_1 grows ")
    assert float(text.split()[3]) == pytest.approx(factor, rel=0.01)
    assert f"({name})" in text


def test_swapped_columns_are_noticed_and_those_of_different_parts_not_compared() -> None:
    for theta_1, w_1 in ((SPEED + NOISE, SWING + NOISE), (5.0 + NOISE, 5.0 * TIMES)):
        assert kinds(experiment(TIMES, theta_1=theta_1, w_1=w_1)) == ["columns"]
    assert kinds(experiment(TIMES, theta_1=SWING, w_2=60 * SPEED, twist=9 * SWING)) == []


@run_cases("bits", [12, 16])
def test_a_counter_that_overflows_shows_in_the_unit_of_its_column(bits: int) -> None:
    unit, half = 0.001, 2 ** (bits - 1)
    counts = np.round(1.5 * half * SWING)
    wrapped = (counts + half) % 2**bits - half
    (text,) = said(experiment(TIMES, theta_1=unit * wrapped), unit)
    assert text.startswith("overflow: theta_1")
    assert f"2^{bits} counts" in text
    assert np.array_equal(np.unwrap(wrapped, period=2**bits), counts)
    assert kinds(experiment(TIMES, theta_1=unit * counts), unit) == []


@run_cases("unit", [1.0, DEGREE])
def test_an_angle_that_is_wrapped_into_one_turn_shows(unit: float) -> None:
    (text,) = said(experiment(TIMES, theta_1=np.mod(5.0 * TIMES, 2 * np.pi)), unit)
    assert "one turn" in text
    assert f"np.unwrap(x, period={2 * np.pi / unit:.6g})" in text
    spike = np.where(np.arange(len(TIMES)) == 700, 2 * np.pi, 0.0)
    assert kinds(experiment(TIMES, theta_1=SWING + spike)) == []


def test_half_a_sample_moves_what_a_late_step_moves() -> None:
    """Against the fit of a record whose step was given half a sample late, to first order."""
    values, free = {**NOMINAL, "t_f": 1e-3}, ("j_m", "k_e", "k_s", "j_1")
    priors = {name: Uniform(0.3 * NOMINAL[name], 3 * NOMINAL[name]) for name in free}
    measures = {name: {name: 1.0} for name in ("theta_1", "w_1")}
    clean = experiment_of(N, DT, measures=measures, constant={"v": 8.0, "t_1": 0.0})
    delayed = Response(MotorShaft(), clean, ObservationModel(delay="t_0"))
    fits = []
    for delay in (0.0, 0.5 * DT):
        y = delayed.signals(np.append(vector(values), delay)[None])[0]
        rig = simulator(MotorShaft(), replace(clean, y=y), ObservationModel())
        fits.append(posterior_of(rig, SIGMA, priors, values))
    theta, moved = map(best, fits)
    study = SensitivityStudy(fits[0].likelihood)
    shift = half_sample_shift(study, theta)
    assert shift.is_reported
    rows = study.with_nuisances(theta)
    sds = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    for (name, value), expected in zip(shift.shifts, np.log(moved / theta) / sds, strict=True):
        assert value == pytest.approx(expected, rel=0.5, abs=0.3), name
