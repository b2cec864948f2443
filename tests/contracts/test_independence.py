"""The independence proposal: exact whatever it is made of, and good where it should be.

The exact test is that of `test_moves.py`: walkers that start i.i.d. from the target stay so.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace

import emcee
import numpy as np
import pytest
import scipy.stats
from support.case_tables import run_cases
from support.handmade_proposals import over, rough
from support.known_targets import TARGETS, Target

from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State, advance, step_trapped
from bayesdrill.sampling.samplers.independence import (
    LONG_LOG_RATIO,
    CachedLogDensity,
    Mixture,
    Proposal,
    WeightedDraws,
    fit_mixture,
    mixture,
)
from bayesdrill.sampling.samplers.ridge import (
    fit_ridge,
    local_basis,
)

FAIL = 1e-6
STEPS = 12
ALONE = {"independence": 1.0}
TWO = {name: TARGETS[name] for name in ("wild", "bent", "cut", "boxed", "humps")}
CUT = TARGETS["cut"]


def walked(target: Target, d: int, proposal: Proposal, steps: int = STEPS) -> ChainSegment:
    z = target.draw(4000, d, np.random.default_rng(50 + d))
    state = State(z, target.log_density(z), np.random.RandomState(50 + d).get_state())
    evaluate = lambda z: (target.log_density(z), 0)  # noqa: E731
    return advance(evaluate, state, steps, ALONE, proposal, target.inside)


@run_cases("d", [2, 5, 9])
@run_cases("target", TWO.values(), ids=TWO)
def test_target_is_kept_exactly_over_two_ridges(target: Target, d: int) -> None:
    """Ridges in units of their own, the draws of one likely on the other or never.

    Mutants killed: the weights of components left out of the density, the volume of a basis
    forgotten, draws cut off in the order of their components, densities beside their points.
    """
    piece = walked(target, d, rough(target, d, 2))
    assert 0.03 < piece.accepted.mean() / STEPS < 0.95
    assert target.p_values(piece.state.z).min() > FAIL


def test_densities_are_remembered_of_walkers_that_stay() -> None:
    """Mutant killed: what a density was before a walker moved."""
    mixture = rough(TARGETS["bent"], 2, 2).mixture
    z = TARGETS["bent"].draw(50, 2, np.random.default_rng(3))
    asked: list[int] = []

    class Counting(Mixture):
        def log_density(self, u):
            asked.append(len(u))
            return mixture.log_density(u)

    known = CachedLogDensity(
        Counting(*(getattr(mixture, f.name) for f in dataclasses.fields(Mixture)))
    )
    known.at(z)
    z[[3, 17]] += 0.1
    assert known.at(z) == pytest.approx(mixture.log_density(z), rel=1e-12)
    assert asked == [50, 2]


def test_redraws_that_run_out_keep_the_target(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws outside the prior are then proposed, and never accepted."""
    monkeypatch.setattr(independence, "MAX_REDRAWS", 1)
    few = replace(rough(CUT, 5), share=1.0)
    piece = walked(CUT, 5, few)
    assert CUT.inside(piece.z.reshape(-1, 5)).all()
    assert CUT.p_values(piece.state.z).min() > FAIL


def test_a_forgotten_proposal_density_is_found_out() -> None:
    """The power of the exact test: without q(old)/q(new) the walkers follow p q."""

    class Forgetful(Mixture):
        def log_density_at(self, y, jacobian):
            return np.zeros(y.shape[1])

    own = rough(CUT, 2)
    fields = (getattr(own.mixture, field.name) for field in dataclasses.fields(Mixture))
    forgetful = replace(own, mixture=Forgetful(*fields), typical_log_ratio=np.inf)
    assert CUT.p_values(walked(CUT, 2, forgetful).state.z).min() < FAIL


@run_cases("name, d", [("wild", 5), ("bent", 2), ("humps", 5)])
def test_steps_of_walkers_by_themselves_keep_the_target(name: str, d: int) -> None:
    """About half of them step, since their limit is set where most of the target is.

    Mutants killed: the share of q that a component has where the step ends forgotten, the Jacobian
    of the ridge, steps over the limit.
    """
    target = TWO[name]
    own = rough(target, d, 2)
    waiting = Waiting(replace(own, typical_log_ratio=own.typical_log_ratio - LONG_LOG_RATIO))
    z = target.draw(4000, d, np.random.default_rng(60 + d))
    random = np.random.RandomState(60 + d).get_state()
    sampler = emcee.EnsembleSampler(4000, d, target.log_density, moves=waiting, vectorize=True)
    start = emcee.State(z, log_prob=target.log_density(z), random_state=random)
    end = sampler.run_mcmc(start, 200, skip_initial_state_check=True)
    assert 0.01 < sampler.acceptance_fraction.mean() < 0.5
    assert target.p_values(end.coords).min() > FAIL


@dataclass(frozen=True)
class Waiting:
    """Nothing but steps of walkers by themselves."""

    proposal: Proposal

    def propose(self, model, state):
        log_q = self.proposal.mixture.log_density(state.coords)
        return state, step_trapped(model, state, self.proposal, log_q)


def test_acceptance_foreseen_is_that_of_the_move() -> None:
    """From draws of the proposal alone, before any walker takes a step."""
    proposal = replace(rough(CUT, 5), typical_log_ratio=np.inf)
    u, log_q = proposal.draw(40_000, CUT.inside, np.random.RandomState(2))
    assert CUT.inside(u).all()
    alike = np.zeros(len(u))
    weighed = WeightedDraws(u, CUT.log_density(u) - log_q, alike)
    piece = walked(CUT, 5, proposal)
    assert weighed.acceptance == pytest.approx(piece.accepted.mean() / STEPS, abs=0.02)


def test_a_walker_in_a_tail_does_not_wait_for_ever() -> None:
    """A proposal of 0.7 of the target's width: five standard deviations out, its draws would be
    accepted once in e^12 steps.  Mutant killed: no walker ever steps by itself.
    """
    d, out = 2, 5.0
    psi = np.linspace(-9.0, 9.0, 40)[:, None]
    flat = fit_ridge(
        local_basis(np.zeros(d), np.eye(d), 1), psi, 0.0 * psi, np.ones((40, 1, 1)), 1, 0
    )
    narrow = mixture([flat], [0], np.ones(1), np.zeros((1, d)), 0.7 * np.eye(d)[None])
    z = np.full((64, d), out / np.sqrt(d))

    def log_p(z: np.ndarray) -> np.ndarray:
        return -0.5 * (z**2).sum(axis=1)

    state = State(z, log_p(z), np.random.RandomState(4).get_state())
    inside = lambda z: np.ones(len(z), dtype=bool)  # noqa: E731
    usual = 1.0 + np.log(2.0 * np.pi * 0.7**2)  # near the middle, where most of it is
    proposal = Proposal(narrow, 1.0, usual)
    piece = advance(lambda z: (log_p(z), 0), state, 400, ALONE, proposal, inside)
    assert (np.abs(piece.z[-1] - out / np.sqrt(d)) > 1e-9).any(axis=1).all()


def bent_mixture() -> Mixture:
    """Two ridges in the plane, each with a root that changes along it; unequal weights."""
    rng = np.random.default_rng(1)
    psi = rng.normal(0.0, 2.0, (200, 1))
    turned = np.array([[0.8, -0.3], [0.5, 0.6]])
    sheets = []
    for centre, bow in (([1.0, 2.0], 0.3), ([-2.0, 0.0], -0.2)):
        roots = 0.4 * np.exp(0.5 * psi)[:, :, None]
        base = local_basis(np.array(centre), (1.0 + bow) * turned, 1)
        sheets.append(fit_ridge(base, psi, bow * psi**2, roots, 2, 1))
    means = np.array([[0.0, 0.0], [1.0, 0.3], [-0.5, 0.0]])
    roots = np.array(
        [[[0.7, 0.0], [0.3, 1.0]], [[0.4, 0.0], [0.0, 1.2]], [[0.9, 0.0], [-0.2, 0.8]]]
    )
    return mixture(sheets, [0, 0, 1], np.array([0.6, 0.1, 0.3]), means, roots)


def test_a_mixture_is_a_normalised_density_that_its_draws_follow() -> None:
    """On a grid.  Mutants killed: the weights, the Jacobian or the volume left out of the density."""
    found = bent_mixture()
    edges = [np.linspace(-8.0, 7.0, 751), np.linspace(-5.0, 9.0, 751)]
    middles = [0.5 * (one[1:] + one[:-1]) for one in edges]
    grid = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1)
    density = np.exp(found.log_density(grid.reshape(-1, 2))).reshape(750, 750)
    mass = density * np.prod([one[1] - one[0] for one in edges])
    assert mass.sum() == pytest.approx(1.0, abs=1e-4)
    u = found.draw(40_000, np.random.RandomState(4)).u
    coarse = mass.reshape(25, 30, 25, 30).sum(axis=(1, 3))
    counts, *_ = np.histogram2d(*u.T, bins=[one[::30] for one in edges])
    often = coarse * len(u) > 5
    expected = np.append(coarse[often], 1.0 - coarse[often].sum()) * len(u)
    seen = np.append(counts[often], len(u) - counts[often].sum())
    assert scipy.stats.chisquare(seen, expected).pvalue > FAIL


def test_what_the_prior_cuts_off_is_filled_up() -> None:
    """A density that fills a box; mutant killed: no filling up (acceptance 0.55)."""

    def inside(z: np.ndarray) -> np.ndarray:
        return ((z > 2.0) & (z < 3.0)).all(axis=1)

    d = 4
    draws = np.random.default_rng(0).uniform(2.0, 3.0, (3000, d))
    none = np.zeros((1, 0))
    base = fit_ridge(
        local_basis(np.full(d, 2.5), np.eye(d), d),
        np.zeros((1, d)),
        none,
        np.zeros((1, 0, 0)),
        0,
        0,
    )
    start = mixture([base], [0], np.ones(1), np.zeros((1, d)), 0.3 * np.eye(d)[None])
    equal = np.full(len(draws), 1.0 / len(draws))
    found = fit_mixture(start, draws, equal, inside, 25, np.random.RandomState(1))
    u, log_q = Proposal(found, 0.3, 0.0).draw(10_000, inside, np.random.RandomState(2))
    assert WeightedDraws(u, -log_q, np.zeros(len(u))).acceptance > 0.65


def test_a_wider_mixture_has_equal_shares_of_its_ridges() -> None:
    """Where ensembles start: mutant killed: the shares that have been found, or guessed, kept."""
    found = over(TARGETS["two_modes"], 3, 2)
    wide = found.with_width(1.5)
    drawn = wide.draw(20_000, np.random.RandomState(5)).u
    assert TARGETS["two_modes"].hump(drawn).mean() == pytest.approx(0.5, abs=0.02)
    y, _ = wide.sheets[0].to_ridge_coordinates(drawn[TARGETS["two_modes"].hump(drawn) == 0])
    own = wide.sheets[0].to_ridge_coordinates(found.draw(20_000, np.random.RandomState(6)).u)[0]
    own = own[TARGETS["two_modes"].hump(wide.sheets[0].from_ridge_coordinates(own)[0]) == 0]
    assert y.std(axis=0) == pytest.approx(1.5 * own.std(axis=0), rel=0.1)
