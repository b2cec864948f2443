"""Times, rows and noise of a record: what `init` reads of them, masks of glitches, turns."""

import math
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from support.case_tables import run_cases
from support.first_configs import draft_of, german_record, read_records, write_table

from bayesdrill.drafting import signals
from bayesdrill.drafting.columns import FileColumn, parse_head

STEP = 0.01


def test_noise_is_that_of_a_swing_or_of_the_counts() -> None:
    rng = np.random.default_rng(9)
    t = 0.01 * np.arange(2000)
    swing = 30 * np.sin(20 * t)
    assert signals.noise(swing + rng.normal(0, 0.3, 2000)) == pytest.approx(0.3, rel=0.15)
    coarse = np.round(3 * np.sin(0.3 * t) / 0.5) * 0.5
    assert signals.noise(coarse) == pytest.approx(0.5 / math.sqrt(12), rel=0.01)
    for step, unit in ((0.36, "deg"), (math.pi / 2048, "rad"), (0.1, "")):
        assert signals.counted_unit(np.round(swing / step) * step) == unit
    assert signals.counted_unit(swing) == ""


def test_infinite_cells_and_rows_without_an_input_are_cut_off(tmp_path: Path) -> None:
    columns = german_record()
    columns["U_Motor"][:4] = np.nan
    columns["phi_Rotor_deg"][1500] = np.inf
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert draft["record"]["window"] == pytest.approx([0.02, 7.495])


def test_rows_that_share_a_time_with_others_are_cut_off(tmp_path: Path) -> None:
    """No window of times can take one of three rows with the same time, or one beyond a wild time."""
    columns = german_record()
    columns["Zeit_ms"][900:] -= 15.0
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert draft["record"]["window"] == pytest.approx([0.0, 4.48])
    columns["Zeit_ms"][900:] += 15.0
    columns["Zeit_ms"][899] = 1e7  # which grows, too
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert draft["record"]["window"] == pytest.approx([0.0, 4.49])


@run_cases("unit", [" [deg]", ""])
def test_an_angle_that_wraps_is_unwrapped(unit: str, tmp_path: Path) -> None:
    columns = german_record()
    columns["n_Rotor [rpm]"] = 5 * columns.pop("n_Rotor")
    wrapped = np.mod(5 * columns.pop("phi_Rotor_deg") + 180, 360) - 180
    columns[f"phi_Rotor{unit}"] = wrapped
    draft = draft_of(write_table(tmp_path / "r.csv", columns), gear=1)
    theta = draft["record"]["channels"]["theta_1"]
    assert (theta["wraps"], theta["unit"]) == (360, "deg")
    jumps = int(np.sum(np.abs(np.diff(wrapped)) > 180))
    sentences = " ".join(read_records(tmp_path / "r.yaml"))
    assert f"theta_1: unwrapped {jumps} jumps of 360 deg" in sentences
    assert jumps > 3


def glitches(columns: dict[str, np.ndarray]) -> dict[str, tuple[tuple[float, float], ...]]:
    """Of each channel the first and last times of what looks like a glitch."""
    heads = {"v": "v [V]"}
    file_columns = [
        FileColumn(name, {"column": name}, x, parse_head(heads.get(name, name)))
        for name, x in columns.items()
    ]
    t = STEP * np.arange(len(columns["v"]))
    segment = signals.longest_segment(signals.Timing(t, None, "s", ""), file_columns)
    assert segment is not None
    sensors, _ = signals.read_sensors(file_columns, segment)
    return {sensor.name: sensor.raw.glitches for sensor in sensors}


def swing(rng: np.random.Generator, n: int = 1200) -> dict[str, np.ndarray]:
    """Return a voltage `v (n,)` and noisy channels of a motor that drives a rotor through a shaft.

    The shaft swings with a period of 10 to 120 samples, damped more or less.
    """
    period = np.exp(rng.uniform(np.log(10), np.log(120)))
    w, share, zeta = 2 * np.pi / period, rng.uniform(0.1, 0.9), np.exp(rng.uniform(-6, -1.6))
    j = (share, 1 - share)
    k, c = w**2 * j[0] * j[1], 2 * zeta * w * j[0] * j[1]
    drag, lag = w * np.exp(rng.uniform(-7, -2.3)), 1 / (period * rng.uniform(0.02, 0.3))
    a = np.zeros((6, 6))
    a[0, 2] = a[1, 3] = a[4, 5] = 1.0
    a[2, :4] = np.array([-k, k, -c, c]) / j[0]
    a[3, :5] = np.array([k, -k, c, -c - drag, w]) / j[1]
    a[4, 3:5] = -0.5 * w, -lag
    t = np.arange(n)
    v = [
        np.sign(np.sin(2 * np.pi * t / rng.uniform(3, 12) / period)),
        np.sin(2 * np.pi * t / rng.uniform(0.7, 6) / period),
        np.repeat(rng.normal(size=n // 40 + 1), 40)[:n],
        1.0 * (t > n // 3) - 1.0 * (t > 2 * n // 3),
    ][int(rng.integers(4))]
    step, x = scipy.linalg.expm(a), np.zeros((n, 5))
    for i in range(n - 1):
        x[i + 1] = step[:5, :5] @ x[i] + step[:5, 5] * v[i]
    channels = {"theta_2": x[:, 1], "w_1": x[:, 2], "twist": x[:, 0] - x[:, 1], "i": x[:, 4]}
    return {"v": v, **{name: _noisy(y, rng) for name, y in channels.items()}}


def _noisy(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y = y + rng.choice([1e-4, 1e-3, 0.01, 0.05]) * y.std() * rng.normal(size=len(y))
    step = y.std() * rng.choice([0.01, 0.1])
    return np.round(y / step) * step if rng.random() < 0.3 else y


@pytest.mark.parametrize(
    "seeds", [range(50), pytest.param(range(50, 200), marks=pytest.mark.slow)], ids=len
)
def test_no_peak_of_a_swing_is_a_glitch(seeds: range) -> None:
    for seed in seeds:
        assert not any(glitches(swing(np.random.default_rng(seed))).values()), seed


def test_a_glitch_is_listed_with_its_time_and_not_masked(tmp_path: Path) -> None:
    columns = german_record()
    columns["n_Motor"][[300, 801, 802, 1203]] = -4000.0
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    channels = draft["record"]["channels"]
    assert not any("mask" in channel for channel in channels.values())
    assert channels["motor"]["measures"] == "5 * w_2"
    words = draft["words"]
    assert "looks like glitches: [1.5, 1.5], [4.005, 4.01], [6.015, 6.015] s" in words
    assert "mask: {times: [[1.5, 1.5], [4.005, 4.01], [6.015, 6.015]]}" in words
    assert words.count("looks like") == 1
