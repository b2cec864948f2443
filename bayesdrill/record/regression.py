"""Integrate a signal of a record, and fit it by others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesdrill.basics.arrays import Array


def integral(x: Array, steps: Array | float) -> Array:
    """Return the trapezoidal integral `(T,)` of `x (T,)` with `steps (T - 1,)`, from zero."""
    return np.concatenate([[0.0], np.cumsum((x[1:] + x[:-1]) * (0.5 * steps))])


def linear_fit(y: Array, causes: Sequence[Array]) -> tuple[Array, float]:
    """Fit `y (T,)` by `causes (T,)` and a constant, by least squares.

    Returns the coefficients, with the constant last, and the variance of the residuals.
    """
    design = np.stack([*causes, np.ones(len(y))], axis=-1)
    scale = np.maximum(np.abs(design).max(axis=0), 1e-300)
    factors = np.linalg.lstsq(design / scale, y, rcond=None)[0] / scale
    return factors, float(np.var(y - design @ factors))
