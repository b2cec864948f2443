"""Kinds and units of columns, told by the sizes and derivatives of what they measure."""

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.first_configs import (
    DEG,
    RPM,
    channels_of,
    draft_of,
    german_record,
    reversing_rig,
    write_table,
)

SIZES = {"deg": DEG, "rad": 1.0, "rpm": RPM, "rad/s": 1.0, "deg/s": DEG}


@run_cases("angle, speed", [("deg", "rpm"), ("deg", "rad/s"), ("rad", "rpm"), ("rad", "deg/s")])
def test_the_derivative_of_an_angle_tells_both_units(
    angle: str, speed: str, tmp_path: Path
) -> None:
    t, v, x = reversing_rig()
    rng = np.random.default_rng(3)
    columns = {
        "t": t,
        "voltage": v,
        "position": (x[:, 1] + rng.normal(0, 0.01, len(t))) * SIZES[angle],
        "velocity": (x[:, 3] + rng.normal(0, 0.1, len(t))) * SIZES[speed],
    }
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert channels_of(draft) == {"theta_2": ("position", angle), "w_2": ("velocity", speed)}
    assert "the end of the shaft is not stated" in draft["words"]


def test_without_times_an_angle_and_its_speed_tell_the_rate(tmp_path: Path) -> None:
    columns = german_record()
    del columns["Zeit_ms"]
    columns["n_Rotor [rpm]"] = columns.pop("n_Rotor")
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert draft["record"]["time"]["rate"] == pytest.approx(200, rel=0.02)
    del columns["n_Rotor [rpm]"]
    draft = draft_of(write_table(tmp_path / "r.csv", columns))
    assert draft["record"]["time"] == {"rate": 100}
    assert "REVIEW: no column is a time" in draft["words"]
