"""What tests of whole runs share."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator

import pytest
from support import finished_runs
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
    return finished_runs.run(tmp_path_factory)


@pytest.fixture(scope="session")
def unconverged(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """The same run with targets out of reach, which used all of its steps without interruption."""
    return finished_runs.run(tmp_path_factory, finished_runs.UNREACHABLE)


@pytest.fixture(scope="session")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """The converged run with its figures, not to be changed."""
    return finished_runs.run(tmp_path_factory, finished_runs.ALL_FIGURES)


copy = pytest.fixture(finished_runs.copied_run, name="copy")
