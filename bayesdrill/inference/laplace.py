"""Approximate the log posterior near a point by its slopes and curvature, as a Gaussian.

The curvature is the Gauss-Newton information of the record plus that of the priors, both in the
logs of the unknowns.  Slopes of the response are exact (`rig.kernels.linear`), and its second
derivatives are neglected.  The information is then positive, and right on average for a good fit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
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
    """Return `R (D, D)` such that R' R is the information on the logs of the unknowns.

    `theta (D,)` is physical.  Some directions are known ten thousand times better than others, so
    the information itself would lose digits that the root keeps.  If the fit is bad, the noise is
    taken to be as large as the residuals.
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
    """Return the covariance `(D, D)` of the unknowns at the MAP, allowing for correlated residuals.

    `theta (D,)` is physical, and the covariance is on the natural scales of the unknowns.  It is
    `H^-1 (J + P) H^-1` (Newey and West 1987), where H is the information of record and priors, and P
    that of the priors.  J is the sum of g_s g_t' over all pairs of samples s and t, where g_t is
    the slope of the log density of sample t.  If the noise model is right, the mean of J is H - P.
    """
    at = natural_directions(posterior, theta)
    slopes = [each.signal_slopes(at) for each in posterior.likelihood.observations]
    rows = _record_rows(posterior, theta, slopes)
    prior = np.diag([natural_sd(unknown) ** -2.0 for unknown in posterior.space.unknowns])
    middle = prior.copy()
    for observation, shifts in zip(posterior.likelihood.observations, slopes, strict=True):
        scores = np.where(observation.experiment.is_measured, observation.scores(at, shifts), 0.0)
        middle += long_run_variance(scores.sum(axis=2).T)
    bread = np.linalg.inv(rows.T @ rows + prior)
    return np.asarray(bread @ middle @ bread)


# Largest autocorrelation that prewhitening removes (Andrews and Monahan 1992).
MAX_AUTOCORRELATION = 0.97


def long_run_variance(scores: Array) -> Array:
    """Return the variance `(D, D)` of the sum of correlated `scores (T, D)`.

    Each column is prewhitened by an AR(1), and the result recoloured (Andrews and Monahan 1992).
    Products at all lags are weighted by the quadratic spectral kernel.  The kernel's width is
    optimal for an AR(1), with equal weights of all columns (Andrews 1991, eqs. 2.7, 5.2 and 6.4).
    """
    x, n = scores - scores.mean(axis=0), len(scores)
    memory = _autocorrelation(x)
    x[1:] -= memory * x[:-1]
    rho = _autocorrelation(x)
    alpha = float(np.mean(4.0 * rho**2 / (1.0 - rho) ** 4))
    turns = 1.2 * np.pi * np.arange(1, n) / max(1.3221 * (alpha * n) ** 0.2, 1e-3)
    weights = np.append(1.0, 3.0 / turns**2 * (np.sin(turns) / turns - np.cos(turns)))
    symmetric = np.concatenate([weights, [0.0], weights[:0:-1]])  # a convolution by FFT
    spectrum = np.fft.rfft(symmetric)[:, None] * np.fft.rfft(x, 2 * n, axis=0)
    summed = (x / (1.0 - memory)).T @ np.fft.irfft(spectrum, 2 * n, axis=0)[:n]
    return np.asarray(summed / (1.0 - memory))


def _autocorrelation(x: Array) -> Array:
    """Return the correlation of neighbours in each column of `x (T, D)`, `(D,)`."""
    correlation = (x[1:] * x[:-1]).sum(axis=0) / np.maximum((x**2).sum(axis=0), 1e-300)
    return np.clip(correlation, -MAX_AUTOCORRELATION, MAX_AUTOCORRELATION)


def natural_sd(unknown: Unknown) -> float:
    """Return the sd of an unknown's prior on its natural scale."""
    if unknown.signed:
        return prior_sd(unknown.prior) / unknown.scale
    return prior_log_sd(unknown.prior)


def natural_directions(posterior: Posterior, theta: Array) -> Directions:
    """Return D directions at `theta (D,)`, each of which moves one unknown on its natural scale."""
    steps = posterior.coordinates.slopes_by_natural(theta[None])[0]
    return directions_at(posterior, theta[None], np.diag(steps))


def directions_at(posterior: Posterior, theta: Array, columns: Array) -> Directions:
    """Return the slopes of unknowns and parameters at `theta (W, D)` along `columns (D, q)`."""
    space, coordinates = posterior.space, posterior.coordinates
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
    """Return whitened slopes `(n, D)` of all measured values, then rows for noise unknowns."""
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
    """Return the mean squared residual divided by the noise variance, and at least 1."""
    ratio = float(posterior.likelihood.mean_square(theta[None])[0])
    return max(ratio, 1.0) if np.isfinite(ratio) else 1.0


def matrix_root(matrix: Array) -> Array:
    """Return a square root of a covariance by principal directions: `root @ root.T == matrix`."""
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-12))


N_QUANTILES = 200  # number of quantiles from which mean and spread of a prior are computed
END_MARGIN = 1e-9  # distance from a prior's ends / its spread; rounding errors are smaller
TAIL_MASS = 1e-9  # prior probability beyond the end of a search, if the prior has no end


@dataclass(frozen=True, slots=True)
class QuadraticModel:
    """A quadratic model of a function has value, slope and curvature at W points, in q directions.

    Shapes are `value (W,)`, `slope (W, q)` and `curvature (W, q, q)`, which is minus the second
    derivative.  If the response overflows, `value` is -inf, and slope and curvature are zero.
    """

    value: Array
    slope: Array
    curvature: Array

    def rows(self, chosen: Flags) -> QuadraticModel:
        """Return the model at the `chosen (W,)` points."""
        return QuadraticModel(self.value[chosen], self.slope[chosen], self.curvature[chosen])


def concatenate_models(parts: Sequence[QuadraticModel]) -> QuadraticModel:
    """Return one model at the points of all parts, in order."""
    columns = zip(*((part.value, part.slope, part.curvature) for part in parts), strict=True)
    return QuadraticModel(*map(np.concatenate, columns))


class LogDensity:
    """Evaluate the log density of a posterior over the sampler's coordinates `u (W, D)`.

    Searches stay between `low (D,)` and `high (D,)`.  `middle (D,)` and `spread (D,)` are the mean
    and the standard deviation of each prior, in these coordinates.
    """

    def __init__(self, posterior: Posterior, *, physical: bool = False) -> None:
        """Take the density over the unknowns, whose maximum is the MAP, if `physical` is true."""
        self.posterior = posterior
        self.physical = physical
        self._priors = tuple(posterior.space.priors.values())
        bounds = np.array([_search_limits(unknown) for unknown in posterior.space.unknowns]).T
        low, high = posterior.coordinates.from_physical(bounds)
        probabilities = (np.arange(N_QUANTILES) + 0.5) / N_QUANTILES
        quantiles = np.stack([prior.quantile(probabilities) for prior in self._priors], axis=-1)
        # A coordinate that is a log needs a positive number.
        floor = [-np.inf if unknown.signed else 1e-300 for unknown in posterior.space.unknowns]
        typical = posterior.coordinates.from_physical(np.maximum(quantiles, floor))
        self.middle, self.spread = typical.mean(axis=0), typical.std(axis=0)
        # The margin keeps a point at an end inside the prior despite rounding.
        self.low, self.high = low + END_MARGIN * self.spread, high - END_MARGIN * self.spread

    def value(self, u: Array) -> Array:
        """Return the log density `(W,)`."""
        if self.physical:
            return self.posterior.density(self.posterior.coordinates.to_physical(u))
        return self.posterior(u)

    def in_support(self, u: Array) -> Flags:
        """Return whether the prior density at `u (W, D)` is not zero, `(W,)`."""
        return self.posterior.supports(u)

    def quadratic_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return value, slope and curvature at `u (W, D)` along `directions (D, q)`."""
        model = self.curvature_model(u, directions)
        with np.errstate(all="ignore"):
            return dataclasses.replace(model, value=model.value + self.value(u))

    @cached_property
    def _unbounded(self) -> LogDensity:
        return LogDensity(self.posterior.with_simulators(lambda old: old.response.unbounded))

    def approximate_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return the curvature model of compressed records, even where they are inaccurate.

        The model only serves to find directions; the exact response would take too long for this.
        """
        return self._unbounded.curvature_model(u, directions)

    def curvature_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return the quadratic model with value 0, since a value would need one more simulation."""
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
        with np.errstate(all="ignore"):  # points may lie far outside the priors
            derivatives = [p.derivatives(theta[:, d]) for d, p in enumerate(self._priors)]
            first, second = np.stack(derivatives, axis=-1)
            slope = np.nan_to_num(first * steps)
            curvature = np.maximum(np.nan_to_num(-second * steps**2 - slope * tilt), 0.0)
        if not self.physical:
            slope, curvature = slope + tilt, curvature + bend
        return slope, curvature


def _search_limits(unknown: Unknown) -> tuple[float, float]:
    """Return the ends of the search for an unknown: those of its support, or just inside."""
    prior = unknown.prior
    if unknown.between is not None:
        low, high = unknown.between
        inset = TAIL_MASS * (high - low)
        return max(prior.low, low + inset), min(prior.high, high - inset)
    return prior_ends(prior, TAIL_MASS)


def prior_ends(prior: Prior, tail: float) -> tuple[float, float]:
    """Return the ends of a prior's support; the quantile of `tail` replaces zero or infinity."""
    bounded = np.isfinite(prior.low) and prior.low != 0  # zero may have no density
    low = prior.low if bounded else float(prior.quantile(np.array(tail)))
    high = prior.high if np.isfinite(prior.high) else float(prior.quantile(np.array(1 - tail)))
    return low, high
