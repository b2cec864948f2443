"""Likelihood and posterior against SciPy, term by term."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, ORDER
from support.small_problems import noisy_step, posterior, vector

from bayesdrill.inference.noise.white import White
from bayesdrill.inference.priors import Uniform

SIGMA = np.array([0.1, 0.07, 0.2, 0.15])
RECORD = noisy_step(SIGMA, n=150)


def points(n: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return vector(NOMINAL) * rng.uniform(0.8, 1.2, (n, 9))


def test_known_sigma_is_a_sum_of_normal_densities() -> None:
    target = posterior(RECORD, SIGMA)
    theta = points(5)
    signals = target.likelihood.signals(theta)
    true = scipy.stats.norm(signals, SIGMA).logpdf(RECORD.y).sum(axis=(1, 2))
    box = np.log(vector(NOMINAL)).sum()  # each width is one nominal value
    assert np.allclose(target.density(theta), true - box, rtol=1e-10)


def test_unknown_sigma_per_channel() -> None:
    """Mutants killed: -log sigma dropped, sigmas of two channels exchanged."""
    target = posterior(RECORD, None)
    sigmas = np.array([[0.3, 0.05, 0.11, 0.7], [0.02, 0.6, 0.4, 0.09]])
    theta = np.hstack([points(2), sigmas])
    signals = target.likelihood.signals(theta)
    true = scipy.stats.norm(signals, sigmas[:, None]).logpdf(RECORD.y).sum(axis=(1, 2))
    constant = np.log(vector(NOMINAL)).sum() + 4 * np.log(0.99)
    assert np.allclose(target.density(theta), true - constant, rtol=1e-10)


def test_noise_density_integrates_to_one() -> None:
    noise = White(n_samples=1, known={0: 0.3}, n_channels=1)
    x = np.linspace(-4, 4, 4001)
    left = SimpleNamespace(squares=x[:, None] ** 2)
    density = np.exp(noise.log_likelihood(left, np.empty((len(x), 0))))[:, 0]
    assert np.trapezoid(density, x) == pytest.approx(1.0, abs=1e-9)


def test_pointwise_terms_sum_to_the_likelihood() -> None:
    target = posterior(RECORD, None)
    theta = np.hstack([points(3), np.full((3, 4), 0.2)])
    sigma = theta[:, target.likelihood.only_observation.noise_columns]
    residuals = RECORD.y - target.likelihood.signals(theta)
    pointwise = target.likelihood.only_observation.noise.pointwise(residuals, sigma)
    by_channel = target.likelihood.only_observation.by_channel(target.space.full(theta), theta)
    assert np.allclose(pointwise.sum(axis=1), by_channel, rtol=1e-10)


def test_predictive_noise_has_the_sigma_of_its_channel() -> None:
    noise = White(n_samples=1, known={0: 0.5, 2: 2.0}, n_channels=3)
    drawn = noise.draw(np.zeros((4000, 10, 3)), np.full((4000, 1), 0.1), np.random.default_rng(2))
    assert drawn.std(axis=(0, 1)) == pytest.approx([0.5, 0.1, 2.0], rel=0.02)


@run_cases("coordinates", ["linear", "log", "mixed"])
def test_density_over_coordinates_carries_the_jacobian(coordinates: str) -> None:
    zero = {name: Uniform(0.0, 2 * NOMINAL[name]) for name in ("c_m", "k_T")}
    target = {
        "linear": posterior(RECORD, SIGMA, logs=False),
        "log": posterior(RECORD, SIGMA),
        "mixed": posterior(RECORD, SIGMA, priors=zero),
    }[coordinates]
    assert sum(target.coordinates.logs) == {"linear": 0, "log": 9, "mixed": 7}[coordinates]
    theta = points(4)
    z = target.coordinates.from_physical(theta)
    step = 1e-6
    extra = [
        np.linalg.slogdet(
            (
                target.coordinates.to_physical(row + np.diag(step * np.abs(row)))
                - target.coordinates.to_physical(row - np.diag(step * np.abs(row)))
            )
            / (2 * step * np.abs(row)[:, None])
        )[1]
        for row in z
    ]
    assert np.allclose(target(z), target.density(theta) + extra, rtol=0, atol=1e-4)


def test_outside_the_prior_is_minus_infinity_and_costs_nothing() -> None:
    target = posterior(RECORD, SIGMA)
    theta = points(6)
    theta[1, 3] *= 5
    theta[4, 0] = np.nan
    theta[5, 2] = -1.0
    with np.errstate(invalid="ignore"):
        density = target.density(theta)
    assert list(np.isfinite(density)) == [True, False, True, True, False, False]
    assert np.all(density[[1, 4, 5]] == -np.inf)


def test_failures_are_counted_never_nan() -> None:
    target = posterior(RECORD, SIGMA, priors={"l_m": Uniform(0.0, 1.0)}, logs=False)
    theta = points(5)
    theta[2, ORDER.index("l_m")] = 1e-320
    density, failures = target.evaluate(theta)
    assert failures == 1
    assert density[2] == -np.inf
    assert np.isfinite(np.delete(density, 2)).all()


def test_fixed_parameters_are_held_and_named() -> None:
    """Mutant killed: two parameters exchanged."""
    target = posterior(RECORD, SIGMA, free=("k_T", "c_m"))
    full = target.space.full(np.array([[0.1, 3e-4]]))[0]
    named = dict(zip(ORDER, full, strict=True))
    assert named == {**NOMINAL, "k_T": 0.1, "c_m": 3e-4}
    nine = posterior(RECORD, SIGMA)
    theta = vector({**NOMINAL, "k_T": 0.1, "c_m": 3e-4})[None]
    assert target.likelihood(np.array([[0.1, 3e-4]]))[0] == nine.likelihood(theta)[0]


def test_pickled_posterior_answers_alike() -> None:
    target = posterior(RECORD, SIGMA)
    z = target.coordinates.from_physical(points(3))
    assert np.array_equal(pickle.loads(pickle.dumps(target))(z), target(z))
