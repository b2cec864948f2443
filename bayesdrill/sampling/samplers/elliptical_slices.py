"""Sample a Gaussian times a weight by elliptical slice sampling, which needs no tuning.

Each step goes to a point on a random ellipse through the current point.  The range of angles is
shrunk until the weight is above a random level (Murray, Adams and MacKay 2010).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesdrill.basics.arrays import Array, Indices

MAX_SHRINKS = 60  # after more shrinks, the range is below rounding and the chain stays

LogWeight = Callable[[Array, Indices], Array]  # points `(n, m)`, indices of chains `(n,)` -> `(n,)`


def elliptical_slices(
    roots: Array, log_weight: LogWeight, steps: int, rng: np.random.Generator
) -> Array:
    """Sample N(0, R' R) times exp(log_weight) by a chain for each root R in `roots (N, m, m)`.

    All chains begin at zero.  Returns all points, `(steps, N, m)`.
    """
    count, m = roots.shape[:2]
    points, every = np.zeros((count, m)), np.arange(count)
    heights, path = log_weight(points, every), np.empty((steps, count, m))
    for step in range(steps):
        others = (rng.standard_normal((count, 1, m)) @ roots)[:, 0]
        levels = heights - rng.exponential(size=(count,))
        angles = 2.0 * np.pi * rng.random((count,))
        low, high = angles - 2.0 * np.pi, angles.copy()
        before, moving = points.copy(), every
        for _ in range(MAX_SHRINKS):
            angle = angles[moving, None]
            trial = before[moving] * np.cos(angle) + others[moving] * np.sin(angle)
            value = log_weight(trial, moving)
            good = value >= levels[moving]
            points[moving[good]], heights[moving[good]] = trial[good], value[good]
            moving = moving[~good]
            if not len(moving):
                break
            backward = angles[moving] < 0.0
            low[moving[backward]] = angles[moving[backward]]
            high[moving[~backward]] = angles[moving[~backward]]
            angles[moving] = low[moving] + (high - low)[moving] * rng.random(len(moving))
        path[step] = points
    return path
