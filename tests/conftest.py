"""What all tests share."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np  # noqa: F401
import pytest
import scipy.linalg  # noqa: F401
from threadpoolctl import threadpool_limits

# Kernels of all workers and their children are compiled once, and apart from those of the user.
os.environ["BAYESDRILL_CACHE"] = str(Path(__file__).parents[1] / ".pytest_cache")


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Of linear algebra, whose libraries are loaded by now: small matrices wait for others else."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session", autouse=True)
def _collected_seldom() -> None:
    """Garbage: what was imported stays until the end, and is not looked through again and again."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
