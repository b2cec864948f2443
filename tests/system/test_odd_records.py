"""Records as other programs write them: read as they are meant, refused with a way out, or suspected.

Plain mistakes, such as a missing column, are in `bad_inputs.yaml`.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse
from scipy.io import savemat
from support import command_line
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.record.formats import matlab

LINES = command_line.small_record().splitlines()
HEADER, BODY = LINES[0], LINES[1:]
T, THETA, W = np.array([line.split(",") for line in BODY], dtype=float).T
TEXT = "\n".join(LINES) + "\n"

type Change = tuple[str, str]


def lines(*text: str) -> str:
    return "\n".join(text) + "\n"


def table(*columns: np.ndarray) -> str:
    return lines(HEADER, *(",".join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)))


def speeds(cell: Callable[[int, str], str]) -> str:
    """Change every speed; the number is that of its line, from 2."""
    rows = (line.rpartition(",") for line in BODY)
    return lines(HEADER, *(f"{row[0]},{cell(n, row[2])}" for n, row in enumerate(rows, start=2)))


def times(cell: Callable[[float], str]) -> str:
    rows = (line.partition(",") for line in BODY)
    return lines(HEADER, *(f"{cell(float(t))},{rest}" for t, _, rest in rows))


def at_line_9(cell: str) -> str:
    return speeds(lambda n, usual: cell if n == 9 else usual)


def semicolons(decimal: str, speed: Callable[[int], str]) -> str:
    rows = [
        f"{t:.2f};{angle:.6f};".replace(".", decimal) + speed(n)
        for n, (t, angle) in enumerate(zip(T, THETA, strict=True))
    ]
    return lines(HEADER.replace(",", ";"), *rows)


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
    ("powers of Fortran", speeds(lambda _, cell: f"{cell}D+00")),
    ("true minus signs", TEXT.replace("-", "\u2212")),
    ("blank cells in a column that is not used", lines(
        f"{HEADER},note", *(f"{line},NA" for line in BODY))),
]  # fmt: skip

DATES = ("dates and times of day are not read", "time: {rate: ...}")
THOUSANDS = ("line 2: column 'w_1'", "thousands separators are not read", "without them")
MISSING = ("column 'w_1' has 1 value without a number, at line 9", "mend or cut")
ON_ITS_SIDE = lines(*(",".join([name, *(f"{x:g}" for x in column)]) for name, column in
                      (("t", T), ("theta_1", THETA), ("w_1", W))))  # fmt: skip

REFUSED: list[tuple[str, str | bytes, tuple[str, ...]]] = [
    ("Inf", at_line_9("Inf"), MISSING),
    ("NA", at_line_9("NA"), MISSING),
    ("#N/A of a spreadsheet", at_line_9("#N/A"), MISSING),
    ("1.#QNAN of Windows", at_line_9("1.#QNAN"), MISSING),
    ("decimal commas between commas", TEXT.replace(".", ","),
     ("line 1: the header has 3 cells and the rows have 6", "decimal commas, export them with ;")),
    ("thousands separators", speeds(lambda n, _: f'"1,{n:03d}.5"'), THOUSANDS),
    ("thousands separators, decimal commas", semicolons(".", lambda n: f"1.{n:03d},5"), THOUSANDS),
    ("blanks at the thousands", semicolons(",", lambda n: f"1 {n:03d},5"), THOUSANDS),
    ("apostrophes at the thousands", semicolons(".", lambda n: f"1'{n:03d}.5"), THOUSANDS),
    ("percent signs", speeds(lambda _, cell: f"{cell} %"),
     ("percent signs are not read: remove them",)),
    ("units in cells", times(lambda t: f"{t:g} s"),
     ("line 2: column 't': '0 s'", "units do not stand in cells")),
    ("degree signs in cells", speeds(lambda _, cell: f"{cell}\xb0"),
     ("units do not stand in cells",)),
    ("complex cells", speeds(lambda _, cell: f"{cell}+0.5i"),
     ("complex numbers are not read: save the real part",)),
    ("hexadecimal cells", speeds(lambda n, _: f"0x{n:04x}"), ("export decimal ones",)),
    ("comment after a row", at_line_9("3.5 # pause"),
     ("line 9", "a comment may only stand in a line of its own")),
    ("header that is a comment", f"# {TEXT}", ("begins with '#'",)),
    ("dates", times(lambda t: f"2026-01-01 10:00:{t:06.3f}"), DATES),
    ("dates in ISO 8601", times(lambda t: f"2026-01-01T10:00:{t:06.3f}Z"), DATES),
    ("dates with points", times(lambda t: f"01.02.2026 10:00:{t:06.3f}"), DATES),
    ("times of day", times(lambda t: f"10:00:{t:06.3f}"), DATES),
    ("days of a spreadsheet", times(lambda t: f"{46000 + t / 86400:.9f}"),
     ("may be days of a calendar", "save seconds since the start")),
    ("seconds of Unix", times(lambda t: f"{1.7e9 + t:.2f}"),
     ("1700000000 s", "times of a clock", "initial: {time: ...}")),
    ("times with too few digits", times(lambda t: f"{t:.1f}"),
     ("time does not increase, at line 4", "too few digits", "{rate: ...}")),
    ("time that goes backwards", lines(HEADER, *BODY[::-1]),
     ("each row is earlier", "turn the rows around")),
    ("two recordings in one file", lines(*LINES, *BODY),
     ("line 103: 5 s is followed by 0 s", "a second recording", "cut it off")),
    ("two files, one header inside", lines(*LINES, *LINES),
     ("line 103: column 't': 't' is not a number", "mend the cells")),
    ("units of which one is 1", lines(HEADER, "s,rad,1", *BODY),
     ("line 2: column 't': 's'", "not one of the record, remove it")),
    ("header with semicolons", TEXT.replace(HEADER, "t;theta_1;w_1"),
     ("names stand between ';'", "write both the same way")),
    ("row numbers without a name", lines(HEADER, *(f"{n},{row}" for n, row in enumerate(BODY))),
     ("row numbers, give it a name",)),
    ("table on its side", ON_ITS_SIDE, ("lies on its side; transpose it",)),
    ("footer", lines(*LINES, "End of file"), ("line 103: 1 cells where 3 are due", "remove them")),
    ("blank lines", b" \n\n \n", ("only blank lines and comments",)),
    ("zeros where writing was cut", TEXT.encode() + bytes(500),
     ("line 103", "holds bytes that are no text", "remove them")),
    ("old spreadsheet named .csv", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100),
     ("is a spreadsheet (.xls)", "export it as CSV")),
    ("gzip named .csv", gzip.compress(TEXT.encode()), ("is compressed (gzip)", "unpack it")),
    ("Parquet named .csv", b"PAR1" + bytes(100), ("is a Parquet file", "ending .parquet")),
    ("web page", "<!DOCTYPE html>\n<html></html>\n",
     ("is a web page or XML", "export it as CSV")),
    ("JSON", '{"t": [0, 1], "w_1": [1, 2]}\n', ("is JSON", "export it as CSV")),
    ("pointer of Git LFS", "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 9\n",
     ("git lfs pull",)),
]  # fmt: skip


def place(folder: Path, content: str | bytes, *changes: Change, name: str = "small.csv") -> Path:
    """Write the small experiment with another record; return the path of its config."""
    config = command_line.small_config(folder, *changes)
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return config


def refusal(config: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return what `bayesdrill check` says of a record that is refused."""
    monkeypatch.chdir(config.parent)
    result = command_line.cli("check", config.name)
    command_line.assert_refused(result)
    assert result.out == ""
    return result.err


@run_cases("name, content", AS_MEANT, ids=[name for name, _ in AS_MEANT])
def test_an_odd_spelling_is_read_as_it_is_meant(
    name: str, content: str | bytes, tmp_path: Path
) -> None:
    experiment = bd.load(place(tmp_path, content)).job.problem.experiment
    np.testing.assert_array_equal(experiment.t, T)
    np.testing.assert_array_equal(experiment.y, np.column_stack([THETA, W]))


@run_cases("name, content, fragments", REFUSED, ids=[name for name, *_ in REFUSED])
def test_an_ambiguous_record_is_refused_with_a_way_out(
    name: str,
    content: str | bytes,
    fragments: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    message = refusal(place(tmp_path, content), monkeypatch)
    assert "small.csv" in message or "small.yaml" in message
    for fragment in fragments:
        assert fragment in message


@run_cases(
    "name, way_out",
    [
        ("small.csv.gz", "Unpack the file first"),
        ("small.xlsx", "Export the spreadsheet as CSV"),
        ("small.tdms", "Export the recording as CSV or .mat"),
        ("small.npy", "numpy.savez"),
    ],
)
def test_files_of_other_programs_are_refused_by_their_endings(
    name: str, way_out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = place(tmp_path, TEXT, ("file: small.csv", f"file: {name}"), name=name)
    assert way_out in refusal(config, monkeypatch)


# --- MATLAB ----------------------------------------------------------------------------------------

MAT = (
    ("file: small.csv", "file: small.mat"),
    ("{column: t,", "{variable: t,"),
    ("{column: theta_1", "{variable: theta_1"),
    ("{column: w_1", "{variable: w_1"),
)


def sparse(path: Path) -> None:
    savemat(path, {"t": T, "theta_1": THETA, "w_1": scipy.sparse.csc_matrix(W[:, None])})


def matlab_object(kind: str) -> Callable[[Path], None]:
    """Return a function that writes what MATLAB leaves of an object that only it can open."""

    def write(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in (("t", T), ("theta_1", THETA)):
                file[name] = values[None]
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
            file["w_1"] = np.zeros((1, 6), np.uint32)
            file["w_1"].attrs["MATLAB_class"] = np.bytes_(kind)
            file["w_1"].attrs["MATLAB_object_decode"] = np.int32(3)

    return write


@run_cases(
    "write, way_out",
    [
        (sparse, "is sparse; save full(...) of it"),
        (matlab_object("timetable"), "y = w_1.Variables; save('run.mat', 'y')"),
        (matlab_object("table"), "y = w_1.Variables; save('run.mat', 'y')"),
        (matlab_object("timeseries"), "y = w_1.Data"),
        (matlab_object("function_handle"), "is a MATLAB object (function_handle)"),
        (matlab_object("datetime"), "is a MATLAB object (datetime)"),
    ],
)
def test_a_matlab_variable_that_is_no_column_of_numbers_is_refused(
    write: Callable[[Path], None], way_out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "small.mat")
    message = refusal(command_line.small_config(tmp_path, *MAT), monkeypatch)
    assert "small.mat" in message
    assert way_out in message


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
COUNTS = np.round(1500 * W)
WRAPPED = (COUNTS + 2**15) % 2**16 - 2**15
ANGLE = (THETA + np.pi) % (2 * np.pi) - np.pi
IN_COUNTS = ("{column: w_1, unit: rad/s, sigma: 0.05}", "{column: w_1, unit: mrad/s, sigma: 50}")
DEG, RPM = 180 / np.pi, 30 / np.pi


@run_cases(
    "name, columns, changes, message",
    [
        ("sound", (T, THETA, W), (), None),
        ("angle in degrees", (T, DEG * THETA, W), (),
         "theta_1 grows 57.3 times as fast as w_1 says; is one of them degrees for radians"),
        ("both in degrees", (T, DEG * THETA, DEG * W), (),
         "w_1 is 57.3 times what the start values predict; was it degrees"),
        ("speed in rpm", (T, THETA, RPM * W), (), "is one of them rpm for rad/s (9.55)"),
        ("gear", (T, THETA, 8 * W), (), "is one of them a side of the gear for the other (8)"),
        ("sign", (T, THETA, -W), (), "grows -1 times as fast as w_1 says; is one of them a sign"),
        ("swapped", (T, W, THETA), (), "are the two columns swapped?"),
        ("stuck", (T, THETA, STUCK), (),
         "stuck: w_1 stays at exactly one value for 15 samples, from 2 to 2.7 s"),
        ("counter", (T, THETA, WRAPPED), (IN_COUNTS,), "2^16 counts"),
        ("turns", (T, ANGLE, W), (), "theta_1 jumps by about 6.28319, one turn"),
    ],
    ids=str,
)  # fmt: skip
def test_a_wrong_column_or_unit_is_suspected(
    name: str,
    columns: tuple[np.ndarray, ...],
    changes: tuple[Change, ...],
    message: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = place(tmp_path, table(*columns), *changes)
    monkeypatch.chdir(tmp_path)
    result = command_line.cli("check", config.name)
    assert result.status == 0, result.text
    warnings = [line for line in result.out.splitlines() if line.startswith("record, ")]
    assert (message is None) == (not warnings), result.out
    assert message is None or any(message in line for line in warnings), warnings
