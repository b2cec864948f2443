"""Where else a record might have come from: frequencies that its samples cannot tell apart.

A swing of frequency omega that is sampled every dt leaves the same samples as one of
|omega + 2 pi n / dt|.  So unknowns at which a pole of the rig has such a frequency are where
another maximum may be, and where a search for it begins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.surface import PosteriorSurface
from bayesdrill.rig.models.linear import dynamics

Array = NDArray[np.float64]

ROUNDS = (-2, -1, 1, 2)  # whole swings more or less between two samples
PAIRS = 2  # of poles that are looked at, the fastest
ITERATIONS = 12
NEAR = 0.02  # relative: what is left is for the search
STEP = 1e-5  # of the priors' spreads
OSCILLATES = 1e-6  # of the largest pole: an imaginary part above it is no rounding


def starts(posterior: Posterior, u: Array) -> Array:
    """`(n, D)` coordinates of the sampler, for the maximum at `u (D,)`."""
    sampled = [one.experiment for one in posterior.likelihood.observations]
    if not all(one.uniform for one in sampled):
        return np.empty((0, len(u)))  # of steps that differ no two swings leave the same samples
    dt = min(one.dt for one in sampled)
    here = frequencies(posterior, u[None])[0]
    found = []
    for pair, omega in enumerate(here):
        for rounds in ROUNDS if omega > 0 else ():
            there = _moved(posterior, u, pair, abs(omega + 2.0 * np.pi * rounds / dt))
            if there is not None:
                found.append(there)
    return np.array(found).reshape(-1, len(u))


def frequencies(posterior: Posterior, u: Array) -> Array:
    """Imaginary parts of the fastest pairs of poles at `u (W, D)`: `(W, PAIRS)`, 0 where none is."""
    model = posterior.likelihood.observations[0].response.model
    theta = posterior.coordinates.to_physical(u)
    full = dict(zip(model.parameters, posterior.likelihood.rig(theta).T, strict=True))
    matrices = dynamics(model.linear(full), model.states, len(u))
    every = np.linalg.eigvals(np.where(np.isfinite(matrices), matrices, 0.0))
    size = np.abs(every).max(axis=1, keepdims=True)
    swings = np.sort(np.where(every.imag > OSCILLATES * size, every.imag, 0.0), axis=1)
    return np.asarray(swings[:, ::-1][:, :PAIRS])


def _moved(posterior: Posterior, u: Array, pair: int, wanted: float) -> Array | None:
    """The nearest unknowns, in the priors' spreads, at which a pair swings as `wanted`."""
    surface = PosteriorSurface(posterior)
    steps = STEP * np.diag(surface.spread)
    for _ in range(ITERATIONS):
        found = frequencies(posterior, np.vstack([u, u + steps, u - steps]))[:, pair]
        if not (found > 0).all():
            return None
        off = np.log(wanted / found[0])
        if abs(off) < NEAR:
            return u
        n = len(u)
        slope = (np.log(found[1 : n + 1]) - np.log(found[n + 1 :])) / (2 * STEP)
        # At the walls only what leads away from them can help.
        slope[
            ((u <= surface.low) & (slope * off < 0)) | ((u >= surface.high) & (slope * off > 0))
        ] = 0
        if not slope.any():
            return None
        u = np.clip(u + surface.spread * slope * off / (slope @ slope), surface.low, surface.high)
    return None
