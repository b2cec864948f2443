"""Unknowns that a record determines only with the priors of others that it leaves alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from bayesdrill.insight.diagnostics import Row

Array = NDArray[np.float64]

MOSTLY = 0.8  # of the variance of the ranks
NAMED = 0.3  # share of an unknown in that, as a standardised slope
MOST_DRAWS = 4000  # looked at


def leaning(rows: Sequence[Row], draws: Array) -> Mapping[str, tuple[str, ...]]:
    """By the name of an unknown that is called determined, those left to their priors that explain
    most of what is left of it: were their priors wider, so would its posterior be.

    `draws (N, D)`, in the order of `rows`.  By ranks, so that no ridge need be straight.
    """
    alone = [d for d, row in enumerate(rows) if row.word == "prior only"]
    if not alone:
        return {}
    some = draws[:: max(1, len(draws) // MOST_DRAWS)]
    ranks = rankdata(some, axis=0)
    z = (ranks - ranks.mean(axis=0)) / np.maximum(ranks.std(axis=0), 1e-300)
    found = {}
    for d, row in enumerate(rows):
        if row.word != "determined":
            continue
        slopes, *_ = np.linalg.lstsq(z[:, alone], z[:, d])
        if 1 - np.mean((z[:, d] - z[:, alone] @ slopes) ** 2) >= MOSTLY:
            found[row.name] = tuple(
                rows[k].name for k, slope in zip(alone, slopes, strict=True) if abs(slope) > NAMED
            )
    return found
