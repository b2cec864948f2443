"""What users get wrong: each mistake is named with value, line and a way out, and costs nothing.

Mistakes in configs and records are in `bad_inputs.yaml`, whose head explains its entries.
"""

import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from scipy.io import savemat
from support import command_line, forked_command
from support.case_tables import read_table, run_cases

K_E = "k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
W_1 = "    w_1: {column: w_1, unit: rad/s, sigma: 0.05}\n"
EXAMPLE = command_line.ROOT / "configs" / "example_ties.yaml"
TIMES = np.arange(101) * 0.05
SECONDS = 15.0  # more than any config takes to be read
CASES: list[dict[str, Any]] = read_table("system/bad_inputs.yaml")

type Lines = list[str]

# Changes of the lines of the record, of which the first is the header.
ROWS: dict[str, Callable[[Lines], Lines]] = {
    "300 columns": lambda lines: [
        f"{lines[0]},{','.join(f'x_{i}' for i in range(297))}",
        *(f"{line},{','.join('1' * 297)}" for line in lines[1:]),
    ],
    "a voltage with a gap": lambda lines: [
        f"{line},{'v' if n == 1 else 'nan' if n == 4 else '8'}" for n, line in enumerate(lines, 1)
    ],
    "two columns of one name": lambda lines: ["t,w_1,w_1", *lines[1:]],
    "two rows exchanged": lambda lines: [*lines[:5], lines[6], lines[5], *lines[7:]],
    "a row twice": lambda lines: [*lines[:6], *lines[5:]],
    "a header that is a comment": lambda lines: [f"# {lines[0]}", *lines[1:]],
    "a header with semicolons": lambda lines: [lines[0].replace(",", ";"), *lines[1:]],
    "turned around": lambda lines: [lines[0], *lines[:0:-1]],
    "two recordings": lambda lines: [*lines, *lines[1:]],
    "two files": lambda lines: [*lines, *lines],
    "units of which one is 1": lambda lines: [lines[0], "s,rad,1", *lines[1:]],
    "on its side": lambda lines: [
        ",".join(column) for column in zip(*(x.split(",") for x in lines), strict=True)
    ],
    "a footer": lambda lines: [*lines, "End of file"],
    "zeros at the end": lambda lines: [*lines, "\0" * 500],
}

# What stands in a MATLAB file as w_1, or the bytes of the whole file.
MATLAB: dict[str, Any] = {
    "missing": {},
    "misspelt": {"w1": TIMES},
    "struct": {"w_1": {"value": TIMES}},
    "cell array": {"w_1": np.array([1, "a"], dtype=object)},
    "two columns": {"w_1": np.stack([TIMES, TIMES], 1)},
    "short": {"w_1": TIMES[:50]},
    "long": {"w_1": np.arange(200.0)},
    "sparse": {"w_1": scipy.sparse.csc_matrix(TIMES[:, None])},
    "damaged v7.3": b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(100),
    "damaged v5": b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM\x0e\x00\x00\x00",
    "text": b"t,w_1\n0,1\n",
}


def rows(folder: Path, change: Callable[[Lines], Lines]) -> None:
    path = folder / "small.csv"
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")


def cells(folder: Path, *entries: tuple[int, int, str]) -> None:
    """Change cells; lines are counted from 1, as an editor does, and columns from 0."""

    def change(lines: Lines) -> Lines:
        table = [line.split(",") for line in lines]
        for line, column, text in entries:
            table[line - 1][column] = text
        return [",".join(row) for row in table]

    rows(folder, change)


def speeds(folder: Path, form: str) -> None:
    """Write every speed anew, by its `cell` and the number `n` of its line, from 2."""

    def change(lines: Lines) -> Lines:
        parts = [line.rpartition(",") for line in lines[1:]]
        cells = (form.format(n=n, cell=cell) for n, (_, _, cell) in enumerate(parts, 2))
        return [lines[0], *(f"{row},{cell}" for (row, *_), cell in zip(parts, cells, strict=True))]

    rows(folder, change)


def times(folder: Path, form: str) -> None:
    """Write every time `t` anew: with its row `n`, a second `earlier`, in `days`, as `unix` seconds."""

    def change(lines: Lines) -> Lines:
        out = [lines[0]]
        for n, line in enumerate(lines[1:]):
            cell, _, rest = line.partition(",")
            t = float(cell)
            ways = {"t": t, "n": n, "earlier": t - 1, "days": 46000 + t / 86400, "unix": 1.7e9 + t}
            out.append(f"{form.format(**ways)},{rest}")
        return out

    rows(folder, change)


def marks(folder: Path, delimiter: str, decimal: str) -> None:
    """Write cells and decimals with other marks, and a hash as a comma."""
    names = str.maketrans({",": delimiter})
    numbers = str.maketrans({",": delimiter, ".": decimal, "#": ","})
    rows(folder, lambda x: [x[0].translate(names), *(line.translate(numbers) for line in x[1:])])


def rename(folder: Path, name: str) -> None:
    (folder / "small.csv").rename(folder / name)
    command_line.replace_text(folder / "small.yaml", "small.csv", name)


def matlab(folder: Path, kind: str) -> None:
    content, path = MATLAB[kind], folder / "small.mat"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        savemat(path, {"t": TIMES, "theta_1": np.sin(TIMES), **content})


def remove(folder: Path, name: str) -> None:
    (folder / name).unlink()


def replaced_by_a_folder(folder: Path, name: str) -> None:
    remove(folder, name)
    (folder / name).mkdir()


def content(name: str) -> Callable[[Path, str], object]:
    """Another content of a file; every character of the table is a byte."""
    return lambda folder, text: (folder / name).write_bytes(text.encode("latin-1"))


SPOIL: dict[str, Callable[[Path, Any], object]] = {
    "remove": remove,
    "folder": replaced_by_a_folder,
    "config": content("small.yaml"),
    "record": content("small.csv"),
    "rows": lambda folder, name: rows(folder, ROWS[name]),
    "head": lambda folder, count: rows(folder, lambda lines: lines[:count]),
    "cells": lambda folder, entries: cells(folder, *entries),
    "speeds": speeds,
    "times": times,
    "marks": lambda folder, both: marks(folder, *both),
    "rename": rename,
    "mat": matlab,
}


def long(text: str) -> str:
    """Write out what the table says a number of times."""
    return re.sub(r"<(\d+) times (.+?)>", lambda m: int(m[1]) * m[2], text)


def make(folder: Path, case: dict[str, Any]) -> None:
    """Write the good experiment, or the example of formulas, with the case's mistake."""
    if "example" in case:
        text = EXAMPLE.read_text().replace("records/", f"{EXAMPLE.parent}/records/")
        for old, new in case["example"]:
            assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the config"
            text = text.replace(old, new)
        (folder / "small.yaml").write_text(text)
        return
    changes = [(long(old), long(new)) for old, new in case.get("replace", ())]
    if "prior" in case:
        changes.append(prior(case["prior"]))
    if "w_1" in case:
        changes.append((W_1, f"    w_1: {{{long(case['w_1'])}}}\n"))
    if "before_map" in case:
        changes.append(("map: {", f"{long(case['before_map'])}\nmap: {{"))
    if "mat" in case:
        changes.append(("file: small.csv", "file: small.mat"))
        changes += [(f"{{column: {x},", f"{{variable: {x},") for x in ("t", "theta_1", "w_1")]
    command_line.small_config(folder, *changes)
    for name, spoil in SPOIL.items():
        if name in case:
            spoil(folder, case[name])


def prior(text: str) -> tuple[str, str]:
    return (K_E, f"k_e: {{{text}}}")


def label(folder: Path, at: str | None) -> str:
    """`small.yaml:<line>` of the one line of the config that holds `at`."""
    if at is None:
        return "small.yaml"
    lines = (folder / "small.yaml").read_text(encoding="utf-8").split("\n")
    numbers = [number for number, line in enumerate(lines, start=1) if long(at) in line]
    assert len(numbers) == 1, f"{at!r} in lines {numbers}"
    return f"small.yaml:{numbers[0]}:"


def assert_a_message(result: command_line.CommandResult) -> None:
    """Status 2, and on stderr what fits one screen; nothing on stdout."""
    assert result.status == 2, result.text
    assert result.out == ""
    assert "Traceback" not in result.err
    lines = result.err.splitlines()
    assert 1 <= len(lines) <= 24
    assert max(map(len, lines)) <= 400


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, which is empty."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def messages() -> list[str]:
    """Return the lines of `bayesdrill check` of a config that is wrong."""
    result = command_line.cli("check", "small.yaml")
    assert_a_message(result)
    return result.err.splitlines()


@run_cases("case", CASES, ids=lambda case: case["name"])
def test_a_mistake_is_named_with_its_place_and_a_way_out(
    case: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, case)
    monkeypatch.chdir(tmp_path)
    before = command_line.listing(tmp_path)
    place = label(tmp_path, case.get("at"))
    # Both commands begin with `bd.load`, so every tenth case is enough for the second of them.
    for command in ("check", "posterior")[CASES.index(case) % 10 > 0 :]:
        start = time.monotonic()
        result = command_line.cli(command, "small.yaml")
        assert time.monotonic() - start < SECONDS
        assert_a_message(result)
        assert result.err.startswith(place), result.err
        for fragment in case["says"]:
            assert fragment in result.err
        lines = len(result.err.splitlines())
        assert lines == case.get("messages", lines)
        assert command_line.listing(tmp_path) == before


def test_a_mistake_ends_a_real_process_without_a_traceback(tmp_path: Path) -> None:
    (case,) = (case for case in CASES if case["name"] == "NaN")
    make(tmp_path, case)
    before = command_line.listing(tmp_path)
    result = command_line.run_process("posterior", "small.yaml", cwd=tmp_path)
    assert_a_message(result)
    assert result.err.startswith(label(tmp_path, case.get("at")))
    assert command_line.listing(tmp_path) == before


def test_a_config_given_with_its_folder_is_named_with_its_folder(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig", ("k_T: nominal", "k_t: nominal"))
    result = command_line.cli("check", os.path.relpath(config))
    assert result.err.startswith(f"{os.path.relpath(config)}:15: ")


def test_all_mistakes_of_a_config_come_at_once(here: Path) -> None:
    rows = command_line.REFUSALS["together"]
    command_line.small_config(here, *((old, new) for old, new, *_ in rows))
    for line, (*_, at, words) in zip(messages(), rows, strict=True):
        assert line.startswith(label(here, at)), line
        assert words in line


def test_more_mistakes_than_a_screen_holds_are_counted(here: Path) -> None:
    unknown = "\n".join(["seed: 7", *(f"x_{i}: 1" for i in range(40))])
    command_line.small_config(here, ("seed: 7", unknown))
    assert messages()[-1] == "... and 25 more"


def test_all_mistakes_of_a_record_come_at_once(here: Path) -> None:
    """A column that is missing hides no other one, be it that of the times."""
    command_line.small_config(
        here, ("{column: theta_1", "{column: theta1"), ("v: 8.0", "v: {column: u, unit: V}")
    )
    cells(here, (5, 0, "nan"), (6, 2, "nan"))
    text = "\n".join(messages())
    for fragment in ("record.time", "line 5", "'theta1'", "line 6", "inputs.v.column"):
        assert fragment in text
    command_line.small_config(here, ("column: t,", "column: time,"), ("column: w_1", "column: w1"))
    text = "\n".join(messages())
    assert "no column 'time'" in text
    assert "no column 'w1'" in text


@run_cases("command, words", command_line.REFUSALS["misuse"])
def test_misuse_of_the_command_line_costs_nothing(command: str, words: str, here: Path) -> None:
    command_line.small_config(here)
    before = command_line.listing(here)
    campaign = command_line.ROOT / "configs" / "campaign" / "shaft.yaml"
    result = command_line.cli(
        *(word.replace("CAMPAIGN", str(campaign)) for word in command.split())
    )
    assert_a_message(result)
    assert words in result.err
    assert command_line.listing(here) == before


@run_cases("command", ["check", "init", "verify", "simulate"])
@run_cases("kind", ["a device", "a pipe", "a link to a pipe"])
def test_a_device_or_a_pipe_is_no_config_and_no_record(
    kind: str, command: str, tmp_path: Path
) -> None:
    """Opening a pipe would wait until somebody writes."""
    path = tmp_path / ("small.csv" if command == "init" else "run.json")
    if kind == "a device":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(pipe := path.with_name("pipe") if "link" in kind else path)
        if pipe != path:
            path.symlink_to(pipe)
    arguments = [command, tmp_path if command == "verify" else path]
    ended = forked_command.ran(arguments, tmp_path, SECONDS)
    assert (ended.status, ended.hung, ended.traceback) == (2, False, False)
    assert ended.text.count("\n") == 1
    assert f"{path.name}: is a device or a pipe, which may have no end; give a file" in ended.text


@run_cases("kind", ["a device", "a pipe", "a large file", "standard input"])
def test_a_record_without_an_end_is_not_read(kind: str, tmp_path: Path) -> None:
    record = tmp_path / "small.csv"
    name = "/dev/stdin" if kind == "standard input" else "small.csv"
    config = command_line.small_config(
        tmp_path, ("file: small.csv", f"file: {name}\n  format: csv")
    )
    record.unlink()
    read, write = os.pipe()  # nobody writes to it, and nobody closes it
    terminal = os.dup(0)
    try:
        os.dup2(read, 0)
        if kind == "a device":
            record.symlink_to("/dev/zero")
        elif kind == "a pipe":
            os.mkfifo(record)
        elif kind == "a large file":
            with record.open("wb") as file:
                file.truncate(2_000_000_000)
        ended = forked_command.ran(["check", config], tmp_path, SECONDS)
    finally:
        os.dup2(terminal, 0)
        for descriptor in (read, write, terminal):
            os.close(descriptor)
    assert (ended.status, ended.hung) == (2, False)
    assert "small.yaml:4" in ended.text
    assert ("at most 1000 MB" if kind == "a large file" else "give a file") in ended.text


def test_a_long_config_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text("#" * 200_000)
    result = command_line.cli("check", tmp_path / "long.yaml")
    command_line.assert_refused(result, "holds more than 100 kB")
