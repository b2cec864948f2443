"""When the searches of a fit are given worker processes."""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayesdrill.sampling.fit import searching_processes


@pytest.mark.parametrize(
    ("seconds", "processes", "given"), [(1e-6, 2, 1), (2e-3, 2, 2), (2e-3, 1, 1), (2e-3, 4, 4)]
)
def test_workers_search_only_where_the_density_is_slow(
    seconds: float, processes: int, given: int
) -> None:
    space = SimpleNamespace(draw=lambda n, rng: np.zeros((n, 1)))
    posterior: Any = SimpleNamespace(space=space, density=lambda points: time.sleep(seconds))
    plan: Any = SimpleNamespace(starts=4, chains=SimpleNamespace(seed=1), shortest=None)
    assert searching_processes(posterior, plan, processes) == given
