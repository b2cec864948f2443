"""What heads, names and counters of columns say, and files of which no column can be used."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from support.case_tables import read_table, run_cases
from support.first_configs import (
    DEG,
    RECORD,
    channels_of,
    draft_of,
    refusal,
    reversing_rig,
    write_table,
)

from bayesdrill.basics import units
from bayesdrill.drafting.columns import contradiction, named_column, parse_head

TABLE = read_table(Path(__file__).with_name("heads.yaml"))


@run_cases("head, expected", TABLE["heads"].items())
def test_heads_are_read_in_several_languages(head: str, expected: list[str]) -> None:
    meaning = parse_head(head)
    assert [meaning.kind, meaning.location, meaning.unit] == expected


def test_a_row_of_units_completes_a_head_and_a_unit_of_no_turn_is_unknown() -> None:
    assert parse_head("theta_1 [counts]").unknown_unit == "counts"
    assert parse_head("position [mm]").kind == "position"  # of what moves along a line
    assert parse_head("w [rpm]", "ignored").unit == "rpm"
    assert (parse_head("w", "[rpm]").unit, parse_head("t", "[%]").unknown_unit) == ("rpm", "%")


@run_cases("head, says", TABLE["doubts"].items())
def test_a_head_whose_name_contradicts_its_unit_is_doubted(head: str, says: str) -> None:
    text = contradiction(parse_head(head))
    assert text.startswith(says)
    assert bool(text) == bool(says)


def test_the_name_of_a_file_may_stand_before_a_column() -> None:
    column = named_column("b.mat:data:2=w_1 [rpm]", ["a.mat", "b.mat"])
    assert (column.file, column.variable, column.column) == ("b.mat", "data", 2)
    assert (column.meaning.symbol, column.meaning.unit) == ("w_1", "rpm")


@run_cases("name", TABLE["wrong_names"])
def test_a_name_or_unit_that_cannot_be_read_is_refused(name: str, tmp_path: Path) -> None:
    message = refusal(write_table(tmp_path / "r.csv", RECORD), "t=t [s]", name)
    assert message.startswith("--columns:")
    assert "ground" in message or "count/(560/cm)" in message
    assert not (tmp_path / "r.yaml").exists()


@run_cases("unit, si, size", TABLE["sizes"])
def test_counts_and_shares_are_units(unit: str, si: str, size: float) -> None:
    """Their sizes are those of a turn, of a length and of what a drive is rated for."""
    assert units.factor(unit, si) == pytest.approx(size)


@pytest.fixture
def matrix(tmp_path: Path) -> Path:
    """Time, noise, an angle at the gearbox in degrees and the voltage, without heads."""
    t, v, x = reversing_rig()
    rng = np.random.default_rng(3)
    angle = x[:, 1] * DEG + rng.normal(0, 0.1, len(t))
    data = np.stack([t, rng.normal(size=len(t)), angle, v], axis=-1)
    scipy.io.savemat(tmp_path / "m.mat", {"data_theta": data})
    return tmp_path / "m.mat"


def test_columns_of_a_matrix_are_named_by_their_numbers(matrix: Path) -> None:
    others = "data_theta:4=v [V]", "data_theta:1=t [s]"
    draft = draft_of(matrix, "data_theta:3=theta_2 [deg]", *others, gear=5)
    assert channels_of(draft) == {"theta_2": ("3", "deg")}
    assert draft["inputs"]["v"]["column"] == 4
    assert draft["record"]["time"] == {"variable": "data_theta", "column": 1, "unit": "s"}
    assert "measures" not in draft["record"]["channels"]["theta_2"]
    against = draft_of(matrix, "data_theta:3=-theta_2 [deg]", *others, gear=5)
    assert against["record"]["channels"]["theta_2"]["measures"] == "-theta_2"


def test_a_matrix_whose_columns_are_unknown_is_refused_with_what_to_type(matrix: Path) -> None:
    message = refusal(matrix)
    assert '--columns "data_theta:2=theta_2 [deg]"' in message
    assert "data_theta, column 3 (" in message
    assert "data_theta:9" in refusal(matrix, "data_theta:9=theta_2 [deg]")
    assert "names no known quantity" in refusal(matrix, "data_theta:3=theta_2 [rpm]")
    assert "names no known quantity" in refusal(matrix, "data_theta:3=colour")
    assert "is not a rig; did you mean motor" in refusal(matrix, rig="motr")


def test_structures_of_simulink_are_read_one_record_at_a_time(tmp_path: Path) -> None:
    t, v, x = reversing_rig()
    signals = np.zeros((1, 2), dtype=[("values", "O"), ("label", "O"), ("plotStyle", "O")])
    signals[0, 0] = (v[:, None], "voltage [V]", 0)
    signals[0, 1] = (x[:, 2:3], "w_1 [rad/s]", 0)
    scope = {"time": t[:, None], "signals": signals, "blockName": "rig/Scope"}
    scipy.io.savemat(tmp_path / "s.mat", {"scope": scope})
    draft = draft_of(tmp_path / "s.mat", gear=5)
    assert channels_of(draft) == {"w_1": ("scope.signals(2).values", "rad/s")}
    assert draft["inputs"]["v"]["column"] == "scope.signals(1).values"
    scipy.io.savemat(tmp_path / "two.mat", {"a": scope, "b": scope})
    message = refusal(tmp_path / "two.mat")
    assert "holds 2 records: a, b" in message
    assert '--columns "a.signals(2).values=w_2 [rpm]"' in message  # and not the voltage
