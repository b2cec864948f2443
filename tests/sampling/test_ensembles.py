"""Ensembles that know nothing of each other, where their walkers start, and runs that are cut."""

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import Walled, humps, learned, ridge_point, ridged
from support.compiled_responses import SIGMA, seen
from support.small_problems import noisy_step, posterior

from bayesdrill.basics.progress import Silent
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.report.findings import finding_sentence
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import (
    MemoryBackend,
    Plan,
    SamplingResult,
    begin_walkers,
    prepare,
    sample,
)
from bayesdrill.sampling.proposal.learning import LearnedProposal
from bayesdrill.sampling.samplers.ensemble import State
from bayesdrill.sampling.samplers.independence import Mixture, Proposal, mixture
from bayesdrill.sampling.samplers.ridge import LocalBasis, fit_ridge, local_basis
from bayesdrill.sampling.workers import WorkerPool

WALKERS = 16
ALL_MOVES = {"independence": 0.5, "differential_evolution": 0.4, "stretch": 0.1}


@cache
def problem() -> tuple[Posterior, np.ndarray, LearnedProposal]:
    """Three unknowns, the one maximum that is known (nearly), and what is learnt from it."""
    target = seen("step", SIGMA, free=("k_s", "j_1", "t_f"))
    maximum = target.space.vector(target.space.start)[None]
    return target, maximum, prepare(WorkerPool(target, 1), maximum, 1)


def visited(moves: dict[str, float], seed: int = 1) -> list[set[bytes]]:
    """Of two ensembles that make a few steps, every place where a walker has been."""
    target, maxima, _ = problem()
    targets = Targets(r_hat=1.01, n_tau=50, ess=1000)
    plan = Plan(
        ensembles=2, walkers=WALKERS, moves=moves, targets=targets, max_steps=12, seed=seed
    )  # fmt: skip
    result = sample(WorkerPool(target, 1), maxima, plan, MemoryBackend(), Silent())
    chains = [np.concatenate([segment.z for segment in chain]) for chain in result.segments]
    return [{row.tobytes() for row in chain.reshape(-1, chain.shape[-1])} for chain in chains]


def begin(seed: int, ensemble: int) -> State:
    target, _, proposal = problem()
    return begin_walkers(target, proposal.proposal, WALKERS, seed, ensemble)


@run_cases("moves", [{"independence": 1.0}, ALL_MOVES])
def test_ensembles_have_no_step_in_common(moves: dict[str, float]) -> None:
    first, second = visited(moves)
    assert min(len(first), len(second)) > 3 * WALKERS  # they have moved
    assert not first & second


def test_ensembles_start_at_different_points_with_different_streams() -> None:
    """Starts are no part of a later walk's stream."""
    starts = [begin(1, ensemble) for ensemble in range(4)]
    for first, second in itertools.combinations(starts, 2):
        assert not np.isin(first.z, second.z).any()
        assert not np.array_equal(first.random[1], second.random[1])
    streams = [np.random.RandomState() for _ in starts]
    for stream, start in zip(streams, starts, strict=True):
        stream.set_state(start.random)
    for first, second in itertools.combinations([s.random_sample(50) for s in streams], 2):
        assert not np.isin(first, second).any()


# --- where walkers start ---------------------------------------------------------------------------


class Known:
    """What a start asks of a posterior, of a surface in closed form."""

    def __init__(self, surface: Walled) -> None:
        self.value, self.supports = surface.value, surface.in_support

    def __call__(self, u: np.ndarray) -> np.ndarray:
        return self.value(u)


def straight(base: LocalBasis, mean: float, width: float) -> Mixture:
    """A mixture of one normal component, over a ridge that bends nowhere."""
    d = len(base.centre)
    nowhere = np.zeros((1, d)), np.zeros((1, 0)), np.zeros((1, 0, 0))
    ridge = fit_ridge(base, *nowhere, 0, 0)
    return mixture([ridge], [0], np.ones(1), np.full((1, d), mean), width * np.eye(d)[None])


def test_starts_are_inside_the_priors_and_wider_than_the_proposal() -> None:
    """So that R-hat can tell."""
    target, _, proposal = problem()
    state = begin_walkers(target, proposal.proposal, 2000, 1, 0)
    assert target.supports(state.z).all()
    assert np.array_equal(state.log_p, target(state.z))
    assert np.isfinite(state.log_p).all()
    drawn, _ = proposal.proposal.draw(2000, target.supports, np.random.RandomState(2))
    assert (state.z.std(axis=0) > 1.15 * drawn.std(axis=0)).all()


def test_starts_in_a_corner_of_the_priors_are_mirrored_into_it() -> None:
    """Of a record that says nothing, where hardly a draw would be inside."""
    target = seen("step", 1e6 * SIGMA, free=("k_s", "j_1", "t_f"))
    surface = LogDensity(target)
    d = len(surface.low)
    base = local_basis(surface.low + 1e-9 * surface.spread, np.diag(surface.spread), d)
    beyond = straight(base, -400.0, 50.0)
    state = begin_walkers(target, Proposal(beyond, 1e-6, 0.0), 64, 1, 0)
    assert target.supports(state.z).all()
    assert np.isfinite(state.log_p).all()
    assert np.linalg.matrix_rank(state.z - state.z.mean(axis=0)) == d


def test_no_walker_starts_where_it_would_wait() -> None:
    """Where hardly a wider draw is good, those of the proposal itself are."""
    surface = humps(5, (1.0,), (1.0,), 0.0)
    narrow = straight(local_basis(surface.means[0], surface.roots[0], 5), 0.0, 0.3)
    usual = float((surface.value(surface.means) - narrow.log_density(surface.means))[0])
    proposal = Proposal(narrow, 1.0, usual)
    state = begin_walkers(Known(surface), proposal, 500, 1, 0)
    assert (state.log_p <= proposal.trapping_log_p(narrow.log_density(state.z))).all()


def test_no_walker_starts_far_off_the_ridge() -> None:
    """It would never leave, as a proposal knows nothing there."""
    surface = ridged(1, 2)
    proposal = learned(surface, [ridge_point(surface)]).proposal
    wide = replace(proposal, mixture=proposal.mixture.with_width(1.5))
    state = begin_walkers(Known(surface), wide, 500, 1, 0)
    assert state.log_p.min() > state.log_p.max() - 50.0
    drawn = wide.mixture.with_width(1.5).draw(2000, np.random.RandomState(3)).u
    assert surface.value(drawn).min() < state.log_p.max() - 100.0


def test_walkers_start_on_all_maxima_alike() -> None:
    """Whatever each seems to hold: that is for the moves to find out."""
    surface = humps(2, (0.9, 0.1), (1.0, 0.5), 20.0)
    proposal = learned(surface, surface.means).proposal
    state = begin_walkers(Known(surface), proposal, 4000, 1, 0)
    assert surface.belongs(state.z).mean() == pytest.approx(0.5, abs=0.05)


# --- runs that are given up, and cut ---------------------------------------------------------------

HOPELESS = Plan(
    ensembles=2,
    walkers=8,
    moves={"stretch": 1.0},
    targets=Targets(r_hat=1.01, n_tau=1e6, ess=1000),
    max_steps=20_000,
    seed=4,
)


def run_hopelessly(backend: MemoryBackend) -> SamplingResult:
    sigma = np.full(4, 0.1)
    target = posterior(noisy_step(sigma, n=60), sigma, free=("k_s", "j_1"))
    maximum = target.space.vector(target.space.start)[None]
    return sample(WorkerPool(target, 1), maximum, HOPELESS, backend, Silent())


@cache
def whole() -> tuple[SamplingResult, MemoryBackend]:
    backend = MemoryBackend()
    return run_hopelessly(backend), backend


def test_a_run_that_would_take_too_long_is_given_up() -> None:
    convergence = whole()[0].convergence
    assert 1000 <= convergence.steps < 1250  # a check is made whenever a quarter is added
    assert "more than sampler.max_steps (20000)" in finding_sentence(convergence.reasons[-1])


@pytest.mark.slow
@pytest.mark.parametrize("kept", [(2, 4), (1, 0), (0, 0), (4, 4), (-1, -1)])
def test_a_run_that_was_cut_is_given_up_at_the_same_step(kept: tuple[int, int]) -> None:
    """Ensembles may have been cut at different steps."""
    result, backend = whole()
    cut = MemoryBackend({k: backend.segments(k)[:n] for k, n in enumerate(kept) if n})
    again = run_hopelessly(cut)
    assert again.convergence.steps == result.convergence.steps
    assert again.convergence.reasons == result.convergence.reasons
    assert np.array_equal(again.theta, result.theta)


def test_the_same_seed_starts_and_walks_alike_and_another_does_not() -> None:
    assert np.array_equal(begin(3, 1).z, begin(3, 1).z)
    assert not np.isin(begin(3, 1).z, begin(4, 1).z).any()
    run, again, other = (visited(ALL_MOVES, seed) for seed in (1, 1, 2))
    assert run == again
    assert not (run[0] | run[1]) & (other[0] | other[1])
