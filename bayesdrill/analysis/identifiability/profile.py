"""Profile the likelihood of a parameter: hold it at values of its prior, and fit all others.

Fits are least squares with exact sensitivities, in logs, inside the ends of the priors.  Each fit
starts at the result for the neighbouring value.  Unknown noise levels are held at those of the best fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy

from bayesdrill.analysis.identifiability import information
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics.arrays import Array, Indices
from bayesdrill.inference.laplace import prior_ends
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.unknowns import Coordinates

Shape = Literal["bounded", "one-sided", "flat", "at the bound"]

THRESHOLD = 1.92  # half the 95 % quantile of chi-squared with one degree of freedom
NEAR = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)  # distances of grid points from the best fit, in sds
FAR = 8  # number of further grid points up to each end of the prior
FAR_ENOUGH = 25.0  # loss of log likelihood above which a profile is not continued
TAIL = 5e-4  # prior mass beyond the end of a profile, if the prior itself has no end
AT_BOUND = 1e-3  # distance of a log from an end, below which the best fit is at the bound
AT_END = 1e-9  # distance of a log from an end, below which there is nothing to profile
MAX_STEPS = 50  # largest number of steps of a fit
MIN_GAIN = 1e-5  # a fit ends if the sum of squares falls by less
PROBE_SHARE = 0.1  # fraction of a step by which the curvature of the residuals is probed
MAX_ACCELERATION = 1.5  # largest norm of the correction by curvature, relative to that of the step


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """The profile likelihood of one parameter is given at physical `values (n,)`.

    `loss (n,)` is the best log likelihood minus the profile's.  The loss passes `THRESHOLD` at `low`
    and `high`; each of these is None if the loss stays below `THRESHOLD` up to the prior's end.
    """

    name: str
    values: Array
    loss: Array
    best: float
    low: float | None
    high: float | None
    shape: Shape

    def in_unit(self, factor: float) -> Profile:
        """Return the profile in a unit that is `factor` times the present unit."""
        low, high = (None if x is None else x / factor for x in (self.low, self.high))
        values, best = self.values / factor, self.best / factor
        return replace(self, values=values, best=best, low=low, high=high)


class Fitter:
    """A fitter minimises squared residuals by changing unknowns of rig, sensors and starts.

    Arguments `logs` are the unknowns on their natural scales; they stay inside the priors.
    """

    def __init__(self, posterior: Posterior, sensitivity: SensitivityStudy, theta: Array) -> None:
        self._likelihood, self._sensitivity = posterior.likelihood, sensitivity
        if any(each.torque for each in self._likelihood.observations):
            fixed = posterior.edit(convert=lambda old: old.with_fixed_covariance(theta))
            self._likelihood = fixed.likelihood
            self._sensitivity = SensitivityStudy(self._likelihood)
        self._m = len(sensitivity.unknowns) + len(sensitivity.nuisances)
        moving, self._noise = posterior.space.unknowns[: self._m], theta[self._m :]
        self._steps = np.array([u.scale if u.signed else 1.0 for u in moving])
        self._coordinates = Coordinates(tuple(not u.signed for u in moving))
        ends = np.array([prior_ends(unknown.prior, TAIL) for unknown in moving]).T
        ends, start = ends / self._steps, theta[None, : self._m] / self._steps
        self.low, self.high = self._coordinates.from_physical(ends)
        self.best = self._fit(self._coordinates.from_physical(start)[0], None)
        if len(self._noise):  # unknown noise levels follow from the residuals of the best fit
            theta = self._theta(self.best.logs)
            full, fitted = self._likelihood.space.full(theta[None]), theta.copy()
            for observation in self._likelihood.observations:
                fitted[observation.noise_columns] = observation.fitted(full, theta)
            self._noise = fitted[self._m :]
            self.best = self._fit(self.best.logs, None)

    def fit_at(self, start: Array, column: int, value: float) -> ProfileFit:
        """Fit all unknowns from `start (m,)` with the one in `column` held at `value`."""
        logs = start.copy()
        logs[column] = value
        return self._fit(logs, column)

    def sds(self) -> Array:
        """Return the sds `(m,)` of the logs at the best fit, with priors of sd = range / sqrt(12)."""
        rows = self._jacobian(self.best.logs)
        names = (*self._sensitivity.unknowns, *self._sensitivity.nuisances)
        known = information.from_sensitivities(names, rows)
        return known.with_priors((self.high - self.low) / np.sqrt(12.0)).bounds()

    def _fit(self, logs: Array, fixed: int | None) -> ProfileFit:
        """Fit by damped Gauss-Newton with geodesic acceleration, which follows curved ridges."""
        free = np.array([k for k in range(self._m) if k != fixed], dtype=np.intp)
        logs = np.clip(logs, self.low, self.high)
        residuals = self._residuals(logs)
        damping = 1e-8
        for _ in range(MAX_STEPS if len(free) else 0):
            rows = self._jacobian(logs)[:, free]
            turned, reduced = np.linalg.qr(np.column_stack([rows, residuals]))
            before = residuals @ residuals
            while damping < 1e8:
                step = self._step(reduced, logs[free], free, damping)
                probe = self._residuals(self._advanced(logs, free, PROBE_SHARE * step)) - residuals
                bent = (2.0 / PROBE_SHARE) * (probe / PROBE_SHARE - rows @ step)
                reduced_bent = np.column_stack([reduced[:, :-1], turned.T @ bent])
                bend = self._step(reduced_bent, logs[free], free, damping)
                if np.linalg.norm(bend) <= MAX_ACCELERATION * np.linalg.norm(step):
                    step = step + 0.5 * bend
                new_logs = self._advanced(logs, free, step)
                new_residuals = self._residuals(new_logs)
                if new_residuals @ new_residuals < before:
                    break
                damping *= 10.0
            else:
                break
            logs, residuals, damping = new_logs, new_residuals, max(0.1 * damping, 1e-12)
            if before - residuals @ residuals < MIN_GAIN:
                break
        return ProfileFit(logs, float(0.5 * residuals @ residuals))

    def _step(self, reduced: Array, logs: Array, free: Indices, damping: float) -> Array:
        m = len(free)
        scale = np.linalg.norm(reduced[:, :m], axis=0)
        scale = np.maximum(scale, 1e-12 * max(float(scale.max()), 1e-300))
        matrix = np.vstack([reduced[:, :m], np.sqrt(damping) * np.diag(scale)])
        target = -np.append(reduced[:, m], np.zeros(m))
        low = np.minimum(self.low[free] - logs, 0.0) - 1e-12
        high = np.maximum(self.high[free] - logs, 0.0) + 1e-12
        bounded = scipy.optimize.lsq_linear(matrix, target, bounds=(low, high), method="bvls")
        return np.asarray(bounded.x)

    def _advanced(self, logs: Array, free: Indices, step: Array) -> Array:
        moved = logs.copy()
        moved[free] = np.clip(logs[free] + step, self.low[free], self.high[free])
        return moved

    def to_si(self, column: int, values: Array) -> Array:
        """Convert `values (n,)` of one unknown from its natural scale to SI."""
        rows = np.zeros((len(values), self._m))
        rows[:, column] = values
        return np.asarray(self._coordinates.to_physical(rows) * self._steps)[:, column]

    def _theta(self, logs: Array) -> Array:
        """Return all physical unknowns `(D,)` at `logs (m,)`."""
        moving = self._coordinates.to_physical(logs[None])[0] * self._steps
        return np.append(moving, self._noise)

    def _residuals(self, logs: Array) -> Array:
        residuals = self._likelihood.whitened_residuals(self._theta(logs))
        return np.asarray(np.nan_to_num(residuals, nan=1e6, posinf=1e6, neginf=-1e6))

    def _jacobian(self, logs: Array) -> Array:
        return self._sensitivity.with_nuisances(self._theta(logs))


@dataclass(frozen=True, slots=True)
class ProfileFit:
    """A fit ends at `logs (m,)`, where `cost` is minus the log likelihood, up to a constant."""

    logs: Array
    cost: float


def profile(fitter: Fitter, names: tuple[str, ...], column: int) -> Profile:
    """Profile the likelihood of the unknown in `column`."""
    best = fitter.best
    centre, sd = best.logs[column], fitter.sds()[column]
    down = _profile_to_end(fitter, column, centre, sd, fitter.low[column])
    up = _profile_to_end(fitter, column, centre, sd, fitter.high[column])
    values, fits = zip(*reversed(down), (centre, best), *up, strict=True)
    logs, costs = np.array(values), np.array([fit.cost for fit in fits])
    lowest = int(np.argmin(costs))  # a fit at another value may be better than the first fit
    loss = costs - costs[lowest]

    def crossing(outward: range) -> float | None:
        for k in outward:
            following = k + outward.step
            if loss[k] < THRESHOLD <= loss[following]:

                def excess(value: float, start: Array = fits[k].logs) -> float:
                    fit = fitter.fit_at(start, column, value)
                    return float(fit.cost - costs[lowest] - THRESHOLD)

                # The tolerance is relative to the bracket: only the last digits of a precise log vary.
                tolerance = 1e-4 * abs(logs[following] - logs[k])
                ends = logs[k], logs[following]
                return float(scipy.optimize.brentq(excess, *ends, xtol=tolerance, rtol=1e-14))
        return None

    def physical(value: float | None) -> float | None:
        return None if value is None else float(fitter.to_si(column, np.array([value]))[0])

    low, high = crossing(range(lowest, 0, -1)), crossing(range(lowest, len(logs) - 1))
    return Profile(
        name=names[column],
        values=fitter.to_si(column, logs),
        loss=loss,
        best=float(fitter.to_si(column, logs[[lowest]])[0]),
        low=physical(low),
        high=physical(high),
        shape=_shape(low, high, logs, lowest),
    )


def _profile_to_end(
    fitter: Fitter, column: int, centre: float, sd: float, end: float
) -> list[tuple[float, ProfileFit]]:
    """Return values up to an end of the prior, and their fits; each fit begins at the previous fit."""
    if abs(end - centre) < AT_END:
        return []
    sign = 1.0 if end > centre else -1.0
    near = [centre + sign * k * sd for k in NEAR if k * sd < abs(end - centre)]
    reached = near[-1] if near else centre
    far = np.linspace(reached, end, FAR + 1)[1:]
    fits: list[tuple[float, ProfileFit]] = []
    start = fitter.best.logs
    for value in [*near, *map(float, far)]:
        fit = fitter.fit_at(start, column, value)
        fits.append((value, fit))
        start = fit.logs
        if fit.cost - fitter.best.cost > FAR_ENOUGH:
            break
    return fits


def _shape(low: float | None, high: float | None, logs: Array, lowest: int) -> Shape:
    if low is None and high is None:
        return "flat"
    if low is not None and high is not None:
        return "bounded"
    at_end = min(logs[lowest] - logs[0], logs[-1] - logs[lowest]) < AT_BOUND
    return "at the bound" if at_end else "one-sided"
