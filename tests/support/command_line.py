"""The command line as its users meet it: a small experiment, and runs of it in and out of process."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import typer
from typer.testing import CliRunner

from bayesdrill import output_files
from bayesdrill.cli import app
from bayesdrill.config import loading
from bayesdrill.config.records import simulation
from bayesdrill.results.run_folder import Folder

ROOT = Path(__file__).parents[2]
STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

SMALL = """\
name: small
seed: 7
record:
  file: small.csv
  time: {column: t, unit: s}
  channels:
    theta_1: {column: theta_1, unit: rad, sigma: 0.05}
    w_1: {column: w_1, unit: rad/s, sigma: 0.05}
inputs:
  v: 8.0
parameters:
  j_m: nominal
  c_m: nominal
  k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  k_T: nominal
  r_m: nominal
  l_m: nominal
  k_s: nominal
  j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}
  t_f: nominal
map: {starts: 1, evaluations: 500}
sampler: {walkers: 8, r_hat: 1.2, n_tau: 5, ess: 100, max_steps: 500}
output: {predictive_draws: 10, figures: []}
simulation: {duration: 5, rate: 20}
"""


@dataclass(frozen=True)
class CommandResult:
    status: int
    out: str
    err: str

    @property
    def text(self) -> str:
        return self.out + self.err


def cli(*arguments: str | Path, program: typer.Typer = app) -> CommandResult:
    """A command line in this process; the handlers of signals are put back."""
    before = {number: signal.getsignal(number) for number in STOPPING}
    try:
        result = CliRunner().invoke(program, [str(argument) for argument in arguments])
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return CommandResult(result.exit_code, result.stdout, result.stderr)


def start_process(*arguments: str | Path, cwd: Path, **options: object) -> subprocess.Popen[str]:
    """`python -m bayesdrill ...` as a process of its own, not stopped with this one."""
    command = [sys.executable, "-m", "bayesdrill", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "COLUMNS": "200"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(  # type: ignore[call-overload,no-any-return]
        command,
        cwd=cwd,
        env=environment,
        start_new_session=True,
        preexec_fn=_hear_all,
        **{**pipes, **options},
    )


def _hear_all() -> None:
    """In the child: what ignores Ctrl-C, as a job in the background does, hands that on."""
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)


def run_process(*arguments: str | Path, cwd: Path, seconds: float = 60) -> CommandResult:
    process = start_process(*arguments, cwd=cwd)
    out, err = process.communicate(timeout=seconds)
    return CommandResult(process.returncode, out, err)


@functools.cache
def small_record() -> str:
    """The record that `SMALL` asks for, simulated once."""
    from bayesdrill.config.yaml_source import parse

    return simulation.simulate(loading.validate(parse(Path("small.yaml"), SMALL)), seed=7)


def small_config(folder: Path, *changes: tuple[str, str], name: str = "small.yaml") -> Path:
    """The small experiment in `folder`, its config changed by replacements of text that stands in it."""
    text = SMALL
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the config"
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "small.csv").write_text(small_record(), encoding="utf-8")
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def simulate_again(config: Path) -> None:
    """Another record in the place of the small one, which is never overwritten."""
    (config.parent / "small.csv").unlink()
    done = cli("simulate", config)
    assert done.status == 0, done.err


def listing(folder: Path) -> dict[str, object]:
    """Every file and folder below, with what it holds, and where a link leads."""
    return {
        path.relative_to(folder).as_posix(): _content(path) for path in sorted(folder.rglob("*"))
    }


def _content(path: Path) -> object:
    if path.is_symlink():
        return path.readlink()
    return path.read_bytes() if path.is_file() else oct(path.lstat().st_mode)


def write_results(folder: Path, kind: output_files.Kind) -> Path:
    """A folder in which a run of this kind has been, with every file that it may write."""
    with Folder(folder, "fresh", {}, kind) as run:
        run.begin(status="finished")
    for name in kind.files:
        path = folder / name.replace("#", "0000007")
        path.parent.mkdir(exist_ok=True)
        path.write_text("ours")
    return folder
