"""Coordinates in which the sampler walks: the log of each unknown, the unknown itself, or a probit.

Rigs are made of products and ratios, so that logs are the natural scale.  They are none for an
unknown whose prior reaches down to zero: all of its lower end would lie in an endless tail.  What
lies between two ends, such as a correlation, goes by its probit between them, over which a uniform
prior is a bell: what is pressed against an end has no longer tail there.  (Over a logit it falls off
like an exponential, and no proposal made of bells gets there.)  What may be negative, such as an
offset, goes by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True, slots=True)
class Coordinates:
    """`logs`: for each of the D unknowns, whether its log is its coordinate; `between`: columns whose
    probit between `low` and `high` is, as `(column, low, high)`.  `signed`: columns that need not be
    positive, these among them, each with the step that is one on its natural scale.

    `z` and `theta` are `(W, D)`; the Jacobian is log |d theta / d z|, `(W,)`.
    """

    logs: tuple[bool, ...]
    between: tuple[tuple[int, float, float], ...] = ()
    signed: tuple[tuple[int, float], ...] = ()

    def from_physical(self, theta: Array) -> Array:
        z = theta.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            z[:, self.logs] = np.log(theta[:, self.logs])
        for column, low, high in self.between:
            z[:, column] = ndtri((theta[:, column] - low) / (high - low))
        return z

    def to_physical(self, z: Array) -> Array:
        theta = z.copy()
        with np.errstate(over="ignore"):
            theta[:, self.logs] = np.exp(z[:, self.logs])
        for column, low, high in self.between:
            theta[:, column] = low + (high - low) * ndtr(z[:, column])
        return theta

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        jacobian = np.ascontiguousarray(z[:, self.logs]).sum(axis=-1)
        for column, low, high in self.between:
            jacobian += np.log(high - low) - LOG_ROOT_2PI - 0.5 * z[:, column] ** 2
        return self.to_physical(z), jacobian

    def slopes(self, theta: Array) -> Array:
        """d unknown / d its coordinate, `(W, D)`."""
        out = np.where(self.logs, theta, 1.0)
        for column, low, high in self.between:
            place = ndtri((theta[:, column] - low) / (high - low))
            out[:, column] = (high - low) * np.exp(-0.5 * place**2 - LOG_ROOT_2PI)
        return out

    def jacobian_bends(self, z: Array) -> tuple[Array, Array]:
        """First and minus second derivatives of the Jacobian by each coordinate: `(W, D)` each."""
        slope = np.tile(np.array(self.logs, dtype=np.float64), (len(z), 1))
        curvature = np.zeros_like(slope)
        for column, *_ in self.between:
            slope[:, column], curvature[:, column] = -z[:, column], 1.0
        return slope, curvature

    def natural(self, theta: Array) -> Array:
        """d unknown / d its natural scale `(W, D)`: its log where it is positive, or else itself over
        its step.
        """
        out = theta.copy()
        for column, step in self.signed:
            out[:, column] = step
        return out

    def to_natural(self, theta: Array) -> Array:
        """Logs `(W, D)`, and what need not be positive over its step."""
        with np.errstate(divide="ignore", invalid="ignore"):
            out = np.log(theta)
        for column, step in self.signed:
            out[:, column] = theta[:, column] / step
        return out

    def from_natural(self, natural: Array) -> Array:
        """What `to_natural` is of."""
        out = np.exp(natural)
        for column, step in self.signed:
            out[:, column] = natural[:, column] * step
        return out
