"""Compute the density of log products that follows from the priors of the parameters.

The K log products are z = A x, where x are the logs of D unknowns with independent priors.  K of the
unknowns, x_d with the square block A_d, follow from z and the D - K free unknowns x_f (block A_f):

    p(z) = integral of p_d(A_d^-1 (z - A_f x_f)) p_f(x_f) dx_f / |det A_d|.

Along the first free unknown, the interval inside all priors is known exactly, so Gauss-Legendre
quadrature over this interval is accurate.  The values of other free unknowns are quantiles of their
priors at lattice points.  The lattice is the same for all z, so the density is continuous in z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.priors import Prior

INNER_NODES = 24  # number of quadrature nodes along the first free unknown
OUTER_NODES = 509  # number of lattice points for the other free unknowns, a prime
CUT_MASS = 1e-10  # prior mass beyond each end of the quadrature
BATCH = 1 << 20  # approximate number of elements of a temporary array


@dataclass(frozen=True, slots=True)
class _FreeUnknowns:
    """The logs of all unknowns are `z @ by_product.T + offset (O, D) + v * direction (D,)`.

    `v` is the log of the first free unknown; all logs lie between `low` and `high (D,)`.
    `outer` are the columns of the other free unknowns, whose values the lattice sets.
    """

    by_product: Array
    offset: Array
    direction: Array
    low: Array
    high: Array
    outer: frozenset[int]
    log_det: float


def log_density_of_products(
    log_products: Array, exponents: Array, priors: Sequence[Prior]
) -> Array:
    """Return the log density of log products under independent priors of the unknowns.

    Parameters
    ----------
    log_products : array, shape (S, K)
        Logarithms of the products.
    exponents : array, shape (K, D)
        Each row has the powers of the unknowns in a product; rows are independent.
    priors : sequence of D priors
        Priors of the unknowns, which are positive.

    Returns
    -------
    array, shape (S,)
        The log density; -inf if no unknowns inside their priors give these products.

    Raises
    ------
    ValueError
        If products depend on one another.
    """
    matrix = np.asarray(exponents, dtype=float)
    used = np.flatnonzero((matrix != 0).any(axis=0))
    matrix, used_priors = matrix[:, used], [priors[int(k)] for k in used]
    if np.linalg.matrix_rank(matrix) < len(matrix):
        raise ValueError(f"The {len(matrix)} products depend on one another; leave one out.")
    if matrix.shape[0] == matrix.shape[1]:
        logs = np.linalg.solve(matrix, log_products.T).T
        return _log_prior(used_priors, logs) - float(np.linalg.slogdet(matrix)[1])
    free = _free_unknowns(matrix, used_priors)
    size = max(1, BATCH // (len(free.offset) * INNER_NODES * len(used)))
    parts = range(0, len(log_products), size)
    return np.concatenate(
        [_integral(free, used_priors, log_products[start : start + size]) for start in parts]
    )


def _free_unknowns(matrix: Array, priors: Sequence[Prior]) -> _FreeUnknowns:
    """Choose the free unknowns, and set all except the first to lattice points."""
    count, width = matrix.shape
    order = scipy.linalg.qr(matrix, mode="r", pivoting=True)[1]
    determined, first, outer = order[:count], order[count], order[count + 1 :]
    inverse = np.linalg.inv(matrix[:, determined])
    lattice = _lattice(len(outer))
    nodes = np.zeros((len(lattice), width))
    for points, k in zip(lattice.T, outer, strict=True):
        nodes[:, k] = np.log(priors[k].quantile(points))
    nodes[:, determined] = -(nodes[:, outer] @ matrix[:, outer].T) @ inverse.T
    direction = np.zeros(width)
    direction[first], direction[determined] = 1.0, -inverse @ matrix[:, first]
    direction[np.abs(direction) < 1e-12] = 0.0
    by_product = np.zeros((width, count))
    by_product[determined] = inverse
    ends = [np.log(prior.quantile(np.array([CUT_MASS, 1.0 - CUT_MASS]))) for prior in priors]
    low, high = np.array(ends).T
    log_det = float(np.linalg.slogdet(matrix[:, determined])[1])
    fixed = frozenset(int(k) for k in outer)
    return _FreeUnknowns(by_product, nodes, direction, low, high, fixed, log_det)


def _lattice(dimension: int) -> Array:
    """Return points `(O, n)` of a Kronecker lattice in the unit cube; a single point if n = 0."""
    if dimension == 0:
        return np.zeros((1, 0))
    golden = 2.0
    for _ in range(30):  # the root of g^(n + 1) = g + 1 spreads points evenly in n dimensions
        golden = (1.0 + golden) ** (1.0 / (dimension + 1))
    steps = golden ** -np.arange(1.0, dimension + 1)
    return np.asarray((np.arange(1, OUTER_NODES + 1)[:, None] * steps) % 1.0)


def _integral(free: _FreeUnknowns, priors: Sequence[Prior], log_products: Array) -> Array:
    """Return the log density at `log_products (S, K)`."""
    base = (log_products @ free.by_product.T)[:, None, :] + free.offset
    moving = free.direction != 0
    ends = (np.stack([free.low, free.high])[:, None, None] - base)[..., moving]
    ends = np.sort(ends / free.direction[moving], axis=0)
    low, high = ends[0].max(axis=-1), ends[1].min(axis=-1)
    half = 0.5 * np.maximum(high - low, 0.0)
    nodes, weights = np.polynomial.legendre.leggauss(INNER_NODES)
    v = 0.5 * (low + high)[..., None] + half[..., None] * nodes
    logs = base[:, :, None, :] + v[..., None] * free.direction
    density = _log_prior(
        [prior for k, prior in enumerate(priors) if k not in free.outer],
        np.delete(logs, sorted(free.outer), axis=-1),
    )
    with np.errstate(divide="ignore"):
        total = np.log(half)[..., None] + np.log(weights) + density
        summed = np.logaddexp.reduce(total.reshape(len(total), -1), axis=1)
    return np.asarray(summed - np.log(len(free.offset)) - free.log_det)


def _log_prior(priors: Sequence[Prior], logs: Array) -> Array:
    """Return the joint log density `(...)` of the logs `(..., D)` of unknowns."""
    with np.errstate(over="ignore"):
        parts = [
            prior.logpdf(np.exp(x)) + x
            for prior, x in zip(priors, np.moveaxis(logs, -1, 0), strict=True)
        ]
    return np.asarray(sum(parts))
