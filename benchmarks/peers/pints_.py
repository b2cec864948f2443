"""PINTS: the default sampler of its MCMC controller, adaptive covariance (HaarioBardenetACMC).

It is given bayesdrill's compiled likelihood, so that the samplers alone are compared, and the
covariance of the Gaussian approximation at the MAP to start from.  Two chains in each process.
"""

from __future__ import annotations

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pints
from threadpoolctl import threadpool_limits

from bayesdrill.inference.posterior import Posterior
from benchmarks import problem, verdict
from benchmarks.verdict import Array, Result

TRIAL = 3000  # iterations that are timed to know how many fit into the budget
BURN_IN = 0.25  # share of the iterations that is dropped; its time counts


class LogDensity(pints.LogPDF):
    """bayesdrill's posterior over the physical parameters."""

    def __init__(self, posterior: Posterior) -> None:
        self._posterior = posterior

    def n_parameters(self) -> int:
        return len(self._posterior.space.free)

    def __call__(self, theta: Array) -> float:
        return float(self._posterior.density(np.asarray(theta, dtype=float)[None])[0])


def run(job: problem.Job, coordinates: str, budget: float) -> Result:
    centre = problem.mode(job)
    first = problem.starts(job, centre, problem.CHAINS, seed=8)
    covariance = np.cov(problem.starts(job, centre, 500, seed=6).T) / problem.START_SPREAD**2
    jobs = [(k, part, covariance, coordinates, budget) for k, part in enumerate(np.split(first, 2))]
    with ProcessPoolExecutor(
        problem.PROCESSES, mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        parts = list(pool.map(_chains, *zip(*jobs, strict=True)))
    iterations = min(theta.shape[1] for theta, _, _ in parts)
    theta = np.concatenate([theta[:, :iterations] for theta, _, _ in parts])
    seconds = max(seconds for _, seconds, _ in parts)
    cost = np.mean([cost for _, _, cost in parts])
    shown = "physical" if coordinates == "physical" else "log"
    return verdict.result(
        "PINTS, adaptive covariance, our response",
        shown,
        verdict.judge(theta[:, int(BURN_IN * iterations) :]),
        seconds=seconds,
        work=float(theta.shape[0] * iterations),
        note=f"{iterations} iterations of each chain; the likelihood takes {cost:.0%} of the time",
    )


def _chains(
    seed: int, first: Array, covariance: Array, coordinates: str, budget: float
) -> tuple[Array, float, float]:
    """Chains `(2, N, 9)`, how long they took, and the likelihood's share of that."""
    np.random.seed(seed)  # noqa: NPY002 (PINTS knows no other)
    with threadpool_limits(1):
        density = LogDensity(problem.load().problem.posterior)
        trial = _sample(density, first, covariance, coordinates, TRIAL)
        iterations = int(TRIAL * budget / trial[1])
        theta, seconds = _sample(density, first, covariance, coordinates, iterations)
        begun = time.perf_counter()
        for point in first.repeat(500, axis=0):
            density(point)
        each = (time.perf_counter() - begun) / (500 * len(first))
    return theta, seconds, each * iterations * len(first) / seconds


def _sample(
    density: LogDensity, first: Array, covariance: Array, coordinates: str, iterations: int
) -> tuple[Array, float]:
    logs = pints.LogTransformation(density.n_parameters())
    controller = pints.MCMCController(
        density,
        len(first),
        list(first),
        sigma0=covariance,
        transformation=logs if coordinates == "log" else None,
    )
    controller.set_max_iterations(iterations)
    controller.set_log_to_screen(False)
    begun = time.perf_counter()
    theta = controller.run()
    return theta, time.perf_counter() - begun
