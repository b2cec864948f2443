"""What the record says of the unknowns: exact response and noise, put together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.noise.gaussian import Gaussian
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.rig.response import Response

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Likelihood:
    """Of unknowns `theta (W, D)`: the model's free parameters, then the unknown sigmas."""

    response: Response
    noise: Gaussian
    space: ParameterSpace

    def __call__(self, theta: Array) -> Array:
        """Log likelihood `(W,)`; NaN where the response overflows."""
        with np.errstate(all="ignore"):
            return self.by_channel(theta).sum(axis=-1)

    def by_channel(self, theta: Array) -> Array:
        """`(W, K)`."""
        misfit = self.response.misfit(self.space.full(theta))
        return self.noise.log_likelihood(misfit, self.sigma_columns(theta))

    @property
    def numbers(self) -> int:
        """How many were measured."""
        return self.noise.n_samples * self.noise.n_channels

    def per_number(self, theta: Array) -> Array:
        """Squared residuals over the noise variance, their mean `(W,)`: 1 where only noise is left."""
        squares = self.response.misfit(self.space.full(theta))
        return np.asarray((squares / self.sigmas(theta) ** 2).mean(axis=-1) / self.noise.n_samples)

    def sigma_columns(self, theta: Array) -> Array:
        """The unknown sigmas among the unknowns, `(W, n)`."""
        return theta[:, theta.shape[1] - len(self.noise.unknown) :]

    def sigmas(self, theta: Array) -> Array:
        """Of every channel, known or not: `(W, K)`, SI."""
        return self.noise.sigmas(self.sigma_columns(theta))

    def signals(self, theta: Array) -> Array:
        """The channels without noise, `(W, T, K)`."""
        return self.response.signals(self.space.full(theta))
