"""Times of records: grids, several clocks as one, inputs held between their own samples."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import for_each

from bayesdrill.record import clocks

KEPT = np.r_[0:20, 25:60, 61:100]


def test_a_grid_with_samples_missing_is_found_through_few_digits() -> None:
    """The gaps are whole multiples of one step, and no time moves by more than its digits."""

    def check(rate: float, begin: float) -> None:
        t = (begin + np.arange(100) / rate)[KEPT]
        found = clocks.grid(np.round(t, 6))
        assert found is not None
        assert found.indices.tolist() == KEPT.tolist()
        assert found.step == pytest.approx(1 / rate, rel=1e-5)
        assert np.abs(found.times - t).max() < 1e-6
        steps = np.diff(clocks.on_grid(np.round(t, 6))) / found.step
        assert np.abs(steps - np.round(steps)).max() < 1e-6

    for_each(
        {
            f"{rate} {begin}": (rate, begin)
            for rate in [100.0, 300.0, 1234.5]
            for begin in [0.0, -3.7, 812.0]
        },
        check,
    )


def test_even_times_stay_as_they_are() -> None:
    """Bit by bit.  Mutant killed: all times put on a grid."""
    t = np.round(np.arange(100) / 300.0, 6)
    assert clocks.on_grid(t) is t


def test_jitter_has_no_grid() -> None:
    t = np.cumsum(np.random.default_rng(3).uniform(0.9, 1.1, 80))
    assert clocks.grid(t) is None
    assert clocks.on_grid(t) is t
    said = clocks.describe_times(t)
    assert said.startswith("80 times at unequal steps")
    steps = np.diff(t)
    for number in (steps.min(), steps.max()):
        assert f"{number:.6g}" in said
    assert f"{steps.std() / steps.mean():.2g}" in said


def test_words_say_what_is_missing_and_where() -> None:
    t = np.arange(100) * 0.01
    assert clocks.describe_times(t) == "a sample every 0.01 s (100 Hz), the first at 0 s"
    said = clocks.describe_times(t[KEPT])
    assert "6 missing in 2 gaps, the longest of 5 between 0.19 and 0.25 s" in said
    assert "2 missing in 1 gap, of 2 between 0.04 and 0.07 s" in clocks.describe_times(
        np.delete(t, [5, 6])
    )


def test_clocks_become_one_and_common_times_stand_once() -> None:
    fast, slow = 40.0 + np.arange(91) / 300.0, 40.1 + np.arange(13) / 120.0
    t = clocks.union([fast, slow + 1e-14])
    exact = {round(x * 1200) for x in np.arange(91) / 300.0} | {
        round((0.1 + x) * 1200) for x in np.arange(13) / 120.0
    }
    assert len(t) == len(exact)
    assert np.all(np.diff(t) > 1e-4)
    np.testing.assert_allclose(t[clocks.indices_in(t, fast)], fast, rtol=0, atol=1e-12)
    np.testing.assert_allclose(t[clocks.indices_in(t, slow)], slow, rtol=0, atol=1e-12)


def test_times_that_are_nearly_the_same_are_named() -> None:
    t = np.arange(50) * 0.02
    other = t + np.where(np.arange(50) == 31, 1e-5, 0.0)
    assert np.isnan(clocks.crowded_time(clocks.union([t, t + 0.01]), [t, t + 0.01]))
    assert clocks.crowded_time(clocks.union([t, other]), [t, other]) == pytest.approx(0.62)


def test_inputs_are_held_exactly_between_samples_of_their_own() -> None:
    """Mutants killed: the next sample instead of the last; the last one before a sample's own time."""
    clock, values = np.array([1.0, 2.0, 4.0]), np.array([5.0, -1.0, 3.0])
    t = np.array([1.0, 1.5, 2.0 - 1e-13, 2.0, 3.0, 4.0, 9.0])
    assert clocks.hold_input(t, clock, values, first_order=False).tolist() == [
        5,
        5,
        -1,
        -1,
        -1,
        3,
        3,
    ]
    assert clocks.hold_input(t, clock, values, first_order=True)[[0, 1, 3, 4, 5]].tolist() == [
        5,
        2,
        -1,
        1,
        3,
    ]
