"""Ranks of true values: exact bands, and verdicts that tell right posteriors from wrong ones."""

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
from bayesdrill.basics.findings import Finding
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.sections.calibration import describe_calibration, describe_refits

N, L = 200, 99


def refits(ranks: np.ndarray, strayed: int = 0, lost: int = 0) -> list[Refit]:
    """Return refits with `ranks (N, Q)`: the first did not converge, or gave no draws."""
    return [
        Refit(
            index=k,
            truth=(0.0,) * len(row),
            ranks=() if k < lost else tuple(map(int, row)),
            r_hat=1.0,
            ess=500.0,
            steps=800,
            reasons=(Finding("nothing sampled", {"why": "R-hat"}),) if k < strayed else (),
            seconds=0.0,
        )
        for k, row in enumerate(ranks)
    ]


def verdict(ranks: np.ndarray, n_draws: int = L, **failures: int) -> CalibrationVerdict:
    names = [*(f"q_{k}" for k in range(ranks.shape[1] - 1)), LOG_LIKELIHOOD]
    return judge_calibration(names, refits(ranks, **failures), n_draws)


@run_cases("false_alarm", [0.02, 0.2, 0.5])
def test_the_chance_to_leave_a_band_is_that_over_all_possible_ranks(false_alarm: float) -> None:
    """Of five ranks among four draws, all of them counted."""
    n, n_draws = 5, 4
    band = ecdf_band(n, n_draws, false_alarm)
    every = itertools.product(range(n_draws + 1), repeat=n)
    outside = np.mean([not band.contains(np.array(ranks)) for ranks in every])
    assert band.false_alarm == pytest.approx(outside, abs=1e-12)
    assert outside <= false_alarm


@run_cases("n, n_draws", [(100, 49), (N, L), (1000, L)])
def test_a_band_is_as_narrow_as_its_false_alarms_allow(n: int, n_draws: int) -> None:
    for chance in (0.05, 0.001):
        assert 0.95 * chance < ecdf_band(n, n_draws, chance).false_alarm <= chance


def test_a_band_of_counts_is_that_of_a_binomial() -> None:
    low, high = count_band(N, 0.8, 0.01)
    counts = np.random.default_rng(4).binomial(N, 0.8, 400_000)
    for outside, narrower in ((counts < low, counts < low + 1), (counts > high, counts > high - 1)):
        assert np.mean(outside) < 0.0055 < 0.0065 < np.mean(narrower) + 0.002


def test_ties_are_broken_evenly() -> None:
    """Three of ten draws equal the truth, two are below: ranks 2 to 5, a quarter each."""
    rng, draws = np.random.default_rng(5), np.array([0.0] * 2 + [1.0] * 3 + [2.0] * 5)
    counts = np.bincount([rank(1.0, draws, rng) for _ in range(4000)], minlength=11)
    assert counts.sum() == counts[2:6].sum()
    assert np.all(abs(counts[2:6] - 1000) < 4 * np.sqrt(750))


def conjugate(
    narrow: float = 1.0, shift: float = 0.0, correlation: float = 0.0, every: int = 1
) -> np.ndarray:
    """Return ranks `(N, 3)` of two normal means with normal priors, and of the log likelihood.

    The posterior draws are exact, but for their sd times `narrow`, a `shift` in sds, and the
    `correlation` of successive ones, of which each `every`-th is used.
    """
    rng, sd = np.random.default_rng(6), 1 / np.sqrt(1 + 1 / 0.25)  # of a noise variance of 0.25
    ranks = np.empty((N, 3), dtype=int)
    for row in ranks:
        truth = rng.standard_normal(2)
        y = truth + 0.5 * rng.standard_normal(2)
        z = rng.standard_normal((L * every, 2))
        z[1:] *= np.sqrt(1 - correlation**2)
        z = lfilter([1.0], [1.0, -correlation], z, axis=0)
        draws = y * sd**2 / 0.25 + sd * (narrow * z[::every] + shift)
        fit = [-((y - x) ** 2).sum(axis=-1) for x in (truth, draws)]
        row[:2] = [rank(t, x, rng) for t, x in zip(truth, draws.T, strict=True)]
        row[2] = rank(fit[0], fit[1], rng)
    return ranks


def test_exact_posteriors_are_calibrated() -> None:
    result = verdict(conjugate())
    assert result.calibrated, describe_calibration(result)
    assert "calibrated: over 200 refits" in describe_calibration(result)
    assert verdict(conjugate(correlation=0.98, every=150)).calibrated  # of nearly independent draws


@run_cases(
    "fault, shape",
    [
        ({"narrow": 1 / np.sqrt(2)}, "posterior too narrow"),  # without the 1/2 of the misfit
        ({"narrow": 1.5}, "posterior too wide"),
        ({"shift": 0.5}, "posterior too high"),
        ({"shift": -0.5}, "posterior too low"),
        ({"correlation": 0.98}, "posterior too narrow"),
    ],
)
def test_a_wrong_posterior_is_not_calibrated(fault: dict[str, float], shape: str) -> None:
    result = verdict(conjugate(**fault))
    assert not result.calibrated
    assert shape in {quantity.shape for quantity in result.quantities[:2]}
    assert result.faults[0].kind == "ranks outside the band"
    assert shape in describe_calibration(result)


def test_a_posterior_that_ignores_the_record_is_noticed_by_its_log_likelihood() -> None:
    """The prior itself ranks every parameter evenly (Modrak et al. 2023)."""
    rng, ranks = np.random.default_rng(7), np.empty((N, 2), dtype=int)
    for row in ranks:
        truth, draws = rng.standard_normal(), rng.standard_normal(L)
        y = truth + 0.5 * rng.standard_normal()
        row[:] = rank(truth, draws, rng), rank(-((y - truth) ** 2), -((y - draws) ** 2), rng)
    result = verdict(ranks)
    assert result.quantities[0].holds
    said = f"ranks of {LOG_LIKELIHOOD} leave the band (posterior too wide)"
    assert finding_sentences(result.faults) == (said,)


@pytest.mark.parametrize("alike", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_right_posterior_is_found_wrong_as_seldom_as_stated(alike: bool) -> None:
    """In studies of five quantities, which may all have the same ranks."""
    rng, n, n_draws, studies = np.random.default_rng(8), 60, 19, 1500 if alike else 4000
    wrong = 0
    for _ in range(studies):
        ranks = rng.integers(0, n_draws + 1, (n, 1 if alike else 5))
        wrong += bool(verdict(np.broadcast_to(ranks, (n, 5)), n_draws).faults)
    assert wrong / studies < FALSE_ALARM + 3 * np.sqrt(FALSE_ALARM / studies)
    if not alike:  # then the bound for all of them is sharp
        by_ranks = 5 * ecdf_band(n, n_draws, 0.1 * FALSE_ALARM).false_alarm
        assert wrong / studies > by_ranks - 3 * np.sqrt(by_ranks / studies)


UNIFORM = np.random.default_rng(9).integers(0, L + 1, (N, 3))


def test_refits_that_did_not_converge_stay_in_the_ranks_and_forbid_the_verdict() -> None:
    few, many = verdict(UNIFORM, strayed=10), verdict(UNIFORM, strayed=11)
    assert few.calibrated
    assert not many.calibrated
    assert many.band.n == N
    assert describe_calibration(many).startswith("no verdict: 11 of 200 refits did not converge")
    assert "0, 1, 2, 3" in describe_refits(many, refits(UNIFORM, 11))


def test_a_refit_without_draws_forbids_the_verdict() -> None:
    result = verdict(UNIFORM, strayed=1, lost=1)
    assert (result.lost, result.band.n, result.calibrated) == ((0,), N - 1, False)
    assert "1 of 200 refits gave no draws" in describe_calibration(result)
