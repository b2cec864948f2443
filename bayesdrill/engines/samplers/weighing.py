"""What draws from a proposal q say of the target p: weights, and how q would do.

Draws come from q and from a wider density too, so that what q hardly ever proposes is seen as well:
a proposal that looks only where it goes takes itself for perfect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONG = 2.0  # of the log of p over q above the usual: e^2 times as long as usual


@dataclass(frozen=True, slots=True)
class Weighed:
    """Draws `u (N, D)`, logs of p over q `(N,)`, and of how much of q each of them stands for `(N,)`.

    Neither p nor q need be normalised; p may be zero.
    """

    u: Array
    log_w: Array
    log_q: Array

    @property
    def weights(self) -> Array:
        """`(N,)`, their sum 1: the draws are those of p then."""
        return normalised(self.log_q + self.log_w)

    @property
    def effective(self) -> float:
        return effective(self.weights)

    @property
    def share(self) -> float:
        """Of draws from q alone, how many would be effective."""
        ratio, q = np.exp(self.log_w - self.log_w.max()), normalised(self.log_q)
        return float((q @ ratio) ** 2 / (q @ ratio**2))

    @property
    def acceptance(self) -> float:
        """Of independent proposals in the long run.

        A move from x to y is accepted with min(1, w(y) / w(x)), x from p and y from q: the mean of
        the smaller of two weights, over the mean weight.
        """
        order = np.argsort(-self.log_w)
        ratio = np.exp(self.log_w[order] - self.log_w[order[0]])
        q = normalised(self.log_q)[order]
        larger = np.cumsum(q) - 0.5 * q  # of q where the weight is larger, itself half
        return float(2.0 * (q * ratio) @ larger / (q @ ratio))

    @property
    def trapped(self) -> float:
        """How much of p is where q is so thin that a walker would wait long for another point."""
        return float(self.weights[self.log_w > self.usual + LONG].sum())

    @property
    def usual(self) -> float:
        """The log of p over q where most of p is: its median over p."""
        order = np.argsort(self.log_w)
        middle = int(np.searchsorted(np.cumsum(self.weights[order]), 0.5))
        return float(self.log_w[order[min(middle, len(order) - 1)]])

    def tempered(self, least: float) -> Array:
        """Weights of p^b q^(1 - b) with b the largest up to 1 that leaves so many effective draws."""

        def flat(power: float) -> Array:
            with np.errstate(invalid="ignore"):
                return normalised(np.where(finite, self.log_q + power * self.log_w, -np.inf))

        finite = np.isfinite(self.log_w)
        if effective(flat(1.0)) >= least:
            return flat(1.0)
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if effective(flat(middle)) >= least else (low, middle)
        return flat(low)

    def those_with_a_density(self) -> Weighed:
        kept = np.isfinite(self.log_w)
        return Weighed(self.u[kept], self.log_w[kept], self.log_q[kept])


def normalised(log_w: Array) -> Array:
    weights = np.exp(log_w - log_w.max())
    return np.asarray(weights / weights.sum())


def effective(weights: Array) -> float:
    """As how many equal ones these `weights (N,)` count (Kish)."""
    largest = float(weights.max())
    if largest == 0.0:
        return 0.0
    scaled = weights / largest
    return float(scaled.sum() ** 2 / (scaled**2).sum())
