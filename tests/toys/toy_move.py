"""Goodman and Weare's walk move: along a random sum of how some of the others differ from their mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesdrill.sampling import halves

Array = NDArray[np.float64]

SOME = 20


def _walk(walkers: Array, others: Array, random: np.random.RandomState) -> tuple[Array, Array]:
    n, d = walkers.shape
    picked = others[random.randint(len(others), size=(n, SOME))]
    apart = picked - picked.mean(axis=1, keepdims=True)
    weights = random.standard_normal((n, SOME)) / np.sqrt(SOME * d)
    return walkers + np.einsum("ns,nsd->nd", weights, apart), np.zeros(n)


walk = halves(_walk)
