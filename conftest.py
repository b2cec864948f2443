"""What all tests share."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest

CACHE = Path(__file__).parent / ".pytest_cache"

# Kernels of all workers and their children are compiled once, and apart from those of the user.
os.environ["BAYESDRILL_CACHE"] = str(CACHE)
# So are modules, where nobody wants them compiled beside their sources.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    os.environ["PYTHONPYCACHEPREFIX"] = str(CACHE / "bytecode")
# Threads of linear algebra wait for each other with matrices as small as these.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture(scope="session", autouse=True)
def _collected_seldom() -> None:
    """Garbage: what was imported stays until the end, and is not looked through again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
