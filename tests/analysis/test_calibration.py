"""Ranks of true values: the bands are exact, and the verdict tells right posteriors from wrong."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.signal import lfilter
from support.case_tables import run_cases

from bayesdrill.analysis.calibration import (
    FALSE_ALARM,
    LOG_LIKELIHOOD,
    CalibrationVerdict,
    Refit,
    count_band,
    ecdf_band,
    judge_calibration,
    rank,
)
from bayesdrill.report.sections import calibration_words as words

N, L = 200, 99


def refits(table: np.ndarray, strayed: int = 0, lost: int = 0) -> list[Refit]:
    """Refits with ranks `(N, Q)`, of which the first `strayed` did not converge."""
    return [
        Refit(
            index=k,
            truth=(0.0,) * len(row),
            ranks=() if k < lost else tuple(map(int, row)),
            r_hat=1.0,
            ess=500.0,
            steps=800,
            reasons=("R-hat",) if k < strayed else (),
            seconds=0.0,
        )
        for k, row in enumerate(table)
    ]


def verdict(table: np.ndarray, n_draws: int = L, **how: int) -> CalibrationVerdict:
    names = [*(f"q_{k}" for k in range(table.shape[1] - 1)), LOG_LIKELIHOOD]
    return judge_calibration(names, refits(table, **how), n_draws)


# --- bands ---------------------------------------------------------------------------------------


@run_cases("false_alarm", [0.02, 0.2, 0.5])
def test_the_chance_to_leave_a_band_is_that_of_all_possible_ranks(false_alarm: float) -> None:
    """Every set of five ranks among four draws, counted. Kills any wrong term of the recursion."""
    n, n_draws = 5, 4
    band = ecdf_band(n, n_draws, false_alarm)
    every = itertools.product(range(n_draws + 1), repeat=n)
    out = np.mean([not band.holds(np.array(ranks)) for ranks in every])
    assert band.false_alarm == pytest.approx(out, abs=1e-12)
    assert out <= false_alarm


@run_cases("false_alarm", [0.05, 0.001])
def test_bands_use_nearly_all_of_the_chance_they_are_given(false_alarm: float) -> None:
    """Kills a band that is valid because it is too wide."""
    for n, n_draws in ((100, 49), (N, L), (1000, L)):
        assert 0.95 * false_alarm < ecdf_band(n, n_draws, false_alarm).false_alarm <= false_alarm


def test_a_band_of_counts_is_the_binomials() -> None:
    low, high = count_band(N, 0.8, 0.01)
    counts = np.random.default_rng(4).binomial(N, 0.8, 400_000)
    for out, one_less in (
        (np.mean(counts < low), np.mean(counts < low + 1)),
        (np.mean(counts > high), np.mean(counts > high - 1)),
    ):
        assert out < 0.0055 < 0.0065 < one_less + 0.002


def test_the_reach_is_above_one_just_outside() -> None:
    band = ecdf_band(60, 19, 0.5)
    ranks = np.random.default_rng(2).integers(0, 20, (2000, 60))
    reach, holds = (np.array([f(row) for row in ranks]) for f in (band.reach, band.holds))
    assert np.array_equal(reach <= 1, holds)
    assert 0.3 < holds.mean() < 0.7


# --- ranks ---------------------------------------------------------------------------------------


def test_ties_are_broken_evenly() -> None:
    """Three of ten draws equal the truth, two are below: ranks 2 to 5, a quarter each."""
    rng = np.random.default_rng(5)
    draws = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    found = np.bincount([rank(1.0, draws, rng) for _ in range(4000)], minlength=11)
    assert found.sum() == found[2:6].sum()
    assert np.all(abs(found[2:6] - 1000) < 4 * np.sqrt(750))


# --- the verdict ---------------------------------------------------------------------------------


def conjugate(
    narrow: float = 1.0, shift: float = 0.0, n: int = N, correlation: float = 0.0, every: int = 1
) -> np.ndarray:
    """Ranks `(n, 3)` of two normal means with normal priors, and of the log likelihood.

    Exact posterior draws, their sd times `narrow`, moved by `shift` sd; successive draws have the
    `correlation`, and `every`-th is used.
    """
    rng = np.random.default_rng(6)
    sd = 1 / np.sqrt(1 + 1 / 0.25)  # of the posterior, noise variance 0.25
    table = np.empty((n, 3), dtype=int)
    for row in table:
        truth = rng.standard_normal(2)
        y = truth + 0.5 * rng.standard_normal(2)
        z = rng.standard_normal((L * every, 2))
        z[1:] *= np.sqrt(1 - correlation**2)
        z = lfilter([1.0], [1.0, -correlation], z, axis=0)
        draws = y * sd**2 / 0.25 + sd * (narrow * z[::every] + shift)
        fit = [-((y - x) ** 2).sum(axis=-1) for x in (truth, draws)]
        row[:2] = [rank(t, x, rng) for t, x in zip(truth, draws.T, strict=True)]
        row[2] = rank(fit[0], fit[1], rng)
    return table


def test_exact_posteriors_are_calibrated() -> None:
    found = verdict(conjugate())
    assert found.calibrated, words.verdict(found)
    assert "calibrated: over 200 refits" in words.verdict(found)


@run_cases(
    "wrong, shape",
    [
        ({"narrow": 1 / np.sqrt(2)}, "posterior too narrow"),
        ({"narrow": 1.5}, "posterior too wide"),
        ({"shift": 0.5}, "posterior too high"),
        ({"shift": -0.5}, "posterior too low"),
    ],
)
def test_wrong_posteriors_are_not(wrong: dict[str, float], shape: str) -> None:
    """sqrt 2 is the 1/2 of the misfit forgotten. Kills a band too wide to see it."""
    found = verdict(conjugate(**wrong))
    assert not found.calibrated
    assert shape in {quantity.shape for quantity in found.quantities[:2]}
    assert found.faults[0].startswith("ranks of ")
    assert shape in words.verdict(found)


def test_a_posterior_that_ignores_the_record_is_seen_by_its_log_likelihood() -> None:
    """The prior itself ranks every parameter evenly (Modrak et al. 2023); kills leaving it out."""
    rng = np.random.default_rng(7)
    table = np.empty((N, 2), dtype=int)
    for row in table:
        truth, draws = rng.standard_normal(), rng.standard_normal(L)
        y = truth + 0.5 * rng.standard_normal()
        row[:] = rank(truth, draws, rng), rank(-((y - truth) ** 2), -((y - draws) ** 2), rng)
    found = verdict(table)
    assert found.quantities[0].holds
    assert found.faults == (f"ranks of {LOG_LIKELIHOOD} leave the band (posterior too wide)",)


def test_correlated_draws_look_too_narrow_and_thinned_ones_do_not() -> None:
    """Why ranks are among nearly independent draws."""
    found = verdict(conjugate(correlation=0.98))
    assert "posterior too narrow" in {quantity.shape for quantity in found.quantities[:2]}
    assert verdict(conjugate(correlation=0.98, every=150)).calibrated


@pytest.mark.parametrize(
    "together",
    [
        pytest.param(False, marks=pytest.mark.slow, id="independent"),
        pytest.param(True, id="the same"),
    ],
)
def test_a_right_posterior_is_found_wrong_as_seldom_as_stated(together: bool) -> None:
    """Studies of five quantities; kills a band not adjusted for their number.

    Where all quantities have the same ranks the union bound is far from sharp, but holds.
    """
    rng = np.random.default_rng(8)
    n, n_draws, studies = 60, 19, 1500 if together else 4000
    wrong = 0
    for _ in range(studies):
        table = rng.integers(0, n_draws + 1, (n, 1 if together else 5))
        wrong += bool(verdict(np.broadcast_to(table, (n, 5)), n_draws).faults)
    assert wrong / studies < FALSE_ALARM + 3 * np.sqrt(FALSE_ALARM / studies)
    if not together:
        by_ranks = 5 * ecdf_band(n, n_draws, 0.1 * FALSE_ALARM).false_alarm
        assert wrong / studies > by_ranks - 3 * np.sqrt(by_ranks / studies)


def test_refits_that_did_not_converge_stay_in_the_ranks_and_forbid_the_verdict() -> None:
    table = np.random.default_rng(9).integers(0, L + 1, (N, 3))
    few, many = verdict(table, strayed=10), verdict(table, strayed=11)
    assert few.calibrated
    assert not many.calibrated
    assert many.band.n == N
    assert words.verdict(many).startswith("no verdict: 11 of 200 refits did not converge")
    assert "0, 1, 2, 3" in words.refits(many, refits(table, 11))


def test_a_refit_without_draws_forbids_the_verdict() -> None:
    table = np.random.default_rng(9).integers(0, L + 1, (N, 3))
    found = verdict(table, strayed=1, lost=1)
    assert (found.lost, found.band.n, found.calibrated) == ((0,), N - 1, False)
    assert "1 of 200 refits gave no draws" in words.verdict(found)


def test_intervals_cover_what_they_say() -> None:
    """Ranks 25 to 74 of 0 to 99 lie between the draws that bound the middle half."""
    ranks = np.repeat(np.arange(L + 1), 2)
    found = verdict(np.stack([ranks, ranks], axis=-1))
    for interval in found.quantities[0].intervals:
        assert interval.inside == pytest.approx(interval.share * N)
    assert [interval.share for interval in found.quantities[0].intervals] == pytest.approx(
        [0.5, 0.8, 0.94]
    )
