"""Densities, draws and fits of independence proposals; `contracts/test_moves.py` tests their move."""

from dataclasses import fields, replace

import numpy as np
import pytest
import scipy.stats
from support.handmade_proposals import advance_draws, rough
from support.known_targets import TARGETS

from bayesdrill.sampling.samplers.ensemble import State, advance, always_inside
from bayesdrill.sampling.samplers.independence import (
    CachedLogDensity,
    Mixture,
    Proposal,
    WeightedDraws,
    fit_mixture,
    mixture,
)
from bayesdrill.sampling.samplers.ridge import fit_ridge, local_basis

CUT = TARGETS["cut"]
INDEPENDENT = {"independence": 1.0}


def test_densities_of_walkers_that_stay_are_not_computed_again() -> None:
    proposal = rough(TARGETS["bent"], 2, 2).mixture
    z = TARGETS["bent"].draw(50, 2, np.random.default_rng(3))
    sizes: list[int] = []

    class Counting(Mixture):
        def log_density(self, u):
            sizes.append(len(u))
            return proposal.log_density(u)

    known = CachedLogDensity(Counting(*(getattr(proposal, f.name) for f in fields(Mixture))))
    known.at(z)
    z[[3, 17]] += 0.1
    assert known.at(z) == pytest.approx(proposal.log_density(z), rel=1e-12)
    assert sizes == [50, 2]


def test_the_acceptance_predicted_from_draws_is_that_of_the_move() -> None:
    proposal = replace(rough(CUT, 5), typical_log_ratio=np.inf)
    u, log_q = proposal.draw(40_000, CUT.in_support, np.random.RandomState(2))
    assert CUT.in_support(u).all()
    weighted = WeightedDraws(u, CUT.log_density(u) - log_q, np.zeros(len(u)))
    piece = advance_draws(CUT, 5, INDEPENDENT, proposal, 12)
    assert weighted.acceptance == pytest.approx(piece.accepted.mean() / 12, abs=0.02)


def test_a_walker_in_a_tail_does_not_wait_for_ever() -> None:
    """Five standard deviations out, draws of a proposal of 0.7 of the target's width would be accepted
    once in e^12 steps.
    """
    d, start = 2, 5.0 / np.sqrt(2.0)
    psi = np.linspace(-9.0, 9.0, 40)[:, None]
    basis = local_basis(np.zeros(d), np.eye(d), 1)
    straight = fit_ridge(basis, psi, 0.0 * psi, np.ones((40, 1, 1)), 1, 0)
    narrow = mixture([straight], [0], np.ones(1), np.zeros((1, d)), 0.7 * np.eye(d)[None])
    z = np.full((64, d), start)

    def log_p(z: np.ndarray) -> np.ndarray:
        return -0.5 * (z**2).sum(axis=1)

    typical = 1.0 + np.log(2.0 * np.pi * 0.7**2)  # near the middle, where most of it is
    state = State(z, log_p(z), np.random.RandomState(4).get_state())
    proposal = Proposal(narrow, 1.0, typical)
    piece = advance(lambda z: (log_p(z), 0), state, 400, INDEPENDENT, proposal, always_inside)
    assert (np.abs(piece.z[-1] - start) > 1e-9).any(axis=1).all()


def mixture_of_bent_ridges() -> Mixture:
    """Two ridges in the plane, each with a root that changes along it; unequal weights."""
    psi = np.random.default_rng(1).normal(0.0, 2.0, (200, 1))
    turned = np.array([[0.8, -0.3], [0.5, 0.6]])
    ridges = []
    for centre, bend in (([1.0, 2.0], 0.3), ([-2.0, 0.0], -0.2)):
        basis = local_basis(np.array(centre), (1.0 + bend) * turned, 1)
        roots = 0.4 * np.exp(0.5 * psi)[:, :, None]
        ridges.append(fit_ridge(basis, psi, bend * psi**2, roots, 2, 1))
    means = np.array([[0.0, 0.0], [1.0, 0.3], [-0.5, 0.0]])
    roots = np.array(
        [[[0.7, 0.0], [0.3, 1.0]], [[0.4, 0.0], [0.0, 1.2]], [[0.9, 0.0], [-0.2, 0.8]]]
    )
    return mixture(ridges, [0, 0, 1], np.array([0.6, 0.1, 0.3]), means, roots)


def test_a_mixture_is_a_normalised_density_that_its_draws_follow() -> None:
    """By the sum over a grid, and by the numbers of draws in its blocks."""
    bent = mixture_of_bent_ridges()
    edges = [np.linspace(-8.0, 7.0, 751), np.linspace(-5.0, 9.0, 751)]
    middles = [0.5 * (axis[1:] + axis[:-1]) for axis in edges]
    grid = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
    density = np.exp(bent.log_density(grid.reshape(-1, 2))).reshape(750, 750)
    mass = density * np.prod([axis[1] - axis[0] for axis in edges])
    assert mass.sum() == pytest.approx(1.0, abs=1e-4)
    u = bent.draw(40_000, np.random.RandomState(4)).u
    coarse = mass.reshape(25, 30, 25, 30).sum(axis=(1, 3))
    counts, *_ = np.histogram2d(*u.T, bins=[axis[::30] for axis in edges])
    frequent = coarse * len(u) > 5
    expected = np.append(coarse[frequent], 1.0 - coarse[frequent].sum()) * len(u)
    seen = np.append(counts[frequent], len(u) - counts[frequent].sum())
    assert scipy.stats.chisquare(seen, expected).pvalue > 1e-6


def test_a_fitted_mixture_fills_what_the_prior_cuts_off() -> None:
    """A density that fills a box; draws that are not filled up would give an acceptance of 0.55."""

    def inside(z: np.ndarray) -> np.ndarray:
        return ((z > 2.0) & (z < 3.0)).all(axis=1)

    d = 4
    draws = np.random.default_rng(0).uniform(2.0, 3.0, (3000, d))
    basis = local_basis(np.full(d, 2.5), np.eye(d), d)
    flat = fit_ridge(basis, np.zeros((1, d)), np.zeros((1, 0)), np.zeros((1, 0, 0)), 0, 0)
    start = mixture([flat], [0], np.ones(1), np.zeros((1, d)), 0.3 * np.eye(d)[None])
    equal = np.full(len(draws), 1.0 / len(draws))
    fitted = fit_mixture(start, draws, equal, inside, 25, np.random.RandomState(1))
    u, log_q = Proposal(fitted, 0.3, 0.0).draw(10_000, inside, np.random.RandomState(2))
    assert WeightedDraws(u, -log_q, np.zeros(len(u))).acceptance > 0.65
