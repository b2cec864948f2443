"""Targets with known draws: skewed, correlated, off the origin.

`WILD` has scales from 0.04 to 20 and strong correlation; `MILD` is nearly round, so that moves
that are not affine invariant accept often there too and cannot hide a wrong factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.stats

SHAPE = 1.5  # of the gamma variables whose logs are mixed: skewed to the left


@dataclass(frozen=True)
class Target:
    """Independent log-gamma variables, mixed by a lower triangle, scaled and shifted."""

    scales: tuple[float, ...]
    centre: tuple[float, ...]
    neighbour: float
    others: float

    def mixing(self, d: int) -> np.ndarray:
        lower = np.eye(d)
        for k in range(1, d):
            lower[k, : k - 1] = self.others
            lower[k, k - 1] = self.neighbour
        return lower * np.array(self.scales[:d])[:, None]

    def draw(self, n: int, d: int, rng: np.random.Generator) -> np.ndarray:
        """`(n, d)` independent draws."""
        base = np.log(rng.gamma(SHAPE, size=(n, d)))
        return base @ self.mixing(d).T + self.centre[:d]

    def unmix(self, x: np.ndarray) -> np.ndarray:
        d = x.shape[-1]
        return np.linalg.solve(self.mixing(d), (x - self.centre[:d]).T).T

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """`(W, d) -> (W,)`, unnormalised."""
        base = self.unmix(x)
        with np.errstate(over="ignore"):
            return (SHAPE * base - np.exp(base)).sum(axis=-1)

    def p_values(self, x: np.ndarray) -> np.ndarray:
        """Kolmogorov-Smirnov of each independent variable and of their sum, for `(n, d)`."""
        base = np.exp(np.clip(self.unmix(x), -700, 700))
        each = [
            scipy.stats.kstest(column, scipy.stats.gamma(SHAPE).cdf).pvalue for column in base.T
        ]
        # A sum of independent gammas is gamma again; it sees what no margin does.
        total = scipy.stats.gamma(SHAPE * base.shape[1])
        each.append(scipy.stats.kstest(base.sum(axis=1), total.cdf).pvalue)
        return np.array(each)


WILD = Target((3.0, 0.04, 1.0, 20.0, 0.7), (5.0, -2.0, 0.3, 100.0, 1.0), 1.5, 0.3)
MILD = Target((1.0, 1.3, 0.8, 1.1, 0.9), (4.0, -2.0, 1.0, 3.0, -1.0), 0.4, 0.1)
TARGETS = {"wild": WILD, "mild": MILD}
