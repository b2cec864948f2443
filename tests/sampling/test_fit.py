"""When the searches of a fit are given worker processes."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayesdrill.sampling import fit


@pytest.mark.parametrize(
    ("seconds", "processes", "given"), [(1e-6, 2, 1), (2e-3, 2, 2), (2e-3, 1, 1), (2e-3, 4, 4)]
)
def test_workers_search_only_where_the_density_is_slow(
    seconds: float, processes: int, given: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]

    def density(points: Any) -> None:
        clock[0] += seconds

    monkeypatch.setattr(fit, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    space = SimpleNamespace(draw=lambda n, rng: np.zeros((n, 1)))
    posterior: Any = SimpleNamespace(space=space, density=density)
    plan: Any = SimpleNamespace(starts=4, chains=SimpleNamespace(seed=1), max_exact=None)
    assert fit.searching_processes(posterior, plan, processes) == given
