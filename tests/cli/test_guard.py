"""Mistakes, signals and full disks end in a message and a status."""

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from support import command_line
from support.case_tables import run_cases
from support.command_line import STOPPING

from bayesdrill import guard
from bayesdrill.basics.errors import ErrorCollector, InputError
from bayesdrill.basics.progress import rest
from bayesdrill.guard import INPUT_WRONG, INTERRUPTED, guarded, never_silent, saved_in
from bayesdrill.output_files import POSTERIOR
from bayesdrill.results.provenance import interruptions
from bayesdrill.results.run_folder import Folder, read_run
from bayesdrill.sampling import workers
from bayesdrill.sampling.workers import WorkerPool

Capture = pytest.CaptureFixture[str]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(command_line.ROOT)}


@contextmanager
def default_signals() -> Iterator[None]:
    """Set signals as an interactive process has them, and put them back at the end."""
    before = {number: signal.getsignal(number) for number in STOPPING}
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def exit_status(command: Callable[[], object]) -> int:
    """Return the status with which a guarded command ends, whose signals were the default ones."""
    with default_signals(), pytest.raises(typer.Exit) as ended, guarded():
        command()
    return ended.value.exit_code


def lose_a_worker() -> None:
    """End a worker at once, as the kernel does when memory is out."""
    with WorkerPool(9, 2) as pool:  # type: ignore[arg-type]
        pool.submit(os._exit).result()


def stop_at_a_library() -> None:
    """Raise what native code that is being loaded makes of a signal."""
    try:
        signal.raise_signal(signal.SIGHUP)
    except KeyboardInterrupt as stopped:
        raise ImportError("initialization failed") from stopped


class _SignalledWhenDeleted:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


def be_signalled_while_an_object_is_deleted() -> None:
    """Python discards the first exception, and prints that it did."""
    _SignalledWhenDeleted()
    time.sleep(30)


def test_a_killed_worker_ends_in_a_message(tmp_path: Path, capsys: Capture) -> None:
    """Whatever the command; a run says how to go on."""
    assert exit_status(lose_a_worker) == INPUT_WRONG
    message = capsys.readouterr().err
    assert "a worker process was killed" in message
    assert "--processes" in message
    with pytest.raises(InputError) as ended, saved_in(tmp_path):
        lose_a_worker()
    (problem,) = ended.value.problems
    assert problem.place == str(tmp_path)
    assert "--processes" in problem.message
    assert "--resume" in problem.message


def test_a_signal_while_a_library_is_loaded_stops_a_run(tmp_path: Path, capsys: Capture) -> None:
    errors = ErrorCollector()

    def run() -> None:
        with interruptions(folder, lambda: "hardly"), errors.collect("a figure"):
            stop_at_a_library()

    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder:
        folder.begin(status="running")
        assert exit_status(run) == INTERRUPTED
    assert capsys.readouterr().err == "stopped; hardly; continue with --resume\n"
    assert not errors.missing
    entries = read_run(tmp_path / "out")
    assert entries is not None
    assert entries["status"] == "interrupted"


def test_a_stopped_command_claims_nothing_of_files(capsys: Capture) -> None:
    """`report` and `identify -o` may have written some by then."""
    for number in STOPPING:
        assert exit_status(lambda number=number: signal.raise_signal(number)) == INTERRUPTED
        assert capsys.readouterr().err == "stopped\n"
    for command in (stop_at_a_library, be_signalled_while_an_object_is_deleted):
        assert exit_status(command) == INTERRUPTED
        assert capsys.readouterr().err == "stopped\n"


def test_only_the_first_of_many_signals_interrupts() -> None:
    cleaned = []

    def command() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            for number in STOPPING:
                signal.raise_signal(number)
                cleaned.append(number)

    assert exit_status(command) == INTERRUPTED
    assert tuple(cleaned) == STOPPING


def test_signals_are_left_as_they_were() -> None:
    """Also those that are to be ignored, by `nohup` and in jobs in the background."""
    with default_signals():
        with guarded():
            assert signal.getsignal(signal.SIGHUP) != signal.SIG_DFL
        assert {signal.getsignal(number) for number in STOPPING} == {signal.SIG_DFL}
    for number in STOPPING:
        with default_signals():
            signal.signal(number, signal.SIG_IGN)
            with guarded():
                signal.raise_signal(number)
            assert signal.getsignal(number) == signal.SIG_IGN


def test_no_room_for_semaphores_is_not_blamed_on_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(workers, "ProcessPoolExecutor", full)
    with pytest.raises(InputError) as ended, saved_in(tmp_path):
        WorkerPool(9, 2)  # type: ignore[arg-type]
    message = str(ended.value)
    assert str(tmp_path) not in message
    assert "/dev/shm" in message
    assert "--processes 1" in message


@run_cases("size", [25, 300])  # MB, of which the libraries take up about 400
def test_memory_may_end_as_libraries_are_loaded(size: int, tmp_path: Path) -> None:
    """Of a process of its own, as a batch system bounds it."""
    command_line.small_config(tmp_path)
    limit = size * 1024**2
    ended = subprocess.run(
        [sys.executable, "-m", "bayesdrill", "check", "small.yaml"],
        cwd=tmp_path,
        env=ENVIRONMENT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        capture_output=True,
        text=True,
    )
    assert ended.returncode == INPUT_WRONG, ended.stderr
    assert ended.stderr.startswith("out of memory")
    assert "Traceback" not in ended.stderr


@run_cases("room", [100, 4_000, 10_000])  # bytes
def test_a_full_disk_names_the_file(room: int, tmp_path: Path) -> None:
    """A limit of files ends writing as a full disk does; what was begun is taken away."""
    command_line.small_config(tmp_path)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    try:
        ran = command_line.cli("identify", tmp_path / "small.yaml", "-o", tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    assert ran.status == INPUT_WRONG
    assert f"{tmp_path / 'out'}/" in ran.err
    assert "cannot be written or read: File too large" in ran.err
    assert not [*tmp_path.rglob("*aside*")]


@run_cases("command", ["--help", "schema"])
def test_output_that_nobody_reads_ends_in_a_status(command: str) -> None:
    """A full device is told and has status 2; of a pipe that is closed nobody wants to know."""
    read, write = os.pipe()
    os.close(read)
    with open("/dev/full", "wb") as full, os.fdopen(write, "wb") as pipe:
        for out, status, message in ((full, INPUT_WRONG, "No space left on device"), (pipe, 0, "")):
            ended = subprocess.run(
                [sys.executable, "-m", "bayesdrill", *command.split()],
                env=ENVIRONMENT,
                stdout=out,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert ended.returncode == status, ended.stderr
            assert message in ended.stderr
            assert "Traceback" not in ended.stderr


@run_cases("threads", ["4,2", " 2"])
def test_a_number_of_threads_that_is_none_counts_as_unset(threads: str) -> None:
    """Transforms of SciPy end in an error there, and all that assesses chains uses them."""
    code = "import bayesdrill, scipy.fft, os; scipy.fft.rfft([1.0, 2.0]); print(sorted(os.environ))"
    names = ("OMP_NUM_THREADS", "DUCC0_NUM_THREADS")
    shell = {**ENVIRONMENT, **dict.fromkeys(names, threads)}
    ended = subprocess.run([sys.executable, "-c", code], env=shell, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert {name in ended.stdout for name in names} == {threads == " 2"}


def test_a_long_silence_says_that_it_is_at_work(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """A command that prints, or that waits for files, is not interrupted."""
    streams, now = (sys.stdout, sys.stderr), [0.0]
    monkeypatch.setattr(guard, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with never_silent(0.5):
        now[0] = 0.6
        watched: Any = sys.stderr
        while watched.written < 0.6:
            time.sleep(0.01)
        for _ in range(12):
            now[0] += 0.1
            print("mine")
        for _ in range(12):
            now[0] += 0.1
            rest(0.02)
    assert (sys.stdout, sys.stderr) == streams
    shown = capsys.readouterr()
    assert shown.out == 12 * "mine\n"
    assert shown.err == "  still working, for 1 s by now\n"
