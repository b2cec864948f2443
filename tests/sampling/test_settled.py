"""Ridges to which Gauss and Newton bring every point: a density all the same, and what it finds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from surfaces import Ridged, corner, ridged
from together import for_each

from bayesdrill.sampling.proposal.learning import LearnedProposal, learn
from bayesdrill.sampling.proposal.missed_mass import CoverageCheck, check_coverage
from bayesdrill.sampling.proposal.ridge_tracing import newton_mixture, newton_ridge
from bayesdrill.sampling.samplers.ensemble import State, advance
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


def looked(
    surface: Ridged, proposal: Proposal, u: np.ndarray, weights: np.ndarray
) -> CoverageCheck | None:
    seed = np.random.RandomState(4)
    return check_coverage(
        surface,
        proposal,
        [0],
        (u, weights[None]),
        seed,
        np.random.default_rng(6),
    )


@cache
def found_beyond(n_loose: int, n_tight: int) -> tuple[Proposal, np.ndarray, CoverageCheck | None]:
    """A proposal of a piece, draws of it, and what is found beside them; looked for once."""
    surface, found = learnt(n_loose, n_tight)
    piece = shortened(found.proposal)
    u, log_q = piece.draw(2000, surface.inside, np.random.RandomState(2))
    return piece, u, looked(surface, piece, u, normalised(surface.value(u) - log_q))


def test_points_are_brought_to_the_ridge() -> None:
    """From one that is off by ten standard deviations, or by hundreds, and has another
    covariance.

    Mutant killed: points that are far astray are given up.
    """

    def check(far: bool, n_loose: int, n_tight: int) -> None:
        surface, found = learnt(n_loose, n_tight)
        own = found.proposal.mixture.sheets[0]
        place = own.location.copy()
        place[0] += 0.8 if far else 10.0 * np.exp(own.ends[1, :n_tight])  # as wide as it gets
        moved = replace(own, location=place, root=0.9 * own.root)
        home = newton_ridge(moved, surface.quadratic_model)
        psi, e = np.split(own.to_ridge_coordinates(found.draws.u)[0], [n_loose], axis=1)
        assert (
            np.median(
                np.linalg.norm(moved.to_ridge_coordinates(found.draws.u)[0][:, n_loose:], axis=1)
            )
            > 5.0
        )
        y, log_volume = home.to_ridge_coordinates(found.draws.u)
        assert y[:, :n_loose] == pytest.approx(psi)
        assert np.quantile(np.abs(y[:, n_loose:] - e), 0.9) < 0.3
        back, again = home.from_ridge_coordinates(y)
        assert back == pytest.approx(found.draws.u, rel=1e-6, abs=1e-6)
        assert again == pytest.approx(log_volume, abs=1e-6)

    for_each(
        {f"{far} {case}": (far, *case) for far in [False, True] for case in [(1, 1), (2, 3)]}, check
    )


def test_what_does_not_arrive_stays_where_the_polynomials_have_it() -> None:
    surface, found = learnt(1, 1)
    own = found.proposal.mixture.sheets[0]
    nowhere = newton_ridge(own, lambda u, q: surface.quadratic_model(np.full_like(u, np.nan), q))
    psi = np.linspace(-1.0, 1.0, 7)[:, None]
    for one, other in zip(nowhere.along(psi), own.along(psi), strict=True):
        assert np.array_equal(one, other)


def test_a_proposal_that_leaves_nothing_out_is_enough() -> None:
    def check(n_loose: int, n_tight: int) -> None:
        surface, found = learnt(n_loose, n_tight)
        assert found.proposal.newton is None
        assert looked(surface, found.proposal, found.draws.u, found.draws.weights) is None

    for_each({str(case): case for case in [(1, 1), (2, 3)]}, check)


def test_what_a_proposal_leaves_out_is_found() -> None:
    """From draws of the piece that it knows, whose own weights say that nothing is missing.

    Mutants killed: only draws of the proposal itself are looked at.
    """

    def check(n_loose: int, n_tight: int) -> None:
        _, found = learnt(n_loose, n_tight)
        _, _, seen = found_beyond(n_loose, n_tight)
        assert seen is not None
        truth, said = ((one.weights @ one.u) for one in (found.draws, seen.draws))
        sd = np.sqrt(found.draws.weights @ (found.draws.u - truth) ** 2)
        assert np.all(np.abs(said - truth) < 0.15 * sd)

    for_each({str(case): case for case in [(1, 1), (2, 3)]}, check)


def test_walkers_reach_what_the_proposal_leaves_out() -> None:
    """Means of a chain whose other proposal hardly ever goes there.

    Mutants killed: the settled proposal never drawn from, or weighed with the other's density.
    """
    surface, found = learnt(2, 3)
    piece, u, seen = found_beyond(2, 3)
    assert seen is not None
    own = replace(
        seen.proposal, mixture=newton_mixture(seen.proposal.mixture, surface.quadratic_model)
    )
    whole = replace(piece, newton=own)
    start = u[:200]
    state = State(start, surface.value(start), np.random.RandomState(5).get_state())
    evaluate = lambda u: (surface.value(u), 0)  # noqa: E731
    chain = advance(evaluate, state, 300, {"independence": 1.0}, whole, surface.inside)
    truth = found.draws.weights @ found.draws.u
    sd = np.sqrt(found.draws.weights @ (found.draws.u - truth) ** 2)
    means = chain.z[50:].reshape(-1, len(sd)).mean(axis=0)
    assert np.all(np.abs(means - truth) < 0.1 * sd)


CORNERS = [
    pytest.param([(1, -1e-4, -9.0), (4, -9.0, -1e-4)], id="quick"),
    pytest.param([(7, -9.0, -1e-4)], id="long", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("cases", CORNERS)
def test_a_ridge_that_turns_a_corner_is_seen_on_both_sides(
    cases: list[tuple[int, float, float]],
) -> None:
    """From either end: the half beyond the corner, where tight and loose are exchanged.

    Mutant killed: no walkers that look for places which draws do not show.
    """
    surface = corner()

    def check(seed: int, *start: float) -> None:
        walk, rng = np.random.RandomState(seed), np.random.default_rng(seed + 1)
        found = learn(surface, [np.array(start)], walk, rng)
        beyond = found.draws.u[:, 1] > found.draws.u[:, 0]
        assert found.draws.weights @ beyond == pytest.approx(0.5, abs=0.1)

    for_each({str(case): case for case in cases}, check)
