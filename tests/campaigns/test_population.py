"""The sampled population, against a grid, an ensemble that samples the integrals, and its prior."""

import emcee
import numpy as np
import pytest
from scipy import special, stats
from support.reporters import Stopping

from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.campaigns import gibbs
from bayesdrill.campaigns.gibbs import FREEDOMS
from bayesdrill.campaigns.mixture import describe, run_arrays
from bayesdrill.campaigns.population import PopulationDraws, PopulationSettings, sample_population
from bayesdrill.sampling.convergence import Targets

SCALE, WIDTH = 0.1, 0.2  # of half-t priors, and sd of the interim prior
ESTIMATES = np.array([[0.05, -0.02], [-0.03, 0.02], [0.02, 0.01], [-0.06, 0.06]])
KNOWN = np.array([[0.02, 0.01], [0.03, 0.02], [0.01, 0.015], [0.02, 0.03]])
# A t is a normal whose precision has a gamma distribution: here its quantiles.
QUANTILES = (np.arange(48) + 0.5) / 48
PRECISIONS = np.array([stats.gamma(nu / 2, scale=2 / nu).ppf(QUANTILES) for nu in FREEDOMS])
LOG_PRIOR_OF_FREEDOM = 2 * np.log(FREEDOMS) - FREEDOMS / 10


def sampled(n_products: int, ess: float, report: Reporter = SILENT) -> PopulationDraws:
    """Sample the population of four runs, whose draws under a normal interim prior spread evenly."""
    runs = []
    for r in range(4):
        estimate, sd = ESTIMATES[r, :n_products], KNOWN[r, :n_products]
        precision = sd**-2.0 + WIDTH**-2.0
        even = stats.qmc.Sobol(n_products, rng=r).random(1024)
        z = estimate * sd**-2.0 / precision + special.ndtri(even) / np.sqrt(precision)
        log_interim = -0.5 * (z**2).sum(axis=1) / WIDTH**2
        runs.append(describe(z, log_interim))
    nothing = np.zeros((4, 0))
    data = run_arrays(runs, np.zeros(4, int), np.zeros((4, n_products)), nothing, np.zeros(0))
    names, rng = tuple("pq")[:n_products], np.random.default_rng(1)
    targets = Targets(r_hat=1.01, n_tau=50, ess=ess)
    settings = PopulationSettings(
        spread_scale=SCALE, targets=targets, max_sweeps=30_000, draws=10**6
    )
    return sample_population(data, names, settings, rng, report)


def assert_same(draws: np.ndarray, mean: float, sd: float, ess: float) -> None:
    assert abs(draws.mean() - mean) < 3 * sd / np.sqrt(ess)
    assert draws.std() == pytest.approx(sd, rel=0.05)


def log_half_t(sd: np.ndarray) -> np.ndarray:
    return -1.5 * np.log1p(sd**2 / (2 * SCALE**2))


@pytest.mark.slow
def test_population_of_four_runs_equals_the_joint_posterior_on_a_grid() -> None:
    """The grid has the integral over each run's true product in closed form, by precisions of the t."""
    fractions: list[float] = []
    draws = sampled(1, 1500.0, Stopping(when=lambda fraction, _: fractions.append(fraction)))
    assert fractions == sorted(fractions)  # the progress that is shown begins once, and never falls
    assert 0.0 == fractions[0] < fractions[1] < 0.5 < fractions[-2] < fractions[-1] == 1.0
    mu, log_sd = np.linspace(-0.4, 0.4, 161), np.linspace(np.log(1e-6), np.log(1.5), 160)
    sd = np.exp(log_sd)
    log_p = np.zeros((len(mu), len(sd), len(FREEDOMS)))
    for k, precisions in enumerate(PRECISIONS):
        for estimate, known in zip(ESTIMATES[:, 0], KNOWN[:, 0], strict=True):
            total = sd[:, None] ** 2 / precisions + known**2
            normal = np.exp(-0.5 * (estimate - mu[:, None, None]) ** 2 / total) / np.sqrt(total)
            log_p[..., k] += np.log(normal.mean(axis=-1) + 1e-300)
    log_p += log_half_t(sd)[:, None] + log_sd[:, None] + LOG_PRIOR_OF_FREEDOM
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    grids = np.meshgrid(mu, log_sd, np.log(FREEDOMS), indexing="ij")
    sample = (draws.mean, 0.5 * np.log(draws.covariance), np.log(draws.nu))
    for grid, values in zip(grids, sample, strict=True):
        mean = (p * grid).sum()
        assert_same(values, mean, np.sqrt((p * (grid - mean) ** 2).sum()), 800)
    assert draws.convergence.converged


@pytest.mark.slow
def test_two_products_of_four_runs_equal_an_ensemble_over_population_and_integrated_runs() -> None:
    draws = sampled(2, 2000.0)

    def log_p(theta: np.ndarray) -> np.ndarray:
        mu, sd, rho = theta[:, :2], np.exp(theta[:, 2:4]), np.tanh(theta[:, 4])
        index = np.clip(theta[:, 5], -0.49, len(FREEDOMS) - 0.51).round().astype(int)
        # Huang and Wand's prior of the covariance, with the Jacobian of sds and correlation
        det = (sd[:, 0] * sd[:, 1]) ** 2 * (1 - rho**2)
        inverse = np.stack([sd[:, 1] ** 2, sd[:, 0] ** 2], axis=1) / det[:, None]
        total = -3 * np.log(det) - 2 * np.log(2 * inverse + SCALE**-2).sum(axis=1)
        total += 3 * np.log(sd).sum(axis=1) + np.log1p(-(rho**2)) + LOG_PRIOR_OF_FREEDOM[index]
        for estimate, known in zip(ESTIMATES, KNOWN, strict=True):
            x, spread = (estimate - mu)[..., None], PRECISIONS[index] ** -0.5
            first, second = ((sd[:, k, None] * spread) ** 2 + known[k] ** 2 for k in (0, 1))
            both = (rho * sd[:, 0] * sd[:, 1])[:, None] * spread**2
            area = first * second - both**2
            squares = second * x[:, 0] ** 2 + first * x[:, 1] ** 2 - 2 * both * x[:, 0] * x[:, 1]
            total += special.logsumexp(-0.5 * squares / area - 0.5 * np.log(area), axis=1)
        outside = np.abs(theta[:, 5] - 0.5 * (len(FREEDOMS) - 1)) > 0.5 * len(FREEDOMS)
        return np.where(outside | (theta[:, 2:4] < -9).any(axis=1), -np.inf, total)

    rng = np.random.default_rng(2)
    start = np.array([0, 0, -3, -3, 0, 7]) + rng.normal(0, [0.03, 0.03, 0.4, 0.4, 0.4, 2], (60, 6))
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)]
    ensemble = emcee.EnsembleSampler(60, 6, log_p, vectorize=True, moves=moves)
    ensemble._random.seed(3)
    ensemble.run_mcmc(start, 5000)
    joint = ensemble.get_chain(discard=500, flat=True)
    sds = np.sqrt(np.diagonal(draws.covariance, axis1=1, axis2=2))
    rho = draws.covariance[..., 0, 1] / sds.prod(axis=-1)
    sample = [*draws.mean.T, *np.log(sds).T, np.arctanh(rho)]
    for k, values in enumerate(sample):
        assert_same(values, joint[:, k].mean(), joint[:, k].std(), 1500)  # both have errors


def test_covariances_without_runs_have_half_t_sds_and_uniform_correlations() -> None:
    rng, scales = np.random.default_rng(4), np.full(3, SCALE**-2.0)
    covariances = []
    for _ in range(8000):
        root, scales = gibbs._update_covariance(np.zeros((3, 3)), 0, scales, SCALE, rng)
        covariances.append(np.linalg.inv(root @ root.T))
    kept = np.array(covariances)[::4]
    sds = np.sqrt(np.diagonal(kept, axis1=1, axis2=2))
    rho = kept[:, 0, 1] / (sds[:, 0] * sds[:, 1])
    assert stats.kstest(rho, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert stats.kstest(sds[:, 2] / SCALE, lambda x: x / np.sqrt(2 + x**2)).pvalue > 1e-3
