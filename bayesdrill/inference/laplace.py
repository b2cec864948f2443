"""The log posterior near a point: slopes, curvature, and the Gaussian approximation there.

The approximation is the Gauss-Newton information of the record plus that of the priors, both in the
logs of the unknowns.  It decides where to start and how to scale, never what is reported.

Slopes of the response are exact (`rig.kernels.linear`), its curvature is that of Gauss and
Newton: what a straight response would have.  That is positive, and right where the fit leaves only
noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.priors import Prior, prior_log_sd, prior_sd
from bayesdrill.inference.unknowns import (
    SIMULATOR_ROLES,
    Directions,
    Unknown,
    directional_curvature,
    directional_slope,
)


def information_root(posterior: Posterior, theta: Array) -> Array:
    """Return `R (D, D)` with R' R the information on the logs of the unknowns at `theta (D,)`.

    The root keeps the digits that the information itself would lose: some directions are known ten
    thousand times better than others.  Far from the data the record counts for less: its noise is
    taken to be as large as the residuals there.
    """
    prior_sd = np.array([natural_sd(unknown) for unknown in posterior.space.unknowns])
    at = natural_directions(posterior, theta)
    slopes = [each.signal_slopes(at) for each in posterior.likelihood.observations]
    record = _record_rows(posterior, theta, slopes) / np.sqrt(residual_excess(posterior, theta))
    return np.asarray(np.linalg.qr(np.vstack([record, np.diag(1.0 / prior_sd)]), mode="r"))


def covariance(posterior: Posterior, theta: Array) -> Array:
    """Return the covariance `(D, D)` in the sampler's coordinates, at physical `theta (D,)`."""
    steps = posterior.coordinates.slopes_by_natural(theta[None])[0]
    scaled_root = steps[:, None] * np.linalg.inv(information_root(posterior, theta))
    return np.asarray(scaled_root @ scaled_root.T)


def sandwich(posterior: Posterior, theta: Array) -> Array:
    """Return the covariance `(D, D)` of unknowns at the MAP where residuals are not independent.

    `theta (D,)` is physical, and the covariance is on the natural scales of the unknowns.  It is
    `H^-1 (J + P) H^-1` (Newey and West 1987): H the information of record and priors, P that of the
    priors, J the sum over all pairs of samples of the slopes of their log densities, which is what
    H has of the record where residuals are as the noise says.
    """
    at = natural_directions(posterior, theta)
    slopes = [each.signal_slopes(at) for each in posterior.likelihood.observations]
    rows = _record_rows(posterior, theta, slopes)
    prior = np.diag([natural_sd(unknown) ** -2.0 for unknown in posterior.space.unknowns])
    middle = prior.copy()
    for observation, shifts in zip(posterior.likelihood.observations, slopes, strict=True):
        scores = np.where(observation.experiment.seen, observation.scores(at, shifts), 0.0)
        middle += long_run_variance(scores.sum(axis=2).T)
    bread = np.linalg.inv(rows.T @ rows + prior)
    return np.asarray(bread @ middle @ bread)


# Correlation of neighbours that is taken out before (Andrews and Monahan).
MAX_AUTOCORRELATION = 0.97


def long_run_variance(scores: Array) -> Array:
    """Return the variance `(D, D)` of the sum of correlated `scores (T, D)`.

    What each has of an AR(1) is taken out first, and put back (Andrews and Monahan 1992).  Then
    products at all lags are weighted by the quadratic spectral kernel, as wide as an AR(1) wants it
    on the mean (Andrews 1991, eqs. 2.7, 5.2 and 6.4, with weights that make all scores alike).
    """
    x, n = scores - scores.mean(axis=0), len(scores)
    memory = _autocorrelation(x)
    x[1:] -= memory * x[:-1]
    rho = _autocorrelation(x)
    alpha = float(np.mean(4.0 * rho**2 / (1.0 - rho) ** 4))
    turns = 1.2 * np.pi * np.arange(1, n) / max(1.3221 * (alpha * n) ** 0.2, 1e-3)
    weights = np.append(1.0, 3.0 / turns**2 * (np.sin(turns) / turns - np.cos(turns)))
    around = np.concatenate([weights, [0.0], weights[:0:-1]])  # a convolution, by its transform
    turned = np.fft.rfft(around)[:, None] * np.fft.rfft(x, 2 * n, axis=0)
    summed = (x / (1.0 - memory)).T @ np.fft.irfft(turned, 2 * n, axis=0)[:n]
    return np.asarray(summed / (1.0 - memory))


def _autocorrelation(x: Array) -> Array:
    """Of the columns of `x (T, D)`."""
    correlation = (x[1:] * x[:-1]).sum(axis=0) / np.maximum((x**2).sum(axis=0), 1e-300)
    return np.clip(correlation, -MAX_AUTOCORRELATION, MAX_AUTOCORRELATION)


def natural_sd(unknown: Unknown) -> float:
    """Return the sd of an unknown's prior on its natural scale."""
    if unknown.signed:
        return prior_sd(unknown.prior) / unknown.scale
    return prior_log_sd(unknown.prior)


def natural_directions(posterior: Posterior, theta: Array) -> Directions:
    """Return the directions at `theta (D,)` that move one unknown each by its natural scale."""
    steps = posterior.coordinates.slopes_by_natural(theta[None])[0]
    return directions_at(posterior, theta[None], np.diag(steps))


def directions_at(posterior: Posterior, theta: Array, columns: Array) -> Directions:
    """Return what moves at `theta (W, D)` along `columns (D, q)`, directions of coordinates."""
    space, coordinates = posterior.space, posterior.coordinates
    # d log unknown / d coordinate, or d unknown / d coordinate where it need not be positive
    steps = coordinates.slopes(theta)
    by_log = steps / coordinates.natural(theta)
    m, moved = len(space.columns(*SIMULATOR_ROLES)), None
    if m:
        turned = space.slopes(theta).swapaxes(1, 2) @ (by_log[:, :m, None] * columns[:m])
        moved = turned.swapaxes(1, 2)
    return Directions(
        theta=theta,
        full=space.full(theta),
        columns=columns,
        parameter_directions=moved,
        slopes=steps,
        by_log=by_log,
    )


def _record_rows(posterior: Posterior, theta: Array, slopes: Sequence[Array]) -> Array:
    """Return slopes `(n, D)` of measured numbers over their noise, and a row for each noise unknown."""
    rows, levels = [], []
    for observation, shifts in zip(posterior.likelihood.observations, slopes, strict=True):
        whitened = observation.whitened_jacobian_at(shifts, theta)
        rows.append(np.nan_to_num(whitened.reshape(len(theta), -1), posinf=0.0, neginf=0.0).T)
        information = observation.expected(theta)
        diagonal = information.ndim == 1
        root_ = np.diag(np.sqrt(information)) if diagonal else np.linalg.cholesky(information).T
        levels.append(root_ @ np.eye(len(theta))[observation.noise_columns])
    return np.vstack([*rows, *levels])


def residual_excess(posterior: Posterior, theta: Array) -> float:
    """Return the mean squared residual over the noise variance, at least 1."""
    ratio = float(posterior.likelihood.mean_square(theta[None])[0])
    return max(ratio, 1.0) if np.isfinite(ratio) else 1.0


def matrix_root(matrix: Array) -> Array:
    """Return a square root in principal directions: `root @ root.T == matrix`."""
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-12))


N_QUANTILES = 200  # of equal mass, which the spread of a prior is taken from
END_MARGIN = 1e-9  # of a prior's spread
TAIL_MASS = 1e-9  # of a prior that has no end lies beyond where one searches


@dataclass(frozen=True, slots=True)
class QuadraticModel:
    """Value, slope and curvature at W points along q directions.

    Shapes: `value (W,)`, `slope (W, q)`, `curvature (W, q, q)`, which is minus the second
    derivative. Where the response overflows `value` is -inf and the others are zero.
    """

    value: Array
    slope: Array
    curvature: Array


def concatenate_models(parts: Sequence[QuadraticModel]) -> QuadraticModel:
    """Return one model at the points of all parts, in order."""
    columns = zip(*((part.value, part.slope, part.curvature) for part in parts), strict=True)
    return QuadraticModel(*map(np.concatenate, columns))


class LogDensity:
    """The log density of a posterior, over the sampler's coordinates `u (W, D)`.

    `low`, `high` `(D,)`: the ends between which one searches.  `middle (D,)`: the mean of each prior,
    and `spread (D,)` its sd: how far each unknown may go before the record is seen.
    """

    def __init__(self, posterior: Posterior, *, physical: bool = False) -> None:
        """`physical`: the density over the unknowns themselves, whose maximum is the MAP."""
        self.posterior = posterior
        self.physical = physical
        self._priors = tuple(posterior.space.priors.values())
        bounds = np.array([_ends(unknown) for unknown in posterior.space.unknowns]).T
        low, high = posterior.coordinates.from_physical(bounds)
        shares = (np.arange(N_QUANTILES) + 0.5) / N_QUANTILES
        quantiles = np.stack([prior.quantile(shares) for prior in self._priors], axis=-1)
        # Where coordinates are numbers.
        floor = [-np.inf if unknown.signed else 1e-300 for unknown in posterior.space.unknowns]
        typical = posterior.coordinates.from_physical(np.maximum(quantiles, floor))
        self.middle, self.spread = typical.mean(axis=0), typical.std(axis=0)
        # What lies at an end must not be rounded beyond it.
        self.low, self.high = low + END_MARGIN * self.spread, high - END_MARGIN * self.spread

    def value(self, u: Array) -> Array:
        """Return the log density `(W,)`."""
        if self.physical:
            return self.posterior.density(self.posterior.coordinates.to_physical(u))
        return self.posterior(u)

    def inside(self, u: Array) -> Flags:
        """Return whether the priors have a density there, `(W,)`."""
        return self.posterior.supports(u)

    def quadratic_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return value, slopes and curvature along `directions (D, q)`, column by column."""
        model = self.curvature_model(u, directions)
        with np.errstate(all="ignore"):
            return dataclasses.replace(model, value=model.value + self.value(u))

    @cached_property
    def _unbounded(self) -> LogDensity:

        def unbounded(observation: Observation) -> Observation:
            return dataclasses.replace(observation, response=observation.response.unbounded)

        return LogDensity(self.posterior.edit(each=unbounded))

    def approximate_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return the curvature model by what compressed records say, however far from where they hold.

        For what leads somewhere and is no density: all samples would take a thousand times as long.
        """
        return self._unbounded.curvature_model(u, directions)

    def curvature_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return the model with a value of 0 or -inf: its own would take another response."""
        with np.errstate(all="ignore"):
            theta = self.posterior.coordinates.to_physical(u)
            slope, curvature = self.record_slopes(theta, directions)
        prior_slope, prior_curvature = self.prior_derivatives(u)
        slope += directional_slope(prior_slope, directions)
        curvature += directional_curvature(directions, prior_curvature)
        good = np.isfinite(slope).all(axis=1) & np.isfinite(curvature).all(axis=(1, 2))
        slope[~good], curvature[~good] = 0.0, 0.0
        return QuadraticModel(np.where(good, 0.0, -np.inf), slope, curvature)

    def record_slopes(self, theta: Array, directions: Array) -> tuple[Array, Array]:
        """Return slope `(W, q)` and curvature `(W, q, q)` of the log likelihood."""
        at = directions_at(self.posterior, theta, directions)
        n, q = len(theta), directions.shape[1]
        slope, curvature = np.zeros((n, q)), np.zeros((n, q, q))
        for observation in self.posterior.likelihood.observations:
            for pulled, bent in observation.quadratic_terms(at):
                slope, curvature = slope + pulled, curvature + bent
        return slope, curvature

    def prior_derivatives(self, u: Array) -> tuple[Array, Array]:
        """Return slopes of the log prior, and minus its second derivatives, `(W, D)` each."""
        theta, coordinates = self.posterior.coordinates.to_physical(u), self.posterior.coordinates
        steps, (tilt, bend) = coordinates.slopes(theta), coordinates.jacobian_derivatives(u)
        derivatives = [p.derivatives(theta[:, d]) for d, p in enumerate(self._priors)]
        first, second = np.stack(derivatives, axis=-1)
        with np.errstate(all="ignore"):
            slope = np.nan_to_num(first * steps)
            curvature = np.maximum(np.nan_to_num(-second * steps**2 - slope * tilt), 0.0)
        if not self.physical:
            slope, curvature = slope + tilt, curvature + bend
        return slope, curvature


def _ends(unknown: Unknown) -> tuple[float, float]:
    """Of the support, or of nearly all of it."""
    prior = unknown.prior
    if unknown.between is not None:
        low, high = unknown.between
        inset = TAIL_MASS * (high - low)
        return max(prior.low, low + inset), min(prior.high, high - inset)
    return prior_ends(prior, TAIL_MASS)


def prior_ends(prior: Prior, tail: float) -> tuple[float, float]:
    """Return the ends of a prior's support; of no end, or zero, beyond which `tail` of it lies."""
    bounded = np.isfinite(prior.low) and prior.low != 0  # where nothing itself may be impossible
    low = prior.low if bounded else float(prior.quantile(np.array(tail)))
    high = prior.high if np.isfinite(prior.high) else float(prior.quantile(np.array(1 - tail)))
    return low, high
