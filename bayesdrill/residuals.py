"""What the best fit leaves of a record, and whether noise alone leaves as much.

All that is said of the unknowns counts on the model and on white noise of the given size.  Both
show in what is left: its size over sigma, and whether one sample is like the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from bayesdrill.likelihood import Likelihood

Array = NDArray[np.float64]

FALSE_ALARM = 0.01  # of records of the model, with its noise, would give any finding at most


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """Of one channel: rms over sigma, and the correlation of one sample with the next.

    `least`, `most`: where noise leaves the rms, None if sigma is an unknown, which then fits it;
    `limit`: as large as noise makes the correlation.
    """

    channel: str
    rms: float
    correlation: float
    least: float | None
    most: float | None
    limit: float

    @property
    def large(self) -> bool:
        return self.most is not None and self.rms > self.most

    @property
    def small(self) -> bool:
        return self.least is not None and self.rms < self.least

    @property
    def correlated(self) -> bool:
        return self.correlation > self.limit


def left(likelihood: Likelihood, theta: Array) -> tuple[Left, ...]:
    """At the unknowns `theta (D,)`.

    A fit takes something away from what noise leaves, and never adds to it: the limits above are
    those without a fit, the one below allows for as many unknowns as there are.
    """
    noise, row = likelihood.noise, theta[None]
    sigma = noise.sigmas(likelihood.sigma_columns(row))[0]
    residuals = (likelihood.response.experiment.y - likelihood.signals(row)[0]) / sigma
    n = len(residuals)
    tail = FALSE_ALARM / (3 * noise.n_channels)  # of each of three looks at each channel
    least = math.sqrt(chdtri(max(n - len(theta), 1), 1 - tail) / n)
    most = math.sqrt(chdtri(n, tail) / n)
    squares = (residuals**2).sum(axis=0)
    products = (residuals[1:] * residuals[:-1]).sum(axis=0)
    return tuple(
        Left(
            channel=name,
            rms=math.sqrt(squares[k] / n),
            correlation=float(products[k] / squares[k]) if squares[k] > 0 else 0.0,
            least=least if k in noise.known else None,
            most=most if k in noise.known else None,
            limit=float(ndtri(1 - tail)) / math.sqrt(n),
        )
        for k, name in enumerate(likelihood.response.experiment.names)
    )
