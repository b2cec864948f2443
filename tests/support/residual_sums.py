"""Sums of residuals that a likelihood asks for, as kernels compute them, by plain sums."""

from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from bayesdrill.inference.noise.contract import Noise

Array = NDArray[np.float64]


def residuals(samples: Array) -> SimpleNamespace:
    """Return all that a noise may ask of samples `(W, n, K)`; NaN stands where none was measured."""
    seen = ~np.isnan(samples).all(axis=0)
    known = np.where(seen, samples, 0.0)
    squares = (known**2).sum(axis=1)
    own = [samples[:, seen[:, k], k].copy("C") for k in range(samples.shape[2])]
    steps = np.stack([(np.diff(x, axis=1) ** 2).sum(axis=1) for x in own], axis=-1)
    ends = np.stack([x[:, 0] ** 2 + x[:, -1] ** 2 for x in own], axis=-1)
    return SimpleNamespace(
        samples=samples,
        squares=squares,
        weighted_squares=lambda w: squares * w**2,
        neighbours=np.stack([squares, steps, ends], axis=-1),
        logs=lambda w: np.log1p(w[:, None] * known**2).sum(axis=1),
        intervals=lambda over, half: np.where(
            seen, masses(known * over[:, None], half[:, None]), 0.0
        ).sum(axis=1),
    )


def masses(middle: Array, half: Array) -> Array:
    """Return logs of the mass of a standard normal number within half a width of a middle."""
    near, far = half - np.abs(middle), -half - np.abs(middle)  # in the lower tail
    return np.asarray(log_ndtr(near) + np.log(-np.expm1(log_ndtr(far) - log_ndtr(near))))


def moved(noise: Noise, at: Array, column: int, step: float) -> Array:
    """Return unknowns with a step in the log of what is positive, or else in the unknown itself."""
    out, plain = at.copy(), noise.unknowns[column].between is not None
    out[:, column] = at[:, column] + step if plain else at[:, column] * np.exp(step)
    return out
