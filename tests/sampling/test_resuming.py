"""A run that is given up is given up at the same step, however often it was cut before."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from support.case_tables import for_each
from support.small_problems import noisy_step, posterior

from bayesdrill.basics.progress import Silent
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import MemoryBackend, Plan, SamplingResult, sample
from bayesdrill.sampling.workers import WorkerPool

SIGMA = np.full(4, 0.1)
PLAN = Plan(
    ensembles=2,
    walkers=8,
    moves={"stretch": 1.0},
    targets=Targets(r_hat=1.01, n_tau=1e6, ess=1000),
    max_steps=20_000,
    seed=4,
)


def run(backend: MemoryBackend) -> SamplingResult:
    target = posterior(noisy_step(SIGMA, n=60), SIGMA, free=("k_s", "j_1"))
    maximum = target.space.vector(target.space.start)[None]
    return sample(WorkerPool(target, 1), maximum, PLAN, backend, Silent())


@cache
def whole() -> tuple[SamplingResult, MemoryBackend]:
    backend = MemoryBackend()
    return run(backend), backend


def test_a_run_that_would_take_too_long_is_given_up() -> None:
    sampled, _ = whole()
    assert 1000 <= sampled.convergence.steps < 1250  # a check is made whenever a quarter is added
    assert "more than sampler.max_steps (20000)" in sampled.convergence.reasons[-1]


CUT = [
    pytest.param([(1, 0), (2, 4)], id="quick"),
    pytest.param([(0, 0), (4, 4), (-1, -1)], id="long", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("cases", CUT)
def test_a_run_that_was_cut_is_given_up_at_the_same_step(cases: list[tuple[int, int]]) -> None:
    """Mutant killed: ensembles that were cut at different steps cannot go on."""

    def check(kept: tuple[int, int]) -> None:
        sampled, backend = whole()
        cut = MemoryBackend({k: backend.segments(k)[:n] for k, n in enumerate(kept) if n})
        again = run(cut)
        assert again.convergence.steps == sampled.convergence.steps
        assert again.convergence.reasons == sampled.convergence.reasons
        assert np.array_equal(again.theta, sampled.theta)

    for_each({str(kept): (kept,) for kept in cases}, check)
