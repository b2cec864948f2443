"""Processes that are killed, stopped or interrupted: a resumed run has the chain that it would have had.

Where only a worker is killed, as the kernel does when memory runs out, the command says so.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from support import command_line
from support.command_line import assert_refused, posterior
from support.finished_runs import FILES, UNREACHABLE, FinishedRun

DRAWN = ("figures: []", "figures: [corner]")
LONG = ("ess: 100, max_steps: 500", "ess: 10000000, max_steps: 4000")
MANY_STARTS = ("starts: 1", "starts: 500")

type Processes = list[subprocess.Popen[str]]


def pieces(folder: Path) -> int:
    return len(list((folder / ".pieces").glob("ensemble_*.h5")))


def start(
    config: Path, folder: Path, *options: str, processes: int = 1, **pipes: object
) -> subprocess.Popen[str]:
    arguments = ("posterior", config, "-o", folder, "--processes", str(processes), *options)
    return command_line.start_process(*arguments, cwd=config.parent, **pipes)


def wait_for[T](process: subprocess.Popen[str], ready: Callable[[], T], seconds: float = 60) -> T:
    """Wait until `ready` while the process lives, and return its result."""
    end = time.monotonic() + seconds
    while not (result := ready()):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.002)
    return result


def group(leader: int, command: bytes = b"") -> list[int]:
    """Return the living processes in the session of `leader` with `command` in their command line."""
    members = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, number = stat.read_text().rpartition(")")[2].split()[:3]
            line = stat.with_name("cmdline").read_bytes()
            if int(number) == leader and state != "Z" and command in line:
                members.append(int(stat.parent.name))
    return members


def workers(leader: int) -> list[int]:
    """Return the processes that the server of `leader` has forked; the server is the oldest."""
    return sorted(group(leader, b"forkserver"))[1:]


def assert_group_ends(leader: int, seconds: float = 10.0) -> None:
    """Helpers of multiprocessing end a moment after their parent."""
    end = time.monotonic() + seconds
    while group(leader) and time.monotonic() < end:
        time.sleep(0.05)
    assert not group(leader), "workers outlive the run"


def begun(folder: Path, processes: int, saved: int, started: Processes) -> FinishedRun:
    """Start a run in a process of its own, and return when this number of pieces is saved."""
    config = command_line.small_config(folder, UNREACHABLE)
    process = start(config, folder / "out", processes=processes)
    started.append(process)
    wait_for(process, (folder / "out" / "run.json").exists)
    wait_for(process, lambda: pieces(folder / "out") >= saved)
    return FinishedRun(config, folder / "out")


def assert_resumes(
    run: FinishedRun,
    process: subprocess.Popen[str],
    number: signal.Signals,
    unconverged: FinishedRun,
) -> None:
    """A run that is interrupted by `number` and resumed equals one without interruption."""
    folder, saved = run.folder, pieces(run.folder)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does, to parent and workers
    else:
        process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert not (folder / "chain.h5").exists()
    assert pieces(folder) >= saved
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        assert "resource_tracker" not in err  # no warnings of semaphores
        assert run.json["status"] == "running"
    else:
        assert process.returncode == 130
        assert "Traceback" not in err
        if saved:
            assert "continue with --resume" in err
            assert run.json["status"] == "interrupted"
    assert_group_ends(process.pid)
    assert posterior(run.config, folder, "--resume").status == 3
    unconverged.assert_same_chains(run)
    assert set(command_line.listing(folder)) == FILES
    summaries = [each.folder / "summary.csv" for each in (run, unconverged)]
    assert summaries[0].read_bytes() == summaries[1].read_bytes()


def test_a_folder_is_locked_while_a_run_writes_and_a_killed_run_can_be_resumed(
    unconverged: FinishedRun, tmp_path: Path, started: Processes
) -> None:
    run = begun(tmp_path, 1, 3, started)
    (process,) = started
    process.send_signal(signal.SIGSTOP)
    before = command_line.listing(run.folder)
    for option in ("--resume", "--force"):
        result = posterior(run.config, run.folder, option)
        assert_refused(result, "another run is writing here")
    assert_refused(command_line.cli("report", run.folder), "another run is writing here")
    assert command_line.listing(run.folder) == before
    assert_resumes(run, process, signal.SIGKILL, unconverged)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "processes", "saved"),
    [(signal.SIGINT, 1, 0), (signal.SIGINT, 2, 3), (signal.SIGTERM, 1, 3), (signal.SIGKILL, 2, 3)],
    ids=lambda value: getattr(value, "name", value),
)
def test_an_interrupted_and_resumed_run_equals_one_without_interruption(
    number: signal.Signals,
    processes: int,
    saved: int,
    unconverged: FinishedRun,
    tmp_path: Path,
    started: Processes,
) -> None:
    run = begun(tmp_path, processes, saved, started)
    assert_resumes(run, started[0], number, unconverged)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.2, 0.5, 1.0, 1.5])
def test_ctrl_c_while_workers_start_shows_no_traceback(
    seconds: float, tmp_path: Path, started: Processes
) -> None:
    process = start(command_line.small_config(tmp_path, UNREACHABLE), tmp_path / "out", processes=2)
    started.append(process)
    wait_for(process, (tmp_path / "out" / "run.json").exists)
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert "Traceback" not in err


LARGE_RESULTS = """
from bayesdrill.sampling.workers import WorkerPool

def large():
    return bytes(32_000_000)

if __name__ == "__main__":
    with WorkerPool(None, 2) as pool:
        tasks = [pool.submit_function(large) for _ in range(8)]
        tasks[0].result()
        raise KeyboardInterrupt
"""


@pytest.mark.slow
def test_ctrl_c_while_a_worker_hands_over_a_result_ends_the_process(
    tmp_path: Path, started: Processes
) -> None:
    (tmp_path / "large.py").write_text(LARGE_RESULTS)
    process = subprocess.Popen(
        [sys.executable, "large.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(command_line.ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    started.append(process)
    _, err = process.communicate(timeout=15)
    assert err.splitlines()[-1] == "KeyboardInterrupt", err


def to_group(*numbers: signal.Signals) -> Callable[[int], None]:
    def send(leader: int) -> None:
        for number in numbers:
            os.killpg(leader, number)
            time.sleep(0.07)

    return send


def stopped_worker(leader: int) -> None:
    os.kill(workers(leader)[0], signal.SIGSTOP)
    os.killpg(leader, signal.SIGINT)


@pytest.mark.slow
@pytest.mark.parametrize(
    "act",
    [
        pytest.param(to_group(*[signal.SIGINT] * 3), id="Ctrl-C three times"),
        pytest.param(to_group(signal.SIGTERM), id="SIGTERM to all"),
        pytest.param(to_group(signal.SIGHUP), id="the terminal is closed"),
        pytest.param(stopped_worker, id="Ctrl-C with a stopped worker"),
    ],
)
@pytest.mark.parametrize("command", ["posterior", "calibrate"])
def test_whatever_stops_a_run_it_ends_and_can_be_resumed(
    command: str, act: Callable[[int], None], tmp_path: Path, started: Processes
) -> None:
    config, folder = command_line.small_config(tmp_path, LONG), tmp_path / "out"
    process = command_line.start_process(
        command, config, "-o", folder, "--processes", "2", cwd=tmp_path
    )
    started.append(process)
    wait_for(process, lambda: len(workers(process.pid)) >= 2)
    time.sleep(1.5)  # until they are at work
    act(process.pid)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "--resume" in err
    assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
    assert not workers(process.pid)


@pytest.mark.slow
def test_a_run_goes_on_when_its_output_is_closed(
    converged: FinishedRun, tmp_path: Path, started: Processes
) -> None:
    config, folder = command_line.small_config(tmp_path), tmp_path / "out"
    process = start(config, folder, stderr=subprocess.STDOUT)
    started.append(process)
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    assert process.wait(timeout=60) == 0
    run = FinishedRun(config, folder)
    assert run.json["status"] == "finished"
    converged.assert_same_chains(run)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", ["map", "identify --at-map", "posterior", "calibrate", "report"]
)
def test_a_killed_worker_ends_the_command_with_a_message(
    command: str, tmp_path: Path, started: Processes
) -> None:
    saves, draws = command in ("posterior", "calibrate"), command == "report"
    change = DRAWN if saves or draws else MANY_STARTS  # few are searched without workers
    config, folder = command_line.small_config(tmp_path, change), tmp_path / "out"
    if draws:
        assert posterior(config, folder).status == 0
    target = folder if draws else config
    options = ["-o", folder] if saves else []
    process = command_line.start_process(
        *command.split(), target, *options, "--processes", "2", cwd=tmp_path
    )
    started.append(process)
    worker, *_ = wait_for(process, lambda: workers(process.pid))
    os.kill(worker, signal.SIGKILL)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 2, err
    assert "Traceback" not in err
    assert "a worker process was killed" in err
    assert "--processes" in err
    assert ("--resume" in err) == saves
    if saves:
        assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
