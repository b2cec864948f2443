"""What nobody needs of a rig ends in one line, at once: nothing that a config can say takes for ever."""

from __future__ import annotations

import json
import os
import time
from itertools import pairwise
from pathlib import Path

import forked
import h5py
import numpy as np
import pytest
import systems
from together import together

from bayesdrill.record.formats import matlab

SECONDS = 15.0
NESTED = "\n".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in pairwise("abcdefghi"))
BOMB = f"a: &a [x, x, x, x, x, x, x, x, x]\n{NESTED}\nname: small"
UNIT = ("theta_1: {column: theta_1, unit: rad", "theta_1: {column: theta_1, unit: ")
K_E = "k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
GRID = "{duration: 5, rate: 20}"


def unit(text: str) -> tuple[str, str]:
    return UNIT[0], f"{UNIT[1]}'{text}'"


def prior(text: str) -> tuple[str, str]:
    return K_E, f"k_e: {{prior: {text}}}"


def tripled() -> list[tuple[str, str]]:
    """Formulas of formulas, each 60 times the one before."""
    chain = ["j_m", "k_T", "r_m", "k_s", "l_m", "k_e"]
    return [
        (f"{one}: nominal", f"{one}: {'*'.join([other] * 60)}") for one, other in pairwise(chain)
    ]


LIMITS = {
    "aliases that multiply": ([("name: small", BOMB)], "more than 5000 entries"),
    "a tag that does not suit": ([("seed: 7", "seed: !!bool maybe")], "cannot be read as bool"),
    "an empty number": ([("seed: 7", "seed: !!int ''")], "small.yaml:2: "),
    "a date that is none": ([("seed: 7", "seed: 2001-99-99")], "small.yaml:2: "),
    "thousands of digits": ([("v: 8.0", f"v: 0x{'f' * 6000}")], "a number of 6002 digits"),
    "a seed beyond 64 bits": ([("seed: 7", f"seed: {2**64}")], "seed"),
    "NUL in a path": ([("file: small.csv", 'file: "a\\0b.csv"')], "a NUL"),
    "half a character": ([("file: small.csv", 'file: "\\ud800.csv"')], "half a character"),
    "a long name": ([("name: small", f"name: {'x' * 3000}")], "at most 2000"),
    "a name of 300 letters": ([("name: small", f"name: {'x' * 300}")], "100 characters"),
    "a long key": ([("k_T: nominal", f"k_T: nominal\n  {'x' * 300}: 1")], "at most 100"),
    "a power tower": ([unit("9**9**9")], "cannot be read"),
    "a hidden power tower": ([unit("rad*(m/m)**2**9**9**9")], "cannot be read"),
    "superscripts": ([unit("9²²²²²²²²²*rad")], "cannot be read"),
    "an endless unit": ([unit("rad" * 600)], "cannot be read"),
    "an endless latex": (
        [("map: {", f"derived: {{q: {{formula: k_e, latex: '{'x' * 1900}'}}}}\nmap: {{")],
        "at most 200 characters",
    ),
    "250 terms": ([("k_T: nominal", f"k_T: {'+'.join(['k_e'] * 250)}")], "more than 100 terms"),
    "formulas that multiply": (tripled(), "more than 100 terms"),
    "a tiny prior": ([prior("half_normal, scale: 1e-150")], "greater than or equal to 1e-30"),
    "a huge prior": ([prior("half_normal, scale: 1e308")], "less than or equal to 1e+30"),
    "sd_log": ([prior("log_normal, median: 0.06, sd_log: 1000")], "less than or equal to 20"),
    "no width": ([prior("normal, mean: 0.06, sd: 1e-17")], "hold the value as a number"),
    "no mass": (
        [prior("truncated_normal, mean: 0.06, sd: 0.001, low: 10, high: 20, start: 15")],
        "hold the value as a number",
    ),
    "a huge load": ([("v: 8.0", "v: 8.0\n  t_1: 1e18")], "times the noise off the record"),
    "a tiny sigma": ([("w_1, unit: rad/s, sigma: 0.05", "w_1, unit: rad/s, sigma: 1e-29")], "off"),
    "an endless duration": ([(GRID, "{duration: 1e18, rate: 20}")], "samples of 2 channels"),
    "an endless rate": ([(GRID, "{duration: 5, rate: 1e18}")], "samples of 2 channels"),
    "pieces": (
        [("map: {", "model: {name: motor_shaft, pieces: 1000000}\nmap: {")],
        "less than or equal to 1000",
    ),
    "starts": ([("starts: 1", "starts: 1000000000")], "less than or equal to 1000"),
    "predictive draws": (
        [("predictive_draws: 10", "predictive_draws: 1000000000")],
        "less than or equal to 1000000",
    ),
    "ensembles": (
        [("walkers: 8", "walkers: 8, ensembles: 1000000")],
        "all that a chain may hold",
    ),
}


@together("name", LIMITS)
def test_what_nobody_needs_is_one_line_at_once(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes, says = LIMITS[name]
    systems.small(tmp_path, *changes)
    monkeypatch.chdir(tmp_path)
    before, begun = systems.listing(tmp_path), time.monotonic()
    ran = systems.cli("check", "small.yaml")
    assert time.monotonic() - begun < SECONDS
    assert ran.status == 2, ran.text
    assert says in ran.err
    assert max(map(len, ran.err.splitlines())) <= 400
    assert systems.listing(tmp_path) == before


@together("command", ["check", "init", "verify", "simulate"])
@together("behind", ["a device", "a pipe", "a link to a pipe"])
def test_what_has_no_end_is_no_config_and_no_record(
    behind: str, command: str, tmp_path: Path
) -> None:
    """Mutant killed: a pipe is opened, which waits until somebody writes."""
    path = tmp_path / ("small.csv" if command == "init" else "run.json")
    if behind == "a device":
        path.symlink_to("/dev/zero")
    else:
        os.mkfifo(pipe := path.with_name("pipe") if "link" in behind else path)
        if pipe != path:
            path.symlink_to(pipe)
    ended = forked.ran([command, tmp_path if command == "verify" else path], tmp_path, SECONDS)
    assert (ended.status, ended.hung, ended.traceback) == (2, False, False)
    assert ended.text.count("\n") == 1
    assert f"{path.name}: is a device or a pipe, which may have no end; give a file" in ended.text


def test_standard_input_is_no_record(tmp_path: Path) -> None:
    """A pipe that nobody writes to, and nobody closes."""
    config = systems.small(tmp_path, ("file: small.csv", "file: /dev/stdin\n  format: csv"))
    out, into = os.pipe()
    before = os.dup(0)
    try:
        os.dup2(out, 0)
        ended = forked.ran(["check", config], tmp_path, SECONDS)
    finally:
        os.dup2(before, 0)
        for one in (out, into, before):
            os.close(one)
    assert (ended.status, ended.hung) == (2, False)
    assert "give a file" in ended.text


def test_a_long_config_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text("#" * 200_000)
    ran = systems.cli("check", tmp_path / "long.yaml")
    assert ran.status == 2
    assert "holds more than 100 kB" in ran.err


def test_groups_that_hold_each_other_twice_are_walked_once(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "nested.mat", "w") as file:
        group = file.create_group("top")
        for _ in range(26):
            inner = group.create_group("a")
            group["b"] = inner
            group = inner
        file["t"] = np.arange(3.0)
    table = matlab.read(tmp_path / "nested.mat")
    assert set(table.variables) == {"t"}
    assert any("second name" in why for why in table.ignored.values())


def test_times_of_a_clock_ask_for_the_initial_time(tmp_path: Path) -> None:
    config = systems.small(tmp_path)
    first, *rows = (tmp_path / "small.csv").read_text().splitlines()
    moved = [f"{float(t) + 1.7e9:.3f},{more}" for t, more in (row.split(",", 1) for row in rows)]
    (tmp_path / "small.csv").write_text("\n".join([first, *moved]) + "\n")
    ran = systems.cli("check", config)
    assert ran.status == 2
    assert "1700000000 s" in ran.err
    assert "initial: {time: ...}" in ran.err


def test_a_header_that_is_a_comment_is_named(tmp_path: Path) -> None:
    config = systems.small(tmp_path)
    text = (tmp_path / "small.csv").read_text()
    (tmp_path / "small.csv").write_text(f"# {text}")
    ran = systems.cli("check", config)
    assert ran.status == 2
    assert "begins with '#'" in ran.err


def test_two_samples_are_a_record(tmp_path: Path) -> None:
    config = systems.small(tmp_path)
    rows = (tmp_path / "small.csv").read_text().splitlines()[:3]
    (tmp_path / "small.csv").write_text("\n".join(rows) + "\n")
    assert systems.cli("check", config).status == 0


@pytest.mark.slow
def test_the_size_is_said_before_and_fewer_draws_are_predicted_of_a_long_record(
    tmp_path: Path,
) -> None:
    """Twelve of each of two ensembles are room for as many as are asked for, but not for tails."""
    config = systems.small(tmp_path, ("duration: 5, rate: 20", "duration: 5, rate: 40000"))
    systems.simulated(config)
    ran = systems.cli("check", config)
    assert ran.status == 0, ran.text
    assert "size at most: chain 0.384 MB (500 steps), 10 predictive draws" in ran.out
    config.write_text(config.read_text().replace("predictive_draws: 10", "predictive_draws: 125"))
    ran = systems.cli("check", config)
    assert "no predictive draws: 125 of each ensemble are too many" in ran.out
    config.write_text(config.read_text().replace("rate: 40000", "rate: 16000"))
    systems.simulated(config)
    ran = systems.cli("check", config)
    assert "31 predictive draws of each ensemble" in ran.out
    assert "not 125" in ran.out


@together("content", [b"\xff\xfe\x80", b"[" * 100_000, b"[]", b'{"values": {"k_e": NaN}}', b"{}"])
@together("name", ["run.json", "map.json"])
def test_a_damaged_file_of_a_run_is_named(content: bytes, name: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"fingerprint": {}}))
    (folder / name).write_bytes(content)
    ran = systems.cli("report", folder)
    assert ran.status == 2
    assert "Traceback" not in ran.text


@together("what", ["a device", "a pipe", "a large file"])
def test_a_record_that_has_no_end_is_not_read(what: str, tmp_path: Path) -> None:
    """Mutant killed: whatever `file:` names is opened, and waited for."""
    config = systems.small(tmp_path, ("file: small.csv", "file: small.csv\n  format: csv"))
    record = tmp_path / "small.csv"
    record.unlink()
    if what == "a device":
        record.symlink_to("/dev/zero")
    elif what == "a pipe":
        os.mkfifo(record)
    else:
        with record.open("wb") as file:
            file.truncate(2_000_000_000)
    ran = systems.cli("check", config)
    assert ran.status == 2
    assert "small.yaml:4" in ran.err
    assert ("at most 1000 MB" if what == "a large file" else "give a file") in ran.err


HEAD = "t,w_1\n" + "\n".join(f"{k / 100},{k % 7}" for k in range(40))
ENDLESS = {
    "one line": "1.5," * 1_500_000,
    "one cell": f"{HEAD}\n0.4,{'1' * 6_000_000}\n",
    "one head": HEAD.replace("w_1", "w [" * 2_000_000),
    "digits": HEAD.replace(",3", f",{'3' * 190_000}"),
    "brackets": "t w" + " [x" * 60_000 + "\n" + "1 2\n" * 30,
    "blanks": HEAD.replace("w_1", f"w{' ' * 190_000}["),
    "5,000 columns": ",".join(f"x_{k}" for k in range(5000)) + ("\n" + "1,2,3,4," * 1250) * 30,
}
SAYS = {
    **dict.fromkeys(("one line", "one cell", "one head"), "at most 200000 are read"),
    "digits": "is not a number",
    "5,000 columns": "300 columns at most",
}


@together("name", ENDLESS)
def test_init_looks_at_no_table_for_ever(name: str, tmp_path: Path) -> None:
    """Processor time, of which each took minutes: pairs of columns, digits, brackets that are open."""
    (tmp_path / "odd.csv").write_text(ENDLESS[name])
    begun = time.process_time()
    ran = systems.cli("init", tmp_path / "odd.csv")
    assert time.process_time() - begun < SECONDS
    assert ran.status == 2
    assert SAYS.get(name, "odd.csv") in ran.err
    assert max(map(len, ran.err.splitlines())) <= 400


def test_columns_that_may_be_anything_are_paired_in_seconds(tmp_path: Path) -> None:
    """Each may be the derivative of each; kills fitting every pair anew, 40 us and more each."""
    walks = np.cumsum(np.random.default_rng(1).standard_normal((200, 5000)), axis=1)
    np.savez(tmp_path / "walks.npz", **{f"x_{k}": one for k, one in enumerate(walks)})
    begun = time.process_time()
    ran = systems.cli("init", tmp_path / "walks.npz")
    assert time.process_time() - begun < SECONDS
    assert (ran.status, "nothing says" in ran.err or "its name does not say" in ran.err) == (
        2,
        True,
    )


@together("what", ["samples", "bytes"])
def test_init_says_how_much_it_looks_at(what: str, tmp_path: Path) -> None:
    path = tmp_path / "long.npz"
    if what == "samples":
        np.savez_compressed(path, t=np.arange(1e6 + 1), w_1=np.zeros(1_000_001))
    else:
        with path.open("wb") as file:
            file.truncate(200_000_000)
    ran = systems.cli("init", path)
    says = {"samples": "looks at 1000000 samples", "bytes": "has 200 MB; at most 100 MB"}
    assert (ran.status, says[what] in ran.err) == (2, True), ran.err
    assert ran.err.count("\n") == 1


@together("command", ["posterior", "calibrate"])
def test_more_processes_than_any_machine_has_are_refused(command: str, tmp_path: Path) -> None:
    config = systems.small(tmp_path)
    ran = systems.cli(command, config, "--processes", "3000000000", "-o", tmp_path / "out")
    assert ran.status == 2
    assert "less than or equal to 256" in ran.text
    assert not (tmp_path / "out").exists()


def test_python_without_docstrings_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which ArviZ works on: a traceback as it is loaded, after minutes of sampling."""
    systems.small(tmp_path)
    monkeypatch.setenv("PYTHONOPTIMIZE", "2")
    ran = systems.run("posterior", "small.yaml", cwd=tmp_path)
    assert ran.status == 2
    assert ran.err.splitlines() == [
        "python -OO takes the docstrings away that ArviZ works on; leave -OO out"
    ]
