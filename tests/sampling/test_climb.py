"""Uphill in a box: where SciPy arrives, at walls and along bent valleys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.optimize
from support.case_tables import run_cases
from support.closed_form_densities import Walled, humps, ridged

from bayesdrill.inference.laplace import QuadraticModel
from bayesdrill.sampling.gauss_newton import bounded_step, gauss_newton, newton_gain


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


def linear(seed: int, d: int) -> tuple[Squares, np.ndarray, np.ndarray]:
    """Least squares of unequal columns, whose free maximum lies outside the box in places."""
    rng = np.random.default_rng(seed)
    scales = np.geomspace(1e-2, 1e2, d)
    matrix = rng.standard_normal((3 * d, d)) @ np.diag(np.geomspace(1.0, 30.0, d)) / scales
    target = matrix @ (scales * rng.uniform(-2.5, 2.5, d))
    ones = np.ones((1, 1, 1))
    surface = Squares(
        np.zeros(d),
        scales,
        1.0,
        lambda u: u @ matrix.T - target,
        lambda u: matrix * ones * u[:, :1, None] ** 0,
    )
    return surface, matrix, target


@run_cases("d", [2, 5, 9])
def test_a_step_within_a_box_is_that_of_bounded_least_squares(d: int) -> None:
    """One step, from the middle and from corners.  Mutant killed: steps cut at the walls."""
    at_walls = 0
    for seed in range(20):
        surface, matrix, target = linear(seed, d)
        rng = np.random.default_rng(seed)
        start = surface.spread * rng.choice([-1.0, 0.0, 0.5, 1.0], (4, d))
        here = surface.quadratic_model(start, np.eye(d))
        step = bounded_step(surface, start, here, np.zeros(4))
        end = np.clip(start + step, surface.low, surface.high)  # but for rounding
        assert end == pytest.approx(start + step, rel=1e-12, abs=1e-14)
        best = scipy.optimize.lsq_linear(matrix, target, (surface.low, surface.high), tol=1e-14)
        assert surface.value(end) == pytest.approx(np.full(4, -best.cost), rel=1e-7)
        assert end / surface.spread == pytest.approx(
            np.tile(best.x / surface.spread, (4, 1)), abs=1e-4
        )
        at_walls += int((np.abs(best.x / surface.spread) > 1 - 1e-6).sum())
    assert at_walls > 20


def test_a_direction_that_hardly_counts_is_no_warning() -> None:
    """A slope that is almost zero: the wall is further away than there are numbers."""
    matrix = np.diag([1.0, 1e-310])
    surface = Squares(
        np.zeros(2),
        np.ones(2),
        1.0,
        lambda u: u @ matrix.T - np.array([0.3, 1.0]),
        lambda u: np.broadcast_to(matrix, (len(u), 2, 2)),
    )
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
    """Mutant killed: no damping."""
    surface = banana(-3.0, 4.0)
    start = np.random.default_rng(2).uniform(-2.5, 3.5, (30, 2))
    found = gauss_newton(surface, start, 60, exact=exact)
    assert found.converged.all()
    assert found.u == pytest.approx(np.ones((30, 2)), abs=1e-4)


@run_cases("low, high", [(-3.0, 0.8), (-1.5, 0.6), (1.2, 4.0)])
def test_a_valley_that_a_wall_cuts_off_is_followed_to_the_wall(low: float, high: float) -> None:
    surface = banana(low, high)
    start = np.random.default_rng(3).uniform(low, high, (20, 2))
    found = gauss_newton(surface, start, 60)
    ends = [
        scipy.optimize.minimize(
            lambda u: -float(surface.log_density(u[None])[0]),
            one,
            jac=lambda u: -surface.derivatives(u[None])[0][0],
            bounds=[(low, high)] * 2,
            options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 2000, "maxfun": 10_000},
        )
        for one in start[:5]
    ]
    best = min(ends, key=lambda end: end.fun)
    assert found.value == pytest.approx(np.full(20, -best.fun), rel=1e-6)
    assert found.u == pytest.approx(np.tile(best.x, (20, 1)), abs=1e-3)


@dataclass(frozen=True)
class Saddle(Walled):
    """Flat to the second order where it starts: -x^4 / 4 + x^2 / 2 - 8 y^2, maxima at x = +-1."""

    def log_density(self, u: np.ndarray) -> np.ndarray:
        return -(u[:, 0] ** 4) / 4 + u[:, 0] ** 2 / 2 - 8.0 * u[:, 1] ** 2

    def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        curvature = np.tile(np.diag([1e-6, 16.0]), (len(u), 1, 1))  # knows nothing of x
        return np.stack([u[:, 0] - u[:, 0] ** 3, -16.0 * u[:, 1]], axis=-1), curvature


def test_second_derivatives_lead_to_the_very_maximum() -> None:
    """Where those of Gauss and Newton are wrong, and upward where it curves upward."""
    surface = Saddle(np.zeros(2), np.full(2, 2.0), 1.0)
    start = np.array([[0.2, 0.5], [-0.3, -1.0], [1.9, 0.0]])
    found = gauss_newton(surface, start, 15, exact=True)
    assert found.u == pytest.approx(np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]]), abs=1e-5)
    assert found.value == pytest.approx(np.full(3, 0.25), abs=1e-10)


def test_each_point_climbs_by_itself() -> None:
    surface = banana(-3.0, 4.0)
    start = np.random.default_rng(4).uniform(-2.5, 3.5, (9, 2))
    together = gauss_newton(surface, start, 12)
    for k in (0, 5, 8):
        alone = gauss_newton(surface, start[k : k + 1], 12)
        assert alone.u[0] == pytest.approx(together.u[k], abs=1e-9)
    assert (together.value >= surface.value(start)).all()


def test_where_there_is_no_density_nothing_moves() -> None:
    surface = humps(2, (0.5, 0.5), (1.0, 1.0), 20.0)

    class Holed(type(surface)):
        def value(self, u: np.ndarray) -> np.ndarray:
            hole = np.linalg.norm(u - self.means[0], axis=1) < 1.0
            return np.where(hole, -np.inf, super().value(u))

    holed = Holed(**{name: getattr(surface, name) for name in surface.__dataclass_fields__})
    start = np.vstack([surface.means[0], surface.means[1] + 2.0])
    found = gauss_newton(holed, start, 20)
    assert found.u[0] == pytest.approx(start[0])
    assert found.value[0] == -np.inf
    assert list(found.converged) == [False, True]
    assert found.u[1] == pytest.approx(surface.means[1], abs=1e-3)


def test_what_is_left_to_gain_is_what_the_next_step_gains() -> None:
    surface, _, _ = linear(3, 5)
    start = 0.3 * surface.spread[None]
    here = surface.quadratic_model(start, np.eye(5))
    gain = newton_gain(surface, start, here)
    best = gauss_newton(surface, start, 30).value
    assert gain == pytest.approx(best - surface.value(start), rel=1e-6)
    none = QuadraticModel(here.value, 0.0 * here.slope, here.curvature)
    assert newton_gain(surface, start, none) == pytest.approx([0.0])


def test_a_long_bent_ridge_is_reached_from_afar() -> None:
    """But from where the way leads into a corner of the box, a maximum too."""
    surface = ridged(1, 3)
    start = np.random.default_rng(5).uniform(surface.low, surface.high, (30, 4))
    found = gauss_newton(surface, start, 40)
    assert found.converged.all()
    on_walls = ((found.u == surface.low) | (found.u == surface.high)).any(axis=1)
    assert found.value[~on_walls] == pytest.approx(np.zeros((~on_walls).sum()), abs=1e-6)
    assert (~on_walls).sum() > 10
