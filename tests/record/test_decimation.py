"""The filter before decimation: what is slow passes, what would alias does not, nothing is shifted."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import for_each

from bayesdrill.record import clocks

RATE, FACTOR = 1000.0, 8
T = 3.0 + np.arange(6000) / RATE
NYQUIST = RATE / FACTOR / 2


def tone(share: float) -> np.ndarray:
    return np.sin(2 * np.pi * share * NYQUIST * T + 0.4)


def test_slow_tones_pass_in_phase() -> None:
    """Mutants killed: samples kept half a filter off; a filter with a delay."""

    def check(share: float) -> None:
        found = clocks.decimated(np.stack([tone(share), 2 - tone(share)], axis=-1), FACTOR)
        np.testing.assert_allclose(found.y[:, 0], tone(share)[found.samples], atol=2e-4)
        np.testing.assert_allclose(found.y[:, 1], 2 - tone(share)[found.samples], atol=4e-4)
        assert np.all(np.diff(found.samples) == FACTOR)
        assert found.removed.max() < 2e-4

    for_each({str(share): (share,) for share in [0.05, 0.3, 0.5]}, check)


def test_what_would_alias_is_taken_away() -> None:
    def check(share: float) -> None:
        found = clocks.decimated(tone(share)[:, None], FACTOR)
        assert np.abs(found.y).max() < 2e-4
        assert found.removed == pytest.approx([np.std(tone(share)[found.samples])], rel=1e-3)

    for_each({str(share): (share,) for share in [1.25, 1.6, 2.0, 5.3]}, check)


def test_the_cutoff_that_is_named_passes_half() -> None:
    share = clocks.cutoff(FACTOR, 1 / RATE) / NYQUIST
    found = clocks.decimated(tone(share)[:, None], FACTOR)
    assert np.std(found.y) / np.std(tone(share)) == pytest.approx(0.5, abs=0.01)


def test_edges_are_dropped() -> None:
    found = clocks.decimated(np.ones((500, 1)), FACTOR)
    half = clocks.filter_length(FACTOR) // 2
    assert found.samples[0] == half
    assert 500 - half - FACTOR <= found.samples[-1] < 500 - half
    np.testing.assert_allclose(found.y, 1.0, atol=1e-12)
