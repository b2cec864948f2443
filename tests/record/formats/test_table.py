"""Columns and variables of all formats: the same numbers, or what cannot be picked and a way out."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from support import array_files
from support.case_tables import run_cases

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import FORMATS, Wanted, format_of
from bayesdrill.record.formats.table import RecordTable

TABLE = yaml.safe_load(Path(__file__).with_name("picks.yaml").read_text(encoding="utf-8"))
PICKED, REFUSED = (
    [(name, row) for row in TABLE[kind] for name in row["files"]] for kind in ("picked", "refused")
)
TEXT = "t [s],w_1 [rpm],theta,x,twin,twin\n1,2,3,4,5,6\n"
NAMED = {"flat", "of MATLAB", "row", "table.t", "table.speed", "counts", "on", "block.x", "t [s]"}
NAMED |= {"run 1/motor/speed", "run 1/motor/t", "w.1", "money", "(column 2)", "theta_1", "data"}
NAMED |= {"rate", "rig.theta", "rig.motor.w"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("formats")
    (folder / "run.csv").write_text(TEXT)
    return {**array_files.write_all(folder), "csv": folder / "run.csv"}


def load(path: Path, wanted: Wanted = None) -> RecordTable:
    file_format = FORMATS[format_of(path)]
    return file_format.read(path, file_format.options(), wanted)


@run_cases("wanted", [None, NAMED], ["all", "named"])
@run_cases("name, row", PICKED)
def test_columns_of_every_layout_are_picked(
    files: dict[str, Path], wanted: Wanted, name: str, row: dict[str, Any]
) -> None:
    values = load(files[name], wanted).pick(row.get("column"), row.get("variable"))
    assert values.dtype == np.float64
    np.testing.assert_array_equal(values, eval(row["values"], vars(array_files)))


@run_cases("name, row", REFUSED)
def test_what_cannot_be_picked_is_named_with_a_way_out(
    files: dict[str, Path], name: str, row: dict[str, Any]
) -> None:
    table = load(files[name])
    with pytest.raises(InputError) as caught:
        table.pick(row.get("column"), row.get("variable"), location="signals.w")
    message = str(caught.value)
    assert message.startswith("signals.w: ")
    assert files[name].name in message
    assert row["says"] in message
