"""Maximise a log density by damped Gauss-Newton from many points at once, within the priors' ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.laplace import LogDensity, QuadraticModel

MAX_STEP = 3.0  # longest step, in priors' spreads, since the quadratic model only holds nearby
INITIAL_DAMPING = 0.1  # relative to the priors' precision; it hardly damps tight directions
DAMPING_FACTORS = (0.01, 1.0, 30.0, 1e3, 3e4)  # multiples of the damping that each step tries
CORRECTED_TRIALS = 2  # this many trials, the least damped, are moved back to a curved ridge
TIGHT_DAMPING = 100.0  # damping of that move / priors' precision; it holds loose directions fixed
MAX_CORRECTIONS = 3  # largest number of steps back to a curved ridge, after a step along the ridge
SETTLED_GAIN = 1e-3  # in log density: a climb to a lower maximum stops if the next step gains less
MIN_DAMPING, MAX_DAMPING = 1e-10, 1e18  # limits of the damping; a climb that needs more ends
DAMPING_DECREASE = 0.3  # damping of the next step, divided by the damping of the best trial
PACE_STEPS = 3  # number of last steps whose largest gain limits the pace; one step may be short
RELEASE_SLOPE = 1e-9  # an unknown at a bound is released if its scaled slope inwards exceeds this
DIAGONAL_ROUNDING = 1e-12  # added to the scaled diagonal, as flat directions make it singular
DIFFERENCE_STEP = 1e-4  # in priors' spreads: step of the finite differences of slopes
MIN_GAIN = 1e-9  # in log density: a climb ends if the next step would gain less


@dataclass(frozen=True, slots=True)
class GaussNewtonResult:
    """Climbs end at `u (W, D)` with log density `value (W,)`; another step would add `gain`."""

    u: Array
    value: Array
    gain: Array

    @property
    def converged(self) -> Flags:
        """Return whether another step would gain less than 1e-6 of the log density, `(W,)`."""
        return np.asarray(self.gain < 1e-6)


def gauss_newton(
    surface: LogDensity,
    start: Array,
    steps: int,
    *,
    exact: bool = False,
    merged: float = 0.0,
    depth: float = math.inf,
    threshold: float = -math.inf,
) -> GaussNewtonResult:
    """Climb from each point of `start (W, D)` in at most `steps` steps.

    With `exact`, second derivatives are included (Newton's method), which helps in the last steps.
    A point that is closer than `merged` (in the priors' spreads) to a higher point gets the value
    -inf.  The pace of a climb is the smaller of the gain that the model predicts and the largest
    gain of the last steps.  A climb stops if at this pace it would end below `threshold`, or more than
    `depth` below the highest point.  With a finite `depth`, climbs also stop near lower maxima.
    """
    u = np.clip(start, surface.low, surface.high)
    value = surface.value(u)
    damping = np.full(len(u), INITIAL_DAMPING)
    gain = np.full(len(u), np.inf)
    under_way, gained = np.isfinite(value), np.full((PACE_STEPS, len(u)), np.inf)
    model = _second_order_model if exact else _gauss_newton_model
    for remaining in range(steps, 0, -1):
        now = np.flatnonzero(under_way)
        if len(now) == 0:
            break
        here = model(surface, u[now])
        gain[now] = newton_gain(surface, u[now], here)
        pace = np.minimum(gain[now], gained[:, now].max(axis=0))
        reach = value[now] + remaining * pace
        hopeful = reach >= max(value.max() - depth, threshold)
        if math.isfinite(depth):
            hopeful &= (reach >= value.max()) | (gain[now] > SETTLED_GAIN)
        under_way[now], now, here = hopeful, now[hopeful], here.rows(hopeful)
        if len(now) == 0:
            break
        moved = _best_step(surface, u[now], value[now], damping[now], here)
        gained = np.roll(gained, 1, axis=0)
        gained[0, now] = moved[1] - value[now]
        u[now], value[now], damping[now], advanced = moved
        under_way[now] = (gain[now] > MIN_GAIN) & (advanced | (damping[now] < MAX_DAMPING))
        if merged:
            close = (np.abs(u[:, None] - u) <= merged * surface.spread).all(axis=2)
            value[(close & (value > value[:, None])).any(axis=1)] = -np.inf
            under_way &= np.isfinite(value)
    return GaussNewtonResult(u, value, np.where(np.isfinite(value), gain, np.inf))


def _gauss_newton_model(surface: LogDensity, u: Array) -> QuadraticModel:
    return surface.curvature_model(u, np.eye(u.shape[1]))


def _second_order_model(surface: LogDensity, u: Array) -> QuadraticModel:
    """Return a model with second derivatives by finite differences, and absolute eigenvalues."""
    n, d = u.shape
    here = _gauss_newton_model(surface, u)
    steps = DIFFERENCE_STEP * np.diag(surface.spread)
    around = [np.clip(u[:, None] + side * steps, surface.low, surface.high) for side in (1.0, -1.0)]
    models = (_gauss_newton_model(surface, at.reshape(-1, d)) for at in around)
    slopes = [model.slope.reshape(n, d, d) for model in models]
    distance = np.einsum("wdd->wd", around[0] - around[1])
    second = (slopes[1] - slopes[0]) / np.maximum(distance, 1e-300)[:, :, None]
    scale = surface.spread[:, None] * surface.spread
    values, vectors = np.linalg.eigh(0.5 * (second + second.swapaxes(1, 2)) * scale)
    downward = (vectors * np.abs(values)[:, None, :]) @ vectors.swapaxes(1, 2) / scale
    return QuadraticModel(here.value, here.slope, downward)


def _best_step(
    surface: LogDensity, u: Array, value: Array, damping: Array, here: QuadraticModel
) -> tuple[Array, Array, Array, Flags]:
    """Try several dampings and take the best step; return points, values, dampings and success."""
    trials = [_damped_step(surface, u, here, damping * factor) for factor in DAMPING_FACTORS]
    values = surface.value(np.concatenate(trials)).reshape(len(trials), -1)
    for k in range(CORRECTED_TRIALS):
        wanted = value + 0.5 * _predicted_gain(here, trials[k] - u)
        trials[k], values[k] = _back_to_ridge(surface, trials[k], values[k], wanted)
    best = np.argmax(values, axis=0)
    best_values = np.take_along_axis(values, best[None], axis=0)[0]
    advanced = best_values > value
    best_trials = np.array(trials)[best, np.arange(len(u))]
    less = damping * np.array(DAMPING_FACTORS)[best] * DAMPING_DECREASE
    return (
        np.where(advanced[:, None], best_trials, u),
        np.where(advanced, best_values, value),
        np.where(advanced, np.maximum(less, MIN_DAMPING), damping * DAMPING_FACTORS[-1] * 10.0),
        advanced,
    )


def _damped_step(surface: LogDensity, u: Array, here: QuadraticModel, damping: Array) -> Array:
    step = bounded_step(surface, u, here, damping)
    longest = (np.abs(step) / surface.spread).max(axis=1, keepdims=True)
    step *= np.minimum(1.0, MAX_STEP / np.maximum(longest, 1e-300))
    return np.clip(u + step, surface.low, surface.high)


def _back_to_ridge(
    surface: LogDensity, u: Array, value: Array, threshold: Array
) -> tuple[Array, Array]:
    """Move points with log density below `threshold` along tight directions, to a curved ridge."""
    u, value = u.copy(), value.copy()
    for _ in range(MAX_CORRECTIONS):
        low = np.flatnonzero((value < threshold) & np.isfinite(value))
        if len(low) == 0:
            break
        here = _gauss_newton_model(surface, u[low])
        u[low] = _damped_step(surface, u[low], here, np.full(len(low), TIGHT_DAMPING))
        value[low] = surface.value(u[low])
    return u, value


def bounded_step(surface: LogDensity, u: Array, here: QuadraticModel, damping: Array) -> Array:
    """Return the damped Gauss-Newton step from `u (W, D)` within the box of the priors, `(W, D)`.

    This is an active set method: the first unknown that reaches a bound is held there, and the step
    of the others is solved again.  A held unknown is released if its slope points into the box.
    """
    d = u.shape[1]
    matrix = here.curvature + (damping[:, None] / surface.spread**2)[:, :, None] * np.eye(d)
    # With a diagonal of ones, the matrix is better conditioned if scales are very different.
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("wdd->wd", matrix), 1e-300))
    matrix = matrix * scale[:, :, None] * scale[:, None, :] + DIAGONAL_ROUNDING * np.eye(d)
    slope = here.slope * scale
    low, high = (surface.low - u) / scale, (surface.high - u) / scale
    held = ((low >= 0) & (slope < 0)) | ((high <= 0) & (slope > 0))
    step, arrived = np.zeros_like(u), np.zeros(len(u), dtype=bool)
    for _ in range(3 * d):
        remaining = slope - np.einsum("wij,wj->wi", matrix, step)
        inward = np.where(held, np.where(step <= low, remaining, -remaining), 0.0)
        released = arrived & (inward.max(axis=1) > RELEASE_SLOPE)
        held[released, np.argmax(inward, axis=1)[released]] = False
        if (arrived & ~released).all():
            break
        free = ~held
        inner = np.where(free[:, :, None] & free[:, None, :], matrix, np.eye(d))
        change = np.linalg.solve(inner, np.where(free, remaining, 0.0)[..., None])[..., 0]
        to_bound = np.where(change > 0, high, low) - step
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            fraction = np.where(free & (change != 0), to_bound / change, np.inf)
        first = fraction.min(axis=1)
        hit = (fraction <= first[:, None]) & (first < 1.0)[:, None]
        step = step + np.minimum(1.0, first)[:, None] * change
        step = np.where(hit, np.where(change > 0, high, low), step)
        held |= hit
        arrived = first >= 1.0
    return np.asarray(np.clip(step, low, high) * scale)


def newton_gain(surface: LogDensity, u: Array, here: QuadraticModel) -> Array:
    """Return the gain that the quadratic model predicts for an undamped step: `(W,)`."""
    step = bounded_step(surface, u, here, np.full(len(u), 1e-9))
    return _predicted_gain(here, step)


def _predicted_gain(here: QuadraticModel, step: Array) -> Array:
    half = 0.5 * np.einsum("wd,wde,we->w", step, here.curvature, step)
    return np.asarray(np.einsum("wd,wd->w", step, here.slope) - half)
