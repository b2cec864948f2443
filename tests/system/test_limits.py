"""Files without an end and tables of any size end at once; `bad_inputs.yaml` has such configs."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from support import command_line, forked_command
from support.case_tables import run_cases

from bayesdrill.record.formats import matlab

SECONDS = 15.0


@run_cases("command", ["check", "init", "verify", "simulate"])
@run_cases("behind", ["a device", "a pipe", "a link to a pipe"])
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
    ended = forked_command.ran(
        [command, tmp_path if command == "verify" else path], tmp_path, SECONDS
    )
    assert (ended.status, ended.hung, ended.traceback) == (2, False, False)
    assert ended.text.count("\n") == 1
    assert f"{path.name}: is a device or a pipe, which may have no end; give a file" in ended.text


def test_standard_input_is_no_record(tmp_path: Path) -> None:
    """A pipe that nobody writes to, and nobody closes."""
    config = command_line.small_config(
        tmp_path, ("file: small.csv", "file: /dev/stdin\n  format: csv")
    )
    out, into = os.pipe()
    before = os.dup(0)
    try:
        os.dup2(out, 0)
        ended = forked_command.ran(["check", config], tmp_path, SECONDS)
    finally:
        os.dup2(before, 0)
        for one in (out, into, before):
            os.close(one)
    assert (ended.status, ended.hung) == (2, False)
    assert "give a file" in ended.text


def test_a_long_config_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text("#" * 200_000)
    ran = command_line.cli("check", tmp_path / "long.yaml")
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
    config = command_line.small_config(tmp_path)
    first, *rows = (tmp_path / "small.csv").read_text().splitlines()
    moved = [f"{float(t) + 1.7e9:.3f},{more}" for t, more in (row.split(",", 1) for row in rows)]
    (tmp_path / "small.csv").write_text("\n".join([first, *moved]) + "\n")
    ran = command_line.cli("check", config)
    assert ran.status == 2
    assert "1700000000 s" in ran.err
    assert "initial: {time: ...}" in ran.err


def test_a_header_that_is_a_comment_is_named(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    text = (tmp_path / "small.csv").read_text()
    (tmp_path / "small.csv").write_text(f"# {text}")
    ran = command_line.cli("check", config)
    assert ran.status == 2
    assert "begins with '#'" in ran.err


def test_two_samples_are_a_record(tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    rows = (tmp_path / "small.csv").read_text().splitlines()[:3]
    (tmp_path / "small.csv").write_text("\n".join(rows) + "\n")
    assert command_line.cli("check", config).status == 0


@pytest.mark.slow
def test_the_size_is_said_before_and_fewer_draws_are_predicted_of_a_long_record(
    tmp_path: Path,
) -> None:
    """Twelve of each of two ensembles are room for as many as are asked for, but not for tails."""
    config = command_line.small_config(
        tmp_path, ("duration: 5, rate: 20", "duration: 5, rate: 40000")
    )
    command_line.simulate_again(config)
    ran = command_line.cli("check", config)
    assert ran.status == 0, ran.text
    assert "size at most: chain 0.384 MB (500 steps), 10 predictive draws" in ran.out
    config.write_text(config.read_text().replace("predictive_draws: 10", "predictive_draws: 125"))
    ran = command_line.cli("check", config)
    assert "no predictive draws: 125 of each ensemble are too many" in ran.out
    config.write_text(config.read_text().replace("rate: 40000", "rate: 16000"))
    command_line.simulate_again(config)
    ran = command_line.cli("check", config)
    assert "31 predictive draws of each ensemble" in ran.out
    assert "not 125" in ran.out


@run_cases("content", [b"\xff\xfe\x80", b"[" * 100_000, b"[]", b'{"values": {"k_e": NaN}}', b"{}"])
@run_cases("name", ["run.json", "map.json"])
def test_a_damaged_file_of_a_run_is_named(content: bytes, name: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"fingerprint": {}}))
    (folder / name).write_bytes(content)
    ran = command_line.cli("report", folder)
    assert ran.status == 2
    assert "Traceback" not in ran.text


@run_cases("what", ["a device", "a pipe", "a large file"])
def test_a_record_that_has_no_end_is_not_read(what: str, tmp_path: Path) -> None:
    """Mutant killed: whatever `file:` names is opened, and waited for."""
    config = command_line.small_config(
        tmp_path, ("file: small.csv", "file: small.csv\n  format: csv")
    )
    record = tmp_path / "small.csv"
    record.unlink()
    if what == "a device":
        record.symlink_to("/dev/zero")
    elif what == "a pipe":
        os.mkfifo(record)
    else:
        with record.open("wb") as file:
            file.truncate(2_000_000_000)
    ran = command_line.cli("check", config)
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


@run_cases("name", ENDLESS)
def test_init_looks_at_no_table_for_ever(name: str, tmp_path: Path) -> None:
    """Processor time, of which each took minutes: pairs of columns, digits, brackets that are open."""
    (tmp_path / "odd.csv").write_text(ENDLESS[name])
    begun = time.process_time()
    ran = command_line.cli("init", tmp_path / "odd.csv")
    assert time.process_time() - begun < SECONDS
    assert ran.status == 2
    assert SAYS.get(name, "odd.csv") in ran.err
    assert max(map(len, ran.err.splitlines())) <= 400


def test_columns_that_may_be_anything_are_paired_in_seconds(tmp_path: Path) -> None:
    """Each may be the derivative of each; kills fitting every pair anew, 40 us and more each."""
    walks = np.cumsum(np.random.default_rng(1).standard_normal((200, 5000)), axis=1)
    np.savez(tmp_path / "walks.npz", **{f"x_{k}": one for k, one in enumerate(walks)})
    begun = time.process_time()
    ran = command_line.cli("init", tmp_path / "walks.npz")
    assert time.process_time() - begun < SECONDS
    assert (ran.status, "nothing says" in ran.err or "its name does not say" in ran.err) == (
        2,
        True,
    )


@run_cases("what", ["samples", "bytes"])
def test_init_says_how_much_it_looks_at(what: str, tmp_path: Path) -> None:
    path = tmp_path / "long.npz"
    if what == "samples":
        np.savez_compressed(path, t=np.arange(1e6 + 1), w_1=np.zeros(1_000_001))
    else:
        with path.open("wb") as file:
            file.truncate(200_000_000)
    ran = command_line.cli("init", path)
    says = {"samples": "looks at 1000000 samples", "bytes": "has 200 MB; at most 100 MB"}
    assert (ran.status, says[what] in ran.err) == (2, True), ran.err
    assert ran.err.count("\n") == 1


@run_cases("command", ["posterior", "calibrate"])
def test_more_processes_than_any_machine_has_are_refused(command: str, tmp_path: Path) -> None:
    config = command_line.small_config(tmp_path)
    ran = command_line.cli(command, config, "--processes", "3000000000", "-o", tmp_path / "out")
    assert ran.status == 2
    assert "less than or equal to 256" in ran.text
    assert not (tmp_path / "out").exists()


def test_python_without_docstrings_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which ArviZ works on: a traceback as it is loaded, after minutes of sampling."""
    command_line.small_config(tmp_path)
    monkeypatch.setenv("PYTHONOPTIMIZE", "2")
    ran = command_line.run_process("posterior", "small.yaml", cwd=tmp_path)
    assert ran.status == 2
    assert ran.err.splitlines() == [
        "python -OO takes the docstrings away that ArviZ works on; leave -OO out"
    ]
