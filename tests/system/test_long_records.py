"""A long record is compressed: the same posterior as by all samples, said in words and checked."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import Silent
from bayesdrill.inference import compression
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.rig.simulators.compressed import CompressedSimulator
from bayesdrill.sampling import fit as fits
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import find_map

T = np.arange(24_001) / 500.0
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
LEVEL = {"prior": "log_uniform", "low": 0.01, "high": 1.0}


@cache
def case(likelihood: str = "auto") -> bd.Case:
    """Two speeds under random steps of voltage; the noise of one of them is unknown."""
    rng = np.random.default_rng(5)
    v = np.where(rng.random(len(T) // 100 + 1) < 0.5, 4.0, 12.0).repeat(100)[: len(T)]
    exact = bd.respond(MotorShaft(), NOMINAL, T, {"v": v}, ["w_1", "w_2"])
    noise = 0.1 * rng.standard_normal((2, len(T)))
    free = ("j_m", "k_e", "r_m", "k_s", "j_1")
    return bd.case(
        T,
        {
            "w_1": bd.Channel(exact["w_1"] + noise[0], "rad/s", 0.1),
            "w_2": bd.Channel(exact["w_2"] + noise[1], "rad/s", LEVEL),
        },
        {"v": bd.Input(v, "V")},
        parameters={name: BOX if name in free else "nominal" for name in NOMINAL},
        nominal="tables_2_3",
        sampler={"likelihood": likelihood, "walkers": 32, "ess": 1000},
        name="long",
    )


@cache
def sampled(likelihood: str) -> bd.Run:
    return case(likelihood).sample(processes=1)


def test_the_posterior_is_that_of_all_samples() -> None:
    short, whole = sampled("auto"), sampled("exact")
    assert short.converged
    assert whole.converged
    pairs = zip(short.analysis.unknowns, whole.analysis.unknowns, strict=True)
    apart = [abs(mine.mean - row.mean) / row.sd for mine, row in pairs]
    assert max(apart) < 0.15  # some five Monte Carlo errors
    assert short.evidence.log_z == pytest.approx(whole.evidence.log_z, abs=0.1)
    assert short.sampled.compression is not None
    assert whole.sampled.compression is None


def test_draws_are_checked_against_the_exact_likelihood() -> None:
    check = sampled("auto").sampled.compression
    assert check is not None
    assert check.samples == len(T)
    assert check.draws == 500
    assert check.difference < 1e-6
    assert check.exact < 10


def test_the_search_sees_an_excerpt_and_then_all() -> None:
    problem = case().job.problem
    plan = find_map.fit_plan(case().job)
    with WorkerPool(problem.posterior, 1) as pool:
        under_way = fits.begin_searches(pool, plan, Silent())
        assert under_way.excerpt is not None
        seen = under_way.excerpt.likelihood.observations[0].experiment
        assert len(seen.t) == compression.EXCERPT
        mode = fits.end_searches(pool, under_way, Silent())
        response = pool.posterior.likelihood.observations[0].response
        assert isinstance(response, CompressedSimulator)
    theta = problem.posterior.space.vector(mode.values)
    assert mode.same_height == plan.starts
    here = problem.posterior.density(theta[None])[0]
    assert here == pytest.approx(mode.log_posterior, abs=1e-6)
    for column in range(len(theta)):
        for factor in (1 - 1e-5, 1 + 1e-5):
            beside = theta.copy()
            beside[column] *= factor
            assert problem.posterior.density(beside[None])[0] < here + 1e-6


def test_what_cannot_be_compressed_is_refused_where_it_is_asked_for() -> None:
    with pytest.raises(InputError, match="cannot be compressed: the rig has dry friction"):
        bd.case(
            T[:200],
            {"w_1": bd.Channel(np.sin(T[:200]), "rad/s", 0.1)},
            {"v": 8.0},
            parameters={**dict.fromkeys(NOMINAL, "nominal"), "t_c1": 0.01, "k_e": BOX},
            sampler={"likelihood": "compressed"},
            name="rubbing",
        )


def test_a_run_that_goes_on_has_the_same_functions() -> None:
    """Mutant killed: functions about the maximum that depend on those of the search."""
    problem, plan = case().job.problem, find_map.fit_plan(case().job)
    triangles = []
    with WorkerPool(problem.posterior, 1) as searched:
        mode = fits.end_searches(searched, fits.begin_searches(searched, plan, Silent()), Silent())
        with WorkerPool(problem.posterior, 1) as resumed:
            for pool in (searched, resumed):
                fits.compress_about(pool, mode, plan.shortest)
                response = pool.posterior.likelihood.observations[0].response
                assert isinstance(response, CompressedSimulator)
                triangles.append(response.compression.record.matrix)
    assert np.array_equal(*triangles)
