"""What one writes first: emcee's default move, physical coordinates.

Twice: with `solve_ivp` for every walker, as one would begin, and with bayesdrill's exact response.
The first is too slow to get anywhere in a benchmark; but its autocorrelation time is that of the
second, as the integrator has no say in it.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import emcee
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import problem, verdict
from benchmarks.verdict import Array, Result

WALKERS = 64
KEEP_EVERY = 10
BLOCK = 200  # steps between looks at the clock
# The loosest power of ten that gets the log density right to 0.01 around the MAP; with the default
# of 1e-3 it is wrong by 0.2, and no faster, as the motor's electrical time constant is short.
TOLERANCE = 1e-5
LEAST_STEPS = 100


def with_exact_response(job: problem.Job, budget: float) -> Result:
    """Independent ensembles in two processes."""
    first = problem.starts(job, problem.mode(job), problem.CHAINS * WALKERS, seed=3)
    ensembles = first.reshape(problem.CHAINS, WALKERS, -1)
    share = budget * problem.PROCESSES / problem.CHAINS
    with ProcessPoolExecutor(
        problem.PROCESSES,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_enlist,
    ) as pool:
        list(pool.map(_prepared, range(problem.PROCESSES)))
        begun = time.perf_counter()
        chains = list(pool.map(_walk, ensembles, range(problem.CHAINS), [share] * problem.CHAINS))
        seconds = time.perf_counter() - begun
    steps = min(map(len, chains))
    theta = np.stack([chain[:steps] for chain in chains])
    return verdict.result(
        "emcee, stretch move, our response",
        "physical",
        verdict.judge_ensembles(theta, KEEP_EVERY),
        seconds=seconds,
        work=float(sum(map(len, chains)) * KEEP_EVERY * WALKERS),
        note=f"{steps * KEEP_EVERY} steps of {WALKERS} walkers in every ensemble",
    )


_POST: dict[str, Any] = {}


def _enlist() -> None:
    threadpool_limits(1)
    _POST["job"] = problem.load()


def _prepared(_: int) -> None:
    time.sleep(1.0)  # so that every process gets one of these, before the clock starts


def _walk(first: Array, seed: int, seconds: float) -> Array:
    """Every `KEEP_EVERY`-th step, `(S, W, D)`, of as many as fit into the time."""
    density = _POST["job"].problem.posterior.density
    sampler = emcee.EnsembleSampler(*first.shape, density, vectorize=True)
    state = emcee.State(first, random_state=np.random.RandomState(seed).get_state())
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        state = sampler.run_mcmc(
            state, BLOCK // KEEP_EVERY, thin_by=KEEP_EVERY, skip_initial_state_check=True
        )
    return sampler.get_chain()


def first_try(job: problem.Job, budget: float) -> Result:
    """Ensembles one after another in one process, a share of the budget each."""
    first = problem.starts(job, problem.mode(job), problem.CHAINS * WALKERS, seed=4)
    evaluations, chains = 0, []
    begun = time.perf_counter()
    for k, ensemble in enumerate(first.reshape(problem.CHAINS, WALKERS, -1)):
        sampler = emcee.EnsembleSampler(WALKERS, ensemble.shape[1], log_density(job))
        end = begun + budget * (k + 1) / problem.CHAINS
        state = emcee.State(ensemble, random_state=np.random.RandomState(k).get_state())
        for _ in sampler.sample(state, iterations=100_000, skip_initial_state_check=True):
            if time.perf_counter() > end:
                break
        chains.append(sampler.get_chain()[: sampler.iteration])
        evaluations += (sampler.iteration + 1) * WALKERS
    seconds = time.perf_counter() - begun
    steps = min(map(len, chains))
    theta = np.stack([chain[:steps] for chain in chains])
    # A few steps are the starting points over again: they would pass for independent draws.
    return verdict.result(
        "emcee, stretch move, solve_ivp: as measured",
        "physical",
        verdict.judge_ensembles(theta, 1) if steps >= LEAST_STEPS else verdict.nothing(),
        seconds=seconds,
        work=float(evaluations),
        note=f"{steps} steps in every ensemble, {1e3 * seconds / evaluations:.0f} ms per evaluation",
    )


def log_density(job: problem.Job) -> Any:
    """`theta (9,)` to a number, up to a constant, without any of bayesdrill's own response."""
    low, high = job.problem.posterior.space.box[1:3]
    y = job.problem.experiment.y
    known = job.problem.posterior.likelihood.only_observation.noise.known
    sigma = np.array([known[k] for k in range(y.shape[1])])

    def density(theta: Array) -> float:
        if not ((theta >= low) & (theta <= high)).all():
            return -np.inf
        signals = problem.by_solve_ivp(job, theta, "RK45", rtol=TOLERANCE)
        return float(-0.5 * (((y - signals) / sigma) ** 2).sum())

    return density


def in_the_long_run(short: Result, long: Result) -> Result:
    """`short` had it gone on: its evaluations per second, with the autocorrelation time of `long`.

    Where `long` did not converge its time is a lower bound, so that the rate is an upper one.
    """
    assert long.tau is not None
    rate = short.work / short.seconds / long.tau
    return dataclasses.replace(
        long,
        name="emcee, stretch move, solve_ivp: in the long run",
        seconds=short.seconds,
        work=short.work,
        ess=rate * short.seconds,
        rate=rate,
        converged=False,
        note="evaluations per second over the autocorrelation time of the same move above",
    )
