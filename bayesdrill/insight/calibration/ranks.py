"""The rank of a true value among draws, and what an uneven set of ranks looks like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

PLAIN = 3.0  # standard errors from which a shift or a spread of the ranks is named


def rank(truth: float, draws: Array, rng: np.random.Generator) -> int:
    """How many of `draws (L,)` are below `truth`, 0 to L; ties are broken at random."""
    below, equal = int((draws < truth).sum()), int((draws == truth).sum())
    return below + int(rng.integers(equal + 1))


def shape(ranks: Counts, n_draws: int) -> str | None:
    """What is wrong with a posterior whose `ranks (N,)` are not uniform; None where unclear.

    By the mean and the spread of the ranks: a shift spreads them too, to one end alone.
    """
    u = (ranks + 0.5) / (n_draws + 1) - 0.5
    n = len(u)
    moved = float(u.mean()) * np.sqrt(12.0 * n)
    spread = (float((u**2).mean()) - 1.0 / 12.0) * np.sqrt(180.0 * n)
    if max(abs(moved), abs(spread)) < PLAIN:
        return None
    if abs(moved) >= max(PLAIN, 0.5 * abs(spread)):
        return "posterior too low" if moved > 0 else "posterior too high"
    return "posterior too narrow" if spread > 0 else "posterior too wide"


def shape_of_fit(ranks: Counts, n_draws: int) -> str | None:
    """The same for the log likelihood, of which only too much or too little can be said.

    Draws that crowd around the best fit all fit the record better than the truth does.
    """
    u = (ranks + 0.5) / (n_draws + 1) - 0.5
    moved = float(u.mean()) * np.sqrt(12.0 * len(u))
    if abs(moved) < PLAIN:
        return None
    return "posterior too wide" if moved > 0 else "posterior too narrow"
