"""Chains whose autocorrelation is known, and chains with one trouble each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def ar1(shape: tuple[int, int, int, int], rho: float, seed: int = 6) -> np.ndarray:
    """`(E, S, W, D)` with autocorrelation rho^k: integrated time (1 + rho)/(1 - rho)."""
    rng = np.random.default_rng(seed)
    x = np.empty(shape)
    x[:, 0] = rng.standard_normal(shape[:1] + shape[2:])
    for s in range(1, shape[1]):
        fresh = rng.standard_normal(shape[:1] + shape[2:])
        x[:, s] = rho * x[:, s - 1] + np.sqrt(1 - rho**2) * fresh
    return x


@dataclass
class Chains:
    """`theta (E, S, W, D)`, `log_p (E, S, W)`: sound until a method spoils them."""

    theta: np.ndarray
    log_p: np.ndarray

    def stuck(self, ensemble: int, walker: int, since: int) -> None:
        """This walker stays where it is at the step `since`."""
        self.theta[ensemble, since:, walker] = self.theta[ensemble, since, walker]
        self.log_p[ensemble, since:, walker] = self.log_p[ensemble, since, walker]

    def lost(self, ensemble: int, walker: int, far: float, below: float) -> None:
        """This walker moves about, but elsewhere, where the density is lower."""
        self.theta[ensemble, :, walker] += far
        self.log_p[ensemble, :, walker] -= below

    def parted(self, ensemble: int, walkers: slice, unknown: int, far: float) -> None:
        """These walkers are in a second place, as high as the first."""
        self.theta[ensemble, :, walkers, unknown] += far


def sound(seed: int, walkers: int = 32, steps: int = 700, rho: float = 0.8) -> Chains:
    """Four ensembles of three unknowns: tau 9 at rho 0.8."""
    theta = ar1((4, steps, walkers, 3), rho, seed)
    return Chains(theta, -0.5 * (theta**2).sum(axis=-1))
