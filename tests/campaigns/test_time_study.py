"""Histories of a log product: evidence against dense covariances, and simulated campaigns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesdrill.campaigns import time_study
from bayesdrill.campaigns.time_study import LevelHistory, level_history

RUNS = 200
INDEX = np.arange(RUNS)
JUMP = np.where(INDEX < 120, 0.0, 0.05)
DRIFT = 0.03 * INDEX / RUNS


def history(
    level: np.ndarray | float, seed: int, spread: float = 0.015, known: float = 0.01
) -> LevelHistory:
    rng = np.random.default_rng(seed)
    y = 0.3 + level + spread * rng.standard_normal(RUNS) + known * rng.standard_normal(RUNS)
    ones = np.ones((RUNS, 1))
    return level_history(3600.0 * INDEX, y, np.full(RUNS, known**2), ones)


def small_series() -> time_study._Series:
    """Return eleven runs of two rigs, at a single spread over runs."""
    rng = np.random.default_rng(8)
    t, c = np.cumsum(rng.uniform(1.0, 5.0, 11)), rng.uniform(1e-4, 4e-4, 11)
    y = 0.05 * rng.standard_normal(11)
    h = np.eye(2)[rng.integers(0, 2, 11)]
    series = time_study._series(t, y, c, h)
    one = {"variance": series.variance[:1], "log_prior": np.zeros(1)}
    return replace(series, prior_sd=np.array([0.3, 0.5]), **one)


def dense_log_evidence(series: time_study._Series, covariance: np.ndarray) -> float:
    total = np.diag(series.variance[0]) + series.h * series.prior_sd**2 @ series.h.T + covariance
    return float(stats.multivariate_normal(cov=total).logpdf(series.y))


def test_evidence_of_constant_drift_and_changes_is_that_of_dense_covariances() -> None:
    series, size = small_series(), time_study.SIZE
    fit = time_study._fit(series.y, series.h, series.variance, series.prior_sd)
    assert fit.log_evidence[0] == pytest.approx(dense_log_evidence(series, np.zeros((11, 11))))
    ramped = series.with_column(time_study.ramp(series.t))
    fit = time_study._fit(ramped.y, ramped.h, ramped.variance, ramped.prior_sd)
    column = (series.t - series.t[-1]) / (series.t[-1] - series.t[0])
    dense = dense_log_evidence(series, size**2 * np.outer(column, column))
    assert fit.log_evidence[0] == pytest.approx(dense)
    log_p, sizes, variances = time_study._moments(series)
    for run in range(1, 11):
        before = np.where(np.arange(11) < run, 1.0, 0.0)
        dense = dense_log_evidence(series, np.outer(before, before) * size**2)
        assert log_p[0, run - 1] == pytest.approx(dense - np.log(10))
        # The column is -1 before the change: its coefficient is the size of the change.
        total = np.diag(series.variance[0]) + series.h * series.prior_sd**2 @ series.h.T
        gain = -(size**2) * before @ np.linalg.inv(total + np.outer(before, before) * size**2)
        assert sizes[0, run - 1] == pytest.approx(gain @ series.y)
        assert variances[0, run - 1] == pytest.approx(size**2 * (1 + gain @ before))


def test_evidence_and_level_of_a_walk_are_those_of_dense_covariances(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    series = small_series()
    walk = time_study._walk(series)
    elapsed = (series.t - series.t[0]) / (series.t[-1] - series.t[0])
    scales = time_study.SIZE * np.geomspace(0.03, 3.0, time_study.WALKS)
    prior = stats.halfnorm(scale=time_study.SIZE).pdf(scales) * scales
    walked = np.minimum.outer(elapsed, elapsed)
    dense = [dense_log_evidence(series, q**2 * walked) for q in scales]
    assert np.allclose(walk.log_evidence, dense + np.log(prior / prior.sum()))
    # With a constant as the only regressor the level is that of a regression on Gaussian processes.
    monkeypatch.setattr(time_study, "WALKS", 1)
    series = replace(series, h=np.ones((11, 1)), prior_sd=np.array([10.0]))
    walk = time_study._walk(series)
    covariance = 100.0 + (0.03 * time_study.SIZE) ** 2 * walked
    gain = covariance @ np.linalg.inv(covariance + np.diag(series.variance[0]))
    assert np.allclose(walk.level, gain @ series.y, atol=1e-6)
    assert np.allclose(walk.level_sd**2, np.diag(covariance - gain @ covariance), rtol=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_a_jump_of_5_percent_after_run_120_is_located_within_3_runs(seed: int) -> None:
    (change,) = history(JUMP, seed).changes
    assert abs(change.run - 120) <= 3
    assert abs(change.size - 0.05) < 3 * change.size_sd
    assert change.probability > 0.9


def test_a_steady_drift_of_3_percent_is_no_jump() -> None:
    histories = [history(DRIFT, seed) for seed in range(8)]
    assert all(h.best == "drift" for h in histories)
    assert np.mean([abs(h.drift - 0.03) < 1.645 * h.drift_sd for h in histories]) > 0.5


def test_two_changes_and_a_wandering_level_are_recognised() -> None:
    middle = (INDEX >= 50) & (INDEX < 120)
    two = history(np.where(middle, 0.08, 0.0), 1)
    assert two.best == "changes"
    assert [abs(c.run - run) <= 3 for c, run in zip(two.changes, (50, 120), strict=True)] == [
        True
    ] * 2
    assert [np.sign(c.size) for c in two.changes] == [1, -1]
    wandering = 0.1 * np.cumsum(np.random.default_rng(4).standard_normal(RUNS)) / np.sqrt(RUNS)
    walk = history(wandering, 2)
    assert walk.best == "walk"
    assert (np.abs(walk.level - 0.3 - wandering) < 1.645 * walk.level_sd).mean() > 0.75


def test_foreign_runs_are_no_changes() -> None:
    level = np.zeros(RUNS)
    level[[30, 31, 90, 150]] = 0.6, 0.5, -0.4, 0.7
    assert history(level, 3).best == "constant"


@pytest.mark.parametrize(
    ("off", "share"), [pytest.param(0.4, 0.75, marks=pytest.mark.slow), (0.15, 0.45)]
)
def test_a_foreign_run_among_twelve_hides_few_jumps_and_is_no_change(
    off: float, share: float
) -> None:
    """The run that is 15 % off kills the mutant whose spread has a prior of the scale 0.1."""
    index, ones = np.arange(12.0), np.ones((12, 1))
    alarms = {"jump": 0, "jump without the foreign run": 0, "no jump": 0}
    for seed in range(50):
        rng = np.random.default_rng(seed)
        flat = np.hypot(0.015, 0.01) * rng.standard_normal(12)
        foreign = rng.integers(12)
        flat[foreign] += off * rng.choice([-1, 1])
        y, kept = flat + np.where(index < 7, 0.0, 0.08), index != foreign
        whole = level_history(index, y, np.full(12, 1e-4), ones)
        without = level_history(index[kept], y[kept], np.full(11, 1e-4), ones[kept])
        null = level_history(index, flat, np.full(12, 1e-4), ones)
        alarms["jump"] += whole.probabilities["constant"] < 0.05
        alarms["jump without the foreign run"] += without.probabilities["constant"] < 0.05
        alarms["no jump"] += null.probabilities["constant"] < 0.05
    assert alarms["jump"] >= share * alarms["jump without the foreign run"] >= share * 36
    assert alarms["no jump"] <= 1


def test_sets_of_foreign_runs_hold_the_farthest_runs_and_none_twice() -> None:
    sets = time_study._foreign_sets(np.array([0.1, 0.4, 0.2, 0.3]))
    assert {tuple(row) for row in sets.astype(int)} == {(0, 0, 0, 0), (0, 1, 0, 0)}
    sets = time_study._foreign_sets(np.linspace(1.0, 0.0, 40))
    assert len(np.unique(sets, axis=0)) == len(sets)
    assert max(sets.sum(axis=1)) == 12  # three tenths of them
    assert sets[:, :12].any(axis=0).all()
    assert not sets[:, 12:].any()


def test_no_change_is_between_runs_of_equal_time() -> None:
    rng = np.random.default_rng(6)
    t = np.repeat(np.arange(20.0), 5)
    y = np.where(np.arange(100) < 50, 0.0, 0.1) + 0.01 * rng.standard_normal(100)
    y[50] = 0.0  # the first run of its hour seems to be before the change
    (change,) = level_history(t, y, np.full(100, 1e-6), np.ones((100, 1))).changes
    assert change.run == 50


def test_runs_that_differ_less_than_records_know_have_a_constant_level() -> None:
    y = 0.001 * np.random.default_rng(9).standard_normal(12)
    flat = level_history(np.arange(12.0), y, np.full(12, 1e-2), np.ones((12, 1)))
    assert flat.best == "constant"
    assert sum(flat.probabilities.values()) == pytest.approx(1.0)
    same = level_history(np.arange(12.0), np.zeros(12), np.zeros(12), np.ones((12, 1)))
    assert same.best == "constant"


def test_the_level_over_time_is_zero_at_the_end_and_follows_the_best_description() -> None:
    t = np.array([0.0, 1.0, 3.0, 4.0])
    change = time_study.LevelChange(
        run=2, first=1, last=3, time=3.0, size=0.1, size_sd=0.01, probability=0.9
    )
    history = LevelHistory(
        probabilities={"constant": 1.0},
        drift=0.2,
        drift_sd=0.01,
        changes=(change,),
        walk_sd=0.1,
        level=np.array([1.0, 2.0, 4.0, 3.0]),
        level_sd=np.zeros(4),
    )
    for best, level in {
        "constant": [0.0, 0.0, 0.0, 0.0],
        "drift": [-0.2, -0.15, -0.05, 0.0],
        "changes": [-0.1, -0.1, 0.0, 0.0],
        "walk": [-2.0, -1.0, 1.0, 0.0],
    }.items():
        described = replace(history, probabilities={best: 1.0})
        assert np.allclose(described.level_over(t), level)
