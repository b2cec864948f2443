"""What `compare` says of records of which it is known what is wrong: see `benchmarks/compare.py`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from support.case_tables import run_cases
from support.small_problems import starts_believed

from bayesdrill.config.job import Job
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.fit import fit
from bayesdrill.sampling.gauss_newton import gauss_newton
from benchmarks import compare
from benchmarks.compare import KINDS, RED, Bench, Kind, rightly

RATE = 0.95


@cache
def bench() -> Bench:
    return Bench(compare.contenders())


def named(kind: Kind, records: int) -> int:
    return sum(rightly(kind, bench().found(kind, index)) for index in range(records))


@pytest.mark.slow
@run_cases("kind", KINDS, ids=[kind.name for kind in KINDS])
def test_95_of_100_records_of_a_kind_are_judged_rightly(kind: Kind) -> None:
    assert named(kind, compare.RECORDS) >= RATE * compare.RECORDS


@pytest.mark.slow
@run_cases("kind", KINDS[::3], ids=[kind.name for kind in KINDS[::3]])
def test_one_record_of_each_kind_is_judged_rightly(kind: Kind) -> None:
    assert named(kind, 1) == 1


@pytest.mark.slow
def test_the_misfit_is_as_large_as_the_bench_says() -> None:
    """The size is what the best fit of the given config leaves, relative to the noise."""
    for kind in KINDS[1:3]:
        y, size = bench().record(kind, 0)
        sums = [mean_square_residual(job, y) for job in (bench().known, bench().jobs[kind.right])]
        assert np.sqrt(sums[0] / sums[1] - 1.0) == pytest.approx(size, rel=0.25)


def mean_square_residual(job: Job, y: NDArray[np.float64]) -> float:
    """Return the mean square of the residuals at the maximum of the posterior."""
    posterior = compare.of(job, y).problem.posterior
    start = posterior.space.vector(posterior.space.start)[None]
    surface = LogDensity(posterior, physical=True)
    top = gauss_newton(surface, posterior.coordinates.from_physical(start), 60)
    best = posterior.coordinates.to_physical(top.u)
    return float(np.mean((y - posterior.likelihood.signals(best)[0]) ** 2))


def test_the_proposal_covers_a_correlation_near_zero() -> None:
    """In its own coordinate a correlation has no long tail at zero: every draw counts."""
    with starts_believed():
        unfitted = Bench(compare.contenders())
    y, _ = unfitted.record(KINDS[2], 3)
    job = compare.of(unfitted.jobs[RED], y)
    _, sampled = fit(job.problem.posterior, compare.plan(job, 3))
    assert sampled.proposal is not None
    assert sampled.proposal.missed == 0.0
    assert sampled.proposal.draws.effective_share > 0.88
