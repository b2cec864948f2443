"""Walkers in groups of `LANES`, as kernels read them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesdrill.rig.kernels import LANES

Array = NDArray[np.float64]


def in_groups(*parts: Array) -> Array:
    """Blocks `(W, ...)` side by side: `(G, n, LANES)`; the last walker fills the last group."""
    count = len(parts[0])
    groups = -(-count // LANES)
    if count % LANES:
        last = [part[-1:].repeat(groups * LANES - count, axis=0) for part in parts]
        parts = tuple(np.concatenate(pair) for pair in zip(parts, last, strict=True))
    turned = [part.reshape(groups, LANES, -1).transpose(0, 2, 1) for part in parts]
    if len(turned) == 1:
        return np.ascontiguousarray(turned[0])
    made = np.empty((groups, sum(part.shape[1] for part in turned), LANES))
    return np.concatenate(turned, axis=1, out=made)
