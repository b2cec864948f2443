"""One column is cleaned: glitches, masks, ends of a range, angles that wrap, derived channels."""

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.config_texts import ANGLE, RNG, SPEED, SUPPLY, T, read_measured, refused, save

SPIKED = SPEED.copy()
SPIKED[[60, 61, 150]] = -90.0


def test_glitches_are_listed_with_rows_and_times_and_kept(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=T, w=SPIKED)
    experiment = read_measured(tmp_path)
    (anomaly,) = experiment.anomalies
    message = anomaly.in_words(5)
    assert message.startswith("glitches: w_1 jumps away")
    assert "2 places (3 samples): line 62 to 63 (0.9 to 0.91 s); line 152 (1.8 s)" in message
    assert "record.channels.w_1: mask: glitches" in message
    assert anomaly.in_words(1).count("line") == 1
    assert experiment.is_measured.all()
    assert experiment.notes == ()


def test_a_head_that_contradicts_the_unit_of_its_column_is_named(tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=T, w=SPEED, **{"supply [mV]": 1e3 * SUPPLY})
    (anomaly,) = read_measured(tmp_path, v='{column: "supply [mV]", unit: V}').anomalies
    assert anomaly.in_words(1) == (
        "unit: the header of 'supply [mV]' says mV, and the config V; correct `unit:` at inputs.v, or "
        "rename the column"
    )
    assert read_measured(tmp_path, v='{column: "supply [mV]", unit: mV}').anomalies == ()


@run_cases(
    "mask, gone",
    [
        ("glitches", [60, 61, 150]),
        ("{glitches: true}", [60, 61, 150]),
        ("{rows: [[62, 63]]}", [60, 61]),
        ("{times: [[1.8, 1.8], [2.0, 2.02]]}", [150, 170, 171, 172]),
        ("{glitches: true, rows: [[2, 4]], times: [[1.0, 1.01]]}", [0, 1, 2, 60, 61, 70, 71, 150]),
    ],
)
def test_a_mask_leaves_out_what_it_names(mask: str, gone: list[int], tmp_path: Path) -> None:
    save(tmp_path, "r.csv", t=T, w=SPIKED)
    experiment = read_measured(tmp_path, w_1=f"mask: {mask}")
    assert np.flatnonzero(~experiment.is_measured[:, 0]).tolist() == gone
    assert experiment.notes


def test_a_masked_glitch_of_an_input_is_held_over(tmp_path: Path) -> None:
    supply = SUPPLY.copy()
    supply[90] = 250.0
    save(tmp_path, "r.csv", t=T, w=SPEED, u=supply)
    kept = read_measured(tmp_path, v="{column: u, unit: V}")
    assert kept.series["v"][90] == 250.0
    assert "glitches: v jumps away" in kept.anomalies[0].in_words(1)
    masked = read_measured(tmp_path, v="{column: u, unit: V, mask: glitches}")
    assert masked.series["v"][90] == masked.series["v"][89] == pytest.approx(SUPPLY[89])
    assert masked.anomalies == ()


def test_masked_samples_may_be_missing(tmp_path: Path) -> None:
    speeds = [f"{x:.12g}" for x in SPEED]
    speeds[20] = speeds[21] = ""
    save(tmp_path, "r.csv", t=T, w=speeds)
    assert read_measured(tmp_path, w_1="mask: {rows: [[22, 23]]}").counts == (238,)
    message = refused(tmp_path, w_1="mask: {rows: [[22, 22]]}")
    assert "1 value without a number, at line 23" in message


def test_a_saturated_sensor_is_named(tmp_path: Path) -> None:
    clipped = np.minimum(9.0 + 40.0 * np.sin(9.0 * T) + 0.1 * RNG.standard_normal(240), 40.0)
    save(tmp_path, "r.csv", t=T, w=clipped)
    (anomaly,) = read_measured(tmp_path).anomalies
    saturated = "saturated: w_1 runs into exactly the same value, 40 rad/s"
    assert anomaly.in_words(1).startswith(saturated)


@run_cases(
    "unit, wraps, turn",
    [
        ("deg", "true", 360.0),
        ("deg", "360", 360.0),
        ("count/4096", "true", 4096.0),
        ("rad", "true", 2 * np.pi),
    ],
)
def test_angles_that_wrap_are_unwrapped(unit: str, wraps: str, turn: float, tmp_path: Path) -> None:
    raw = np.mod(ANGLE / (2 * np.pi) * turn, turn)
    save(tmp_path, "r.csv", t=T, w=SPEED, phi=raw)
    channel = f"theta_1: {{column: phi, unit: {unit}, wraps: {wraps}, sigma: 1}}"
    experiment = read_measured(tmp_path, channel=channel)
    assert experiment.y[:, 1] - experiment.y[0, 1] == pytest.approx(ANGLE - ANGLE[0])
    jumps = int(np.sum(np.abs(np.diff(raw)) > turn / 2))
    assert jumps > 5
    assert any(f"theta_1: unwrapped {jumps} jumps" in note for note in experiment.notes)


def test_a_jump_of_half_a_turn_is_refused(tmp_path: Path) -> None:
    raw = np.degrees(ANGLE)
    raw[80:] += 178.0
    save(tmp_path, "r.csv", t=T, w=SPEED, phi=raw)
    channel = "theta_1: {column: phi, unit: deg, wraps: 360, sigma: 1}"
    message = refused(tmp_path, channel=channel)
    assert "at line 82 (1 such jumps), nearly half of 360" in message
    assert "record at a higher rate" in message


def test_a_derived_channel_is_compared_and_not_counted(tmp_path: Path) -> None:
    speed = np.degrees(np.diff(ANGLE, prepend=ANGLE[0]) / 0.01)
    save(tmp_path, "r.csv", t=T, w=SPEED, phi=ANGLE, q=speed)
    channels = (
        "theta_1: {column: phi, unit: rad, sigma: 1}\n"
        "    w_2: {column: COLUMN, unit: deg/s, derived_from: theta_1, sigma: 1}"
    )
    experiment = read_measured(tmp_path, channel=channels.replace("COLUMN", "q"))
    assert experiment.names == ("w_1", "theta_1")
    assert experiment.y.shape == (240, 2)
    (note,) = experiment.notes
    assert note.startswith("w_2 is not counted, as it is derived from theta_1")
    assert "1 times the backward difference quotient of theta_1" in note
    assert experiment.anomalies == ()
    other = read_measured(tmp_path, channel=channels.replace("COLUMN", "w"))
    own_sensor = "if it was measured by a sensor of its own, remove derived_from"
    assert own_sensor in other.anomalies[0].in_words(1)
    for unlike in ("w_2: {time: {rate: 90}, column: q, unit: deg/s", "i: {column: q, unit: A"):
        uncompared = channels.replace("w_2: {column: COLUMN, unit: deg/s", unlike)
        notes = read_measured(tmp_path, channel=uncompared).notes
        assert any(note.endswith("not compared, as it has other times or units") for note in notes)
