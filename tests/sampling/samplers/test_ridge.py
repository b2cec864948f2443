"""Coordinates along a ridge: there and back, their volume, and the polynomials behind them."""

import dataclasses
import itertools

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.sampling.samplers import ridge
from bayesdrill.sampling.samplers.ridge import LocalBasis, RidgeMap

SHAPES = [(1, 1), (2, 3), (4, 5), (0, 3), (3, 0)]  # loose and tight directions


def curved(n_loose: int, n_tight: int) -> RidgeMap:
    """Cubic, in a slanted basis of unequal units, with a root that changes along it."""
    rng = np.random.default_rng(3)
    d = n_loose + n_tight
    psi = rng.standard_normal((400, n_loose)) * 2.0 + 1.0
    tau = np.sin(0.3 * psi @ rng.standard_normal((n_loose, n_tight))) * 5.0
    roots = np.tril(0.3 * rng.standard_normal((n_tight, n_tight)), -1) + np.eye(n_tight)
    roots = np.exp(0.2 * psi.sum(axis=1))[:, None, None] * roots
    columns = np.geomspace(1.0, 100.0, d)[:, None] * rng.standard_normal((d, d))
    base = ridge.local_basis(10.0 * rng.standard_normal(d), columns, n_loose)
    return ridge.fit_ridge(base, psi, tau, roots, 3, 2)


def coordinates_of(ridge_map: RidgeMap, n: int = 12) -> np.ndarray:
    """Within the points of its fit and beyond them."""
    d = len(ridge_map.frame.centre)
    return np.random.default_rng(4).standard_normal((n, d)) * np.geomspace(0.5, 30.0, n)[:, None]


@run_cases("n_loose, n_tight", SHAPES)
def test_bending_and_straightening_undo_each_other(n_loose: int, n_tight: int) -> None:
    ridge_map = curved(n_loose, n_tight)
    y = coordinates_of(ridge_map)
    u, log_volume = ridge_map.from_ridge_coordinates(y)
    back, back_volume = ridge_map.to_ridge_coordinates(u)
    assert back == pytest.approx(y, rel=1e-7, abs=1e-7)
    assert back_volume == pytest.approx(log_volume, abs=1e-7)


@run_cases("n_loose, n_tight", SHAPES)
def test_volumes_are_those_of_a_numerical_determinant(n_loose: int, n_tight: int) -> None:
    """Beyond the points of the fit too, where the ridge goes straight on."""
    to_u = curved(n_loose, n_tight).from_ridge_coordinates
    y = coordinates_of(curved(n_loose, n_tight))
    h = 1e-5
    steps = h * np.eye(y.shape[1])
    for row, log_volume in zip(y, to_u(y)[1], strict=True):
        columns = (to_u(row + steps)[0] - to_u(row - steps)[0]) / (2 * h)
        assert np.linalg.slogdet(columns)[1] == pytest.approx(log_volume, abs=1e-4)


def test_beyond_its_points_a_polynomial_stays_what_it_is_at_their_edge() -> None:
    ridge_map = curved(2, 3)
    way = np.array([[0.6, -0.8]]) * ridge_map.width
    edge = ridge_map.at(ridge_map.psi_centre + way)
    assert ridge_map.at(ridge_map.psi_centre + 40.0 * way) == pytest.approx(edge)
    assert not np.allclose(ridge_map.at(ridge_map.psi_centre + 0.9 * way), edge)
    further = dataclasses.replace(ridge_map, radius=2.0)
    assert further.at(ridge_map.psi_centre + way) == pytest.approx(edge)
    assert not np.allclose(further.at(ridge_map.psi_centre + 2.0 * way), edge)


def test_each_monomial_stands_once_the_lowest_degrees_first() -> None:
    x = np.random.default_rng(1).uniform(0.5, 2.0, (3, 7))
    monomials = ridge.build_monomials(3, 4)
    expected = [
        np.prod([x[v] for v in chosen], axis=0) if chosen else np.ones(7)
        for degree in range(5)
        for chosen in itertools.combinations_with_replacement(range(3), degree)
    ]
    assert monomials.terms == len(expected)
    rows = monomials.evaluate(x)
    assert np.sort(rows, axis=0) == pytest.approx(np.sort(expected, axis=0), rel=1e-12)
    fewer = ridge.build_monomials(3, 2)
    assert np.array_equal(rows[: fewer.terms], fewer.evaluate(x))


def test_a_direction_along_which_nothing_bends_is_left_out_of_the_polynomials() -> None:
    psi = np.random.default_rng(2).standard_normal((60, 2))
    tau = psi[:, 1:] ** 2
    base = LocalBasis(np.zeros(3), np.eye(3)[:, :2], np.eye(3)[:, 2:], np.eye(3), 0.0)
    ridge_map = ridge.fit_ridge(base, psi, tau, np.ones((60, 1, 1)), 2, 0, np.array([1]))
    assert ridge_map.at(psi + np.array([[100.0, 0.0]])) == pytest.approx(tau, abs=1e-9)
