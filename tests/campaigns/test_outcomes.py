"""Outcomes of a population equal closed forms of normal, t and chi-square distributions."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats
from support.simulated_campaigns import BRIEF

from bayesdrill.basics.progress import SILENT
from bayesdrill.campaigns import outcomes
from bayesdrill.campaigns.mixture import RunArrays, describe, run_arrays
from bayesdrill.campaigns.population import (
    NominalRange,
    PopulationDraws,
    PopulationSettings,
    sample_population,
)

ROOT = np.array([[0.04, 0.0], [0.015, 0.02]])
COVARIANCE = ROOT @ ROOT.T
MEAN = np.array([0.5, -0.2])
PRODUCTS = ("k_s/j_1", "c_1/j_1")


def arrays(estimates: np.ndarray, sd: float = 0.01, width: float = 0.05) -> RunArrays:
    """Return normal posteriors of estimates `(R, 2)` under normal interim priors about the mean."""
    rng = np.random.default_rng(1)
    precision = sd**-2.0 + width**-2.0
    runs = []
    for y in estimates:
        centre = (y * sd**-2.0 + MEAN * width**-2.0) / precision
        z = centre + rng.standard_normal((1000, 2)) / np.sqrt(precision)
        log_interim = -0.5 * ((z - MEAN) ** 2).sum(axis=1) / width**2
        runs.append(describe(z, log_interim))
    none, zeros = np.zeros((len(runs), 0)), np.zeros((len(runs), 2))
    return run_arrays(runs, np.zeros(len(runs), int), zeros, none, np.zeros(0))


@cache
def known_population(nu: float, n_draws: int = 2000) -> PopulationDraws:
    """Return a population of two runs that is known exactly: every draw of it is the same."""
    sampled = sample_population(
        arrays(np.array([MEAN, MEAN])),
        PRODUCTS,
        PopulationSettings(targets=BRIEF, max_sweeps=10, chains=2, draws=10),
        np.random.default_rng(2),
        SILENT,
    )
    return replace(
        sampled,
        mean=np.tile(MEAN, (n_draws, 1)),
        slopes=np.zeros((n_draws, 0, 2)),
        levels=np.tile(MEAN, (n_draws, 1, 1)),
        covariance=np.tile(COVARIANCE, (n_draws, 1, 1)),
        rig_covariance=np.zeros((n_draws, 2, 2)),
        nu=np.full(n_draws, nu),
        log_likelihood=np.zeros((n_draws, 2)),
    )


@pytest.mark.parametrize("nu", [4.0, 200.0])
def test_next_runs_of_a_known_population_have_its_t_distribution(nu: float) -> None:
    draws = known_population(nu)
    rng = np.random.default_rng(3)
    following = outcomes.next_runs(draws, draws.mean, np.zeros((2, 0)), rng)
    assert following.shape == (len(draws.nu) * outcomes.FOLLOWERS, 2)
    for k, sd in enumerate(np.sqrt(np.diag(COVARIANCE))):
        t = (following[:, k] - MEAN[k]) / sd
        for p in (0.05, 0.25, 0.75, 0.95):
            assert (t < stats.t(nu).ppf(p)).mean() == pytest.approx(p, abs=0.01)
    standard = np.linalg.solve(ROOT, (following - MEAN).T)
    assert stats.spearmanr(*standard)[0] == pytest.approx(0.0, abs=0.02)


def test_a_table_is_compared_with_the_runs_and_not_with_their_mean() -> None:
    rng, sds = np.random.default_rng(4), np.sqrt(np.diag(COVARIANCE))
    values = MEAN[0] + 1.5 * sds[0], MEAN[1] - 2.5 * sds[1]
    nominal = {
        name: NominalRange(value=x, low=x, high=x) for name, x in zip(PRODUCTS, values, strict=True)
    }
    first, second = outcomes.product_populations(
        known_population(200.0), PRODUCTS, nominal, np.zeros((2, 0)), rng
    )
    assert first.table.probability == pytest.approx(2 * stats.norm.sf(1.5), abs=0.01)
    assert second.table.probability == pytest.approx(2 * stats.norm.sf(2.5), abs=0.005)
    assert (first.table.agrees, second.table.agrees) == (True, False)
    assert first.table.offset.mean == pytest.approx(-1.5 * sds[0])
    assert first.spread.mean == pytest.approx(sds[0], rel=0.01)
    assert first.rig_spread is None


def test_a_nominal_value_is_off_by_its_distance_beyond_the_tolerance() -> None:
    sd, x = float(np.sqrt(COVARIANCE[0, 0])), MEAN[0]
    nominal = NominalRange(value=x + 2.5 * sd, low=x + 1.5 * sd, high=x + 3.5 * sd)
    table = outcomes.product_populations(
        known_population(200.0),
        PRODUCTS,
        {PRODUCTS[0]: nominal},
        np.zeros((2, 0)),
        np.random.default_rng(4),
    )[0].table
    assert table.agrees
    assert table.probability == pytest.approx(2 * stats.norm.sf(1.5), abs=0.01)
    assert table.offset.mean == pytest.approx(-2.5 * sd)


def test_a_run_is_an_outlier_by_the_chi_square_of_its_distance() -> None:
    total = COVARIANCE + 1e-4 * np.eye(2)
    away = (
        5.0 * np.linalg.cholesky(total)[:, 1]
    )  # five standard deviations, given the first product
    data = arrays(np.array([MEAN, MEAN + away]))
    draws, labels = known_population(200.0), (("near", "rig"), ("far", "rig"))
    near, far = outcomes.run_outcomes(data, draws, labels, PRODUCTS, np.zeros((2, 2)), (0.0, 0.02))
    assert np.log(far.core_tail) == pytest.approx(np.log(stats.chi2(2).sf(25.0)), abs=1.0)
    assert (near.outlier, far.outlier) == (False, True)
    assert far.worst == PRODUCTS[1]
    assert far.sds == pytest.approx(away[1] / np.sqrt(total[1, 1]), rel=0.05)
    assert np.allclose(near.ranks, 0.5, atol=0.03)
    assert far.ranks[1] == pytest.approx(stats.t(200).cdf(far.sds), abs=0.001)
    assert far.core_tail < far.tail
    assert far.description_error == 0.02


def test_the_population_without_a_run_weighs_draws_against_its_likelihood() -> None:
    """Half of the draws put the level 0.1 higher, and the run itself is all that speaks for them."""
    draws = known_population(200.0, 2000)
    shift = np.where(np.arange(2000) < 1000, 0.0, 0.1)[:, None, None]
    shifted = replace(
        draws,
        levels=draws.levels + shift,
        log_likelihood=np.where(shift[:, 0] > 0, np.log(9.0), 0.0) * np.ones((1, 2)),
    )
    data = arrays(np.array([MEAN, MEAN]), sd=0.002)
    labels = (("first", "rig"), ("second", "rig"))
    run = outcomes.run_outcomes(data, shifted, labels, PRODUCTS, np.zeros((2, 2)), (0.0, 0.02))[0]
    sd = float(np.hypot(np.sqrt(COVARIANCE[0, 0]), 0.002))
    expected = 0.9 * 0.5 + 0.1 * stats.norm.cdf(-0.1 / sd)
    assert run.ranks[0] == pytest.approx(expected, abs=0.02)


def test_a_noted_column_explains_its_share_of_the_variance() -> None:
    draws = known_population(200.0)
    slopes = np.tile(np.array([[[0.08, 0.0]]]), (len(draws.nu), 1, 1))
    first, second = outcomes.noted_effects(replace(draws, slopes=slopes), ("oil",), PRODUCTS)
    variance = COVARIANCE[0, 0] * stats.t(200).ppf(stats.norm.cdf(1.0)) ** 2
    assert first.share.mean == pytest.approx(0.0064 / (0.0064 + variance))
    assert first.slope.mean == pytest.approx(0.08)
    assert second.share.mean == 0.0
