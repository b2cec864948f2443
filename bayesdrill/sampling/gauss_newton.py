"""Damped Gauss-Newton uphill from many points at once, within the ends of the priors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.laplace import LogDensity, QuadraticModel

MAX_STEP = 3.0  # of the priors' spreads: what a curvature says is not true further on
INITIAL_DAMPING = 0.1  # of what the priors know: it holds the loose directions, not the tight ones
DAMPING_FACTORS = (0.01, 1.0, 30.0, 1e3, 3e4)  # times the present one, tried together, of which ...
CORRECTED_TRIALS = 2  # ... so many first ones may leave a bent ridge, and are led back to it by ...
TIGHT_DAMPING = 100.0  # ... steps that hold all but the tight directions
MAX_CORRECTIONS = 3  # back to a bent ridge, after a step along it
MIN_DAMPING, MAX_DAMPING = 1e-10, 1e18
DAMPING_DECREASE = 0.3  # of the damping that was best, for the next step
RELEASE_SLOPE = 1e-9  # a slope away from a wall, over the square root of the curvature there
DIAGONAL_ROUNDING = 1e-12  # of the diagonal: what is flat but for rounding stays solvable
DIFFERENCE_STEP = 1e-4  # of the priors' spreads, over which slopes are differentiated
MIN_GAIN = 1e-9  # of the log density: a point that would gain less by its next step has arrived


@dataclass(frozen=True, slots=True)
class GaussNewtonResult:
    """Where each start has led, `u (W, D)`, and what another step would gain, `gain (W,)`."""

    u: Array
    value: Array
    gain: Array

    @property
    def converged(self) -> Flags:
        """Whether another step would gain next to nothing, `(W,)`."""
        return np.asarray(self.gain < 1e-6)


def gauss_newton(
    surface: LogDensity, start: Array, steps: int, *, exact: bool = False, merged: float = 0.0
) -> GaussNewtonResult:
    """Climb from `start (W, D)`, each point by itself, in at most `steps` steps.

    `exact`: with the second derivatives themselves, for the last steps to a maximum.  `merged`: a point
    that comes as near to a higher one, in the priors' spreads, is left out, and its value is -inf.
    """
    u = np.clip(start, surface.low, surface.high)
    value = surface.value(u)
    damping = np.full(len(u), INITIAL_DAMPING)
    gain = np.full(len(u), np.inf)
    under_way = np.isfinite(value)
    look = _second_order_model if exact else _gauss_newton_model
    for _ in range(steps):
        now = np.flatnonzero(under_way)
        if len(now) == 0:
            break
        here = look(surface, u[now])
        gain[now] = newton_gain(surface, u[now], here)
        moved = _best_step(surface, u[now], value[now], damping[now], here)
        u[now], value[now], damping[now], advanced = moved
        under_way[now] = (gain[now] > MIN_GAIN) & (advanced | (damping[now] < MAX_DAMPING))
        if merged:
            beside = (np.abs(u[:, None] - u) <= merged * surface.spread).all(axis=2)
            value[(beside & (value > value[:, None])).any(axis=1)] = -np.inf
            under_way &= np.isfinite(value)
    return GaussNewtonResult(u, value, np.where(np.isfinite(value), gain, np.inf))


def _gauss_newton_model(surface: LogDensity, u: Array) -> QuadraticModel:
    return surface.curvature_model(u, np.eye(u.shape[1]))


def _second_order_model(surface: LogDensity, u: Array) -> QuadraticModel:
    """With second derivatives from differences of exact slopes, each taken as if it were downward."""
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
    """The best of a few damped steps, or none; the damping for the next one."""
    tried = [_damped_step(surface, u, here, damping * factor) for factor in DAMPING_FACTORS]
    values = surface.value(np.concatenate(tried)).reshape(len(tried), -1)
    for k in range(CORRECTED_TRIALS):
        wanted = value + 0.5 * _predicted_gain(here, tried[k] - u)
        tried[k], values[k] = _back_to_ridge(surface, tried[k], values[k], wanted)
    best = np.argmax(values, axis=0)
    best_values = np.take_along_axis(values, best[None], axis=0)[0]
    advanced = best_values > value
    there = np.array(tried)[best, np.arange(len(u))]
    less = damping * np.array(DAMPING_FACTORS)[best] * DAMPING_DECREASE
    return (
        np.where(advanced[:, None], there, u),
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
    surface: LogDensity, u: Array, value: Array, wanted: Array
) -> tuple[Array, Array]:
    """Points that a step along a bent ridge has led off it, led back by their tight directions."""
    u, value = u.copy(), value.copy()
    for _ in range(MAX_CORRECTIONS):
        off = np.flatnonzero((value < wanted) & np.isfinite(value))
        if len(off) == 0:
            break
        here = _gauss_newton_model(surface, u[off])
        there = _damped_step(surface, u[off], here, np.full(len(off), TIGHT_DAMPING))
        u[off], value[off] = there, surface.value(there)
    return u, value


def bounded_step(surface: LogDensity, u: Array, here: QuadraticModel, damping: Array) -> Array:
    """Return the damped step of Gauss and Newton within the box, `(W, D)`.

    The first unknown on the way out stops at its wall, the others are solved for again, and so on;
    one whose slope then points inside is let go.
    """
    d = u.shape[1]
    matrix = here.curvature + (damping[:, None] / surface.spread**2)[:, :, None] * np.eye(d)
    # In units in which the diagonal is one, so that no direction is lost beside a stiffer one.
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("wdd->wd", matrix), 1e-300))
    matrix = matrix * scale[:, :, None] * scale[:, None, :] + DIAGONAL_ROUNDING * np.eye(d)
    slope = here.slope * scale
    low, high = (surface.low - u) / scale, (surface.high - u) / scale
    clamped = ((low >= 0) & (slope < 0)) | ((high <= 0) & (slope > 0))
    step, arrived = np.zeros_like(u), np.zeros(len(u), dtype=bool)
    for _ in range(3 * d):
        remaining = slope - np.einsum("wij,wj->wi", matrix, step)
        inward = np.where(clamped, np.where(step <= low, remaining, -remaining), 0.0)
        let_go = arrived & (inward.max(axis=1) > RELEASE_SLOPE)
        clamped[let_go, np.argmax(inward, axis=1)[let_go]] = False
        if (arrived & ~let_go).all():
            break
        free = ~clamped
        inner = np.where(free[:, :, None] & free[:, None, :], matrix, np.eye(d))
        way = np.linalg.solve(inner, np.where(free, remaining, 0.0)[..., None])[..., 0]
        wall = np.where(way > 0, high, low) - step
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            reach = np.where(free & (way != 0), wall / way, np.inf)
        first = reach.min(axis=1)
        hit = (reach <= first[:, None]) & (first < 1.0)[:, None]
        step = step + np.minimum(1.0, first)[:, None] * way
        step = np.where(hit, np.where(way > 0, high, low), step)
        clamped |= hit
        arrived = first >= 1.0
    return np.asarray(np.clip(step, low, high) * scale)


def newton_gain(surface: LogDensity, u: Array, here: QuadraticModel) -> Array:
    """Return what an undamped step would gain, by slopes and curvatures alone: `(W,)`."""
    step = bounded_step(surface, u, here, np.full(len(u), 1e-9))
    return _predicted_gain(here, step)


def _predicted_gain(here: QuadraticModel, step: Array) -> Array:
    half = 0.5 * np.einsum("wd,wde,we->w", step, here.curvature, step)
    return np.asarray(np.einsum("wd,wd->w", step, here.slope) - half)
