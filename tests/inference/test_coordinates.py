"""Coordinates of the walkers, some of them logs: round trips and Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import noisy_step, posterior, vector

from bayesdrill.inference import laplace
from bayesdrill.inference.priors import (
    PRIORS,
    HalfNormal,
    Uniform,
)
from bayesdrill.inference.unknowns import Coordinates

NAMES = ("log", "linear", "mixed")
N = 11  # nine parameters and two noise levels


def make(name: str, n: int = N) -> Coordinates:
    return Coordinates(tuple(name == "log" or (name == "mixed" and d % 3 != 1) for d in range(n)))


def test_steps_stay_between_two_ends() -> None:
    """Of a correlation next to one: 1e-5 further there is no density.

    Mutant killed: steps that are the same however near an end is.
    """
    between = Coordinates((False,), between=((0, 0.0, 1.0),), signed=((0, 1.0),))
    for rho in (1.0 - 1e-8, 0.5, 1e-7):
        slope = laplace.slopes_by_logs(between, np.array([rho]))[0, 0]
        analytic = 1.0 / norm.pdf(norm.ppf(rho))
        # Half the way to an end is no small step: what matters is that it is there.
        assert slope == pytest.approx(analytic, rel=1e-3 if rho == 0.5 else 0.2)


def points(n: int = 40, width: float = 0.9) -> np.ndarray:
    """Far apart, and of very different sizes."""
    rng = np.random.default_rng(4)
    centre = np.append(vector(NOMINAL), [0.1, 0.3])
    factors = np.exp(rng.uniform(-width, width, (n, N)))
    factors[: n // 2, 8] *= 40.0
    return centre * factors


@run_cases("name", NAMES)
def test_there_and_back(name: str) -> None:
    """Mutant killed: logs of columns beside those that are meant."""
    coordinates, theta = make(name), points()
    z = coordinates.from_physical(theta)
    assert np.array_equal(z, np.where(coordinates.logs, np.log(theta), theta))
    assert np.allclose(coordinates.to_physical(z), theta, rtol=1e-14)


@run_cases("name", NAMES)
def test_nothing_that_goes_in_is_changed(name: str) -> None:
    """Mutant killed: logs taken in place, of the walkers themselves."""
    coordinates, theta = make(name), points(3)
    z = coordinates.from_physical(theta)
    before = theta.copy(), z.copy()
    coordinates.from_physical(theta)
    coordinates.to_physical(z)
    coordinates.with_jacobian(z)
    assert np.array_equal(theta, before[0])
    assert np.array_equal(z, before[1])


@run_cases("name", NAMES)
def test_jacobian_equals_a_numerical_determinant(name: str) -> None:
    """Mutants killed: the Jacobian dropped, or that of all unknowns where some have no logs."""
    coordinates = make(name)
    for row in points(12):
        z = coordinates.from_physical(row[None])[0]
        h = 1e-6 * np.maximum(np.abs(z), 1e-3)
        up = coordinates.to_physical(z + np.diag(h))
        down = coordinates.to_physical(z - np.diag(h))
        columns = (up - down) / (2 * h[:, None]) / row  # d log theta / dz: well scaled
        _, log_det = np.linalg.slogdet(columns)
        true = log_det + np.log(row).sum()
        theta, log_jacobian = coordinates.with_jacobian(z[None])
        assert log_jacobian[0] == pytest.approx(true, abs=1e-6)
        assert theta[0] == pytest.approx(row, rel=1e-12)


@run_cases("name", NAMES)
def test_slopes_are_those_of_differences(name: str) -> None:
    coordinates, theta = make(name), points(5)
    z = coordinates.from_physical(theta)
    h = 1e-6 * np.maximum(np.abs(z), 1e-3)
    numeric = (coordinates.to_physical(z + h) - coordinates.to_physical(z - h)) / (2 * h)
    assert coordinates.slopes(theta) == pytest.approx(numeric, rel=1e-7)


PARAMETERS: dict[str, dict[str, float]] = {
    "uniform": {"low": 0.1, "high": 2.0},
    "log_uniform": {"low": 0.1, "high": 2.0},
    "normal": {"mean": 1.0, "sd": 0.4},
    "truncated_normal": {"mean": 1.0, "sd": 0.4, "low": 0.1, "high": 2.0},
    "log_normal": {"median": 1.0, "sd_log": 0.4},
    "half_normal": {"scale": 1.0},
}


@run_cases("family", PRIORS)
def test_logs_are_the_scale_unless_zero_itself_has_a_density(family: str) -> None:
    """Mutant killed: logs of an unknown whose lower end is zero, an endless tail for the walkers."""
    prior = PRIORS[family](**PARAMETERS[family])
    at_zero = float(np.exp(prior.logpdf(np.array([1e-12]))[0]))
    assert prior.in_logs == (at_zero == 0.0)
    if "low" in PARAMETERS[family] and family != "log_uniform":
        down = PRIORS[family](**{**PARAMETERS[family], "low": 0.0})
        assert not down.in_logs
        assert np.isfinite(down.logpdf(np.array([1e-12]))[0])


def test_a_posterior_walks_in_logs_but_where_its_prior_reaches_zero() -> None:
    """Its density at zero is finite there, and nothing lies beyond.

    Mutant killed: the density over an unknown that is no log carries the Jacobian of one.
    """
    sigma = np.full(4, 0.1)
    zero = {"c_m": HalfNormal(2 * NOMINAL["c_m"]), "t_f": Uniform(0.0, 0.2)}
    target = posterior(noisy_step(sigma, n=60), sigma, priors=zero)
    logs = dict(zip(target.space.free, target.coordinates.logs, strict=True))
    assert {name for name, log in logs.items() if not log} == {"c_m", "t_f"}
    c_m, t_f = (target.space.free.index(name) for name in zero)
    z = target.coordinates.from_physical(np.repeat(vector(NOMINAL)[None], 4, axis=0))
    z[1:, [c_m, t_f]] = [[1e-15, 1e-12], [-1e-15, 0.1], [1e-4, -1e-12]]
    found = target(z)
    assert np.isfinite(found[:2]).all()
    assert (found[2:] == -np.inf).all()
    assert list(target.supports(z)) == [True, True, False, False]
    others = np.log(vector({**NOMINAL, "c_m": 1.0, "t_f": 1.0})).sum()
    theta = target.coordinates.to_physical(z)
    assert found[:2] == pytest.approx(target.density(theta)[:2] + others, rel=1e-12)


BETWEEN = Coordinates((True, False, False), ((1, -0.9, 0.99), (2, 2.0, 5.0)), ((1, 1.0), (2, 1.0)))


def between(n: int = 30) -> np.ndarray:
    """A positive number, a correlation that may be negative, and something far off the origin."""
    rng = np.random.default_rng(8)
    return np.stack(
        [np.exp(rng.normal(size=n)), rng.uniform(-0.89, 0.98, n), rng.uniform(2.01, 4.99, n)],
        axis=-1,
    )


def test_what_lies_between_two_ends_goes_by_its_probit_and_back() -> None:
    """Mutants killed: the ends of another column, a width forgotten."""
    theta = between()
    z = BETWEEN.from_physical(theta)
    assert BETWEEN.to_physical(z) == pytest.approx(theta, rel=1e-12)
    assert norm.cdf(z[:, 1]) == pytest.approx((theta[:, 1] + 0.9) / 1.89, rel=1e-9)
    far = np.array([[0.0, 400.0, -400.0]])
    assert BETWEEN.to_physical(far)[0] == pytest.approx([1.0, 0.99, 2.0])
    assert np.isfinite(BETWEEN.with_jacobian(far)[1]).all()


def test_slopes_and_jacobian_between_two_ends_are_differences() -> None:
    theta = between()
    z, step = BETWEEN.from_physical(theta), 1e-6
    moved = BETWEEN.to_physical(z + step) - BETWEEN.to_physical(z - step)
    assert BETWEEN.slopes(theta) == pytest.approx(moved / (2 * step), rel=1e-7)
    same, jacobian = BETWEEN.with_jacobian(z)
    assert same == pytest.approx(theta)
    assert jacobian == pytest.approx(np.log(BETWEEN.slopes(theta)).sum(axis=1), rel=1e-9)
    slope, curvature = BETWEEN.jacobian_derivatives(z)
    for column in range(3):
        shift = 1e-4 * np.eye(3)[column]
        up, here, down = (BETWEEN.with_jacobian(z + k * shift)[1] for k in (1, 0, -1))
        assert slope[:, column] == pytest.approx((up - down) / 2e-4, abs=1e-6)
        assert curvature[:, column] == pytest.approx(-(up - 2 * here + down) / 1e-8, abs=1e-5)


def test_the_natural_scale_of_what_may_be_negative_is_itself() -> None:
    theta = between(3)
    assert np.array_equal(BETWEEN.natural(theta)[:, 0], theta[:, 0])
    assert (BETWEEN.natural(theta)[:, 1:] == 1.0).all()
