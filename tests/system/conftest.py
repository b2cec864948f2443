"""What tests of whole runs share; what only some tests need is loaded by them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from support.finished_runs import FinishedRun


@pytest.fixture
def started() -> Iterator[list[subprocess.Popen[str]]]:
    """Processes to be ended with the test, with all that they started."""
    processes: list[subprocess.Popen[str]] = []
    yield processes
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.fixture(scope="session")
def converged(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """A converged run without figures, not to be changed."""
    from support import finished_runs

    return finished_runs.run(tmp_path_factory)


@pytest.fixture(scope="session")
def unconverged(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """The same run with targets out of reach, which used all of its steps without interruption."""
    from support import finished_runs

    return finished_runs.run(tmp_path_factory, finished_runs.UNREACHABLE)


@pytest.fixture(scope="session")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """The converged run with its figures, not to be changed."""
    from support import finished_runs

    return finished_runs.run(tmp_path_factory, finished_runs.ALL_FIGURES)


@pytest.fixture
def copy(converged: FinishedRun, tmp_path: Path) -> FinishedRun:
    """Return a copy of the converged run, to be changed."""
    return converged.copy(tmp_path / "copy")
