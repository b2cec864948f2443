"""Noises against dense covariances, quadrature and the densities of SciPy, with samples missing."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray
from scipy.integrate import quad
from support.case_tables import run_cases
from support.residual_sums import moved, residuals

from bayesdrill.inference.noise.ar1 import AR1
from bayesdrill.inference.noise.contract import Noise, NoisyChannel
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed, noise_for_record
from bayesdrill.inference.noise.quantised import Quantised
from bayesdrill.inference.noise.student_t import StudentT
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import Uniform
from bayesdrill.record.experiment import Channel

Array = NDArray[np.float64]
SIGMAS = {"w_1": 0.3, "w_2": 0.02}
EVEN = 0.01 * np.arange(10)
UNEVEN = np.cumsum([0.0, 0.01, 0.01, 0.025, 0.01, 0.0173, 0.01, 0.01, 0.04, 0.01])


def noisy(name: str, sigma: float, **entries: float) -> NoisyChannel:
    channel = Channel(name=name, weights={name: 1.0}, unit="rad/s", latex=name, latex_unit="")
    prior = Uniform(0.1 * sigma, 10 * sigma)
    return NoisyChannel(channel=channel, sigma=prior, start=sigma, entries=entries)


def two_channels(**entries: float) -> list[NoisyChannel]:
    return [noisy(name, sigma, **entries) for name, sigma in SIGMAS.items()]


def measured(**missing: list[int]) -> NDArray[np.bool_]:
    """Return which of ten samples of two channels are measured `(10, 2)`."""
    seen = np.ones((10, 2), dtype=bool)
    for k, name in enumerate(SIGMAS):
        seen[missing.get(name, []), k] = False
    return seen


# --- AR(1) -------------------------------------------------------------------------------------------

RECORDS = {
    "even": (EVEN, measured(), 0.01),
    "missing": (EVEN, measured(w_1=[2, 3, 7], w_2=[0]), 0.01),
    "uneven": (UNEVEN, measured(), 0.01),
    "every other one": (EVEN, measured(w_1=[0, 2, 4, 6, 8]), 0.02),
}


@run_cases("rho, record", [(rho, name) for rho in (0.02, 0.5, 0.95, 0.9999) for name in RECORDS])
def test_an_ar1_noise_has_a_covariance_that_falls_off_with_time(rho: float, record: str) -> None:
    """By `rho` over the usual step of the channel."""
    t, seen, step = RECORDS[record]
    noise = noise_for_record(AR1.from_channels(two_channels(), 10), t, seen)
    rng = np.random.default_rng(2)
    sigmas = rng.uniform(0.5, 2, (3, 2)) * [*SIGMAS.values()]
    own = np.column_stack([sigmas, np.full(3, rho), np.full(3, 0.4)])
    samples = noise.draw(np.zeros((3, 10, 2)), own, rng)
    samples[:, ~seen] = np.nan
    log_p = noise.log_likelihood(residuals(samples), own)
    for w, k in np.ndindex(3, 2):
        here = seen[:, k]
        lags = np.abs(t[here][:, None] - t[here]) / (step if k == 0 else 0.01)
        covariance = own[w, k] ** 2 * own[w, 2 + k] ** lags
        x = samples[w, here, k]
        true = scipy.stats.multivariate_normal(cov=covariance, allow_singular=False)
        assert log_p[w, k] == pytest.approx(true.logpdf(x), rel=1e-8, abs=1e-8)
        white = np.linalg.solve(np.linalg.cholesky(covariance), x)
        assert noise.whiten(samples, own)[w, here, k] == pytest.approx(white, rel=1e-6, abs=1e-8)
        score = np.linalg.solve(covariance, x)
        rounding = 1e-7 * np.abs(score).max()
        assert noise.score(samples, own)[w, here, k] == pytest.approx(score, abs=rounding)
    terms = noise.pointwise(samples, own)
    assert np.isnan(terms[:, ~seen]).all()
    assert np.nansum(terms, axis=1) == pytest.approx(log_p, rel=1e-9)
    jacobian = noise.whitened_jacobian(np.where(seen, 1.0, 0.0)[None], own[:1])
    assert (jacobian[:, ~seen] == 0.0).all()


def differences(noise: Noise, samples: Array, own: Array, column: int) -> Array:
    """Return central differences of the log likelihood, by the log of an unknown that has one."""
    up, down = (
        noise.log_likelihood(residuals(samples), moved(noise, own, column, step)).sum(axis=1)
        for step in (1e-5, -1e-5)
    )
    return np.asarray((up - down) / 2e-5)


def test_slopes_of_an_ar1_noise_with_gaps_scatter_by_its_information() -> None:
    seen = measured(w_2=[1, 5, 6])
    noise = noise_for_record(AR1.from_channels(two_channels(), 10), UNEVEN, seen)
    own = np.tile([0.3, 0.02, 0.6, 0.8], (40_000, 1))
    samples = noise.draw(np.zeros((len(own), 10, 2)), own, np.random.default_rng(3))
    samples[:, ~seen] = np.nan
    slope, curvature = noise.noise_score(residuals(samples), own)
    for column in range(4):
        numeric = differences(noise, samples[:50], own[:50], column)
        assert slope[:50, column] == pytest.approx(numeric, rel=1e-5, abs=1e-5)
    expected = noise.expected(own[0])
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    scatter = np.cov(slope, rowvar=False)
    assert scatter / scale == pytest.approx(expected / scale, abs=0.04)
    assert (np.linalg.eigvalsh(curvature - expected) > -1e-9 * scale.max()).all()


# --- Student's t -------------------------------------------------------------------------------------


@run_cases("nu", [2.1, 5.0, 80.0])
def test_heavy_tails_are_those_of_student(nu: float) -> None:
    channels = [noisy("w_1", 0.3), noisy("w_2", 0.02, degrees=nu)]
    noise, own = StudentT.from_channels(channels, 40), np.array([[0.31, 0.017, nu]])
    samples = noise.draw(np.zeros((1, 40, 2)), own, np.random.default_rng(1))
    samples[0, 7] = 1e6
    samples[0, 9] = -1e3
    for k in range(2):
        true = scipy.stats.t(nu, scale=own[0, k])
        terms = noise.pointwise(samples, own)[0, :, k]
        assert terms == pytest.approx(true.logpdf(samples[0, :, k]), rel=1e-10)
        total = noise.log_likelihood(residuals(samples), own)[0, k]
        assert total == pytest.approx(terms.sum(), rel=1e-12)
        normal = scipy.stats.norm.isf(true.sf(samples[0, 7, k]))
        assert noise.whiten(samples, own)[0, 7, k] == pytest.approx(normal, rel=1e-9)
        assert noise.scales(own)[0, k] == pytest.approx(true.std(), rel=1e-12)


# --- rounded records ---------------------------------------------------------------------------------

STEP = 0.1


def rounded(sigma: float, n: int) -> Quantised:
    return Quantised.from_channels([noisy("w_1", sigma, step=STEP)], n)


@run_cases("ratio", [0.01, 0.1, 0.5, 3.0, 100.0])
def test_a_rounded_sample_has_the_probability_of_its_interval(ratio: float) -> None:
    """By quadrature, for a sigma of `ratio` steps; the density over all residuals is one."""
    sigma = ratio * STEP
    noise, own = rounded(sigma, 6), np.array([[sigma]])
    samples = np.array([0.0, 0.3, 0.5 - 1e-3, 0.8, -0.52, 1.1]) * STEP
    terms = noise.pointwise(samples[None, :, None], own)[0, :, 0]
    for term, x in zip(terms, samples, strict=True):
        if ratio >= 0.1:
            density = scipy.stats.norm(0.0, sigma).pdf
            mass, _ = quad(density, x - STEP / 2, x + STEP / 2, epsabs=0.0)
            assert term == pytest.approx(math.log(mass / STEP), rel=1e-8, abs=1e-9)
    x = np.linspace(-1, 1, 200_001) * (0.5 * STEP + 9 * sigma)
    every = np.exp(noise.pointwise(x[None, :, None], own)[0, :, 0])
    assert np.trapezoid(every, x) == pytest.approx(1.0, rel=1e-7)


def test_a_sample_far_off_its_interval_overflows_nothing() -> None:
    """It is as far as the nearer end, by the asymptotic tail of a normal."""
    noise, own, off = rounded(0.001, 4), np.array([[1e-4]]), np.array([0.2, -0.2, 5.0, -5.0])
    samples, nearest = off[None, :, None], (np.abs(off) - 0.05) / 1e-4
    tail = -0.5 * nearest**2 - np.log(nearest * math.sqrt(2 * math.pi)) - math.log(STEP)
    assert noise.pointwise(samples, own)[0, :, 0] == pytest.approx(tail, rel=1e-5)
    score = np.sign(off) * nearest / 1e-4
    assert noise.score(samples, own)[0, :, 0] == pytest.approx(score, rel=1e-4)
    assert np.abs(noise.whiten(samples, own)[0, :, 0]) == pytest.approx(nearest, rel=1e-3)


def test_a_step_is_in_the_unit_of_the_column_and_must_be_known() -> None:
    channel = replace(noisy("w_1", 0.3, step=2.0), factor=0.25)
    assert Quantised.from_channels([channel], 3).steps == (0.5,)
    with pytest.raises(ValueError, match="needs a known step \\(w_1\\)"):
        Quantised.from_channels([noisy("w_1", 0.3)], 3)


def test_samples_are_asked_for_only_where_a_step_is_small_beside_sigma() -> None:
    """Each walker by itself: the others take the sums of kernels."""
    noise, own = rounded(0.3, 8), np.array([[1.0], [0.02], [0.26], [0.24]])
    samples = np.random.default_rng(0).normal(0, 0.05, (4, 8, 1))
    seen = residuals(samples)
    exact = noise.pointwise(samples, own).sum(axis=1)[:, 0]
    assert noise.log_likelihood(seen, own)[:, 0] == pytest.approx(exact)
    seen.intervals = lambda over, half: np.full(over.shape, 7.0)
    of_kernel = 7.0 - 8 * math.log(STEP)
    expected = [exact[0], of_kernel, exact[2], of_kernel]
    assert noise.log_likelihood(seen, own)[:, 0] == pytest.approx(expected)


# --- mixtures ----------------------------------------------------------------------------------------


@run_cases("missing", [False, True])
def test_each_channel_of_a_mixture_has_the_likelihood_of_its_own_noise(missing: bool) -> None:
    parts = (
        ChannelNoise(StudentT.from_channels([noisy("w_2", 0.02)], 10), (2,)),
        ChannelNoise(AR1.from_channels([noisy("w_1", 0.3)], 10), (0,)),
        ChannelNoise(White.from_channels([noisy("i", 0.1)], 10), (1,)),
    )
    own = np.array([[0.02, 4.0, 0.3, 0.7, 0.1]])
    samples = np.random.default_rng(0).standard_normal((1, 10, 3)) * [0.3, 0.1, 0.02]
    seen = np.ones((10, 3), dtype=bool)
    seen[4] = not missing
    samples[:, ~seen] = np.nan
    mixture = noise_for_record(Mixed(parts), UNEVEN, seen)
    log_p = mixture.log_likelihood(residuals(samples), own)
    for part, unknowns in zip(parts, (own[:, :2], own[:, 2:4], own[:, 4:]), strict=True):
        columns = list(part.columns)
        alone = noise_for_record(part.noise, UNEVEN, seen[:, columns])
        true = alone.log_likelihood(residuals(samples[..., columns]), unknowns)
        assert log_p[:, columns] == pytest.approx(true)
