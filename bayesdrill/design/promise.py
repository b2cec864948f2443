"""Compute promised standard deviations under the priors as they are, and not as Gaussians.

Where a coming record leaves a direction open, its posterior follows the priors and their ends.  The
likelihood near a draw is Gaussian in the unknowns on their natural scales.  Its product with the priors
is sampled by elliptical slices, which need no tuning (Murray, Adams and MacKay 2010).  Some samples are
then simulated, and moved to the curved ridge of the likelihood by a step of Gauss and Newton.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.design.knowledge import PresentKnowledge
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.unknowns import ParameterSpace

CHAINS = 1024  # for all draws together, of which each has its share
WARM_STEPS, KEPT_STEPS = 40, 60  # of each chain
MAX_SHRINKS = 60  # of an ellipse, after which a chain stays: the angle is below rounding then
SIMULATED = 256  # samples for all draws together that are moved to the ridge

LogWeight = Callable[[Array, Indices], Array]  # of points `(n, m)` and their chains `(n,)`


def promise(
    posterior: Posterior, known: PresentKnowledge, slopes: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return relative sds `(k,)` of targets with `slopes (W, k, m)` after a record of a posterior.

    The sds are geometric means over draws.  The second result is the information `(W, m, m)` of the
    record at each draw.
    """
    study, space, draws = SensitivityStudy(posterior.likelihood), posterior.space, known.draws
    rows = [study.with_nuisances(theta) for theta in draws]
    information = np.stack([each.T @ each for each in rows])
    path = sample_deviations(space, known, information, rng)
    sds = spreads(path, slopes)
    for w, theta in enumerate(draws):
        linear = path[-1, w, : max(2, SIMULATED // len(draws))]
        points = _moved(space, np.repeat(theta[None], len(linear), axis=0), linear)
        beyond = study.changes(theta, points) - linear @ rows[w].T
        back = np.linalg.solve(information[w] + known.precision, rows[w].T @ beyond.T).T
        # The sd of all samples has less noise than that of the simulated ones, so it is corrected.
        sds[w] *= ((linear - back) @ slopes[w].T).std(axis=0) / (linear @ slopes[w].T).std(axis=0)
    return geometric_mean(sds), information


def present_sds(
    space: ParameterSpace, known: PresentKnowledge, slopes: Array, rng: np.random.Generator
) -> Array:
    """Return relative sds `(k,)` of targets with `slopes (W, k, m)` without a further record."""
    nothing = np.zeros((len(slopes), *known.precision.shape))
    return geometric_mean(spreads(sample_deviations(space, known, nothing, rng), slopes))


def spreads(path: Array, slopes: Array) -> Array:
    """Return sds `(W, k)` of targets with `slopes (W, k, m)` over samples `path (S, W, C, m)`."""
    return np.asarray(np.einsum("wkm,swcm->wksc", slopes, path).std(axis=(2, 3)))


def geometric_mean(sds: Array) -> Array:
    """Return the means `(k,)` of sds `(W, k)` over draws."""
    return np.asarray(np.exp(np.log(sds).mean(axis=0)))


def sample_deviations(
    space: ParameterSpace, known: PresentKnowledge, information: Array, rng: np.random.Generator
) -> Array:
    """Return deviations `(S, W, C, m)` from draws, on natural scales, after C chains for each draw.

    `information (W, m, m)` is that of a record at each draw.
    """
    draws, m, chains = known.draws, known.precision.shape[0], max(2, CHAINS // len(known.draws))
    # The inverse of a triangular root keeps the digits of directions that are known well.
    roots = np.linalg.inv(np.linalg.cholesky(information + known.precision))
    bases, logs = draws.repeat(chains, axis=0), _logs(space, m)

    def log_weight(points: Array, here: Indices) -> Array:
        """Return the log of the priors over their Gaussian approximation."""
        if known.gaussian:
            return np.zeros(len(points))
        gaussian = 0.5 * ((points @ known.precision) * points).sum(axis=1)
        jacobian = points[:, logs].sum(axis=1)
        return np.asarray(space.log_prior(_moved(space, bases[here], points)) + jacobian + gaussian)

    steps = WARM_STEPS + KEPT_STEPS
    path = elliptical_slices(roots.repeat(chains, axis=0), log_weight, steps, rng)[WARM_STEPS:]
    return path.reshape(KEPT_STEPS, len(draws), chains, m)


def _logs(space: ParameterSpace, m: int) -> Flags:
    return np.array([not unknown.signed for unknown in space.unknowns[:m]])


def _moved(space: ParameterSpace, theta: Array, deviations: Array) -> Array:
    """Return unknowns `theta (N, D)`, moved by `deviations (N, m)` on natural scales."""
    m = deviations.shape[1]
    out, logs = theta.copy(), _logs(space, m)
    plain = theta[:, :m] + space.coordinates.natural(theta)[:, :m] * deviations
    with np.errstate(over="ignore"):
        out[:, :m] = np.where(logs, theta[:, :m] * np.exp(deviations), plain)
    return out


def elliptical_slices(
    roots: Array, log_weight: LogWeight, steps: int, rng: np.random.Generator
) -> Array:
    """Sample N(0, R' R) times exp(log_weight) by a chain for each root R in `roots (N, m, m)`.

    All chains begin at zero.  Returns all points, `(steps, N, m)`.
    """
    count, m = roots.shape[:2]
    points, every = np.zeros((count, m)), np.arange(count)
    heights, path = log_weight(points, every), np.empty((steps, count, m))
    for step in range(steps):
        others = (rng.standard_normal((count, 1, m)) @ roots)[:, 0]
        levels = heights - rng.exponential(size=(count,))
        angles = 2.0 * np.pi * rng.random((count,))
        low, high = angles - 2.0 * np.pi, angles.copy()
        before, moving = points.copy(), every
        for _ in range(MAX_SHRINKS):
            angle = angles[moving, None]
            trial = before[moving] * np.cos(angle) + others[moving] * np.sin(angle)
            value = log_weight(trial, moving)
            good = value >= levels[moving]
            points[moving[good]], heights[moving[good]] = trial[good], value[good]
            moving = moving[~good]
            if not len(moving):
                break
            backward = angles[moving] < 0.0
            low[moving[backward]] = angles[moving[backward]]
            high[moving[~backward]] = angles[moving[~backward]]
            angles[moving] = low[moving] + (high - low)[moving] * rng.random(len(moving))
        path[step] = points
    return path
