"""Coordinates in which the sampler walks: the log of each unknown, or the unknown itself.

Rigs are made of products and ratios, so that logs are the natural scale.  They are none for an
unknown whose prior reaches down to zero: all of its lower end would lie in an endless tail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Coordinates:
    """`logs`: for each of the D unknowns, whether its log is its coordinate.

    `z` and `theta` are `(W, D)`; the Jacobian is log |d theta / d z|, `(W,)`.
    """

    logs: tuple[bool, ...]

    def from_physical(self, theta: Array) -> Array:
        z = theta.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            z[:, self.logs] = np.log(theta[:, self.logs])
        return z

    def to_physical(self, z: Array) -> Array:
        theta = z.copy()
        with np.errstate(over="ignore"):
            theta[:, self.logs] = np.exp(z[:, self.logs])
        return theta

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        return self.to_physical(z), np.ascontiguousarray(z[:, self.logs]).sum(axis=-1)

    def slopes(self, theta: Array) -> Array:
        """d unknown / d its coordinate, `(W, D)`."""
        return np.where(self.logs, theta, 1.0)
