"""Coordinates along a ridge: there and back, their volume, and whether they follow a known one."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import humps, ridged

from bayesdrill.sampling.proposal import ridge_tracing
from bayesdrill.sampling.samplers import ridge
from bayesdrill.sampling.samplers.ridge import (
    LocalBasis,
    RidgeMap,
)

SHAPES = [(1, 1), (2, 3), (4, 5), (0, 3), (3, 0)]  # loose and tight directions


def curved(n_loose: int, n_tight: int, seed: int = 3) -> RidgeMap:
    """Cubic, in a slanted basis of unequal units, with a root that changes along it."""
    rng = np.random.default_rng(seed)
    d = n_loose + n_tight
    psi = rng.standard_normal((400, n_loose)) * 2.0 + 1.0
    along = psi.sum(axis=1)
    tau = np.sin(0.3 * psi @ rng.standard_normal((n_loose, n_tight))) * 5.0
    roots = np.tril(0.3 * rng.standard_normal((n_tight, n_tight)), -1) + np.eye(n_tight)
    roots = np.exp(0.2 * along)[:, None, None] * roots
    columns = np.geomspace(1.0, 100.0, d)[:, None] * rng.standard_normal((d, d))
    base = ridge.local_basis(10.0 * rng.standard_normal(d), columns, n_loose)
    return ridge.fit_ridge(base, psi, tau, roots, 3, 2)


def far_and_near(found: RidgeMap, n: int = 12) -> np.ndarray:
    """Coordinates within the points of its fit and beyond them."""
    d = len(found.frame.centre)
    return np.random.default_rng(4).standard_normal((n, d)) * np.geomspace(0.5, 30.0, n)[:, None]


@run_cases("n_loose, n_tight", SHAPES)
def test_bending_and_straightening_undo_each_other(n_loose: int, n_tight: int) -> None:
    """Mutant killed: the covariance's root taken at another point on the way back."""
    found = curved(n_loose, n_tight)
    y = far_and_near(found)
    u, bent = found.from_ridge_coordinates(y)
    back, straightened = found.to_ridge_coordinates(u)
    assert back == pytest.approx(y, rel=1e-7, abs=1e-7)
    assert straightened == pytest.approx(bent, abs=1e-7)


@run_cases("n_loose, n_tight", SHAPES)
def test_volumes_are_those_of_a_numerical_determinant(n_loose: int, n_tight: int) -> None:
    """Beyond the points of the fit too, where the ridge goes straight on.

    Mutants killed: the volume of the basis forgotten, or the root's, or that at the middle taken.
    """
    found = curved(n_loose, n_tight)
    y = far_and_near(found)
    _, log_volume = found.from_ridge_coordinates(y)
    h = 1e-5
    steps = h * np.eye(y.shape[1])
    for row, volume in zip(y, log_volume, strict=True):
        columns = (
            found.from_ridge_coordinates(row + steps)[0]
            - found.from_ridge_coordinates(row - steps)[0]
        ) / (2 * h)
        assert np.linalg.slogdet(columns)[1] == pytest.approx(volume, abs=1e-4)


def test_a_polynomial_says_nothing_of_what_lies_beyond_its_points() -> None:
    """It stays what it is at their edge.  Mutant killed: followed for ever."""
    found = curved(2, 3)
    way = np.array([[0.6, -0.8]]) * found.width
    edge = found.at(found.middle + way)
    assert found.at(found.middle + 40.0 * way) == pytest.approx(edge)
    assert not np.allclose(found.at(found.middle + 0.9 * way), edge)
    further = dataclasses.replace(found, reach=2.0)
    assert further.at(found.middle + way) == pytest.approx(edge)
    assert not np.allclose(further.at(found.middle + 2.0 * way), edge)


def test_powers_are_all_monomials_once() -> None:
    x = np.random.default_rng(1).uniform(0.5, 2.0, (3, 7))
    found = ridge.build_monomials(3, 4)
    every = [
        np.prod([x[v] for v in chosen], axis=0) if chosen else np.ones(7)
        for degree in range(5)
        for chosen in itertools.combinations_with_replacement(range(3), degree)
    ]
    assert found.terms == len(every)
    rows = found.evaluate(x)
    assert np.sort(rows, axis=0) == pytest.approx(np.sort(every, axis=0), rel=1e-12)
    fewer = ridge.build_monomials(3, 2)  # the first of them
    assert np.array_equal(rows[: fewer.terms], fewer.evaluate(x))


def test_a_direction_along_which_nothing_bends_is_left_out_of_the_polynomials() -> None:
    rng = np.random.default_rng(2)
    psi = rng.standard_normal((60, 2))
    tau = psi[:, 1:] ** 2
    base = LocalBasis(np.zeros(3), np.eye(3)[:, :2], np.eye(3)[:, 2:], np.eye(3), 0.0)
    found = ridge.fit_ridge(base, psi, tau, np.ones((60, 1, 1)), 2, 0, np.array([1]))
    moved = psi + np.array([[100.0, 0.0]])
    assert found.at(moved) == pytest.approx(tau, abs=1e-9)


def test_roots_are_those_of_the_inverse_curvature() -> None:
    """Lower triangles, however unequal the units are."""
    rng = np.random.default_rng(5)
    mixed = rng.standard_normal((6, 4, 4)) * np.geomspace(1e-4, 1e4, 4)
    curvature = mixed.swapaxes(1, 2) @ mixed
    roots = ridge_tracing.covariance_roots(curvature)
    assert np.array_equal(roots, np.tril(roots))
    white = roots.swapaxes(1, 2) @ curvature @ roots
    assert white == pytest.approx(np.broadcast_to(np.eye(4), white.shape), abs=1e-6)


@run_cases(
    "seed, n_loose, n_tight",
    [(seed, *case) for seed in [1, 2] for case in [(1, 1), (1, 3), (2, 1), (2, 3)]],
)
def test_a_strongly_bent_ridge_is_followed(seed: int, n_loose: int, n_tight: int) -> None:
    """Over hundreds of standard deviations, on points that no fit has seen.

    Mutants killed: the root at the middle for everywhere, or no polynomial above the second degree.
    """
    surface = ridged(n_loose, n_tight)
    start = surface.at(np.full((1, n_loose), 0.1), np.zeros((1, n_tight)))[0]
    traced = ridge_tracing.trace(surface, start, np.random.default_rng(seed))
    rng = np.random.default_rng(9)
    psi = rng.uniform(-0.7, 0.7, (1000, n_loose))
    fresh = surface.at(psi, np.zeros((1000, n_tight)))
    psi = psi[surface.inside(fresh)]
    exact = surface.at(psi, np.zeros((len(psi), n_tight)))
    off = np.linalg.norm(traced.ridge.to_ridge_coordinates(exact)[0][:, n_loose:], axis=1)
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.9) < 0.2
    noisy = surface.at(psi, rng.standard_normal((len(psi), n_tight)))
    e = traced.ridge.to_ridge_coordinates(noisy)[0][:, n_loose:]
    assert np.cov(e.T).reshape(n_tight, n_tight) == pytest.approx(np.eye(n_tight), abs=0.25)


def test_a_ridge_is_followed_up_to_the_ends_of_the_priors() -> None:
    """On its last tenth.  Mutant killed: points that come to lie beyond an end are left out."""
    surface = ridged(2, 2)
    start = surface.at(np.full((1, 2), 0.1), np.zeros((1, 2)))[0]
    psi = np.random.default_rng(9).uniform(-2.0, 2.0, (20_000, 2))
    exact = surface.at(psi, np.zeros((len(psi), 2)))
    near = np.abs(exact - surface.middle) / (surface.reach * surface.spread)
    last = exact[(near.max(axis=1) > 0.9) & surface.inside(exact)]
    for seed in range(1, 4):
        found = ridge_tracing.trace(surface, start, np.random.default_rng(seed)).ridge
        off = np.linalg.norm(found.to_ridge_coordinates(last)[0][:, 2:], axis=1)
        assert np.quantile(off, 0.9) < 0.3


def test_the_outermost_point_does_not_decide_how_bent_a_ridge_is() -> None:
    """No polynomial reaches it from the others.  Mutant killed: judged there."""
    psi = np.linspace(-1.0, 1.0, 48)[:, None]
    psi[47] = 6.0  # every fourth point is held out: this one too
    base, roots = ridge.local_basis(np.zeros(2), np.eye(2), 1), np.full((48, 1, 1), 0.01)
    _, off = ridge_tracing._best_fit(
        base, np.arange(1), psi, 0.1 * np.sin(2.0 * psi), roots, last=True
    )
    assert off < 0.3


def test_a_point_that_is_on_the_ridge_has_arrived() -> None:
    """Where the slope is zero to the last bit.  Mutant killed: no slope taken for no density."""
    surface = humps(3, (1.0,), (1.0,), 0.0)
    base = ridge.local_basis(surface.means[0], np.eye(3), 1)
    psi, tau = np.zeros((1, 1)), np.zeros((1, 2))
    assert not surface.quadratic_model(surface.means, base.tight).slope.any()
    found, _, _, arrived = ridge_tracing.return_to_ridge(surface.quadratic_model, base, psi, tau)
    assert arrived.all()
    assert np.array_equal(found, tau)


def test_a_direction_along_which_nothing_changes_anywhere_is_known() -> None:
    """Mutant killed: what is flat at one point taken for flat everywhere."""
    surface = humps(3, (1.0,), (1.0,), 0.0)
    flat = np.array([1.0, -2.0, 0.5])
    flat /= np.linalg.norm(flat)
    long = surface.roots[0] + 1e8 * surface.spread[:, None] * np.outer(flat, flat)
    endless = dataclasses.replace(surface, roots=long[None])
    found = ridge_tracing.flat_directions(endless, np.random.default_rng(1))
    assert np.abs(flat @ found) == pytest.approx([1.0], abs=1e-6)
    for bent in (ridged(1, 1), ridged(2, 3), surface):
        here = ridge_tracing.flat_directions(bent, np.random.default_rng(1))
        assert here.shape == (len(bent.middle), 0)


def test_tight_directions_are_those_that_the_record_knows() -> None:
    """Against the covariance of the hump itself, in units of the priors' spreads."""
    surface = humps(5, (1.0,), (1.0,), 0.0)
    here = surface.quadratic_model(surface.means, np.eye(5))
    base, known = ridge_tracing.split_directions(surface, surface.means[0], here)
    whitened = surface.roots[0] / surface.spread[:, None]
    knowledge = np.sort(1.0 / np.linalg.svd(whitened, compute_uv=False) ** 2)
    loose = knowledge < ridge_tracing.TIGHT_RATIO
    assert base.loose.shape[1] == loose.sum() == 3
    assert known == pytest.approx(knowledge[loose])
    psi, tau = base.split(surface.means + surface.roots[0].T)
    assert base.join(psi, tau) == pytest.approx(surface.means + surface.roots[0].T)


def test_an_unknown_that_its_wall_holds_back_is_loose() -> None:
    """Its maximum lies beyond the end of its prior, where a ridge would lead out of the box."""
    surface = humps(2, (1.0,), (1.0,), 0.0)
    scales = surface.spread / 24.0
    wall = surface.means[0] + np.array([4.0, 0.0]) * scales
    low = dataclasses.replace(surface, middle=wall + surface.reach * surface.spread)
    start = low.low
    here = low.quadratic_model(start[None], np.eye(2))
    assert here.slope[0, 0] < 0
    base, _ = ridge_tracing.split_directions(low, start, here)
    assert base.loose.shape[1] >= 1
    assert base.loose[1, 0] == pytest.approx(0.0, abs=1e-12)
