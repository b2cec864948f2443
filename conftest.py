"""What all tests share."""

from __future__ import annotations

import gc
import os
import time
from pathlib import Path

import pytest

CACHE = Path(__file__).parent / ".pytest_cache"
# Each structure of a rig takes some 0.2 s to compile, so tests share rigs, and no more are wanted.
MOST_KERNELS = 300
BEGUN, KERNELS = pytest.StashKey[float](), pytest.StashKey[int]()

# Kernels of all workers and their children are compiled once, and apart from those of the user.
os.environ["BAYESDRILL_CACHE"] = str(CACHE)
# Modules as well, beside their sources: otherwise each worker and each child compiles them all.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Objects that are imported or kept stay until the end, so garbage is looked for seldom.
gc.set_threshold(20_000, 20, 20)
# Threads of linear algebra wait for each other with matrices as small as these.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(scope="session", autouse=True)
def _collected_seldom() -> None:
    """Garbage: what was imported stays until the end, and is not looked through again and again."""
    gc.freeze()


def pytest_configure(config: pytest.Config) -> None:
    """Note when the run begins."""
    config.stash[BEGUN] = time.time()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the longest files come first, so that two workers end together."""
    items.sort(key=lambda item: "system" not in item.path.parts)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Count the kernels that all processes of this run used; too many fail a whole run."""
    gc.freeze()  # no search for reference cycles, of seconds in a worker, when the process ends
    config = session.config
    if hasattr(config, "workerinput"):  # a worker of xdist: the process that hands out tests counts
        return
    used = [file for file in (CACHE / "kernels").glob("*") if _changed(file) >= config.stash[BEGUN]]
    config.stash[KERNELS] = len(used)
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.option.keyword
    if whole and len(used) > MOST_KERNELS and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many kernels were used."""
    used = terminalreporter.config.stash[KERNELS]
    terminalreporter.write_line(f"{used} kernels were used; a whole run may use {MOST_KERNELS}")


def _changed(file: Path) -> float:
    """When a kernel was stored or last read from the cache; a file that has gone was not used."""
    try:
        return file.stat().st_mtime
    except FileNotFoundError:
        return 0.0
