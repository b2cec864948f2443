"""Rigs that lack a torque, records of them, and draws of what such a record says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import multivariate_t

import bayesdrill as bd
from bayesdrill.inference import laplace
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.gauss_newton import gauss_newton

Array = NDArray[np.float64]

T = 0.02 * np.arange(501)  # s
VOLTS = 6 * np.sin(0.5 * np.pi * T) + 4 * np.sin(1.24 * np.pi * T + 0.5)
SIGMA = {"theta_1": 0.02, "theta_2": 0.02, "w_1": 0.1, "w_2": 0.1}
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
FREE = ("j_m", "k_e", "k_s", "j_1")
RIG = {**dict.fromkeys(FREE, BOX), **dict.fromkeys(("c_m", "k_T", "r_m", "l_m"), "nominal")}
FRICTION = {"prior": "uniform", "low": 0.05, "high": 0.25}  # N m, at rotor 1
TORQUE = {
    "at": "rotor_1",
    "smoothness": "1/2",
    "size": {"prior": "log_uniform", "low": 1e-3, "high": 10},
    "time": {"prior": "log_uniform", "low": 0.01, "high": 10},
}
PIECES = 64  # of a step of the rig that rubs: far finer than what it is fitted with
DRAWS, ROUNDS, ENOUGH, WIDER = 3000, 5, 0.3, 1.2


def observed(**entries: object) -> Posterior:
    """Of no record yet."""
    own = {"t_f": 0.0, **entries.pop("rubs", {})}  # type: ignore[dict-item]
    channels = {
        name: bd.Channel(np.sin(T), "rad" if name.startswith("theta") else "rad/s", sigma)
        for name, sigma in SIGMA.items()
    }
    volts = {"v": bd.Input(VOLTS, "V")}
    made = bd.case(T, channels, volts, {**RIG, **own}, nominal="tables_2_3", **entries)
    return made.job.problem.posterior


def of(posterior: Posterior, one: Observation) -> Posterior:
    likelihood = replace(posterior.likelihood, observations=(one,))
    return replace(posterior, likelihood=likelihood)


def weighed(
    target: Posterior, true: Array, seed: int, enough: float = ENOUGH
) -> tuple[Array, Array]:
    """Draws about the maximum, over the coordinates, and their weights: of a proposal that is fitted to
    them until enough count.
    """
    middle = gauss_newton(LogDensity(target), true, 60).u[0]
    covariance = laplace.covariance(target, target.coordinates.to_physical(middle[None])[0])
    for k in range(ROUNDS):
        proposal = multivariate_t(middle, WIDER * covariance, df=5, seed=ROUNDS * seed + k)
        u = proposal.rvs(DRAWS)
        logs = target(u) - proposal.logpdf(u)
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        share = 1.0 / (weights @ weights) / DRAWS
        if share > enough:
            return u, weights
        some = np.sqrt(weights) / np.sqrt(weights).sum() if share < ENOUGH / 10 else weights
        middle = some @ u
        covariance = ((u - middle).T * some) @ (u - middle)
    raise AssertionError(f"record {seed}: {share:.2f} of the draws count")


def points_near(
    posterior: Posterior, theta: np.ndarray, n: int, rng: np.random.Generator
) -> np.ndarray:
    """Return `(n, D)` points of finite density around `theta (D,)`, in the sampler's coordinates."""
    centre = posterior.coordinates.from_physical(theta[None])[0]
    root = laplace.matrix_root(laplace.covariance(posterior, theta))
    points = np.empty((0, len(theta)))
    while len(points) < n:
        z = centre + rng.standard_normal((n, len(theta))) @ root.T
        points = np.concatenate([points, z[np.isfinite(posterior(z))]])
    return points[:n]
