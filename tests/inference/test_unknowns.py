"""The coordinates of unknowns: round trips, slopes and Jacobians, and which unknown has which."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from support import two_experiments
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL
from support.small_problems import vector, with_priors

from bayesdrill.inference.priors import LogNormal, Prior, TruncatedNormal, Uniform
from bayesdrill.inference.unknowns import Coordinates, ParameterSpace

RNG = np.random.default_rng(4)


def positive(n: int) -> np.ndarray:
    """Return nine parameters and two noise levels `(n, 11)`, far apart and of different sizes."""
    theta = np.append(vector(NOMINAL), [0.1, 0.3]) * np.exp(RNG.uniform(-0.9, 0.9, (n, 11)))
    theta[: n // 2, 8] *= 40.0
    return theta


def bounded(n: int) -> np.ndarray:
    """Return a positive number, one that may be negative, and one far from the origin `(n, 3)`."""
    columns = np.exp(RNG.normal(size=n)), RNG.uniform(-0.89, 0.98, n), RNG.uniform(2.01, 4.99, n)
    return np.stack(columns, axis=-1)


BETWEEN = Coordinates((True, False, False), ((1, -0.9, 0.99), (2, 2.0, 5.0)), ((1, 1.0), (2, 1.0)))
COORDINATES = {
    "log": (Coordinates((True,) * 11), positive(12)),
    "linear": (Coordinates((False,) * 11), positive(12)),
    "mixed": (Coordinates(tuple(d % 3 != 1 for d in range(11))), positive(12)),
    "between": (BETWEEN, bounded(30)),
}


@run_cases("coordinates, theta", COORDINATES.values(), COORDINATES)
def test_coordinates_lead_back_and_leave_their_argument_as_it_is(
    coordinates: Coordinates, theta: np.ndarray
) -> None:
    given = theta.copy()
    z = coordinates.from_physical(theta)
    logs = np.array(coordinates.logs)
    assert np.array_equal(z[:, logs], np.log(given[:, logs]))
    kept = z.copy()
    assert coordinates.to_physical(z) == pytest.approx(given, rel=1e-12)
    assert coordinates.with_jacobian(z)[0] == pytest.approx(given, rel=1e-12)
    assert np.array_equal(theta, given)
    assert np.array_equal(z, kept)


@run_cases("coordinates, theta", COORDINATES.values(), COORDINATES)
def test_slopes_and_jacobian_are_differences(coordinates: Coordinates, theta: np.ndarray) -> None:
    z = coordinates.from_physical(theta)
    h = 1e-6 * np.maximum(np.abs(z), 1e-3)
    numeric = (coordinates.to_physical(z + h) - coordinates.to_physical(z - h)) / (2 * h)
    assert coordinates.slopes(theta) == pytest.approx(numeric, rel=1e-6)
    _, jacobian = coordinates.with_jacobian(z)
    assert jacobian == pytest.approx(np.log(numeric).sum(axis=1), abs=1e-5)
    slope, curvature = coordinates.jacobian_derivatives(z)
    for column in range(z.shape[1]):
        shift = 1e-4 * np.eye(z.shape[1])[column]
        up, here, down = (coordinates.with_jacobian(z + k * shift)[1] for k in (1, 0, -1))
        assert slope[:, column] == pytest.approx((up - down) / 2e-4, abs=1e-6)
        assert curvature[:, column] == pytest.approx(-(up - 2 * here + down) / 1e-8, abs=1e-4)


def test_slopes_by_natural_scales_are_exact_near_both_ends() -> None:
    between = Coordinates((False,), bounded=((0, 0.0, 1.0),), signed=((0, 1.0),))
    rho = np.array([1.0 - 1e-8, 0.5, 1e-7])
    slopes = between.slopes_by_natural(rho[:, None])[:, 0]
    assert slopes == pytest.approx(1.0 / norm.pdf(norm.ppf(rho)), rel=1e-9)


def test_an_unknown_between_two_ends_is_walked_by_its_probit() -> None:
    theta = bounded(30)
    z = BETWEEN.from_physical(theta)
    assert norm.cdf(z[:, 1]) == pytest.approx((theta[:, 1] + 0.9) / 1.89, rel=1e-9)
    far = np.array([[0.0, 400.0, -400.0]])
    assert BETWEEN.to_physical(far)[0] == pytest.approx([1.0, 0.99, 2.0])
    assert np.isfinite(BETWEEN.with_jacobian(far)[1]).all()
    assert np.array_equal(BETWEEN.natural(theta)[:, 0], theta[:, 0])
    assert (BETWEEN.natural(theta)[:, 1:] == 1.0).all()


# --- unknowns that may be negative -----------------------------------------------------------------


def joint_space() -> ParameterSpace:
    return two_experiments.rich_job().problem.posterior.space


@run_cases(
    "prior, signed",
    [
        (Uniform(-1.0, 2.0), True),
        (Uniform(0.0, 0.05), True),
        (Uniform(0.01, 0.05), False),
        (TruncatedNormal(0.0, 2.0, -np.inf, np.inf), True),
        (LogNormal(1.0, 0.1), False),
    ],
)
def test_an_unknown_of_a_sensor_that_may_be_zero_has_no_logarithmic_scale(
    prior: Prior, signed: bool
) -> None:
    """A parameter of the rig from zero on has one, as it may span decades."""
    sensor = replace(joint_space().unknowns[-3], prior=prior, role="sensor", start=0.0)
    assert sensor.signed is signed
    if prior == Uniform(0.0, 0.05):
        assert not replace(sensor, role="rig").signed


def test_the_log_prior_is_the_sum_of_all_also_of_those_below_zero() -> None:
    space = with_priors(joint_space(), {"offset_v_late": Uniform(-2.0, -0.5)})
    theta = space.draw(3, np.random.default_rng(4))
    each = [p.logpdf(x) for p, x in zip(space.priors.values(), theta.T, strict=True)]
    assert space.log_prior(theta) == pytest.approx(np.sum(each, axis=0), rel=1e-12)
    d = space.free.index("offset_v_late")
    assert (theta[:, d] < -0.5).all()
    theta[0, d] = -0.4
    assert space.log_prior(theta)[0] == -np.inf
