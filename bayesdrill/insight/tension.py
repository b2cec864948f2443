"""How far draws are from a value, in sigma, and how much they tell beyond a prior, in bits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.special import ndtr, ndtri
from scipy.stats import chi2, differential_entropy, norm

Array = NDArray[np.float64]

FARTHEST, STEP = 3.0, 0.25  # sigma: tails are counted up to here, ...
LEAST_BEYOND = 25  # ... where at least so many draws lie beyond
FAR_OUT = 1000.0  # a squared distance whose tail probability no longer fits into a float
PRIOR_BINS = 100  # of equal mass, for the density of a product under the prior


def tension(logs: Array, low: float, high: float) -> float:
    """Sigmas between draws `(N,)` and the nearest value from `low` to `high`.

    The two-sided tail probability of that value, as sigmas of a normal; where too few draws lie
    beyond it to be counted, the tail goes on as wide as it was up to there, or wider.
    """
    middle = float(np.median(logs))
    value = min(max(middle, low), high)
    side = np.sign(value - middle)
    if side == 0:
        return 0.0
    top = min(FARTHEST, float(-ndtri(min(LEAST_BEYOND / len(logs), 0.4))))
    scores = np.linspace(0.0, top, max(3, round(top / STEP) + 1))
    places = np.abs(np.quantile(logs, ndtr(side * scores)) - middle)
    distance = abs(value - middle)
    if distance <= places[-1]:
        return float(np.interp(distance, places, scores))
    last = (places[-1] - places[-2]) / (scores[-1] - scores[-2])
    sd = max(float(places[-1]) / top, float(last), 1e-300)
    return top + (distance - float(places[-1])) / sd


def joint_tension(logs: Array, powers: Array, ends: Array) -> float:
    """Sigmas between draws `(N, K)` of products with `powers (K, m)` and the nearest point at which
    every factor is within its tolerance, `ends (m, 2)`.

    Of the Mahalanobis distance: the share of draws at least as far out, as sigmas of a normal; where
    too few are, chi-squared says how many would be.
    """
    centre = logs.mean(axis=0)
    scale = logs.std(axis=0)
    root = np.linalg.cholesky(np.atleast_2d(np.cov((logs / scale).T))) * scale[:, None]
    spread = np.linalg.solve(root, (logs - centre).T)
    middle = np.linalg.solve(root, centre)
    wide = ends[:, 1] > ends[:, 0]
    if wide.any():
        matrix = np.linalg.solve(root, powers[:, wide])
        nearest = lsq_linear(matrix, middle, bounds=(ends[wide, 0], ends[wide, 1]))
        middle = middle - matrix @ nearest.x
    squared = float(middle @ middle)
    beyond = int(np.sum(np.sum(spread**2, axis=0) >= squared))
    if beyond >= LEAST_BEYOND:
        return float(norm.isf(0.5 * beyond / len(logs)))
    if squared > FAR_OUT:
        return math.sqrt(squared)
    p = min(float(chi2.sf(squared, len(powers))), LEAST_BEYOND / len(logs))
    return float(norm.isf(0.5 * p))


def bits_gained(logs: Array, prior_logs: Array) -> float:
    """Kullback-Leibler divergence from prior to posterior, in bits, from draws of both.

    Entropy of the posterior from spacings of its sorted draws (Ebrahimi's, nearly unbiased), density
    of the prior from bins of equal mass.  Below zero only by chance, and then zero.
    """
    edges = np.quantile(prior_logs, np.linspace(0.0, 1.0, PRIOR_BINS + 1))
    log_density = -math.log(PRIOR_BINS) - np.log(np.maximum(np.diff(edges), 1e-300))
    bins = np.clip(np.searchsorted(edges, logs) - 1, 0, PRIOR_BINS - 1)
    return max(0.0, (-_entropy(logs) - float(log_density[bins].mean())) / math.log(2.0))


def _entropy(logs: Array) -> float:
    """In nats; where one value is repeated over and over (a stuck walker), of the distinct ones."""
    sd = float(logs.std()) or 1e-300
    with np.errstate(divide="ignore"):
        entropy = float(differential_entropy(logs / sd, method="ebrahimi"))
    if not np.isfinite(entropy):
        entropy = float(differential_entropy(np.unique(logs) / sd, method="ebrahimi"))
    return entropy + math.log(sd)
