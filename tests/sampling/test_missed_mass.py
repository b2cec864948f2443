"""Posterior mass that a proposal misses, and the ridges to which Gauss and Newton bring every point."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.case_tables import for_each, run_cases
from support.closed_form_densities import Ridged, corner, ridged

from bayesdrill.sampling.proposal.learning import LearnedProposal, learn
from bayesdrill.sampling.proposal.missed_mass import FAR_LOG_RATIO, missed_mass
from bayesdrill.sampling.proposal.ridge_tracing import newton_ridge
from bayesdrill.sampling.samplers.independence import Proposal, mixture, normalised


@cache
def learnt(n_loose: int, n_tight: int) -> tuple[Ridged, LearnedProposal]:
    surface = ridged(n_loose, n_tight)
    start = surface.at(np.full((1, n_loose), 0.1), np.zeros((1, n_tight)))[0]
    seed, rng = np.random.RandomState(1), np.random.default_rng(3)
    return surface, learn(surface, [start], seed, rng)


def shortened(proposal: Proposal) -> Proposal:
    """That knows only a piece of the ridge."""
    own = proposal.mixture
    n = own.sheets[0].n_loose
    means, roots = own.means.copy(), own.roots.copy()
    means[:, :n] -= 0.6 * np.sqrt(np.einsum("kij,kij->ki", roots, roots))[:, :n]
    roots[:, :n] *= 0.25
    return replace(proposal, mixture=mixture(own.sheets, own.sheet, own.weights, means, roots))


def missed(surface: Ridged, proposal: Proposal, u: np.ndarray, weights: np.ndarray) -> float:
    return missed_mass(surface, proposal, [0], (u, weights[None]), np.random.RandomState(4))


@run_cases(
    "far, n_loose, n_tight", [(far, *case) for far in [False, True] for case in [(1, 1), (2, 3)]]
)
def test_points_are_brought_to_the_ridge(far: bool, n_loose: int, n_tight: int) -> None:
    """From one that is off by ten standard deviations, or by hundreds, and has another
    covariance.

    Mutant killed: points that are far astray are given up.
    """
    surface, found = learnt(n_loose, n_tight)
    own = found.proposal.mixture.sheets[0]
    place = own.location.copy()
    place[0] += 0.8 if far else 10.0 * np.exp(own.ends[1, :n_tight])  # as wide as it gets
    moved = replace(own, location=place, root=0.9 * own.root)
    home = newton_ridge(moved, surface.quadratic_model)
    psi, e = np.split(own.to_ridge_coordinates(found.draws.u)[0], [n_loose], axis=1)
    assert (
        np.median(np.linalg.norm(moved.to_ridge_coordinates(found.draws.u)[0][:, n_loose:], axis=1))
        > 5.0
    )
    y, log_volume = home.to_ridge_coordinates(found.draws.u)
    assert y[:, :n_loose] == pytest.approx(psi)
    assert np.quantile(np.abs(y[:, n_loose:] - e), 0.9) < 0.3
    back, again = home.from_ridge_coordinates(y)
    assert back == pytest.approx(found.draws.u, rel=1e-6, abs=1e-6)
    assert again == pytest.approx(log_volume, abs=1e-6)


def test_what_does_not_arrive_stays_where_the_polynomials_have_it() -> None:
    surface, found = learnt(1, 1)
    own = found.proposal.mixture.sheets[0]
    nowhere = newton_ridge(own, lambda u, q: surface.quadratic_model(np.full_like(u, np.nan), q))
    psi = np.linspace(-1.0, 1.0, 7)[:, None]
    for one, other in zip(nowhere.along(psi), own.along(psi), strict=True):
        assert np.array_equal(one, other)


@run_cases("n_loose, n_tight", [(1, 1), (2, 3)])
def test_a_proposal_that_leaves_nothing_out_is_enough(n_loose: int, n_tight: int) -> None:
    surface, found = learnt(n_loose, n_tight)
    assert found.missed == 0.0
    assert missed(surface, found.proposal, found.draws.u, found.draws.weights) == 0.0


@run_cases("n_loose, n_tight", [(1, 1), (2, 3)])
def test_what_a_proposal_leaves_out_is_found(n_loose: int, n_tight: int) -> None:
    """As much as draws of the whole say, from draws of the piece, whose weights say nothing of it.

    Mutant killed: no look at what a proposal leaves out.
    """
    surface, found = learnt(n_loose, n_tight)
    piece = shortened(found.proposal)
    u, log_q = piece.draw(2000, surface.inside, np.random.RandomState(2))
    share = missed(surface, piece, u, normalised(surface.value(u) - log_q))
    ratio = surface.value(found.draws.u) - piece.mixture.log_density(found.draws.u)
    far = ratio > piece.typical_log_ratio + FAR_LOG_RATIO
    assert share == pytest.approx(found.draws.weights[far].sum(), abs=0.05)
    assert share > 0.2


def test_a_ridge_that_turns_a_corner_is_not_covered() -> None:
    """From either end: beyond the corner, where tight and loose are exchanged, lies a half.

    Mutant killed: no look at what a proposal leaves out.
    """
    surface = corner()

    def check(seed: int, *start: float) -> None:
        walk, rng = np.random.RandomState(seed), np.random.default_rng(seed + 1)
        assert learn(surface, [np.array(start)], walk, rng).missed > 0.05

    cases = [(1, -1e-4, -9.0), (4, -9.0, -1e-4), (7, -9.0, -1e-4)]
    for_each({str(case): case for case in cases}, check)
