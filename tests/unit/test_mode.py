"""The Gaussian approximation and the search for the MAP, on a problem with a known answer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.optimize
from oracles import NOMINAL
from rigs import measured, posterior, vector

from bayesdrill import laplace, mode
from bayesdrill.optimisers import OPTIMISERS

SIGMA = np.array([0.02, 0.03, 0.05, 0.04])
RECORD = measured(SIGMA, n=200)
TWO = ("k_e", "k_s")


@pytest.mark.parametrize("coordinates", ["physical", "log"])
def test_covariance_is_the_inverse_hessian(coordinates: str) -> None:
    """Of a well determined pair, against a numerical Hessian over the sampler's coordinates."""
    target = posterior(RECORD, SIGMA, coordinates, free=TWO)
    found = scipy.optimize.minimize(
        lambda s: -target.density(target.space.vector(NOMINAL)[None] * (1 + 1e-3 * s))[0],
        np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10},
    )  # fmt: skip
    theta = target.space.vector(NOMINAL) * (1 + 1e-3 * found.x)
    z = target.coordinates.from_physical(theta[None])[0]
    step = 0.3 * np.sqrt(np.diag(laplace.covariance(target, theta)))
    shifts = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)])
    values = target.density(target.coordinates.to_physical(z + shifts * step)).reshape(3, 3)
    hessian = np.empty((2, 2))
    hessian[0, 0] = values[2, 1] - 2 * values[1, 1] + values[0, 1]
    hessian[1, 1] = values[1, 2] - 2 * values[1, 1] + values[1, 0]
    mixed = 0.25 * (values[2, 2] - values[2, 0] - values[0, 2] + values[0, 0])
    hessian[0, 1] = hessian[1, 0] = mixed
    numeric = np.linalg.inv(-hessian / np.outer(step, step))
    assert np.allclose(laplace.covariance(target, theta), numeric, rtol=0.05)


def test_undetermined_directions_have_the_width_of_the_prior() -> None:
    target = posterior(RECORD, 10 * SIGMA, "log")
    cov = laplace.covariance(target, vector(NOMINAL))
    assert np.sqrt(cov[1, 1]) == pytest.approx(0.31, abs=0.02)  # log of uniform 0.5 to 1.5
    assert np.linalg.eigvalsh(cov).min() > 0


@pytest.mark.parametrize("coordinates", ["log", "modal"])
def test_draws_are_finite_spread_and_reproducible(coordinates: str) -> None:
    target = posterior(RECORD, SIGMA, coordinates)
    z = laplace.draws(target, vector(NOMINAL), 64, np.random.default_rng(3))
    assert z.shape == (64, 9)
    assert np.isfinite(target(z)).all()
    assert np.linalg.matrix_rank(z - z.mean(axis=0)) == 9
    again = laplace.draws(target, vector(NOMINAL), 64, np.random.default_rng(3))
    assert np.array_equal(z, again)


def test_draws_near_an_edge_of_the_prior() -> None:
    target = posterior(RECORD, SIGMA, "log")
    edge = vector({**NOMINAL, "t_f": 0.05 * (1 + 1e-9), "c_m": 28.4999e-5})
    assert np.isfinite(target(laplace.draws(target, edge, 40, np.random.default_rng(1)))).all()


@pytest.mark.parametrize("method", OPTIMISERS)
def test_every_optimiser_finds_a_curved_skewed_maximum(method: str) -> None:
    """Rosenbrock's valley with unequal scales, maximum off the origin."""

    def target(x: np.ndarray) -> np.ndarray:
        a, b = x[:, 0] / 3 - 1, x[:, 1] * 50
        return -100 * (b - a**2) ** 2 - (1 - a) ** 2

    found = OPTIMISERS[method](
        target, np.array([-3.0, 0.05]), lambda z: np.diag([0.3, 0.002]) ** 2, 8000
    )
    assert found.settled
    assert found.z == pytest.approx([6.0, 0.02], rel=0.02)
    assert found.evaluations <= 8000


def test_searches_agree_where_the_record_determines_everything() -> None:
    target = posterior(RECORD, SIGMA, "log", free=TWO)
    points = mode.starts(target, 4, np.random.default_rng(9))
    found = mode.summarise(
        target, tuple(mode.search(target, "nelder_mead", 4000, point) for point in points)
    )
    assert found.same_height >= 2
    assert found.wandering == ()
    assert found.gain < 1e-2
    assert found.at_bound == ()
    assert found.values["k_e"] == pytest.approx(NOMINAL["k_e"], rel=2e-3)
    assert max(abs(s) for s in found.slope.values()) < 0.1


def test_nine_parameters_wander_along_the_symmetries_and_that_is_said() -> None:
    target = posterior(RECORD, SIGMA, "modal")
    points = mode.starts(target, 4, np.random.default_rng(2))
    found = mode.summarise(
        target, tuple(mode.search(target, "nelder_mead", 8000, point) for point in points)
    )
    assert found.log_posterior >= target.density(vector(NOMINAL)[None])[0]
    assert found.gain < 0.05
    assert found.same_height >= 2
    assert len(found.wandering) >= 3


def test_starts_begin_with_the_configured_one() -> None:
    target = posterior(RECORD, SIGMA, free=TWO)
    space = dataclasses.replace(target.space, start={"k_e": 0.05, "k_s": 0.3})
    points = mode.starts(dataclasses.replace(target, space=space), 3, np.random.default_rng(1))
    assert points[0] == pytest.approx([0.05, 0.3])
    assert np.isfinite(target.density(points)).all()


def test_gradient_at_a_slope_is_seen() -> None:
    """Away from the maximum the report says so."""
    target = posterior(RECORD, SIGMA, "log", free=TWO)
    off = target.space.vector({**NOMINAL, "k_e": NOMINAL["k_e"] * 1.01})
    search = mode.search(target, "nelder_mead", 1, off)
    start = dict(zip(target.space.free, off, strict=True))
    stuck = dataclasses.replace(search, end=start, log_posterior=-1e9)
    assert mode.summarise(target, (stuck,)).gain > 1.0


def test_a_maximum_on_the_bound_is_named() -> None:
    target = posterior(RECORD, SIGMA, "log", free=TWO)
    low = {**NOMINAL, "k_s": 1.5 * NOMINAL["k_s"] * (1 - 1e-5)}
    search = mode.search(target, "nelder_mead", 1, target.space.vector(low))
    stuck = dataclasses.replace(search, end={name: low[name] for name in TWO}, log_posterior=0.0)
    assert mode.summarise(target, (stuck,)).at_bound == ("k_s",)
