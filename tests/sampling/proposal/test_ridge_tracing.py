"""Ridges that are traced: whether they follow a known one, and which directions are loose."""

import dataclasses

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import Walled, humps, ridge_point, ridged

from bayesdrill.inference.laplace import QuadraticModel
from bayesdrill.sampling.proposal import ridge_tracing
from bayesdrill.sampling.samplers import ridge


@run_cases("seed", [1, 2])
@run_cases("n_loose, n_tight", [(1, 1), (1, 3), (2, 1), (2, 3)])
def test_a_strongly_bent_ridge_is_followed(seed: int, n_loose: int, n_tight: int) -> None:
    """Over hundreds of standard deviations, on points that no fit has seen."""
    surface = ridged(n_loose, n_tight)
    traced = ridge_tracing.trace(surface, ridge_point(surface), np.random.default_rng(seed)).ridge
    rng = np.random.default_rng(9)
    psi = rng.uniform(-0.7, 0.7, (1000, n_loose))
    psi = psi[surface.in_support(surface.at(psi, np.zeros((1000, n_tight))))]

    def across(e: np.ndarray) -> np.ndarray:
        return traced.to_ridge_coordinates(surface.at(psi, e))[0][:, n_loose:]

    off = np.linalg.norm(across(np.zeros((len(psi), n_tight))), axis=1)
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.9) < 0.2
    e = across(rng.standard_normal((len(psi), n_tight)))
    assert np.cov(e.T).reshape(n_tight, n_tight) == pytest.approx(np.eye(n_tight), abs=0.25)


@run_cases("seed", [1, 2, 3])
def test_a_ridge_is_followed_up_to_the_ends_of_the_priors(seed: int) -> None:
    """On its last tenth."""
    surface = ridged(2, 2)
    psi = np.random.default_rng(9).uniform(-2.0, 2.0, (20_000, 2))
    exact = surface.at(psi, np.zeros((len(psi), 2)))
    share = np.abs(exact - surface.middle) / (surface.reach * surface.spread)
    last = exact[(share.max(axis=1) > 0.9) & surface.in_support(exact)]
    traced = ridge_tracing.trace(surface, ridge_point(surface), np.random.default_rng(seed)).ridge
    off = np.linalg.norm(traced.to_ridge_coordinates(last)[0][:, 2:], axis=1)
    assert np.quantile(off, 0.9) < 0.3


def test_the_outermost_point_does_not_decide_how_bent_a_ridge_is() -> None:
    """No polynomial reaches it from the others."""
    psi = np.linspace(-1.0, 1.0, 48)[:, None]
    psi[47] = 6.0  # every fourth point is held out: this one too
    base, roots = ridge.local_basis(np.zeros(2), np.eye(2), 1), np.full((48, 1, 1), 0.01)
    tau = 0.1 * np.sin(2.0 * psi)
    _, off = ridge_tracing._best_fit(base, np.arange(1), psi, tau, roots, last=True)
    assert off < 0.3


def test_a_point_that_is_on_the_ridge_has_arrived() -> None:
    """Where the slope is zero to the last bit."""
    surface = humps(3, (1.0,), (1.0,), 0.0)
    base = ridge.local_basis(surface.means[0], np.eye(3), 1)
    psi, tau = np.zeros((1, 1)), np.zeros((1, 2))
    assert not surface.quadratic_model(surface.means, base.tight).slope.any()
    end, _, _, arrived = ridge_tracing.return_to_ridge(surface.quadratic_model, base, psi, tau)
    assert arrived.all()
    assert np.array_equal(end, tau)


def test_a_direction_along_which_nothing_changes_anywhere_is_flat() -> None:
    surface = humps(3, (1.0,), (1.0,), 0.0)
    flat = np.array([1.0, -2.0, 0.5])
    flat /= np.linalg.norm(flat)
    long = surface.roots[0] + 1e8 * surface.spread[:, None] * np.outer(flat, flat)
    endless = dataclasses.replace(surface, roots=long[None])
    directions = ridge_tracing.flat_directions(endless, np.random.default_rng(1))
    assert np.abs(flat @ directions) == pytest.approx([1.0], abs=1e-6)
    for bent in (ridged(1, 1), ridged(2, 3), surface):
        directions = ridge_tracing.flat_directions(bent, np.random.default_rng(1))
        assert directions.shape == (len(bent.middle), 0)


def test_an_unknown_that_its_wall_holds_back_is_loose() -> None:
    """Its maximum lies beyond the end of its prior, where a ridge would lead out of the box."""
    surface = humps(2, (1.0,), (1.0,), 0.0)
    wall = surface.means[0] + np.array([4.0, 0.0]) * surface.spread / 24.0
    cut = dataclasses.replace(surface, middle=wall + surface.reach * surface.spread)
    here = cut.quadratic_model(cut.low[None], np.eye(2))
    assert here.slope[0, 0] < 0
    base, _ = ridge_tracing.split_directions(cut, cut.low, here)
    assert base.loose.shape[1] >= 1
    assert base.loose[1, 0] == pytest.approx(0.0, abs=1e-12)


D = 4
STILL = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]]).T / np.sqrt(2.0)


@run_cases("flat", [0, 1, 2])
@run_cases("pressed", [2, 3, 4])
def test_all_that_is_held_back_and_all_that_changes_nothing_is_loose(
    flat: int, pressed: int
) -> None:
    """At a maximum in a corner of the priors, where the record would have more unknowns go further."""
    walls = Walled(np.zeros(D), np.linspace(1.0, 2.0, D), 1.0)
    centre = np.where(np.arange(D) < pressed, walls.high, 0.1 * walls.high)
    still = STILL[:, :flat]
    whitened = 1e6 * (np.eye(D) - still @ still.T)
    slope = np.where(np.arange(D) < pressed, 1e4, 0.0)
    here = QuadraticModel(
        np.zeros(1), slope[None], (whitened / np.outer(walls.spread, walls.spread))[None]
    )
    base, known = ridge_tracing.split_directions(walls, centre, here, still)
    apart = np.linalg.matrix_rank(np.concatenate([still, np.eye(D)[:, :pressed]], axis=1))
    assert base.loose.shape == (D, apart)
    assert known.shape == (apart,)
    assert (known[:flat] == 0).all()
    assert (known[flat:] > 1e7).all()
    assert np.abs(base.tight[:pressed]).max(initial=0.0) < 1e-9
    u = centre + np.random.default_rng(1).normal(0, 0.1, (5, D))
    assert base.join(*base.split(u)) == pytest.approx(u, abs=1e-12)
