"""Records as they come: each odd file is read as it was meant, refused with a way out, or suspected.

Plain mistakes, such as a missing column, are in `bad_inputs.yaml`.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse
from scipy.io import savemat
from support import command_line
from support.case_tables import run_cases

import bayesdrill as bd

LINES = command_line.small_record().splitlines()
HEADER, BODY = LINES[0], LINES[1:]
T, THETA, W = np.array([line.split(",") for line in BODY], dtype=float).T
TEXT = "\n".join(LINES) + "\n"

type Change = tuple[str, str]


@dataclass(frozen=True)
class Odd:
    """A file and what has to be said of it; `says` is empty where it is read as if nothing was odd."""

    name: str
    content: bytes
    says: tuple[str, ...]
    changes: tuple[Change, ...] = ()


def odd(name: str, content: str | bytes, *says: str, changes: tuple[Change, ...] = ()) -> Odd:
    return Odd(name, content.encode() if isinstance(content, str) else content, says, changes)


def table(*columns: np.ndarray, head: str = HEADER, mark: str = ",") -> str:
    rows = (mark.join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True))
    return "\n".join([head, *rows]) + "\n"


def cells(change: Callable[[int, list[str]], list[str]]) -> str:
    """Every row changed; its number is that of its line, from 2."""
    rows = (",".join(change(n, line.split(","))) for n, line in enumerate(BODY, start=2))
    return "\n".join([HEADER, *rows]) + "\n"


def last(text: Callable[[int, str], str]) -> str:
    return cells(lambda n, row: [*row[:2], text(n, row[2])])


def first(text: Callable[[float], str]) -> str:
    return cells(lambda _, row: [text(float(row[0])), *row[1:]])


def at_line_9(cell: str) -> str:
    return last(lambda n, usual: cell if n == 9 else usual)


def lines(*text: str) -> str:
    return "\n".join(text) + "\n"


def semicolons(decimal: str, speed: Callable[[int], str]) -> str:
    rows = [
        f"{t:.2f};{angle:.6f};".replace(".", decimal) + speed(n)
        for n, (t, angle) in enumerate(zip(T, THETA, strict=True))
    ]
    return lines(HEADER.replace(",", ";"), *rows)


AS_MEANT = [
    odd("UTF-16 without a mark", TEXT.encode("utf-16-le")),
    odd(
        "decimal commas in quotes between commas",
        lines(*(",".join(f'"{c.replace(".", ",")}"' for c in line.split(",")) for line in LINES)),
    ),
    odd(
        "rows of units and kinds", lines(HEADER, "[s],[rad],[rad/s]", "double,double,double", *BODY)
    ),
    odd("comment lines", lines("# rig 3", "% run 1", *LINES[:30], "# pause", *LINES[30:])),
    odd("CRCRLF line ends", TEXT.replace("\n", "\r\r\n")),
    odd("header in single quotes", TEXT.replace(HEADER, "'t','theta_1','w_1'")),
    odd("blanks in the header", TEXT.replace(HEADER, " t , theta_1 ,\u00a0w_1 ")),
    odd("title above the header", lines("LabVIEW Measurement", "Operator: A. B.", "", *LINES)),
    odd(
        "head of an EPOS recorder, units below the names",
        lines(
            *("Date:;2020-07-08", "Index:;0x30D3;0x30D2;0x0000", "Sampling period:;51.2"),
            *(HEADER.replace(",", ";"), "s;rad;rad/s", *(row.replace(",", ";") for row in BODY)),
        ),
    ),
    odd(
        "commas behind cells of a spreadsheet",
        lines(*(f"{row.replace(',', ';')},," for row in LINES)),
    ),
    odd("powers of Fortran", last(lambda _, cell: f"{cell}D+00")),
    odd("true minus signs", TEXT.replace("-", "\u2212")),
    odd(
        "blank cells in a column that is not used",
        lines(f"{HEADER},note", *(f"{line},NA" for line in BODY)),
    ),
]

DATES = ("dates and times of day are not read", "time: {rate: ...}")
THOUSANDS = ("line 2: column 'w_1'", "thousands separators are not read", "without them")
MISSING = ("column 'w_1' has 1 value without a number, at line 9", "mend or cut")

REFUSED = [
    odd("Inf", at_line_9("Inf"), *MISSING),
    odd("NA", at_line_9("NA"), *MISSING),
    odd("#N/A of a spreadsheet", at_line_9("#N/A"), *MISSING),
    odd("1.#QNAN of Windows", at_line_9("1.#QNAN"), *MISSING),
    odd(
        "decimal commas between commas",
        TEXT.replace(".", ","),
        "line 1: the header has 3 cells and the rows have 6",
        "decimal commas, export them with ;",
    ),
    odd("thousands separators", last(lambda n, _: f'"1,{n:03d}.5"'), *THOUSANDS),
    odd(
        "thousands separators, decimal commas",
        semicolons(".", lambda n: f"1.{n:03d},5"),
        *THOUSANDS,
    ),
    odd("blanks at the thousands", semicolons(",", lambda n: f"1 {n:03d},5"), *THOUSANDS),
    odd("apostrophes at the thousands", semicolons(".", lambda n: f"1'{n:03d}.5"), *THOUSANDS),
    odd(
        "percent signs",
        last(lambda _, cell: f"{cell} %"),
        "percent signs are not read: remove them",
    ),
    odd(
        "units in cells",
        first(lambda t: f"{t:g} s"),
        "line 2: column 't': '0 s'",
        "units do not stand in cells",
    ),
    odd(
        "degree signs in cells", last(lambda _, cell: f"{cell}\xb0"), "units do not stand in cells"
    ),
    odd(
        "complex cells",
        last(lambda _, cell: f"{cell}+0.5i"),
        "complex numbers are not read: save the real part",
    ),
    odd("hexadecimal cells", last(lambda n, _: f"0x{n:04x}"), "export decimal ones"),
    odd(
        "comment after a row",
        at_line_9("3.5 # pause"),
        "line 9",
        "a comment may only stand in a line of its own",
    ),
    odd("dates", first(lambda t: f"2026-01-01 10:00:{t:06.3f}"), *DATES),
    odd("dates in ISO 8601", first(lambda t: f"2026-01-01T10:00:{t:06.3f}Z"), *DATES),
    odd("dates with points", first(lambda t: f"01.02.2026 10:00:{t:06.3f}"), *DATES),
    odd("times of day", first(lambda t: f"10:00:{t:06.3f}"), *DATES),
    odd(
        "days of a spreadsheet",
        first(lambda t: f"{46000 + t / 86400:.9f}"),
        "may be days of a calendar",
        "save seconds since the start",
    ),
    odd(
        "seconds of Unix",
        first(lambda t: f"{1.7e9 + t:.2f}"),
        "times of a clock",
        "initial: {time: ...}",
    ),
    odd(
        "times with too few digits",
        first(lambda t: f"{t:.1f}"),
        "time does not increase, at line 4",
        "too few digits",
        "{rate: ...}",
    ),
    odd(
        "time that goes backwards",
        lines(HEADER, *BODY[::-1]),
        "each row is earlier",
        "turn the rows around",
    ),
    odd(
        "two recordings in one file",
        lines(*LINES, *BODY),
        "line 103: 5 s is followed by 0 s",
        "a second recording",
        "cut it off",
    ),
    odd(
        "two files, one header inside",
        lines(*LINES, *LINES),
        "line 103: column 't': 't' is not a number",
        "mend the cells",
    ),
    odd(
        "units of which one is 1",
        lines(HEADER, "s,rad,1", *BODY),
        "line 2: column 't': 's'",
        "not one of the record, remove it",
    ),
    odd(
        "header with semicolons",
        TEXT.replace(HEADER, "t;theta_1;w_1"),
        "names stand between ';'",
        "write both the same way",
    ),
    odd(
        "row numbers without a name",
        lines(HEADER, *(f"{n},{line}" for n, line in enumerate(BODY))),
        "row numbers, give it a name",
    ),
    odd(
        "table on its side",
        lines(
            *(
                ",".join([n, *(f"{x:g}" for x in v)])
                for n, v in (("t", T), ("theta_1", THETA), ("w_1", W))
            )
        ),
        "lies on its side; transpose it",
    ),
    odd("footer", lines(*LINES, "End of file"), "line 103: 1 cells where 3 are due", "remove them"),
    odd("blank lines", b" \n\n \n", "only blank lines and comments"),
    odd(
        "zeros where writing was cut",
        TEXT.encode() + bytes(500),
        "line 103",
        "holds bytes that are no text",
        "remove them",
    ),
    odd(
        "old spreadsheet named .csv",
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100),
        "is a spreadsheet (.xls)",
        "export it as CSV",
    ),
    odd("gzip named .csv", gzip.compress(TEXT.encode()), "is compressed (gzip)", "unpack it"),
    odd("Parquet named .csv", b"PAR1" + bytes(100), "is a Parquet file", "ending .parquet"),
    odd("web page", "<!DOCTYPE html>\n<html></html>\n", "is a web page or XML", "export it as CSV"),
    odd("JSON", '{"t": [0, 1], "w_1": [1, 2]}\n', "is JSON", "export it as CSV"),
    odd(
        "pointer of Git LFS",
        "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 9\n",
        "git lfs pull",
    ),
]


def place(folder: Path, one: Odd, name: str = "small.csv") -> Path:
    config = command_line.small_config(folder, *one.changes)
    (folder / name).write_bytes(one.content)
    return config


def refusal(config: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(config.parent)
    ran = command_line.cli("check", config.name)
    assert ran.status == 2, ran.text
    assert ran.out == ""
    assert "Traceback" not in ran.err
    return ran.err


@run_cases("one", AS_MEANT, ids=lambda one: one.name)
def test_odd_spelling_is_read_as_it_was_meant(one: Odd, tmp_path: Path) -> None:
    experiment = bd.load(place(tmp_path, one)).job.problem.experiment
    np.testing.assert_array_equal(experiment.t, T)
    np.testing.assert_array_equal(experiment.y, np.column_stack([THETA, W]))


@run_cases("one", REFUSED, ids=lambda one: one.name)
def test_what_may_mean_two_things_is_refused_with_a_way_out(
    one: Odd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = refusal(place(tmp_path, one), monkeypatch)
    assert "small.csv" in said or "small.yaml" in said
    for words in one.says:
        assert words in said


@run_cases(
    "name, says",
    [
        ("small.csv.gz", "Unpack the file first"),
        ("small.xlsx", "Export the spreadsheet as CSV"),
        ("small.tdms", "Export the recording as CSV or .mat"),
        ("small.npy", "numpy.savez"),
    ],
)
def test_endings_of_other_programs_have_a_way_out(
    name: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = place(
        tmp_path, odd("ending", TEXT, changes=(("file: small.csv", f"file: {name}"),)), name
    )
    assert says in refusal(config, monkeypatch)


# --- MATLAB ----------------------------------------------------------------------------------------

MAT = (
    ("file: small.csv", "file: small.mat"),
    ("{column: t,", "{variable: t,"),
    ("{column: theta_1", "{variable: theta_1"),
    ("{column: w_1", "{variable: w_1"),
)


def v5(w_1: object) -> Callable[[Path], None]:
    return lambda path: savemat(path, {"t": T, "theta_1": THETA, "w_1": w_1})


def v73(kind: str) -> Callable[[Path], None]:
    """What MATLAB leaves of an object that only it can open."""

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
    "write, says",
    [
        (v5(scipy.sparse.csc_matrix(W[:, None])), "is sparse; save full(...) of it"),
        (v73("timetable"), "y = w_1.Variables; save('run.mat', 'y')"),
        (v73("table"), "y = w_1.Variables; save('run.mat', 'y')"),
        (v73("timeseries"), "y = w_1.Data"),
        (v73("function_handle"), "is a MATLAB object (function_handle)"),
        (v73("datetime"), "is a MATLAB object (datetime)"),
    ],
)
def test_what_is_no_column_of_numbers_in_matlab(
    write: Callable[[Path], None], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "small.mat")
    said = refusal(command_line.small_config(tmp_path, *MAT), monkeypatch)
    assert "small.mat" in said
    assert says in said


# --- suspicions ------------------------------------------------------------------------------------

RUN = 40  # where a fault begins
STUCK = np.where((np.arange(len(T)) >= RUN) & (np.arange(len(T)) < RUN + 15), W[RUN], W)
COUNTS = np.round(1500 * W)
WRAPPED = (COUNTS + 2**15) % 2**16 - 2**15
ANGLE = (THETA + np.pi) % (2 * np.pi) - np.pi
IN_COUNTS = ("{column: w_1, unit: rad/s, sigma: 0.05}", "{column: w_1, unit: mrad/s, sigma: 50}")


@run_cases(
    "columns, changes, says",
    [
        ((T, THETA, W), (), None),
        (
            (T, THETA * 180 / np.pi, W),
            (),
            "theta_1 grows 57.3 times as fast as w_1 says; is one of them degrees for radians",
        ),
        (
            (T, THETA * 180 / np.pi, W * 180 / np.pi),
            (),
            "w_1 is 57.3 times what the start values predict; was it degrees",
        ),
        ((T, THETA, W * 30 / np.pi), (), "is one of them rpm for rad/s (9.55)"),
        ((T, THETA, W * 8), (), "is one of them a side of the gear for the other (8)"),
        ((T, THETA, -W), (), "grows -1 times as fast as w_1 says; is one of them a sign"),
        ((T, W, THETA), (), "are the two columns swapped?"),
        (
            (T, THETA, STUCK),
            (),
            "stuck: w_1 stays at exactly one value for 15 samples, from 2 to 2.7 s",
        ),
        ((T, THETA, WRAPPED), (IN_COUNTS,), "2^16 counts"),
        ((T, ANGLE, W), (), "theta_1 jumps by about 6.28319, one turn"),
    ],
)
def test_what_was_read_with_a_wrong_column_or_unit_is_suspected(
    columns: tuple[np.ndarray, ...],
    changes: tuple[Change, ...],
    says: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = place(tmp_path, odd("suspected", table(*columns), changes=changes))
    monkeypatch.chdir(tmp_path)
    ran = command_line.cli("check", config.name)
    assert ran.status == 0, ran.text
    found = [line for line in ran.out.splitlines() if line.startswith("record, ")]
    assert (says is None) == (not found), ran.out
    assert says is None or any(says in line for line in found), found


FEWER = ("max_steps: 500", "max_steps: 100")
LOOSE = ("w_1, unit: rad/s, sigma: 0.05", "w_1, unit: rad/s, sigma: 5")


def test_a_run_says_what_it_suspects_beside_its_results(tmp_path: Path) -> None:
    stuck = odd("stuck", table(T, THETA, STUCK), changes=(FEWER, LOOSE))
    outcome = bd.load(place(tmp_path, stuck)).run(tmp_path / "run")
    notes = json.loads((outcome.folder / "run.json").read_text(encoding="utf-8"))["notes"]
    assert [one for one in notes if one.startswith("note: record, stuck: w_1 stays")]
    assert "stuck: w_1 stays at exactly one value" in outcome.summary
