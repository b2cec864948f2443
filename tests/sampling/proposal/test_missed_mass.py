"""Posterior mass that a proposal misses, and the ridges to which Gauss and Newton bring every point."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.case_tables import run_cases, slow_except
from support.closed_form_densities import Ridged, corner, learned, ridge_point, ridged

from bayesdrill.sampling.proposal.learning import LearnedProposal
from bayesdrill.sampling.proposal.missed_mass import FAR_LOG_RATIO, missed_mass
from bayesdrill.sampling.proposal.ridge_tracing import newton_ridge
from bayesdrill.sampling.samplers.independence import Proposal, mixture, normalised

SIZES = [(1, 1), (2, 3)]  # loose and tight directions


@cache
def of_a_ridge(n_loose: int, n_tight: int) -> tuple[Ridged, LearnedProposal]:
    surface = ridged(n_loose, n_tight)
    return surface, learned(surface, [ridge_point(surface)])


def shortened(proposal: Proposal) -> Proposal:
    """A proposal that knows only a piece of the ridge."""
    whole = proposal.mixture
    n = whole.sheets[0].n_loose
    means, roots = whole.means.copy(), whole.roots.copy()
    means[:, :n] -= 0.6 * np.sqrt(np.einsum("kij,kij->ki", roots, roots))[:, :n]
    roots[:, :n] *= 0.25
    piece = mixture(whole.sheets, whole.sheet, whole.weights, means, roots)
    return replace(proposal, mixture=piece)


def missed(surface: Ridged, proposal: Proposal, u: np.ndarray, weights: np.ndarray) -> float:
    return missed_mass(surface, proposal, [0], (u, weights[None]), np.random.RandomState(4))


@run_cases("far", [False, True])
@run_cases("n_loose, n_tight", SIZES)
def test_points_are_brought_to_the_ridge(far: bool, n_loose: int, n_tight: int) -> None:
    """From a ridge that is off by ten standard deviations, or by hundreds, of another covariance."""
    surface, proposal = of_a_ridge(n_loose, n_tight)
    draws = proposal.draws.u
    ridge = proposal.proposal.mixture.sheets[0]
    location = ridge.location.copy()
    location[0] += (
        0.8 if far else 10.0 * np.exp(ridge.root_limits[1, :n_tight])
    )  # as wide as it gets
    moved = replace(ridge, location=location, root=0.9 * ridge.root)
    newton = newton_ridge(moved, surface.quadratic_model)
    psi, e = np.split(ridge.to_ridge_coordinates(draws)[0], [n_loose], axis=1)
    off = moved.to_ridge_coordinates(draws)[0][:, n_loose:]
    assert np.median(np.linalg.norm(off, axis=1)) > 5.0
    y, log_volume = newton.to_ridge_coordinates(draws)
    assert y[:, :n_loose] == pytest.approx(psi)
    assert np.quantile(np.abs(y[:, n_loose:] - e), 0.9) < 0.3
    back, back_volume = newton.from_ridge_coordinates(y)
    assert back == pytest.approx(draws, rel=1e-6, abs=1e-6)
    assert back_volume == pytest.approx(log_volume, abs=1e-6)


def test_points_that_do_not_arrive_stay_where_the_polynomials_have_them() -> None:
    surface, proposal = of_a_ridge(1, 1)
    ridge = proposal.proposal.mixture.sheets[0]
    lost = newton_ridge(ridge, lambda u, q: surface.quadratic_model(np.full_like(u, np.nan), q))
    psi = np.linspace(-1.0, 1.0, 7)[:, None]
    for result, expected in zip(lost.along(psi), ridge.along(psi), strict=True):
        assert np.array_equal(result, expected)


@run_cases("n_loose, n_tight", SIZES)
def test_a_proposal_of_the_whole_ridge_misses_nothing(n_loose: int, n_tight: int) -> None:
    surface, proposal = of_a_ridge(n_loose, n_tight)
    assert proposal.missed == 0.0
    assert missed(surface, proposal.proposal, proposal.draws.u, proposal.draws.weights) == 0.0


@run_cases("n_loose, n_tight", SIZES)
def test_the_missed_mass_of_a_shortened_proposal_is_that_of_the_whole(
    n_loose: int, n_tight: int
) -> None:
    """From draws of the piece, whose weights say nothing of the rest."""
    surface, proposal = of_a_ridge(n_loose, n_tight)
    piece = shortened(proposal.proposal)
    u, log_q = piece.draw(2000, surface.in_support, np.random.RandomState(2))
    share = missed(surface, piece, u, normalised(surface.value(u) - log_q))
    whole = proposal.draws
    ratio = surface.value(whole.u) - piece.mixture.log_density(whole.u)
    far = ratio > piece.typical_log_ratio + FAR_LOG_RATIO
    assert share == pytest.approx(whole.weights[far].sum(), abs=0.05)
    assert share > 0.2


@pytest.mark.parametrize("start", slow_except(((-1e-4, -9.0),), ((-1e-4, -9.0), (-9.0, -1e-4))))
def test_a_ridge_that_turns_a_corner_is_not_covered(start: tuple[float, float]) -> None:
    """From either end: beyond the corner, where tight and loose are exchanged, lies a half."""
    assert learned(corner(), [np.array(start)], 1).missed > 0.05
