"""Records of a motor that drives a rotor through a shaft, which swings; and glitches put into them."""

from __future__ import annotations

import numpy as np
import scipy.linalg


def swing(rng: np.random.Generator, n: int = 1200) -> dict[str, np.ndarray]:
    """Voltage `v (n,)` and channels: a swing of 10 to 120 samples, damped more or less, with noise."""
    period = np.exp(rng.uniform(np.log(10), np.log(120)))
    w, share, zeta = 2 * np.pi / period, rng.uniform(0.1, 0.9), np.exp(rng.uniform(-6, -1.6))
    j = (share, 1 - share)
    k, c = w**2 * j[0] * j[1], 2 * zeta * w * j[0] * j[1]
    drag, lag = w * np.exp(rng.uniform(-7, -2.3)), 1 / (period * rng.uniform(0.02, 0.3))
    a = np.zeros((6, 6))
    a[0, 2] = a[1, 3] = a[4, 5] = 1.0
    a[2, :4] = np.array([-k, k, -c, c]) / j[0]
    a[3, :5] = np.array([k, -k, c, -c - drag, w]) / j[1]
    a[4, 3:5] = -0.5 * w, -lag
    t = np.arange(n)
    v = [
        np.sign(np.sin(2 * np.pi * t / rng.uniform(3, 12) / period)),
        np.sin(2 * np.pi * t / rng.uniform(0.7, 6) / period),
        np.repeat(rng.normal(size=n // 40 + 1), 40)[:n],
        1.0 * (t > n // 3) - 1.0 * (t > 2 * n // 3),
    ][int(rng.integers(4))]
    step, x = scipy.linalg.expm(a), np.zeros((n, 5))
    for i in range(n - 1):
        x[i + 1] = step[:5, :5] @ x[i] + step[:5, 5] * v[i]
    channels = {"theta_2": x[:, 1], "w_1": x[:, 2], "twist": x[:, 0] - x[:, 1], "i": x[:, 4]}
    return {"v": v, **{name: _noisy(y, rng) for name, y in channels.items()}}


def _noisy(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y = y + rng.choice([1e-4, 1e-3, 0.01, 0.05]) * y.std() * rng.normal(size=len(y))
    step = y.std() * rng.choice([0.01, 0.1])
    return np.round(y / step) * step if rng.random() < 0.3 else y


def with_glitches(y: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Four of 1 to 3 samples, 5 spreads of the channel; and the first sample of each."""
    at = np.sort(rng.choice(np.arange(40, len(y) - 40, 20), 4, replace=False))
    spoilt = y.copy()
    for first in at:
        spoilt[first : first + rng.integers(1, 4)] += rng.choice([-5.0, 5.0]) * y.std()
    return spoilt, at
