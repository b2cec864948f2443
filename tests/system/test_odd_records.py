"""Records as other programs write them, read as they are meant, and columns that are suspected.

Those that are refused are in `bad_inputs.yaml`.
"""

from pathlib import Path

import h5py
import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.record.formats import matlab

LINES = command_line.small_record().splitlines()
HEADER, BODY = LINES[0], LINES[1:]
T, THETA, W = np.array([line.split(",") for line in BODY], dtype=float).T
TEXT = "\n".join(LINES) + "\n"


def lines(*text: str) -> str:
    return "\n".join(text) + "\n"


def table(*columns: np.ndarray) -> str:
    return lines(HEADER, *(",".join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)))


def quoted(line: str) -> str:
    """Cells in quotes, with decimal commas."""
    return ",".join(f'"{cell.replace(".", ",")}"' for cell in line.split(","))


EPOS = ("Date:;2020-07-08", "Index:;0x30D3;0x30D2;0x0000", "Sampling period:;51.2")
AS_MEANT: list[tuple[str, str | bytes]] = [
    ("UTF-16 without a mark", TEXT.encode("utf-16-le")),
    ("decimal commas in quotes between commas", lines(*map(quoted, LINES))),
    ("rows of units and kinds", lines(HEADER, "[s],[rad],[rad/s]", "double,double,double", *BODY)),
    ("comment lines", lines("# rig 3", "% run 1", *LINES[:30], "# pause", *LINES[30:])),
    ("CRCRLF line ends", TEXT.replace("\n", "\r\r\n")),
    ("header in single quotes", TEXT.replace(HEADER, "'t','theta_1','w_1'")),
    ("blanks in the header", TEXT.replace(HEADER, " t , theta_1 ,\u00a0w_1 ")),
    ("title above the header", lines("LabVIEW Measurement", "Operator: A. B.", "", *LINES)),
    ("head of an EPOS recorder, units below the names", lines(
        *EPOS, HEADER.replace(",", ";"), "s;rad;rad/s", *(row.replace(",", ";") for row in BODY))),
    ("commas behind cells of a spreadsheet", lines(
        *(f"{row.replace(',', ';')},," for row in LINES))),
    ("powers of Fortran", lines(HEADER, *(f"{row}D+00" for row in BODY))),
    ("true minus signs", TEXT.replace("-", "\u2212")),
    ("blank cells in a column that is not used", lines(
        f"{HEADER},note", *(f"{line},NA" for line in BODY))),
]  # fmt: skip


def place(folder: Path, content: str | bytes) -> Path:
    """Write the small experiment with another record; return the path of its config."""
    config = command_line.small_config(folder)
    (folder / "small.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    return config


@run_cases("name, content", AS_MEANT, ids=[name for name, _ in AS_MEANT])
def test_an_odd_spelling_is_read_as_it_is_meant(
    name: str, content: str | bytes, tmp_path: Path
) -> None:
    experiment = bd.load(place(tmp_path, content)).job.problem.experiment
    np.testing.assert_array_equal(experiment.t, T)
    np.testing.assert_array_equal(experiment.y, np.column_stack([THETA, W]))


# --- MATLAB ----------------------------------------------------------------------------------------


@run_cases(
    "kind, way_out",
    [
        ("timetable", "y = w_1.Variables; save('run.mat', 'y')"),
        ("table", "y = w_1.Variables; save('run.mat', 'y')"),
        ("timeseries", "y = w_1.Data"),
        ("function_handle", "is a MATLAB object (function_handle)"),
        ("datetime", "is a MATLAB object (datetime)"),
    ],
)
def test_an_object_that_only_matlab_can_open_is_refused(
    kind: str, way_out: str, tmp_path: Path
) -> None:
    with h5py.File(tmp_path / "small.mat", "w", userblock_size=512) as file:
        for name, values in (("t", T), ("theta_1", THETA)):
            file[name] = values[None]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["w_1"] = np.zeros((1, 6), np.uint32)
        file["w_1"].attrs["MATLAB_class"] = np.bytes_(kind)
        file["w_1"].attrs["MATLAB_object_decode"] = np.int32(3)
    changes = [(f"{{column: {x},", f"{{variable: {x},") for x in ("t", "theta_1", "w_1")]
    config = command_line.small_config(tmp_path, ("file: small.csv", "file: small.mat"), *changes)
    command_line.assert_refused(command_line.cli("check", config), "small.mat", way_out)


def test_groups_of_hdf5_with_two_names_are_read_once(tmp_path: Path) -> None:
    """26 of them inside each other have 2^26 paths."""
    with h5py.File(tmp_path / "nested.mat", "w") as file:
        group = file.create_group("top")
        for _ in range(26):
            inner = group.create_group("a")
            group["b"] = inner
            group = inner
        file["t"] = np.arange(3.0)
    read = matlab.read(tmp_path / "nested.mat")
    assert set(read.variables) == {"t"}
    assert any("second name" in reason for reason in read.ignored.values())


# --- suspicions ------------------------------------------------------------------------------------

STUCK = np.where((np.arange(len(T)) >= 40) & (np.arange(len(T)) < 55), W[40], W)
DEG = 180 / np.pi


@run_cases(
    "name, columns, message",
    [
        ("sound", (T, THETA, W), None),
        ("both in degrees", (T, DEG * THETA, DEG * W),
         "w_1 is 57.3 times what the start values predict; was it degrees"),
        ("sign", (T, THETA, -W), "grows -1 times as fast as w_1 says; is one of them a sign"),
        ("stuck", (T, THETA, STUCK),
         "stuck: w_1 stays at exactly one value for 15 samples, from 2 to 2.7 s"),
    ],
    ids=str,
)  # fmt: skip
def test_a_wrong_column_or_unit_is_suspected(
    name: str,
    columns: tuple[np.ndarray, ...],
    message: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = place(tmp_path, table(*columns))
    monkeypatch.chdir(tmp_path)
    result = command_line.cli("check", config.name)
    assert result.status == 0, result.text
    warnings = [line for line in result.out.splitlines() if line.startswith("record, ")]
    assert (message is None) == (not warnings), result.out
    assert message is None or any(message in line for line in warnings), warnings
