"""The command line with a small experiment, run in this process or in one of its own."""

import csv
import functools
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
from support.case_tables import read_table
from typer.testing import CliRunner

import bayesdrill.cli
from bayesdrill import output_files
from bayesdrill.api import arguments as api_arguments
from bayesdrill.cli import app
from bayesdrill.config import loading
from bayesdrill.config.records import simulation
from bayesdrill.results.run_folder import Folder
from bayesdrill.tasks import remote

ROOT = Path(__file__).parents[2]
CONFIGS = Path(__file__).parent / "configs"  # tests change them by replacements
STILL_WORKING = re.compile(r"^  still working, for .*\n", re.MULTILINE)
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

SMALL = (CONFIGS / "small.yaml").read_text(encoding="utf-8")
REFUSALS = read_table("system/refusals.yaml")


@dataclass(frozen=True)
class CommandResult:
    status: int
    out: str
    err: str

    @property
    def text(self) -> str:
        return self.out + self.err


def cli(*arguments: str | Path, program: typer.Typer = app) -> CommandResult:
    """Run a command line in this process; the handlers of signals are put back.

    No other process is started, unless several are asked for: each would import the package first.
    """
    before = {number: signal.getsignal(number) for number in STOPPING}
    try:
        with pytest.MonkeyPatch.context() as patch:
            for module in (api_arguments, bayesdrill.cli):
                patch.setattr(module, "available_processors", lambda: 1)
            patch.setattr(remote, "local_executor", executor)
            patch.setattr(typer.testing, "_get_command", _command)
            result = CliRunner().invoke(program, [str(argument) for argument in arguments])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return CommandResult(result.exit_code, result.stdout, result.stderr)


@functools.cache
def _command(program: typer.Typer) -> Any:
    """Return the command of a program, which takes as long to make as most commands."""
    return typer.main.get_command(program)


@contextmanager
def executor(
    processes: int, several: Callable[[int], Any] = remote.local_executor
) -> Iterator[remote.RefitExecutor]:
    """Yield a thread of this process in the place of one worker."""
    if processes > 1:
        with several(processes) as crew:
            yield crew
        return
    with ThreadPoolExecutor(1) as pool:
        try:
            yield remote.RefitExecutor(pool)
        finally:
            pool.shutdown(cancel_futures=True)


def start_process(*arguments: str | Path, cwd: Path, **options: object) -> subprocess.Popen[str]:
    """Start `python -m bayesdrill ...`, which is not stopped with this process."""
    usual = {
        "env": {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "COLUMNS": "200"},
        **dict.fromkeys(("stdout", "stderr"), subprocess.PIPE),
        "text": True,
        "start_new_session": True,
        "preexec_fn": _hear_all_signals,
    }
    command = [sys.executable, "-m", "bayesdrill", *map(str, arguments)]
    return subprocess.Popen(command, cwd=cwd, **{**usual, **options})  # type: ignore[call-overload,no-any-return]


def _hear_all_signals() -> None:
    """Hear Ctrl-C in the child, also where this process ignores it as a job in the background does."""
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)


def run_process(*arguments: str | Path, cwd: Path, seconds: float = 60) -> CommandResult:
    """Return what `python -m bayesdrill ...` printed, without lines that only slow machines get."""
    process = start_process(*arguments, cwd=cwd)
    out, err = process.communicate(timeout=seconds)
    return CommandResult(process.returncode, out, STILL_WORKING.sub("", err))


@functools.cache
def small_record() -> str:
    """The record that `SMALL` asks for, simulated once."""
    from bayesdrill.config.yaml_source import parse

    return simulation.simulate(loading.validate(parse(Path("small.yaml"), SMALL)), seed=7)


def small_config(folder: Path, *changes: tuple[str, str], name: str = "small.yaml") -> Path:
    """Write the small experiment; each text that `changes` replace in its config stands there once."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "small.csv").write_text(small_record(), encoding="utf-8")
    (folder / name).write_text(replaced(SMALL, *changes), encoding="utf-8")
    return folder / name


def replaced(text: str, *changes: tuple[str, str]) -> str:
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the config"
        text = text.replace(old, new)
    return text


def simulate_again(config: Path) -> None:
    """Simulate another record in the place of the small one, which is never overwritten."""
    (config.parent / "small.csv").unlink()
    result = cli("simulate", config)
    assert result.status == 0, result.err


def posterior(
    config: Path, folder: Path, *options: str | Path, processes: int = 1
) -> CommandResult:
    """Sample the posterior of a config into `folder`, in this process unless told otherwise."""
    return cli("posterior", config, "-o", folder, "--processes", str(processes), *options)


def assert_refused(result: CommandResult, *fragments: str) -> None:
    """Status 2, and on stderr at most a screen that holds all fragments and is no traceback."""
    assert result.status == 2, result.text
    assert "Traceback" not in result.text
    assert len(result.err.splitlines()) <= 24
    for fragment in fragments:
        assert fragment in result.err, result.err


def assert_refused_unchanged(folder: Path, message: str, *arguments: str | Path) -> None:
    """The command is refused in one line that holds `message`, and nothing below `folder` changes."""
    before = listing(folder)
    result = cli(*arguments)
    assert_refused(result, message)
    assert len(result.err.splitlines()) == 1, result.err
    assert listing(folder) == before


def replace_text(path: Path, old: str, new: str) -> None:
    """Replace a text, which must stand in the file, everywhere in it."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def table(path: Path, key: str = "name") -> dict[str, dict[str, str]]:
    """Return the rows of a CSV file by their cell under `key`."""
    with path.open(encoding="utf-8") as file:
        return {row[key]: row for row in csv.DictReader(file)}


def renew_digests(folder: Path) -> None:
    """Write the digests of the files that are there now into `run.json`, as a forger would."""
    run = output_files.loads_checksummed((folder / "run.json").read_bytes())
    run["files"] = {name: output_files.digest(folder / name) for name in run["files"]}
    (folder / "run.json").write_text(output_files.dumps_checksummed(run))


def listing(folder: Path) -> dict[str, object]:
    """Return every file and folder below, with its content, or the place to which a link leads."""
    return {
        path.relative_to(folder).as_posix(): _content(path) for path in sorted(folder.rglob("*"))
    }


def _content(path: Path) -> object:
    if path.is_symlink():
        return path.readlink()
    return path.read_bytes() if path.is_file() else oct(path.lstat().st_mode)


def write_results(folder: Path, kind: output_files.Kind) -> Path:
    """Write a folder as of a finished run of this kind, with every file that it may write."""
    with Folder(folder, "fresh", {}, kind) as run:
        run.begin(status="finished")
    for name in kind.files:
        path = folder / name.replace("#", "0000007")
        path.parent.mkdir(exist_ok=True)
        path.write_text("ours")
    return folder
