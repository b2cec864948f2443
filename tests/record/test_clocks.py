"""Times of records: grids, several clocks as one, inputs between their samples, and decimation."""

from itertools import product

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.record import clocks

KEPT = np.r_[0:20, 25:60, 61:100]


@run_cases("rate, begin", product([100.0, 300.0, 1234.5], [0.0, -3.7, 812.0]))
def test_a_grid_with_missing_samples_is_recognised_in_rounded_times(
    rate: float, begin: float
) -> None:
    """The gaps are whole multiples of one step, and no time moves by more than its digits."""
    t = (begin + np.arange(100) / rate)[KEPT]
    grid = clocks.grid(np.round(t, 6))
    assert grid.indices.tolist() == KEPT.tolist()
    assert grid.step == pytest.approx(1 / rate, rel=1e-5)
    assert np.abs(grid.times - t).max() < 1e-6
    steps = np.diff(clocks.on_grid(np.round(t, 6))) / grid.step
    assert np.abs(steps - np.round(steps)).max() < 1e-6


def test_even_times_stay_as_they_are() -> None:
    t = np.round(np.arange(100) / 300.0, 6)
    assert clocks.on_grid(t) is t


def test_times_with_jitter_have_no_grid() -> None:
    t = np.cumsum(np.random.default_rng(3).uniform(0.9, 1.1, 80))
    assert clocks.grid(t) is None
    assert clocks.on_grid(t) is t
    words = clocks.describe_times(t)
    assert words.startswith("80 times at unequal steps")
    steps = np.diff(t)
    for number in (f"{steps.min():.6g}", f"{steps.max():.6g}", f"{steps.std() / steps.mean():.2g}"):
        assert number in words


@run_cases(
    "missing, words",
    [
        ([], "a sample every 0.01 s (100 Hz), the first at 0 s"),
        ([*range(20, 25), 60], "6 missing in 2 gaps, the longest of 5 between 0.19 and 0.25 s"),
        ([5, 6], "2 missing in 1 gap between 0.04 and 0.07 s"),
    ],
)
def test_missing_samples_are_described_with_their_place(missing: list[int], words: str) -> None:
    assert clocks.describe_times(np.delete(np.arange(100) * 0.01, missing)).endswith(words)


def test_times_that_are_nearly_the_same_are_named() -> None:
    t = np.arange(50) * 0.02
    other = t + np.where(np.arange(50) == 31, 1e-5, 0.0)
    assert np.isnan(clocks.crowded_time(clocks.union([t, t + 0.01]), [t, t + 0.01]))
    assert clocks.crowded_time(clocks.union([t, other]), [t, other]) == pytest.approx(0.62)


@run_cases(
    "first_order, expected",
    [(False, [5, 5, -1, -1, -1, 3, 3]), (True, [5, 2, pytest.approx(-1), -1, 1, 3, 3])],
)
def test_inputs_are_held_exactly_between_samples_of_their_own(
    first_order: bool, expected: list[float]
) -> None:
    clock, values = np.array([1.0, 2.0, 4.0]), np.array([5.0, -1.0, 3.0])
    t = np.array([1.0, 1.5, 2.0 - 1e-13, 2.0, 3.0, 4.0, 9.0])
    assert clocks.hold_input(t, clock, values, first_order=first_order).tolist() == expected


RATE, FACTOR = 1000.0, 8
T = 3.0 + np.arange(6000) / RATE


def tone(share: float) -> np.ndarray:
    """A sine at this share of the new Nyquist frequency."""
    return np.sin(2 * np.pi * share * RATE / FACTOR / 2 * T + 0.4)


@run_cases("share", [0.05, 0.3, 0.5])
def test_decimation_leaves_slow_tones_in_phase(share: float) -> None:
    result = clocks.decimated(np.stack([tone(share), 2 - tone(share)], axis=-1), FACTOR)
    np.testing.assert_allclose(result.y[:, 0], tone(share)[result.samples], atol=2e-4)
    np.testing.assert_allclose(result.y[:, 1], 2 - tone(share)[result.samples], atol=4e-4)
    assert np.all(np.diff(result.samples) == FACTOR)
    assert result.removed.max() < 2e-4


@run_cases("share", [1.25, 1.6, 2.0, 5.3])
def test_decimation_takes_away_what_would_alias(share: float) -> None:
    result = clocks.decimated(tone(share)[:, None], FACTOR)
    assert np.abs(result.y).max() < 2e-4
    assert result.removed == pytest.approx([np.std(tone(share)[result.samples])], rel=1e-3)


def test_half_of_the_amplitude_passes_at_the_cutoff() -> None:
    share = clocks.cutoff(FACTOR, 1 / RATE) / (RATE / FACTOR / 2)
    result = clocks.decimated(tone(share)[:, None], FACTOR)
    assert np.std(result.y) / np.std(tone(share)) == pytest.approx(0.5, abs=0.01)
