"""Noises against what they are said to be: dense covariances, quadrature, other people's densities.

Mutants killed: a correlation that forgets gaps, a first sample as the others, ends left out of the
fused sums, a mass without its step, tails that lose their digits, a scale taken for a variance.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray
from scipy.integrate import quad
from support.case_tables import run_cases

from bayesdrill.inference.noise.ar1 import AR1
from bayesdrill.inference.noise.contract import Noise, NoisyChannel
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed, noise_for_record
from bayesdrill.inference.noise.quantised import Quantised, _information
from bayesdrill.inference.noise.student_t import StudentT
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import Uniform
from bayesdrill.record.experiment import Channel

Array = NDArray[np.float64]
SIGMA = (0.3, 0.02)
UNEVEN = np.cumsum([0.0, 0.01, 0.01, 0.025, 0.01, 0.0173, 0.01, 0.01, 0.04, 0.01])


def noisy(name: str, sigma: float, **entries: float) -> NoisyChannel:
    channel = Channel(name=name, weights={name: 1.0}, unit="rad/s", latex=name, latex_unit="")
    prior = Uniform(0.1 * sigma, 10 * sigma)
    return NoisyChannel(channel=channel, sigma=prior, start=sigma, entries=entries)


def remembering(n: int) -> AR1:
    return AR1.from_channels(
        [noisy(name, s) for name, s in zip(("w_1", "w_2"), SIGMA, strict=True)], n
    )


def left_of(samples: Array) -> SimpleNamespace:
    """What a noise asks for, NaN where nothing was seen; sums of what is seen."""
    kept = np.nan_to_num(samples)
    found = np.empty((len(samples), samples.shape[2], 3))
    for w, k in np.ndindex(found.shape[:2]):
        own = samples[w, ~np.isnan(samples[w, :, k]), k]
        found[w, k] = own @ own, np.diff(own) @ np.diff(own), own[0] ** 2 + own[-1] ** 2
    return SimpleNamespace(
        samples=samples,
        squares=(kept**2).sum(axis=1),
        neighbours=found,
        logs=lambda w: np.log1p(w[:, None] * kept**2).sum(axis=1),
        intervals=lambda over, half: within(samples * over[:, None], half[:, None]),
    )


def within(middle: Array, half: Array) -> Array:
    """As kernels have it: a walker that overflows is lost, what is not seen has none."""
    mass = scipy.stats.norm.cdf(np.abs(middle) + half) - scipy.stats.norm.cdf(np.abs(middle) - half)
    seen = ~np.isnan(middle).all(axis=0)
    return np.asarray(np.where(seen, np.log(mass), 0.0).sum(axis=1))


def dense(t: Array, sigma: float, rho: float, usual: float) -> Array:
    return sigma**2 * rho ** (np.abs(t[:, None] - t) / usual)


@run_cases(
    "rho, times",
    [
        (rho, times)
        for rho in [0.02, 0.5, 0.95, 0.9999]
        for times in ["even", "missing", "uneven", "every other one"]
    ],
)
def test_a_memory_is_a_covariance_that_falls_off_with_time(rho: float, times: str) -> None:
    t = UNEVEN if times == "uneven" else 0.01 * np.arange(10)
    seen = np.ones((10, 2), dtype=bool)
    if times == "missing":
        seen[[2, 3, 7], 0] = False
        seen[0, 1] = False
    if times == "every other one":
        seen[::2, 0] = False
    of = noise_for_record(remembering(10), t, seen)
    rng = np.random.default_rng(2)
    own = np.column_stack([rng.uniform(0.5, 2, (3, 2)) * SIGMA, np.full(3, rho), np.full(3, 0.4)])
    samples = of.draw(np.zeros((3, 10, 2)), own, rng)
    samples[:, ~seen] = np.nan
    found = of.log_likelihood(left_of(samples), own)
    usual = 0.02 if times == "every other one" else 0.01
    for k, step in enumerate((usual, 0.01)):
        here = seen[:, k]
        for w in range(3):
            covariance = dense(t[here], own[w, k], own[w, 2 + k], step)
            true = scipy.stats.multivariate_normal(cov=covariance, allow_singular=False)
            assert found[w, k] == pytest.approx(
                true.logpdf(samples[w, here, k]), rel=1e-8, abs=1e-8
            )
            root = np.linalg.cholesky(covariance)
            white = np.linalg.solve(root, samples[w, here, k])
            assert of.whiten(samples, own)[w, here, k] == pytest.approx(white, rel=1e-6, abs=1e-8)
            pull = np.linalg.solve(covariance, samples[w, here, k])
            scale = np.abs(pull).max()
            assert of.score(samples, own)[w, here, k] == pytest.approx(pull, abs=1e-7 * scale)
    terms = of.pointwise(samples, own)
    assert np.isnan(terms[:, ~seen]).all()
    assert np.nansum(terms, axis=1) == pytest.approx(found, rel=1e-9)
    assert (of.whitened_jacobian(np.where(seen, 1.0, 0.0)[None], own[:1])[:, ~seen] == 0.0).all()


def slopes_of(of: Noise, samples: Array, own: Array, column: int) -> Array:
    """By central differences, of the log where there is one."""
    plain, ends = of.unknowns[column].between is not None, []
    for step in (1e-5, -1e-5):
        moved = own.copy()
        moved[:, column] = own[:, column] + step if plain else own[:, column] * math.exp(step)
        ends.append(of.log_likelihood(left_of(samples), moved).sum(axis=1))
    return np.asarray((ends[0] - ends[1]) / 2e-5)


def test_slopes_and_information_allow_for_gaps() -> None:
    """Information is how slopes scatter over draws."""
    seen = np.ones((10, 2), dtype=bool)
    seen[[1, 5, 6], 1] = False
    of = noise_for_record(remembering(10), UNEVEN, seen)
    own = np.tile([0.3, 0.02, 0.6, 0.8], (40_000, 1))
    samples = of.draw(np.zeros((len(own), 10, 2)), own, np.random.default_rng(3))
    samples[:, ~seen] = np.nan
    slope, curvature = of.noise_score(left_of(samples), own)
    for column in range(4):
        some = slopes_of(of, samples[:50], own[:50], column)
        assert slope[:50, column] == pytest.approx(some, rel=1e-5, abs=1e-5)
    expected = of.expected(own[0])
    size = np.sqrt(np.diag(expected))
    scatter = np.cov(slope, rowvar=False) / np.outer(size, size)
    assert scatter == pytest.approx(expected / np.outer(size, size), abs=0.04)
    assert (np.linalg.eigvalsh(curvature - expected) > -1e-9 * size.max() ** 2).all()


def test_a_walker_that_overflows_is_lost_whatever_is_missing() -> None:
    seen = np.ones((10, 2), dtype=bool)
    seen[3, 0] = False
    samples = np.full((1, 10, 2), 0.01)
    samples[:, 3, 0] = np.nan
    sick = samples.copy()
    sick[0, 5:, 0] = np.nan
    both = [noisy(name, s, step=0.1) for name, s in zip(("w_1", "w_2"), SIGMA, strict=True)]
    for kind in (remembering(10), Quantised.from_channels(both, 10)):
        of = noise_for_record(kind, UNEVEN, seen)
        own = np.array([[0.3, 0.02, 0.5, 0.5][: len(of.unknowns)]])
        assert np.isfinite(of.log_likelihood(left_of(samples), own)).all()
        assert np.isnan(of.log_likelihood(left_of(sick), own)[0, 0])


@run_cases("nu", [2.1, 5.0, 80.0])
def test_heavy_tails_are_students(nu: float) -> None:
    of = StudentT.from_channels([noisy("w_1", 0.3), noisy("w_2", 0.02, degrees=nu)], 40)
    own = np.array([[0.31, 0.017, nu]])
    samples = of.draw(np.zeros((1, 40, 2)), own, np.random.default_rng(1))
    samples[0, 7] = 1e6
    samples[0, 9] = -1e3
    for k in range(2):
        true = scipy.stats.t(nu, scale=own[0, k])
        terms = of.pointwise(samples, own)[0, :, k]
        assert terms == pytest.approx(true.logpdf(samples[0, :, k]), rel=1e-10)
        total = of.log_likelihood(left_of(samples), own)[0, k]
        assert total == pytest.approx(terms.sum(), rel=1e-12)
        upper = scipy.stats.norm.isf(true.sf(samples[0, 7, k]))
        assert of.whiten(samples, own)[0, 7, k] == pytest.approx(upper, rel=1e-9)
        assert of.scales(own)[0, k] == pytest.approx(true.std(), rel=1e-12)


RATIOS = [0.01, 0.1, 0.5, 3.0, 100.0]  # of sigma to a step


@run_cases("ratio", RATIOS)
def test_what_is_rounded_has_the_probability_of_its_interval(ratio: float) -> None:
    """By quadrature over where the number was before; and the density of all residuals is one."""
    step = 0.1
    sigma = ratio * step
    of = Quantised.from_channels([noisy("w_1", sigma, step=step)], 6)
    own = np.array([[sigma]])
    samples = np.array([0.0, 0.3, 0.5 - 1e-3, 0.8, -0.52, 1.1])[:, None] * step
    terms = of.pointwise(samples[None], own)[0, :, 0]
    for term, x in zip(terms, samples[:, 0], strict=True):
        if ratio >= 0.1:
            mass, _ = quad(scipy.stats.norm(0.0, sigma).pdf, x - step / 2, x + step / 2, epsabs=0.0)
            assert term == pytest.approx(math.log(mass / step), rel=1e-8, abs=1e-9)
    reach = 0.5 * step + 9 * sigma
    ends = np.linspace(-reach, reach, 200_001)
    every = np.exp(of.pointwise(ends[None, :, None], own)[0, :, 0])
    assert np.trapezoid(every, ends) == pytest.approx(1.0, rel=1e-7)


def test_far_off_an_interval_nothing_overflows() -> None:
    """As far as a Gaussian is: the nearer end decides."""
    of = Quantised.from_channels([noisy("w_1", 0.001, step=0.1)], 4)
    own, off = np.array([[1e-4]]), np.array([0.2, -0.2, 5.0, -5.0])
    samples = off[None, :, None]
    terms = of.pointwise(samples, own)[0, :, 0]
    nearest = (np.abs(off) - 0.05) / 1e-4
    asymptotic = -0.5 * nearest**2 - np.log(nearest * math.sqrt(2 * math.pi)) - math.log(0.1)
    assert terms == pytest.approx(asymptotic, rel=1e-5)
    pull = of.score(samples, own)[0, :, 0]
    assert pull == pytest.approx(np.sign(off) * nearest / 1e-4, rel=1e-4)
    assert np.abs(of.whiten(samples, own)[0, :, 0]) == pytest.approx(nearest, rel=1e-3)


@pytest.mark.parametrize(
    "ratio",
    [pytest.param(0.02, marks=pytest.mark.slow), 0.2, pytest.param(1.0, marks=pytest.mark.slow)],
)
def test_rounded_records_of_a_moving_signal_are_as_informed_as_is_said(ratio: float) -> None:
    step, n = 0.1, 400_000
    of = Quantised.from_channels([noisy("w_1", ratio * step, step=step)], n)
    own = np.array([[ratio * step]])
    signal = step * np.modf(np.arange(n) * 0.6180339887498949)[0][None, :, None]
    left = of.draw(signal, own, np.random.default_rng(8)) - signal
    rounded = (left + signal) / step
    assert rounded == pytest.approx(np.round(rounded), abs=1e-9)
    place, size = _information(np.array(1.0 / ratio))
    pull = of.score(left, own)[0, :, 0] * own[0, 0]
    assert abs(pull.mean()) < 5 * math.sqrt(place / n)
    assert pull.var() == pytest.approx(place, rel=0.05)
    single = replace(of, levels=White.from_channels([noisy("w_1", ratio * step)], 1))
    slope, _ = single.noise_score(
        SimpleNamespace(samples=left[0, :20_000, None, :]), np.repeat(own, 20_000, 0)
    )
    assert slope.var() == pytest.approx(size, rel=0.1)
    white = of.whiten(left, own)[0, :5000, 0]
    assert scipy.stats.kstest(white, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 5 / math.sqrt(5000)
    assert of.fitted(left[0, :20_000], own[0])[0] == pytest.approx(own[0, 0], rel=0.15)


def test_steps_are_in_the_unit_of_the_column_and_must_be_known() -> None:
    one = replace(noisy("w_1", 0.3, step=2.0), factor=0.25)
    assert Quantised.from_channels([one], 3).steps == (0.5,)
    with pytest.raises(ValueError, match="the step must be known \\(w_1\\)"):
        Quantised.from_channels([noisy("w_1", 0.3)], 3)


def test_channels_of_other_kinds_have_their_own_sums() -> None:
    """Of a mixture, each in its place, with and without gaps."""
    made = (
        ChannelNoise(StudentT.from_channels([noisy("w_2", 0.02)], 10), (2,)),
        ChannelNoise(AR1.from_channels([noisy("w_1", 0.3)], 10), (0,)),
        ChannelNoise(White.from_channels([noisy("i", 0.1)], 10), (1,)),
    )
    own = np.array([[0.02, 4.0, 0.3, 0.7, 0.1]])
    samples = np.random.default_rng(0).standard_normal((1, 10, 3)) * [0.3, 0.1, 0.02]
    seen = np.ones((10, 3), dtype=bool)
    seen[4] = False
    for here in (np.ones_like(seen), seen):
        shown = np.where(here, samples, np.nan)
        found = noise_for_record(Mixed(made), UNEVEN, here).log_likelihood(left_of(shown), own)
        for part, some in zip(made, (own[:, :2], own[:, 2:4], own[:, 4:]), strict=True):
            (k,) = part.columns
            alone = noise_for_record(part.noise, UNEVEN, here[:, [k]])
            true = alone.log_likelihood(left_of(shown[..., [k]]), some)
            assert found[:, [k]] == pytest.approx(true)


def test_where_a_step_is_small_beside_sigma_samples_are_asked() -> None:
    """And only there: each walker by itself."""
    of = Quantised.from_channels([noisy("w_1", 0.3, step=0.1)], 8)
    own = np.array([[1.0], [0.02], [0.26], [0.24]])  # of sigma: 10, 0.2, 2.6 and 2.4 steps
    samples = np.random.default_rng(0).normal(0, 0.05, (4, 8, 1))
    told = left_of(samples)
    told.intervals = lambda over, half: np.full(over.shape, 7.0)
    found = of.log_likelihood(told, own)[:, 0]
    exact = of.pointwise(samples, own).sum(axis=1)[:, 0]
    fused = 7.0 - 8 * math.log(0.1)
    assert found == pytest.approx([exact[0], fused, exact[2], fused])
    assert of.log_likelihood(left_of(samples), own)[:, 0] == pytest.approx(exact)
