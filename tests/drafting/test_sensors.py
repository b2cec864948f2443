"""Rates of columns without times; kinds and units that sizes and derivatives tell: `drafts.yaml`."""

from pathlib import Path

import pytest
from support.first_configs import draft_of, german_record, write_table


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
