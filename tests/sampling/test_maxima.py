"""Maxima told apart: points of one ridge are one, however far apart; two humps are two."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import Gaussians, humps, ridged

from bayesdrill.sampling import multiple_modes


@run_cases("n_loose, n_tight", [(1, 1), (1, 3), (2, 1), (2, 3)])
def test_points_of_one_long_bent_ridge_are_one_maximum(n_loose: int, n_tight: int) -> None:
    """Hundreds of standard deviations apart.  Mutant killed: a straight path from one to the other."""
    surface = ridged(n_loose, n_tight)
    psi = np.random.default_rng(3).uniform(-0.4, 0.8, (12, n_loose))
    points = surface.at(psi, np.zeros((12, n_tight)))
    far = surface.parts(points[0] + 0.5 * (points[1:] - points[0]))[1]
    assert np.linalg.norm(far, axis=1).max() > 10.0  # what lies straight between them is off it
    values = -1e-3 * np.arange(12.0)
    assert multiple_modes.distinct_modes(surface, points, values) == [0]


@run_cases("d", [1, 2, 5])
def test_two_humps_are_two_maxima_the_highest_first(d: int) -> None:
    """Mutant killed: places that a step has brought back to where it came from."""
    surface = humps(d, (0.1, 0.9), (1.0, 1.0), 20.0)
    rng = np.random.default_rng(4)
    near = surface.means[np.arange(10) % 2] + 1e-4 * rng.standard_normal((10, d))
    values = surface.value(near)
    found = multiple_modes.distinct_modes(surface, near, values)
    assert found == [
        int(np.argmax(values)),
        int(np.argmax(np.where(np.arange(10) % 2, -1e9, values))),
    ]
    assert list(surface.belongs(near[found])) == [1, 0]


def test_a_valley_parts_what_the_record_hardly_knows() -> None:
    """Humps so wide that nothing is tight.  Mutant killed: all that is loose is one."""
    surface = humps(1, (0.6, 0.4), (3.0, 3.0), 10.0)
    assert multiple_modes.distinct_modes(surface, surface.means, surface.value(surface.means)) == [
        0,
        1,
    ]
    one = humps(1, (0.6, 0.4), (3.0, 3.0), 1.0)
    assert multiple_modes.distinct_modes(one, one.means, one.value(one.means)) == [
        int(np.argmax(one.value(one.means)))
    ]


def test_of_a_long_row_of_maxima_none_is_taken_for_another() -> None:
    """As those of a lag under a periodic input.  Mutant killed: valleys looked for at even distances,
    all of which fall on maxima.
    """
    one, count = humps(1, (1.0,), (0.1,), 0.0), 60
    means = np.linspace(one.low[0] + 1.0, one.high[0] - 1.0, count)[:, None]
    row = dataclasses.replace(
        one, weights=np.ones(count), means=means, roots=np.repeat(one.roots, count, axis=0)
    )
    assert len(multiple_modes.distinct_modes(row, means, row.value(means))) == count


def test_what_is_much_lower_holds_nothing() -> None:
    """A maximum e^25 times lower is left out."""
    surface = humps(2, (1.0, 1e-9, 1e-13), (1.0, 1.0, 1.0), 20.0)
    values = surface.value(surface.means)
    assert multiple_modes.distinct_modes(surface, surface.means, values) == [0, 1]


def test_a_second_ridge_beside_the_first_is_another() -> None:
    """Both long and bent: points of either are joined to their own only."""
    one = ridged(1, 2)
    shift = one.mixing @ np.array([0.0, 0.6, 0.6])

    class Both(type(one)):
        def log_density(self, u: np.ndarray) -> np.ndarray:
            return np.maximum(super().log_density(u), super().log_density(u - shift))

        def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            first = super().log_density(u) >= super().log_density(u - shift)
            return super().derivatives(np.where(first[:, None], u, u - shift))

    both = Both(**{field.name: getattr(one, field.name) for field in dataclasses.fields(one)})
    psi = np.array([[-0.3], [0.1], [0.5]])
    on = one.at(psi, np.zeros((3, 2)))
    points = np.concatenate([on, on + shift])
    same = multiple_modes.joined_by_ridge(both, points[0], points[1:])
    assert list(same) == [True, True, False, False, False]
    assert multiple_modes.distinct_modes(both, points, -1e-3 * np.arange(6.0)) == [0, 3]


def test_where_there_is_no_density_no_path_arrives() -> None:
    """Without a word of NumPy's: a response that overflows has no slope and no curvature."""
    one = ridged(1, 1)

    class Cut(type(one)):
        def derivatives(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            here = (np.abs(self.parts(u)[0][:, 0] - 0.3) > 0.15)[:, None]
            slope, curvature = super().derivatives(u)
            return np.where(here, slope, 0.0), np.where(here[..., None], curvature, 0.0)

    cut = Cut(**{field.name: getattr(one, field.name) for field in dataclasses.fields(one)})
    points = one.at(np.array([[-0.3], [0.0], [0.3]]), np.zeros((3, 1)))
    assert list(multiple_modes.joined_by_ridge(cut, points[0], points[1:])) == [True, False]


def test_scouts_find_both_humps() -> None:
    surface = humps(2, (0.5, 0.5), (1.0, 1.0), 20.0)
    starts = np.random.default_rng(5).uniform(surface.low, surface.high, (24, 2))
    points, values = multiple_modes.best_ends(surface, starts)
    assert values == pytest.approx(surface.value(points))
    assert set(surface.belongs(points)) == {0, 1}
    near = np.linalg.norm(points - surface.means[surface.belongs(points)], axis=1)
    assert (near < 1e-3).sum() >= len(points) - 1
    chosen = multiple_modes.distinct_modes(surface, points, values)
    assert len(chosen) == 2


def test_a_point_at_the_very_maximum_is_joined_to_itself() -> None:
    """Where the slope is zero to the last bit."""
    surface = humps(3, (1.0,), (1.0,), 0.0)
    twice = np.repeat(surface.means, 3, axis=0)
    assert not surface.quadratic_model(twice, np.eye(3)).slope.any()
    assert multiple_modes.distinct_modes(surface, twice, np.zeros(3)) == [0]


def test_scouts_without_a_density_are_left_at_home() -> None:
    surface = humps(2, (0.5, 0.5), (1.0, 1.0), 20.0)

    class Nowhere(Gaussians):
        def value(self, u: np.ndarray) -> np.ndarray:
            return np.full(len(u), -np.inf)

    like = {field.name: getattr(surface, field.name) for field in dataclasses.fields(surface)}
    points, values = multiple_modes.best_ends(Nowhere(**like), surface.means)
    assert points.shape == (0, 2)
    assert len(values) == 0
