"""Where mistakes end: in a message and a status."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import typer
from support import command_line
from support.case_tables import run_cases
from support.command_line import STOPPING

from bayesdrill.basics.errors import ErrorCollector, InputError
from bayesdrill.guard import INPUT_WRONG, INTERRUPTED, guarded, never_silent, saved_in
from bayesdrill.output_files import POSTERIOR
from bayesdrill.results.provenance import interruptions
from bayesdrill.results.run_folder import Folder, read_run
from bayesdrill.sampling import workers
from bayesdrill.sampling.workers import WorkerPool


def test_a_worker_that_is_killed_ends_in_a_message(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever the command. The task ends its process at once, as the kernel does when memory is out."""
    with pytest.raises(typer.Exit) as ended, guarded(), WorkerPool(9, 2) as pool:  # type: ignore[arg-type]
        pool.submit(os._exit).result()
    assert ended.value.exit_code == INPUT_WRONG
    said = capsys.readouterr().err
    assert "a worker process was killed" in said
    assert "--processes" in said


def test_a_run_that_loses_a_worker_says_how_to_go_on(tmp_path: Path) -> None:
    with pytest.raises(InputError) as ended, saved_in(tmp_path), WorkerPool(9, 2) as pool:  # type: ignore[arg-type]
        pool.submit(os._exit).result()
    (problem,) = ended.value.problems
    assert problem.place == str(tmp_path)
    assert "--processes" in problem.message
    assert "--resume" in problem.message


@contextmanager
def hearing() -> Iterator[None]:
    """Signals as an interactive process has them; put back at the end."""
    before = {number: signal.getsignal(number) for number in STOPPING}
    for number in STOPPING:
        signal.signal(number, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def heard() -> Iterator[None]:
    with hearing():
        yield


def stopped_at_a_library() -> None:
    """What is raised while native code is being loaded comes out of there as an `ImportError`."""
    try:
        signal.raise_signal(signal.SIGHUP)
    except KeyboardInterrupt as stopped:
        raise ImportError("initialization failed") from stopped


@pytest.mark.usefixtures("heard")
def test_a_signal_while_a_library_is_loaded_stops_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Mutants killed: only a KeyboardInterrupt stops a run; a signal is a figure that failed."""
    sparing = ErrorCollector()
    with Folder(tmp_path / "out", "fresh", {}, POSTERIOR) as folder:
        folder.begin(status="running")
        with (
            pytest.raises(typer.Exit) as ended,
            guarded(),
            interruptions(folder, lambda: "hardly"),
            sparing.making("a figure"),
        ):
            stopped_at_a_library()
    assert ended.value.exit_code == INTERRUPTED
    assert capsys.readouterr().err == "stopped; hardly; continue with --resume\n"
    assert not sparing.missing
    run = read_run(tmp_path / "out")
    assert run is not None
    assert run["status"] == "interrupted"


@pytest.mark.usefixtures("heard")
def test_a_signal_while_a_library_is_loaded_stops_a_command(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(typer.Exit) as ended, guarded():
        stopped_at_a_library()
    assert ended.value.exit_code == INTERRUPTED
    assert capsys.readouterr().err == "stopped\n"


@run_cases("number", STOPPING, ids=lambda number: number.name)
def test_a_command_that_is_stopped_claims_nothing_of_files(
    number: signal.Signals, capsys: pytest.CaptureFixture[str]
) -> None:
    """`report` and `identify -o` may have written some by then."""
    with hearing(), pytest.raises(typer.Exit) as ended, guarded():
        signal.raise_signal(number)
    assert ended.value.exit_code == INTERRUPTED
    assert capsys.readouterr().err == "stopped\n"


@pytest.mark.usefixtures("heard")
def test_only_the_first_of_many_signals_interrupts() -> None:
    cleaned = []

    @contextmanager
    def cleaning() -> Iterator[None]:
        try:
            yield
        finally:
            for number in STOPPING:
                signal.raise_signal(number)
                cleaned.append(number)

    with pytest.raises(typer.Exit) as ended, guarded(), cleaning():
        signal.raise_signal(signal.SIGINT)
    assert tuple(cleaned) == STOPPING
    assert ended.value.exit_code == INTERRUPTED


@run_cases("number", STOPPING, ids=lambda number: number.name)
def test_a_signal_that_is_to_be_ignored_stays_so(number: signal.Signals) -> None:
    """`nohup`, and jobs in the background."""
    with hearing():
        signal.signal(number, signal.SIG_IGN)
        with guarded():
            signal.raise_signal(number)
        assert signal.getsignal(number) == signal.SIG_IGN


@pytest.mark.usefixtures("heard")
def test_a_command_that_ends_well_leaves_signals_as_they_were() -> None:
    with guarded():
        assert signal.getsignal(signal.SIGHUP) != signal.SIG_DFL
    assert {signal.getsignal(number) for number in STOPPING} == {signal.SIG_DFL}


def test_no_room_for_semaphores_is_not_blamed_on_the_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(workers, "ProcessPoolExecutor", full)
    with pytest.raises(InputError) as ended, saved_in(tmp_path):
        WorkerPool(9, 2)  # type: ignore[arg-type]
    (problem,) = ended.value.problems
    assert str(tmp_path) not in str(problem)
    assert "/dev/shm" in str(problem)
    assert "--processes 1" in str(problem)


def test_a_message_that_nobody_can_read_leaves_the_status(monkeypatch: pytest.MonkeyPatch) -> None:
    with open("/dev/full", "w") as full, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", full)
        with pytest.raises(typer.Exit) as ended, guarded():
            raise InputError.at("here", "wrong")
        patched.undo()
        with suppress(OSError):
            full.close()
    assert ended.value.exit_code == INPUT_WRONG


@run_cases("size", [25, 40, 300])  # MB, of which the libraries take up about 400
def test_memory_that_ends_as_libraries_are_loaded(size: int, tmp_path: Path) -> None:
    """Of a process of its own, as a batch system bounds it."""
    command_line.small_config(tmp_path)
    limit = size * 1024**2
    ended = subprocess.run(
        [sys.executable, "-m", "bayesdrill", "check", "small.yaml"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(command_line.ROOT)},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        capture_output=True,
        text=True,
    )
    assert ended.returncode == INPUT_WRONG, ended.stderr
    assert ended.stderr.startswith("out of memory")
    assert "Traceback" not in ended.stderr


@run_cases("room", [100, 4_000, 10_000])  # bytes
def test_a_disk_that_is_full_names_the_file(room: int, tmp_path: Path) -> None:
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


@run_cases(
    "command",
    [
        ("--help",),
        ("--version",),
        ("posterior", "--help"),
        ("schema",),
        ("cite",),
    ],
    ids=" ".join,
)
def test_what_is_said_to_nobody_ends_in_a_status(command: tuple[str, ...]) -> None:
    """A full device is told and has status 2; of a pipe that is closed nobody wants to know."""
    shell = {**os.environ, "PYTHONPATH": str(command_line.ROOT)}
    read, write = os.pipe()
    os.close(read)
    with open("/dev/full", "wb") as full, os.fdopen(write, "wb") as pipe:
        for out, status, says in ((full, INPUT_WRONG, "No space left on device"), (pipe, 0, "")):
            ended = subprocess.run(
                [sys.executable, "-m", "bayesdrill", *command],
                env=shell,
                stdout=out,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert ended.returncode == status, ended.stderr
            assert says in ended.stderr
            assert "Traceback" not in ended.stderr


@run_cases("threads", ["", "x", "4,2", "-1", "1e3"])
def test_what_is_no_number_of_threads_counts_as_unset(threads: str) -> None:
    """Transforms of SciPy end in an error there, and all that assesses chains uses them."""
    code = "import bayesdrill, scipy.fft, os; scipy.fft.rfft([1.0, 2.0]); print(sorted(os.environ))"
    names = ("OMP_NUM_THREADS", "DUCC0_NUM_THREADS")
    shell = {**os.environ, "PYTHONPATH": str(command_line.ROOT), **dict.fromkeys(names, threads)}
    ended = subprocess.run([sys.executable, "-c", code], env=shell, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert not any(name in ended.stdout for name in names)
    kept = {**shell, **dict.fromkeys(names, " 2")}
    ended = subprocess.run([sys.executable, "-c", code], env=kept, capture_output=True, text=True)
    assert all(name in ended.stdout for name in names), ended.stderr


def test_what_is_silent_for_long_says_that_it_is_at_work(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """And what speaks by itself is not interrupted.

    Mutants killed: a line for each look; silence of one stream alone; streams that stay watched.
    """
    streams = sys.stdout, sys.stderr
    with never_silent(0.5):
        time.sleep(1.2)
        for _ in range(12):
            time.sleep(0.1)
            print("mine")
    assert (sys.stdout, sys.stderr) == streams
    said = capsys.readouterr()
    assert said.out == 12 * "mine\n"
    lines = said.err.splitlines()
    assert 1 <= len(lines) <= 2
    assert all(line.startswith("  still at work, for ") for line in lines)
