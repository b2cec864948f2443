"""The Gaussian approximation of the posterior at a point: scales for optimiser and walkers.

Gauss-Newton information of the record plus the information of the priors, both in the logs of the
unknowns.  It decides where to start and how to scale, never what is reported.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.coordinates import Coordinates
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import spread, spread_of_log
from bayesdrill.inference.unknowns import Unknown

Array = NDArray[np.float64]

_STEP = 1e-5  # of a log: central differences then err by about 1e-10


def information_root(posterior: Posterior, theta: Array) -> Array:
    """`R (D, D)` with R' R the information about the logs of the unknowns, at physical `theta (D,)`.

    The root keeps the digits that the information itself would lose: some directions are known ten
    thousand times better than others.  Far from the data the record counts for less: its noise is
    taken to be what is left there.
    """
    prior_sd = np.array([natural_spread(unknown) for unknown in posterior.space.unknowns])
    record = _record_rows(posterior, theta) / np.sqrt(excess(posterior, theta))
    return np.asarray(np.linalg.qr(np.vstack([record, np.diag(1.0 / prior_sd)]), mode="r"))


def covariance(posterior: Posterior, theta: Array, information: Array | None = None) -> Array:
    """`(D, D)` in the sampler's coordinates, at the physical point `theta (D,)`.

    `information (D, D)`: its root there, where that is known already.
    """
    if information is None:
        information = information_root(posterior, theta)
    spread = slopes_by_logs(posterior.coordinates, theta) @ np.linalg.inv(information)
    return np.asarray(spread @ spread.T)


def slopes_by_logs(coordinates: Coordinates, theta: Array) -> Array:
    """d coordinate / d log unknown at physical `theta (D,)`: `(D, D)`, a column for each unknown."""
    up, down = _neighbours(coordinates, theta)
    return (coordinates.from_physical(up) - coordinates.from_physical(down)).T / (2 * _STEP)


def _neighbours(coordinates: Coordinates, theta: Array) -> tuple[Array, Array]:
    """A step up and down of each unknown, on its natural scale."""
    shifts = np.exp(_STEP * np.eye(len(theta)))
    up, down = theta * shifts, theta / shifts
    for column, step in coordinates.signed:
        up[column, column] = theta[column] + _STEP * step
        down[column, column] = theta[column] - _STEP * step
    return up, down


def natural_spread(unknown: Unknown) -> float:
    """On its natural scale."""
    if unknown.signed:
        return spread(unknown.prior) / unknown.scale
    return spread_of_log(unknown.prior)


def _record_rows(posterior: Posterior, theta: Array) -> Array:
    """Slopes of all measured numbers over their noise, by the logs of the unknowns: `(n, D)`.

    Each unknown of a noise has a row of its own.
    """
    up, down = _neighbours(posterior.coordinates, theta)
    full = posterior.space.full(np.concatenate([up, down]))
    rows, levels = [], []
    for one in posterior.likelihood.observations:
        signals = one.signals(full)
        shifts = np.where(one.experiment.seen, signals[: len(theta)] - signals[len(theta) :], 0.0)
        slopes = _whitened(one, shifts, theta)
        rows.append(np.nan_to_num(slopes.reshape(len(theta), -1), posinf=0.0, neginf=0.0).T)
        information = one.expected(theta)
        levels.append(_root_of(information) @ np.eye(len(theta))[one.own])
    return np.vstack([*rows, *levels])


def _root_of(information: Array) -> Array:
    """`R` with R' R the information about the unknowns of a noise, or its diagonal."""
    if information.ndim == 1:
        return np.diag(np.sqrt(information))
    return np.asarray(np.linalg.cholesky(information).T)


def _whitened(one: Observation, shifts: Array, theta: Array) -> Array:
    """`shifts (D, T, K)` of two steps, over the noise at `theta (D,)`."""
    if one.white:
        return np.asarray(shifts / (2 * _STEP * one.scales(theta[None])[0]))
    return one.inform(shifts / (2 * _STEP), np.repeat(theta[None], len(shifts), axis=0))


def excess(posterior: Posterior, theta: Array) -> float:
    """Mean squared residual over the noise variance, at least 1."""
    ratio = float(posterior.likelihood.per_number(theta[None])[0])
    return max(ratio, 1.0) if np.isfinite(ratio) else 1.0


def draws(
    posterior: Posterior, theta: Array, n: int, rng: np.random.Generator, *, spread: float = 1.0
) -> Array:
    """`(n, D)` points of finite posterior around `theta`, in the sampler's coordinates.

    Raises `ValueError` when the posterior is finite nowhere near.
    """
    centre = posterior.coordinates.from_physical(theta[None])[0]
    steps = root(covariance(posterior, theta)) * spread
    kept: list[Array] = []
    have = 0
    for attempt in range(60):
        shrink = 0.5 ** max(0, attempt - 20)
        z = centre + shrink * rng.standard_normal((n, len(theta))) @ steps.T
        good = z[np.isfinite(posterior(z))]
        kept.append(good)
        have += len(good)
        if have >= n:
            return np.concatenate(kept)[:n]
    raise ValueError("no point of finite posterior was found around the start")


def root(matrix: Array) -> Array:
    """A square root whose columns are principal directions: `root @ root.T == matrix`."""
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-12))
