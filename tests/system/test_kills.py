"""A run that is killed again and again ends with the chain that it would have had anyway.

And where only a worker is killed, as the kernel does when memory is out, that is said.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray
from emcee.backends import HDFBackend
from support import command_line

DRAWN = ("figures: []", "figures: [corner]")
LONG = ("ess: 100, max_steps: 500", "ess: 10000000, max_steps: 4000")
KILLS = 20
GROUPS = ("posterior", "sample_stats", "posterior_predictive", "log_likelihood")


def pieces(folder: Path) -> int:
    return len(list((folder / ".pieces").glob("ensemble_*.npz")))


def moments(folder: Path) -> list[tuple[str, Callable[[], bool]]]:
    """What is waited for, from start-up to the report; a random delay follows."""
    before, begun = pieces(folder), time.time()

    def fresh(name: str) -> bool:
        path = folder / name
        return path.exists() and path.stat().st_mtime > begun

    return [
        ("start-up", lambda: True),
        ("MAP", (folder / "run.json").exists),
        ("learning", (folder / "map.json").exists),
        ("sampling", lambda: pieces(folder) > before + 2),
        ("sampling", lambda: pieces(folder) > before + 6),
        ("writing chain.h5", lambda: any(folder.glob(".chain.*.aside.h5"))),
        ("after chain.h5", (folder / "chain.h5").exists),
        ("report", lambda: fresh("summary.md")),
        ("figures", lambda: fresh("figures/corner.pdf")),
    ]


# The first kills while the chain is short, the last when it is whole, and written no more: each moment
# can be reached.
ORDER = (0, 0, 1, 1, 2, 2, 0, 3, 3, 2, 4, 3, 4, 0, 5, 6, 6, 7, 8, 8)


def ended(process: subprocess.Popen[str], *, whole_group: bool) -> None:
    if whole_group:
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()


def start(config: Path, folder: Path, options: list[str]) -> subprocess.Popen[str]:
    arguments = ("posterior", config, "-o", folder, *options)
    return command_line.start_process(*arguments, cwd=config.parent, stdout=subprocess.DEVNULL)


@pytest.mark.slow
def test_twenty_kills_in_a_row_cost_nothing(tmp_path: Path) -> None:
    """kill -9 of the parent alone or of all its processes; every resume goes on, and the chain and
    the draws are those of a run that was left in peace."""
    config = command_line.small_config(tmp_path, LONG, DRAWN)
    peace, folder = tmp_path / "peace", tmp_path / "killed"
    assert command_line.cli("posterior", config, "-o", peace, "--processes", "1").status == 3
    rng = np.random.default_rng(20)
    log: list[str] = []
    options: list[str] = []
    for kill in range(KILLS):
        process = start(config, folder, [*options, "--processes", str(1 + kill % 2)])
        name, reached = moments(folder)[ORDER[kill]]
        longest = {"start-up": 2.5, "figures": 0.02}.get(name, 0.3)  # of figures little is left
        delay = rng.uniform(0.0, longest)
        end = time.monotonic() + 60
        while not reached() and process.poll() is None and time.monotonic() < end:
            time.sleep(0.001)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(delay)
        begun = (folder / "run.json").exists()
        ended(process, whole_group=kill % 4 < 2)
        _, err = process.communicate(timeout=30)
        state = f"{name} +{delay:.2f} s: {process.returncode}, {pieces(folder)} pieces"
        log.append(f"{state}, chain.h5: {(folder / 'chain.h5').exists()}")
        print(log[-1])
        assert process.returncode == -signal.SIGKILL, (log, err)
        assert "Traceback" not in err, (log, err)
        with contextlib.suppress(ProcessLookupError):  # workers that outlive their parent
            os.killpg(process.pid, signal.SIGKILL)
        # A run that was killed before it wrote anything may also just be begun again.
        options = ["--resume"] if begun or kill % 4 else []
    ran = command_line.run_process(
        "posterior", config, "-o", folder, "--resume", cwd=tmp_path, seconds=120
    )
    assert ran.status == 3, ran.text
    assert len({line.split(" +")[0] for line in log}) >= 7
    for k in range(4):
        one, other = (
            HDFBackend(str(path / "chain.h5"), name=f"ensemble_{k}", read_only=True)
            for path in (peace, folder)
        )
        assert one.get_chain().shape == (4000, 8, 2)
        assert np.array_equal(one.get_chain(), other.get_chain())
        assert np.array_equal(one.get_log_prob(), other.get_log_prob())
        assert np.array_equal(one.accepted, other.accepted)
        assert np.array_equal(one.random_state[1], other.random_state[1])
    with (
        xarray.open_datatree(peace / "posterior.nc", engine="h5netcdf") as one,
        xarray.open_datatree(folder / "posterior.nc", engine="h5netcdf") as other,
    ):
        for group in GROUPS:
            xarray.testing.assert_equal(one[group].to_dataset(), other[group].to_dataset())
    assert (peace / "summary.csv").read_bytes() == (folder / "summary.csv").read_bytes()
    assert set(command_line.listing(peace)) == set(command_line.listing(folder))


def test_what_a_killed_run_leaves_behind_is_taken_away_in_silence(tmp_path: Path) -> None:
    """Its semaphores, once its workers have ended: on the terminal where it is resumed by then."""
    config, folder = command_line.small_config(tmp_path, LONG), tmp_path / "killed"
    process = start(config, folder, ["--processes", "2"])
    end = time.monotonic() + 60
    while pieces(folder) < 2 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    process.kill()
    _, err = process.communicate(timeout=30)  # until the last of its processes has ended
    assert process.returncode == -signal.SIGKILL
    assert "starting the walkers" in err
    assert "resource_tracker" not in err


def workers(leader: int) -> list[int]:
    """The worker processes in the group of `leader`."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            pid = int(path.parent.name)
            if os.getpgid(pid) == leader and b"spawn_main" in path.read_bytes():
                found.append(pid)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", ["map", "identify --at-map", "posterior", "calibrate", "report"]
)
def test_a_worker_that_is_killed_ends_in_a_message(
    command: str, tmp_path: Path, started: list[subprocess.Popen[str]]
) -> None:
    config, folder = command_line.small_config(tmp_path, DRAWN), tmp_path / "out"
    saves = command in ("posterior", "calibrate")
    if command == "report":
        assert command_line.cli("posterior", config, "-o", folder, "--processes", "1").status == 0
    target = folder if command == "report" else config
    options = ["-o", folder] if saves else []
    process = command_line.start_process(
        *command.split(), target, *options, "--processes", "2", cwd=tmp_path
    )
    started.append(process)
    end = time.monotonic() + 60
    while not (there := workers(process.pid)) and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    os.kill(there[0], signal.SIGKILL)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 2, err
    assert "Traceback" not in err
    assert "a worker process was killed" in err
    assert "--processes" in err
    assert ("--resume" in err) == saves
    if saves:
        assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"


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
def test_whatever_stops_a_run_it_ends_and_can_go_on(
    command: str,
    act: Callable[[int], None],
    tmp_path: Path,
    started: list[subprocess.Popen[str]],
) -> None:
    config, folder = command_line.small_config(tmp_path, LONG), tmp_path / "out"
    process = command_line.start_process(
        command, config, "-o", folder, "--processes", "2", cwd=tmp_path
    )
    started.append(process)
    end = time.monotonic() + 60
    while len(workers(process.pid)) < 2 and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        time.sleep(0.002)
    time.sleep(1.5)  # until they are at work
    act(process.pid)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "--resume" in err
    assert json.loads((folder / "run.json").read_text())["status"] == "interrupted"
    assert not workers(process.pid)
