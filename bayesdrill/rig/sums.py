"""Sums of least squares from signals and their slopes, some walkers at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesdrill.rig.simulator import Simulator

Array = NDArray[np.float64]

MOST_BYTES = 6e7  # of sensitivities at a time
MOST_SQUARES = 1e200  # beyond which a product of their logs may have overflown


def interval_sums(tally: Array) -> Array:
    """Of a tally of intervals `(W, K, 4)`, likewise."""
    return np.asarray(log_sums(tally[..., :3]) + tally[..., 3])


def log_sums(tally: Array) -> Array:
    """Of a tally of logs `(W, K, 3)`, see `kernels.tally`: `(W, K)`, NaN where squares overflow."""
    squares, product, powers = np.moveaxis(tally, -1, 0)
    whole = np.ascontiguousarray(powers).view(np.int64)
    found = np.log(product) + math.log(2.0) * whole
    return np.asarray(np.where(squares < MOST_SQUARES, found, np.nan))


def normal(of: Simulator, full: Array, along: Array, scales: Array) -> tuple[Array, Array, Array]:
    """See `Simulator.normal`."""
    n, q, _ = along.shape
    y, seen = of.experiment.y, of.experiment.seen
    squares, slopes, products = np.empty((n, y.shape[1])), np.empty((n, q)), np.empty((n, q, q))
    chunk = max(1, int(MOST_BYTES / (8 * q * max(seen.size, 1))))
    for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
        signals, found = of.course(full[rows], along[rows])
        left = np.where(seen, y - signals, 0.0) * scales[rows, None, :]
        shown = np.where(seen, found, 0.0) * scales[rows, None, None, :]
        flat = shown.reshape(*shown.shape[:2], -1)
        products[rows] = flat @ flat.swapaxes(1, 2)
        slopes[rows] = (flat @ left.reshape(len(flat), -1, 1))[..., 0]
        squares[rows] = (left**2).sum(axis=1)
    return squares, slopes, products
