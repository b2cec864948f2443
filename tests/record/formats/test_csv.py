"""Text tables: one set of numbers in many spellings, and what the errors say."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.case_tables import read_table, run_cases

from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats import format_of
from bayesdrill.record.formats.csv import CsvOptions, read
from bayesdrill.record.formats.table import RecordTable

TABLE = read_table(Path(__file__).with_name("texts.yaml"))
NAMES = ("t [s]", "w_1 [rpm]", "theta")
# Unequal, off the origin, negative, with exponents and whole numbers: no column can stand in
# for another, and no mark for another.
DATA = np.array(
    [[10.0, 101.25, -3.5e-07], [10.5, 99.0, 4.75], [11.25, -98.5, 1.0 / 3.0], [12.0, 2.5e11, -7.0]]
)


def rows(delimiter: str, decimal: str = ".", end: str = "") -> list[str]:
    return [delimiter.join(repr(float(x)) for x in row).replace(".", decimal) + end for row in DATA]


def text(delimiter: str, decimal: str = ".", *, head: bool = True, end: str = "") -> str:
    first = [delimiter.join(NAMES) + end] if head else []
    return "\n".join([*first, *rows(delimiter, decimal, end)]) + "\n"


def quoted(delimiter: str, decimal: str = ".") -> bytes:
    lines = text(delimiter, decimal).splitlines()
    cells = [[f'"{cell}"' for cell in line.split(delimiter)] for line in lines]
    return "\n".join(delimiter.join(row) for row in cells).encode()


DIALECTS: dict[str, bytes] = {
    "comma": text(",").encode(),
    "comma and blank": text(", ").encode(),
    "semicolon": text(";").encode(),
    "semicolon, decimal comma": text(";", ",").encode(),
    "tab": text("\t").encode(),
    "tab, decimal comma, trailing tab": text("\t", ",", end="\t").encode(),
    "bar": text(" | ").encode(),
    "blanks": text("   ").encode(),
    "one blank, units in the header": text(" ").encode(),
    "blanks, decimal comma": text("  ", ",").encode(),
    "UTF-8 with BOM and CRLF": text(";").replace("\n", "\r\n").encode("utf-8-sig"),
    "UTF-16": text("\t").encode("utf-16"),
    "UTF-16 without a mark": text(";").encode("utf-16-le"),
    "powers of Fortran": "\n".join([",".join(NAMES), *rows(",")]).replace("e+", "D+").encode(),
    "UTF-16 big endian": b"\xfe\xff" + text(";", ",").encode("utf-16-be"),
    "old Mac line ends": text(",").replace("\n", "\r").encode(),
    "no newline at the end": text(",").rstrip().encode(),
    "comments and blank lines": ("# rig 3\n\n% run 1\n" + text(",").replace("\n", "\n\n")).encode(),
    "quoted header": text(",").replace("t [s],", '"t [s]",').replace("theta", '"theta"').encode(),
    "quoted cells": quoted(","),
    "quoted cells, decimal comma": quoted(";", ","),
    "row of units": "\n".join([";".join(NAMES), "s;rpm;", *rows(";")]).encode(),
    "trailing delimiter under the data": "\n".join([";".join(NAMES), *rows(";", end=";")]).encode(),
    "trailing delimiter in the header": "\n".join([",".join(NAMES) + ",", *rows(",")]).encode(),
    "rows of nothing at the end": (text(";") + ";;\n;;\n").encode(),
    "control-Z at the end": (text(";") + "\x1a").encode(),
}  # fmt: skip


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def load(path: Path, **options: object) -> RecordTable:
    return read(path, CsvOptions(**options))


def refusal(path: Path, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        load(path, **options)
    return str(caught.value)


@run_cases("dialect", DIALECTS)
def test_every_dialect_has_the_same_numbers(dialect: str, tmp_path: Path) -> None:
    table = load(write(tmp_path / "run.csv", DIALECTS[dialect]))
    assert tuple(table.variables) == NAMES
    np.testing.assert_array_equal(np.column_stack(list(table.variables.values())), DATA)


@run_cases("delimiter, decimal", [(",", "."), (";", ","), (" ", ","), ("\t", ".")])
def test_without_header_columns_are_numbered(delimiter: str, decimal: str, tmp_path: Path) -> None:
    table = load(write(tmp_path / "run.csv", text(delimiter, decimal, head=False)))
    assert tuple(table.variables) == ("1", "2", "3")
    np.testing.assert_array_equal(table.pick(2), DATA[:, 1])
    np.testing.assert_array_equal(table.pick("3"), DATA[:, 2])
    assert table.where(0) == "line 1"


@run_cases("case", TABLE["spellings"], lambda case: case["text"])
def test_numbers_of_a_csv_are_read_in_every_spelling(case: dict[str, Any], tmp_path: Path) -> None:
    table = load(write(tmp_path / "run.csv", case["text"]), **case.get("options", {}))
    names = [*table.variables]
    np.testing.assert_array_equal(np.column_stack(list(table.variables.values())), case["numbers"])
    assert case.get("names", names) == names


def test_a_decimal_comma_may_come_late(tmp_path: Path) -> None:
    zeros = "0;0\n" * 300
    table = load(write(tmp_path / "run.csv", f"a;b\n{zeros}0,5;1\n{zeros}"))
    assert table.pick("a")[300] == 0.5
    assert [values.sum() for values in table.variables.values()] == [0.5, 1.0]


def test_names_in_latin_1_are_kept_verbatim(tmp_path: Path) -> None:
    content = "t;Drehwinkel [°]\n1;2\n".encode("latin-1")
    assert tuple(load(write(tmp_path / "run.csv", content)).variables) == ("t", "Drehwinkel [°]")


def test_rows_are_named_by_the_line_of_the_file(tmp_path: Path) -> None:
    table = load(write(tmp_path / "run.csv", "# rig\n\nt,w\ns,rpm\n1,2\n\n# pause\n3,4\n"))
    assert [table.where(0), table.where(1)] == ["line 5", "line 8"]


@run_cases("case", TABLE["faults"], lambda case: case["text"])
def test_a_fault_is_named_with_its_line_and_a_way_out(case: dict[str, Any], tmp_path: Path) -> None:
    message = refusal(write(tmp_path / "run.csv", case["text"]), **case.get("options", {}))
    assert [words for words in ["run.csv", *case["says"]] if words not in message] == []


@run_cases(
    "content",
    [
        "user secret\nroot hunter2\nguest hunter3\n",
        "root:hunter2:0:0\nguest:hunter3:1:1\n",
        "1,hunter2,secret,other\n1,2,3,4\n",
        "t,w\n1,2\n3,hunter2,secret\n4,5\n",
        "hunter2 and secret\n1;2\n3;4\n",
        "hunter2\nhunter4\nsecret\n",
    ],
)
def test_errors_show_no_more_than_the_cell_that_failed(content: str, tmp_path: Path) -> None:
    message = refusal(write(tmp_path / "run.csv", content))
    assert "secret" not in message
    assert "hunter3" not in message


def test_five_faults_are_shown_and_the_rest_counted(tmp_path: Path) -> None:
    faulty = "t,w\n" + "".join(f"{i},{'bad' if i % 7 == 0 else i}\n" for i in range(70_000))
    with pytest.raises(InputError) as caught:
        load(write(tmp_path / "run.csv", faulty))
    assert len(caught.value.problems) == 6
    places = [problem.place.rsplit(" ", 1)[1] for problem in caught.value.problems[:5]]
    assert places == ["2", "9", "16", "23", "30"]
    assert "and 9995 more cells" in caught.value.problems[-1].message


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    write(tmp_path / "run_01.csv", text(","))
    assert "did you mean run_01.csv?" in refusal(tmp_path / "run_1.csv")
    assert "is a folder" in refusal(tmp_path)
    assert "does not exist" in refusal(tmp_path / "nowhere" / "run.csv")


def test_the_format_follows_from_the_ending() -> None:
    assert [format_of(Path(n)) for n in ("a.csv", "a.TXT", "a.tsv", "a.dat")] == ["csv"] * 4
    assert format_of(Path("a.MAT")) == "mat"
    for name, message in [("a.xlsx", ".csv, .txt, .tsv, .dat, .mat"), ("a", "no ending")]:
        with pytest.raises(InputError, match=message):
            format_of(Path(name))


_ALPHABET = st.sampled_from([*'0123456789,.;\t |"#%-eE_x\n\r naN[]', "\x00", "é", "\x85"])


@given(st.text(_ALPHABET, max_size=60), st.sampled_from([None, True, False]))
def test_any_text_is_read_or_refused(tmp_path_factory, content: str, header: bool | None) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_text(content, encoding="utf-8", newline="")
    try:
        table = load(path, header=header)
    except InputError:
        return
    lengths = {len(values) for values in table.variables.values()}
    assert lengths == {len(table.lines)}
