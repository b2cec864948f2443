"""Ranks of ensembles among all draws: their counts, and a band that sound ensembles keep to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from bayesdrill.analysis import diagnostics
from bayesdrill.analysis.diagnostics import RANK_BINS, independent_draws, rank_histograms

Array = NDArray[np.float64]


def draws(seed: int, n: int = 600, unknowns: int = 2) -> Array:
    return np.random.default_rng(seed).standard_normal((4, n, unknowns))


def test_counts_sum_to_the_draws_and_are_those_of_the_ranks() -> None:
    x = draws(1)
    for d, one in enumerate(rank_histograms(x, np.random.default_rng(0))):
        assert one.draws == 600
        assert (one.counts.sum(axis=1) == 600).all()
        assert (one.counts.sum(axis=0) == 4 * 600 / RANK_BINS).all()
        place = rankdata(x[..., d]).reshape(4, 600)
        first = (place <= 2400 / RANK_BINS).sum(axis=1)
        assert (one.counts[:, 0] == first).all()


def test_an_ensemble_that_is_elsewhere_leaves_the_band_and_is_named() -> None:
    x = draws(2)
    x[2, :, 0] += 0.25
    x[1, :, 1] *= 1.3
    shifted, wider = rank_histograms(x, np.random.default_rng(0))
    assert list(np.flatnonzero(~shifted.holds)) == [2]
    assert list(np.flatnonzero(~wider.holds)) == [1]
    assert (shifted.away[2] < 0).mean() > 0.9  # draws too high: too few below any share


def test_ensembles_alike_leave_the_band_as_often_as_is_said() -> None:
    """1 % of 400; twelve or more of them would come once in a thousand times."""
    alarms = 0
    room = diagnostics._chance_widths(4, 300, 0.01, np.random.default_rng(3))
    for seed in range(400):
        x = draws(1000 + seed, 300, 1)
        own = rankdata(x).reshape(4, 300) / 1200
        away = np.stack([(own <= share).sum(axis=1) for share in diagnostics.SHARES], axis=1)
        alarms += bool((np.abs(away - 300 * diagnostics.SHARES) > room).any())
    assert 0 < alarms < 12


def test_draws_that_remember_each_other_are_left_out() -> None:
    theta = np.random.default_rng(4).standard_normal((4, 100, 8, 2))
    kept = independent_draws(theta, 20, 4.6)
    assert kept.shape == (4, 8 * 8, 2)  # every tenth of 80 steps
    assert np.array_equal(kept[:, :8], theta[:, 20])
    assert independent_draws(theta, 20, 1e3).shape[1] == 2 * 8  # of too short a chain the ends
