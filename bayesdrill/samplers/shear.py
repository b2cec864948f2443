"""A change of coordinates that takes a bend out of a posterior and keeps its volume.

What a record determines well is often a curved function of what it determines badly.  The tight
coordinates are therefore measured from a quadratic in the loose ones: `tight' = tight - Q(loose)`.
The Jacobian is 1 wherever one stands, so that densities carry over as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DRAWS_PER_TERM = 20  # fewer draws than this for each term of the quadratic, and it is left out
LEAST_GAIN = 0.05  # in nats: a smaller gain is not worth the quadratic


@dataclass(frozen=True, slots=True)
class Shear:
    """`z -> y` and back, `(n, D)`. `coefficients`: of 1, x, x x' of the loose, one column each."""

    centre: Array
    scale: Array
    loose: Indices
    tight: Indices
    coefficients: Array

    def straighten(self, z: Array) -> Array:
        y = (z - self.centre) / self.scale
        if len(self.loose):
            y[:, self.tight] -= _quadratic(y[:, self.loose]) @ self.coefficients
        return y

    def bend(self, y: Array) -> Array:
        x = y.copy()
        if len(self.loose):
            x[:, self.tight] += _quadratic(x[:, self.loose]) @ self.coefficients
        return x * self.scale + self.centre


def fit(draws: Array) -> Shear:
    """The split into loose and tight, by their spreads, of which draws `(N, D)` gain the most."""
    centre, scale = draws.mean(axis=0), draws.std(axis=0)
    x = (draws - centre) / scale
    order = np.argsort(-scale)
    best, gained = Shear(centre, scale, order[:0], order, np.empty((0, 0))), LEAST_GAIN
    for split in range(1, len(order)):
        loose, tight = order[:split], order[split:]
        terms = _quadratic(x[:, loose])
        if len(draws) < DRAWS_PER_TERM * terms.shape[1]:
            break
        straight, _ = _regress(terms[:, : 1 + split], x[:, tight])
        bent, coefficients = _regress(terms, x[:, tight])
        gain = 0.5 * (_log_volume(straight) - _log_volume(bent))
        if gain > gained:
            best, gained = Shear(centre, scale, loose, tight, coefficients), gain
    return best


def _quadratic(x: Array) -> Array:
    row, column = np.triu_indices(x.shape[1])
    return np.concatenate([np.ones((len(x), 1)), x, x[:, row] * x[:, column]], axis=1)


def _regress(terms: Array, values: Array) -> tuple[Array, Array]:
    """Residuals and coefficients of least squares."""
    coefficients = np.linalg.lstsq(terms, values, rcond=None)[0]
    return values - terms @ coefficients, coefficients


def _log_volume(residuals: Array) -> float:
    d = residuals.shape[1]
    return float(np.linalg.slogdet(np.cov(residuals.T).reshape(d, d))[1])
