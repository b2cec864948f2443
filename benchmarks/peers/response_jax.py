"""The same log density in JAX, for samplers that want gradients; nine unknowns, float64.

The response is exact here as well: one matrix exponential per parameter vector (Taylor series of
the matrix, halved so often that the series is exact to rounding all over the box of the priors),
then the samples by doubling, `[X, E^n X]`, a dozen matrix products instead of a loop over a
thousand samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayesdrill.config.job import Job
from bayesdrill.rig.models.motor_shaft import MotorShaft

jax.config.update("jax_enable_x64", True)

TAYLOR_DEGREE = 16
TAYLOR_NORM = 0.75  # 0.75**17 / 17! = 2e-17: the series is exact to rounding below it

Density = Callable[[Any], Any]


def log_likelihood(job: Job) -> Density:
    """`theta (9,)` to a number, up to a constant."""
    experiment, space = job.problem.experiment, job.problem.posterior.space
    rig, names = (
        MotorShaft(job.problem.posterior.likelihood.only_observation.response.model.i_m),
        job.problem.names,
    )
    if experiment.series or experiment.t[0] != experiment.t_start or any(experiment.start.values()):
        raise ValueError("written for constant inputs and a start at rest")
    n, index = len(experiment.t), {state: k for k, state in enumerate(rig.states)}
    weights = jnp.array([[c.weights.get(s, 0.0) for s in rig.states] for c in experiment.channels])
    known = job.problem.posterior.likelihood.only_observation.noise.known
    sigma = jnp.array([known[k] for k in range(len(experiment.channels))])
    y = jnp.array(experiment.y.T)

    def matrix(theta: Any) -> Any:
        """Of the states and a one, times the sampling interval."""
        linear = rig.linear({name: theta[k] for k, name in enumerate(names)})
        entries = {(index[row], index[column]): v for (row, column), v in linear.A.items()}
        for row, value in linear.c.items():
            entries[index[row], 5] = value
        for (row, name), value in linear.B.items():
            if experiment.constant[name] != 0.0:
                entries[index[row], 5] = (
                    entries.get((index[row], 5), 0.0) + value * experiment.constant[name]
                )
        rows = [[entries.get((i, j), 0.0) for j in range(6)] for i in range(6)]
        return experiment.dt * jnp.stack([jnp.stack([jnp.asarray(v) for v in r]) for r in rows])

    halvings = _halvings(matrix, *space.box[1:3])

    def density(theta: Any) -> Any:
        states = _powers(_exponential(matrix(theta), halvings), n)[:5]
        residuals = (y - weights @ states) / sigma[:, None]
        return -0.5 * jnp.sum(residuals * residuals)

    return density


def _halvings(matrix: Density, low: np.ndarray, high: np.ndarray) -> int:
    """Enough for the largest entries that the box allows; only the states' columns count."""
    corner = high.copy()
    sizes = []
    for inductance in (low, high):
        for inertia in (low, high):
            corner[5], corner[0], corner[7] = inductance[5], inertia[0], inertia[7]
            sizes.append(float(jnp.abs(matrix(jnp.array(corner)))[:, :5].sum(axis=1).max()))
    return max(0, math.ceil(math.log2(max(sizes) / TAYLOR_NORM)))


def _exponential(matrix: Any, halvings: int) -> Any:
    small = matrix / 2.0**halvings
    one = jnp.eye(matrix.shape[0])
    # Horner in blocks of four powers: seven products for degree 16 (Paterson and Stockmeyer).
    p2 = small @ small
    p3, p4 = p2 @ small, p2 @ p2
    c = [1.0 / math.factorial(k) for k in range(TAYLOR_DEGREE + 1)]
    total = c[16] * one
    for k in (12, 8, 4, 0):
        total = total @ p4 + c[k] * one + c[k + 1] * small + c[k + 2] * p2 + c[k + 3] * p3
    for _ in range(halvings):
        total = total @ total
    return total


def _powers(step: Any, n: int) -> Any:
    """`[x_0, E x_0, E^2 x_0, ...]`, `(6, n)`, from rest."""
    states = jnp.zeros((6, 1)).at[5, 0].set(1.0)
    while states.shape[1] < n:
        states = jnp.concatenate([states, step @ states], axis=1)
        step = step @ step
    return states[:, :n]
