"""Steps of Gauss and Newton in a box: as SciPy's, also at walls and along bent valleys."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.optimize
from support.case_tables import run_cases
from support.closed_form_densities import Walled, humps

from bayesdrill.sampling.gauss_newton import bounded_step, gauss_newton


@dataclass(frozen=True)
class Squares(Walled):
    """Minus half the sum of squares of `residuals(u)`, with their slopes."""

    residuals: Callable[[np.ndarray], np.ndarray]
    slopes: Callable[[np.ndarray], np.ndarray]

    def log_density(self, u: np.ndarray) -> np.ndarray:
        return -0.5 * (self.residuals(u) ** 2).sum(axis=1)

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r, j = self.residuals(u), self.slopes(u)
        return -np.einsum("wrd,wr->wd", j, r), np.einsum("wrd,wre->wde", j, j)


def linear_squares(matrix: np.ndarray, target: np.ndarray, scales: np.ndarray) -> Squares:
    def slopes(u: np.ndarray) -> np.ndarray:
        return np.broadcast_to(matrix, (len(u), *matrix.shape))

    return Squares(np.zeros(len(scales)), scales, 1.0, lambda u: u @ matrix.T - target, slopes)


def random_squares(seed: int, d: int) -> tuple[Squares, np.ndarray, np.ndarray]:
    """Least squares of unequal columns, whose free maximum lies outside the box in places."""
    rng = np.random.default_rng(seed)
    scales = np.geomspace(1e-2, 1e2, d)
    matrix = rng.standard_normal((3 * d, d)) @ np.diag(np.geomspace(1.0, 30.0, d)) / scales
    target = matrix @ (scales * rng.uniform(-2.5, 2.5, d))
    return linear_squares(matrix, target, scales), matrix, target


@run_cases("d", [2, 5, 9])
def test_a_step_within_a_box_is_that_of_bounded_least_squares(d: int) -> None:
    """From the middle and from corners."""
    at_walls = 0
    for seed in range(20):
        surface, matrix, target = random_squares(seed, d)
        start = surface.spread * np.random.default_rng(seed).choice([-1.0, 0.0, 0.5, 1.0], (4, d))
        here = surface.quadratic_model(start, np.eye(d))
        step = bounded_step(surface, start, here, np.zeros(4))
        end = np.clip(start + step, surface.low, surface.high)  # but for rounding
        assert end == pytest.approx(start + step, rel=1e-12, abs=1e-14)
        best = scipy.optimize.lsq_linear(matrix, target, (surface.low, surface.high), tol=1e-14)
        assert surface.value(end) == pytest.approx(np.full(4, -best.cost), rel=1e-7)
        expected = np.tile(best.x / surface.spread, (4, 1))
        assert end / surface.spread == pytest.approx(expected, abs=1e-4)
        at_walls += int((np.abs(best.x / surface.spread) > 1 - 1e-6).sum())
    assert at_walls > 20


def test_a_slope_of_almost_zero_warns_of_nothing() -> None:
    """The wall is further away than there are numbers."""
    surface = linear_squares(np.diag([1.0, 1e-310]), np.array([0.3, 1.0]), np.ones(2))
    start = np.zeros((1, 2))
    step = bounded_step(surface, start, surface.quadratic_model(start, np.eye(2)), np.ones(1))
    assert step == pytest.approx(np.array([[0.15, 0.0]]), abs=1e-9)


def banana(low: float, high: float) -> Squares:
    """Rosenbrock's valley, a hundred times as steep across as along."""
    middle, spread = np.full(2, 0.5 * (low + high)), np.full(2, 0.5 * (high - low))

    def slopes(u: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(u), 2, 2))
        rows[:, 0, 0], rows[:, 0, 1], rows[:, 1, 0] = -200.0 * u[:, 0], 100.0, -1.0
        return rows

    def residuals(u: np.ndarray) -> np.ndarray:
        return np.stack([100.0 * (u[:, 1] - u[:, 0] ** 2), 1.0 - u[:, 0]], axis=-1)

    return Squares(middle, spread, 1.0, residuals, slopes)


@run_cases("exact", [False, True])
def test_a_valley_shaped_like_a_banana_is_followed(exact: bool) -> None:
    start = np.random.default_rng(2).uniform(-2.5, 3.5, (30, 2))
    result = gauss_newton(banana(-3.0, 4.0), start, 60, exact=exact)
    assert result.converged.all()
    assert result.u == pytest.approx(np.ones((30, 2)), abs=1e-4)


@run_cases("low, high", [(-3.0, 0.8), (-1.5, 0.6), (1.2, 4.0)])
def test_a_valley_that_a_wall_cuts_off_is_followed_to_the_wall(low: float, high: float) -> None:
    surface = banana(low, high)
    starts = np.random.default_rng(3).uniform(low, high, (20, 2))
    result = gauss_newton(surface, starts, 60)
    ends = [
        scipy.optimize.minimize(
            lambda u: -float(surface.log_density(u[None])[0]),
            start,
            jac=lambda u: -surface.derivatives(u[None])[0][0],
            bounds=[(low, high)] * 2,
            options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 2000, "maxfun": 10_000},
        )
        for start in starts[:5]
    ]
    best = min(ends, key=lambda end: end.fun)
    assert result.value == pytest.approx(np.full(20, -best.fun), rel=1e-6)
    assert result.u == pytest.approx(np.tile(best.x, (20, 1)), abs=1e-3)


@dataclass(frozen=True)
class Saddle(Walled):
    """Flat to the second order where it starts: -x^4 / 4 + x^2 / 2 - 8 y^2, maxima at x = +-1."""

    def log_density(self, u: np.ndarray) -> np.ndarray:
        return -(u[:, 0] ** 4) / 4 + u[:, 0] ** 2 / 2 - 8.0 * u[:, 1] ** 2

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        curvature = np.tile(np.diag([1e-6, 16.0]), (len(u), 1, 1))  # knows nothing of x
        return np.stack([u[:, 0] - u[:, 0] ** 3, -16.0 * u[:, 1]], axis=-1), curvature


def test_second_derivatives_lead_to_the_maximum_where_the_surface_curves_upward() -> None:
    start = np.array([[0.2, 0.5], [-0.3, -1.0], [1.9, 0.0]])
    result = gauss_newton(Saddle(np.zeros(2), np.full(2, 2.0), 1.0), start, 15, exact=True)
    assert result.u == pytest.approx(np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]]), abs=1e-5)
    assert result.value == pytest.approx(np.full(3, 0.25), abs=1e-10)


@run_cases("steps, depth, goes_on", [(5, 3.0, False), (40, 3.0, True), (5, 30.0, True)])
def test_a_climb_stops_that_would_end_far_below_the_highest(
    steps: int, depth: float, goes_on: bool
) -> None:
    """The lower hump is 20.7 below the higher.  From two sds a step gains 2: 40 might suffice."""
    surface = humps(2, (1.0, 1e-9), (1.0, 1.0), 20.0)
    start = surface.means + 2.0 * surface.roots[:, :, 0]
    result = gauss_newton(surface, start, steps, depth=depth)
    assert result.u[0] == pytest.approx(surface.means[0], abs=1e-3)
    assert result.u[1] == pytest.approx((surface.means if goes_on else start)[1], abs=1e-3)
    assert result.value == pytest.approx(surface.value(result.u))
    assert list(result.converged) == [True, goes_on]
