"""What users get wrong: each mistake is named with value, line and a way out, and costs nothing.

The mistakes are in `bad_inputs.yaml`, whose head explains its entries.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.io import savemat
from support import command_line
from support.case_tables import run_cases

K_E = "k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
J_1 = "j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
THETA_1 = "    theta_1: {column: theta_1, unit: rad, sigma: 0.05}\n"
W_1 = "    w_1: {column: w_1, unit: rad/s, sigma: 0.05}\n"
TIMES = np.arange(101) * 0.05
SECONDS = 15.0  # more than any config takes to be read
CASES: list[dict[str, Any]] = YAML(typ="safe").load(Path(__file__).with_name("bad_inputs.yaml"))

type Lines = list[str]

# Changes of the lines of the record, of which the first is the header.
ROWS: dict[str, Callable[[Lines], Lines]] = {
    "a tiny column": lambda lines: [
        lines[0],
        *(f"{line.rpartition(',')[0]},{n % 7}e-320" for n, line in enumerate(lines[1:])),
    ],
    "tiny times": lambda lines: [
        lines[0],
        *(f"{n}e-310,{line.partition(',')[2]}" for n, line in enumerate(lines[1:])),
    ],
    "a tiny step of time": lambda lines: [
        *lines[:2],
        f"1e-40,{lines[2].partition(',')[2]}",
        *lines[3:],
    ],
    "a second earlier": lambda lines: [
        lines[0],
        *(f"{float(t) - 1.0:.9g},{rest}" for t, _, rest in (x.partition(",") for x in lines[1:])),
    ],
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


def last(folder: Path, text: str) -> None:
    rows(folder, lambda lines: [lines[0], *(f"{x.rpartition(',')[0]},{text}" for x in lines[1:])])


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
    "last": last,
    "mat": matlab,
}


def long(text: str) -> str:
    """Write out what the table says a number of times."""
    return re.sub(r"<(\d+) times (.+?)>", lambda m: int(m[1]) * m[2], text)


def make(folder: Path, case: dict[str, Any]) -> None:
    """Write the good experiment with the case's mistake."""
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
    for name in SPOIL.keys() & case.keys():
        SPOIL[name](folder, case[name])


def prior(text: str) -> tuple[str, str]:
    return (K_E, f"k_e: {{{text}}}")


def label(folder: Path, at: str | None) -> str:
    """`small.yaml:<line>` of the one line of the config that holds `at`."""
    if at is None:
        return "small.yaml"
    lines = (folder / "small.yaml").read_text(encoding="utf-8").split("\n")
    found = [number for number, line in enumerate(lines, start=1) if long(at) in line]
    assert len(found) == 1, f"{at!r} in lines {found}"
    return f"small.yaml:{found[0]}:"


def assert_a_message(ran: command_line.CommandResult) -> None:
    """Status 2, and on stderr what fits one screen; nothing on stdout."""
    assert ran.status == 2, ran.text
    assert ran.out == ""
    assert "Traceback" not in ran.err
    lines = ran.err.splitlines()
    assert 1 <= len(lines) <= 24
    assert max(map(len, lines)) <= 400


def test_the_cases_are_many_and_named_once() -> None:
    assert len(CASES) >= 40
    assert len({case["name"] for case in CASES}) == len(CASES)


def test_the_good_experiment_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command_line.small_config(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = command_line.listing(tmp_path)
    ran = command_line.cli("check", "small.yaml")
    assert (ran.status, ran.err) == (0, "")
    assert "would run" in ran.out
    assert command_line.listing(tmp_path) == before


@run_cases("case", CASES, ids=lambda case: case["name"])
def test_a_mistake_is_named_with_its_place_and_a_way_out(
    case: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, case)
    monkeypatch.chdir(tmp_path)
    before = command_line.listing(tmp_path)
    place = label(tmp_path, case.get("at"))
    # Both begin with `bd.load`; that they say the same is seen of every tenth.
    for command in ("check", "posterior")[CASES.index(case) % 10 > 0 :]:
        begun = time.monotonic()
        ran = command_line.cli(command, "small.yaml")
        assert time.monotonic() - begun < SECONDS
        assert_a_message(ran)
        assert ran.err.startswith(place), ran.err
        for fragment in case["says"]:
            assert fragment in ran.err
        assert command_line.listing(tmp_path) == before


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("misspelt symbol", marks=SLOW),
        pytest.param("missing config", marks=SLOW),
        "NaN",
    ],
)
def test_a_mistake_ends_a_real_process_without_a_traceback(name: str, tmp_path: Path) -> None:
    (case,) = (case for case in CASES if case["name"] == name)
    make(tmp_path, case)
    before = command_line.listing(tmp_path)
    ran = command_line.run_process("posterior", "small.yaml", cwd=tmp_path)
    assert_a_message(ran)
    assert ran.err.startswith(label(tmp_path, case.get("at")))
    assert command_line.listing(tmp_path) == before


def test_all_mistakes_of_a_config_come_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_line.small_config(
        tmp_path,
        ("seed: 7", "seed: -7\nsampelr: {}"),
        ("unit: s}", "unit: V}"),
        (THETA_1, THETA_1.replace("0.05", "0")),
        (W_1, W_1.replace("rad/s", "radd/s")),
        ("v: 8.0", "v: 8 V"),
        ("k_T: nominal", "k_t: nominal"),
        ("r_m: nominal", "r_m: 1/3"),
        ("l_m: nominal", "l_m: {prior: unifrom, low: 1, high: 2}"),
        ("k_s: nominal", "k_s: {prior: uniform, low: 1, high: 2}"),
        (J_1, "j_1: {prior: uniform, low: 1.5, high: 0.5, relative: true}"),
        ("t_f: nominal", "t_f: nominal\n  t_f: 0.1"),
        ("walkers: 8", "walkers: 9"),
        ("map: {", "map: {method: nelder, "),
    )
    monkeypatch.chdir(tmp_path)
    wanted = [
        ("seed: -7", "seed: -7"),
        ("sampelr", "did you mean sampler?"),
        ("time:", "unit 'V' is not a unit of s"),
        ("    theta_1", "sigma: 0"),
        ("    w_1", "unit 'radd/s'"),
        ("  v:", "'8 V' is not a number"),
        ("k_t", "did you mean k_T?"),
        ("r_m", "write for example 0.333333"),
        ("l_m", "did you mean uniform?"),
        ("k_s", "is outside the prior"),
        ("j_1", "is not below high"),
        ("t_f: 0.1", "stands already in line"),
        ("map:", "did you mean nelder_mead?"),
        ("walkers: 9", "an even number"),
    ]
    ran = command_line.cli("check", "small.yaml")
    assert_a_message(ran)
    lines = ran.err.splitlines()
    assert len(lines) == len(wanted), ran.err
    for line, (at, says) in zip(lines, wanted, strict=True):
        assert line.startswith(label(tmp_path, at)), line
        assert says in line


def test_more_mistakes_than_a_screen_holds_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_line.small_config(
        tmp_path, ("seed: 7", "\n".join(["seed: 7", *(f"x_{i}: 1" for i in range(40))]))
    )
    monkeypatch.chdir(tmp_path)
    ran = command_line.cli("check", "small.yaml")
    assert_a_message(ran)
    assert ran.err.splitlines()[-1] == "... and 25 more"


def test_all_mistakes_of_a_record_come_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_line.small_config(
        tmp_path, ("{column: theta_1", "{column: theta1"), ("v: 8.0", "v: {column: u, unit: V}")
    )
    cells(tmp_path, (5, 0, "nan"), (6, 2, "nan"))
    monkeypatch.chdir(tmp_path)
    ran = command_line.cli("check", "small.yaml")
    assert_a_message(ran)
    for fragment in ("record.time", "line 5", "'theta1'", "line 6", "inputs.v.column"):
        assert fragment in ran.err


# Each of these entries is needed: without it, a mistake elsewhere has to be found all the same.
@run_cases(
    "change",
    [
        ("name: small\n", ""),
        ("seed: 7", "seed: x"),
        ("  file: small.csv\n", ""),
        ("{column: t, unit: s}", "{column: t, unit: 3}"),
        ("  channels:\n" + THETA_1 + W_1, "  channels: {}\n"),
        ("inputs:\n  v: 8.0\n", ""),
        ("v: 8.0", "v: 8 V"),
        ("k_T: nominal", "k_T: [1]"),
        ("walkers: 8", "walkers: 8.5"),
    ],
    ids=lambda change: change[0].split(":")[0].strip(),
)
def test_a_spoilt_entry_hides_no_mistake_elsewhere(
    change: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_line.small_config(tmp_path, change, prior("prior: uniform, low: 0.09, high: 0.03"))
    monkeypatch.chdir(tmp_path)
    ran = command_line.cli("check", "small.yaml")
    assert_a_message(ran)
    assert len(ran.err.splitlines()) == 2, ran.err
    assert "parameters.k_e: low 0.09 is not below high 0.03" in ran.err


def test_a_missing_time_hides_no_other_missing_column(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_line.small_config(
        tmp_path, ("column: t,", "column: time,"), ("column: w_1", "column: w1")
    )
    monkeypatch.chdir(tmp_path)
    ran = command_line.cli("check", "small.yaml")
    assert_a_message(ran)
    assert "no column 'time'" in ran.err
    assert "no column 'w1'" in ran.err


@run_cases(
    "arguments",
    [
        ["chek"],
        ["check"],
        ["check", "small.yaml", "--fast"],
        ["posterior", "small.yaml", "--processes", "0"],
        ["posterior", "small.yaml", "--processes", "two"],
        ["posterior", "small.yaml", "--resume", "--force"],
        ["simulate", "small.yaml", "--seed", "-1"],
        ["simulate", "small.yaml"],
        ["report"],
        ["report", "nowhere"],
        ["report", "small.yaml"],
        ["posterior", "small.yaml", "--output", "small.csv"],
        ["posterior", "small.yaml", "--output", "."],
        ["posterior", "small.yaml", "--output", ".", "--resume"],
    ],
    ids=" ".join,
)
def test_misuse_of_the_command_line_costs_nothing(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command_line.small_config(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = command_line.listing(tmp_path)
    ran = command_line.cli(*arguments)
    assert_a_message(ran)
    assert command_line.listing(tmp_path) == before


def test_a_config_given_with_its_folder_names_the_folder(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path / "rig", ("k_T: nominal", "k_t: nominal"))
    ran = command_line.cli("check", os.path.relpath(config))
    assert ran.err.startswith(f"{os.path.relpath(config)}:15: ")
