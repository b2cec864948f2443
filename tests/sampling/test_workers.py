"""Processes that share the work: what they hold, and how many threads each has."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from support.compiled_responses import SIGMA, seen
from threadpoolctl import threadpool_info, threadpool_limits

from bayesdrill.basics.processes import FORKED
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling import workers
from bayesdrill.sampling.workers import WorkerPool

MOST_SECONDS = 0.5  # of processor until the first task; a worker that loads all itself needs 1.8


@pytest.fixture(scope="module")
def target() -> Posterior:
    return seen("step", SIGMA, free=("k_s", "j_1", "t_f"))


def have_one_thread(libraries: Sequence[Mapping[str, Any]]) -> bool:
    return all(library["num_threads"] == 1 for library in libraries)


def test_workers_map_the_arrays_of_a_large_record(
    target: Posterior, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And need next to no time to begin, as their server has loaded what they will need."""
    theta = target.space.vector(target.space.start)[None]
    monkeypatch.setattr(workers, "PIPE", 1000)
    with WorkerPool(target, 2) as pool:
        begun = pool.submit_function(time.process_time).result()
        assert begun < MOST_SECONDS or not FORKED
        density = pool.submit(Posterior.density, theta).result()
        assert pool.submit_function(eval, "'corner' in __import__('sys').modules").result()
        assert have_one_thread(pool.submit_function(threadpool_info).result())
    assert np.array_equal(density, target.density(theta))


def test_all_work_beside_workers_is_done_on_one_thread(target: Posterior) -> None:
    """Sums of many threads depend on how many there are, and so would a chain on the machine.

    Two threads of Python may each have a pool, of which the first to open is the first to close.
    """
    first, second = WorkerPool(target, 1), WorkerPool(target, 1)
    with threadpool_limits(2):
        for pool in (first, second):
            pool.__enter__()
        first.__exit__()
        assert have_one_thread(threadpool_info())
        second.__exit__()
        assert not have_one_thread(threadpool_info())
