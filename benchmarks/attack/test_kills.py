"""A run that is killed again and again, at moments from start-up to the last figure, loses nothing."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray
from support import command_line
from support.command_line import posterior
from support.finished_runs import FinishedRun
from system.test_kills import DRAWN, LONG, pieces, start

KILLS = 20
GROUPS = ("posterior", "sample_stats", "posterior_predictive", "log_likelihood")


def moments(folder: Path) -> list[tuple[str, Callable[[], bool]]]:
    """What is waited for before a kill, from start-up to the report; a random delay follows."""
    before, now = pieces(folder), time.time()

    def fresh(name: str) -> bool:
        path = folder / name
        return path.exists() and path.stat().st_mtime > now

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


# The first kills come while the chain is short, the last when it is complete: each moment is reached.
ORDER = (0, 0, 1, 1, 2, 2, 0, 3, 3, 2, 4, 3, 4, 0, 5, 6, 6, 7, 8, 8)


@pytest.mark.slow
def test_twenty_kills_in_a_row_cost_nothing(tmp_path: Path) -> None:
    """kill -9 of the parent alone or of all its processes; every resume goes on, and chain and draws
    are those of a run that was never killed."""
    config = command_line.small_config(tmp_path, LONG, DRAWN)
    result = posterior(config, tmp_path / "whole")
    assert result.status == 3
    whole = FinishedRun(config, tmp_path / "whole", result)
    folder = tmp_path / "killed"
    rng = np.random.default_rng(20)
    log: list[str] = []
    options: list[str] = []
    for kill in range(KILLS):
        process = start(config, folder, *options, processes=1 + kill % 2, stdout=subprocess.DEVNULL)
        name, reached = moments(folder)[ORDER[kill]]
        longest = {"start-up": 2.5, "figures": 0.02}.get(name, 0.3)  # figures are soon drawn
        delay = rng.uniform(0.0, longest)
        end = time.monotonic() + 60
        while not reached() and process.poll() is None and time.monotonic() < end:
            time.sleep(0.001)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(delay)
        has_begun = (folder / "run.json").exists()
        if kill % 4 < 2:
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        _, err = process.communicate(timeout=30)
        state = f"{name} +{delay:.2f} s: {process.returncode}, {pieces(folder)} pieces"
        log.append(f"{state}, chain.h5: {(folder / 'chain.h5').exists()}")
        print(log[-1])
        assert process.returncode == -signal.SIGKILL, (log, err)
        assert "Traceback" not in err, (log, err)
        with contextlib.suppress(ProcessLookupError):  # workers that outlive their parent
            os.killpg(process.pid, signal.SIGKILL)
        # A run that was killed before it wrote anything may also just be begun again.
        options = ["--resume"] if has_begun or kill % 4 else []
    result = command_line.run_process(
        "posterior", config, "-o", folder, "--resume", cwd=tmp_path, seconds=120
    )
    assert result.status == 3, result.text
    assert len({line.split(" +")[0] for line in log}) >= 7
    killed = FinishedRun(config, folder, result)
    assert whole.chains()["z 0"].shape == (4000, 8, 2)
    whole.assert_same_chains(killed)
    with (
        xarray.open_datatree(whole.folder / "posterior.nc", engine="h5netcdf") as expected,
        xarray.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree,
    ):
        for name in GROUPS:
            xarray.testing.assert_equal(expected[name].to_dataset(), tree[name].to_dataset())
    assert (whole.folder / "summary.csv").read_bytes() == (folder / "summary.csv").read_bytes()
    assert set(command_line.listing(whole.folder)) == set(command_line.listing(folder))
