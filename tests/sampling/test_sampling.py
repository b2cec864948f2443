"""Ensembles that know nothing of each other: without that, R-hat means nothing."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases
from support.closed_form_densities import Walled, humps, ridged
from support.compiled_responses import SIGMA, seen
from threadpoolctl import threadpool_info, threadpool_limits

from bayesdrill.basics.progress import Silent
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling import workers
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import (
    MemoryBackend,
    Plan,
    SamplingResult,
    begin_walkers,
    prepare,
    sample,
)
from bayesdrill.sampling.proposal.learning import LearnedProposal, learn
from bayesdrill.sampling.samplers.ensemble import State
from bayesdrill.sampling.samplers.independence import Proposal, mixture
from bayesdrill.sampling.samplers.ridge import fit_ridge, local_basis
from bayesdrill.sampling.workers import WorkerPool

N = 16  # walkers
MOVES = {
    "independence alone": {"independence": 1.0},
    "all": {"independence": 0.5, "differential_evolution": 0.4, "stretch": 0.1},
}


@cache
def problem() -> tuple[Posterior, np.ndarray, LearnedProposal]:
    """Three unknowns, the one maximum that is known (nearly), and what is learnt from it."""
    target = seen("step", SIGMA, free=("k_s", "j_1", "t_f"))
    maximum = target.space.vector(target.space.start)[None]
    return target, maximum, prepare(WorkerPool(target, 1), maximum, 1)


def run(moves: dict[str, float], seed: int = 1) -> SamplingResult:
    """Two ensembles, a few steps."""
    target, maxima, _ = problem()
    plan = Plan(
        ensembles=2,
        walkers=N,
        moves=moves,
        targets=Targets(r_hat=1.01, n_tau=50, ess=1000),
        max_steps=12,
        seed=seed,
    )
    return sample(WorkerPool(target, 1), maxima, plan, MemoryBackend(), Silent())


def steps(sampled: SamplingResult) -> list[set[bytes]]:
    """Of each ensemble, every place where a walker has been."""
    chains = [np.concatenate([piece.z for piece in pieces]) for pieces in sampled.segments]
    return [{row.tobytes() for row in chain.reshape(-1, chain.shape[-1])} for chain in chains]


def begun(seed: int, ensemble: int) -> State:
    target, _, learnt = problem()
    return begin_walkers(target, learnt.proposal, N, seed, ensemble)


@run_cases("moves", [moves for name, moves in MOVES.items()])
def test_ensembles_have_no_step_in_common(moves: dict[str, float]) -> None:
    """Proposals of their own, from starts of their own.

    Mutants killed: all ensembles from the same start points, all with the same random stream.
    """
    one, two = steps(run(moves))
    assert min(len(one), len(two)) > 3 * N  # they have moved
    assert not one & two


def test_ensembles_start_at_different_points_with_different_streams() -> None:
    """The same mutants killed, each by itself; and starts are no part of a later walk's stream."""
    starts = [begun(1, ensemble) for ensemble in range(4)]
    for one, two in itertools.combinations(starts, 2):
        assert not np.isin(one.z, two.z).any()
        assert not np.array_equal(one.random[1], two.random[1])
    random = [np.random.RandomState() for _ in starts]
    for state, start in zip(random, starts, strict=True):
        state.set_state(start.random)
    fresh = [state.random_sample(50) for state in random]
    for one, two in itertools.combinations(fresh, 2):
        assert not np.isin(one, two).any()


def test_the_same_seed_starts_and_walks_alike_and_another_does_not() -> None:
    assert np.array_equal(begun(3, 1).z, begun(3, 1).z)
    assert not np.isin(begun(3, 1).z, begun(4, 1).z).any()
    one, again, other = (steps(run(MOVES["all"], seed)) for seed in (1, 1, 2))
    assert one == again
    assert not (one[0] | one[1]) & (other[0] | other[1])


def test_starts_are_inside_the_priors_and_wider_than_the_proposal() -> None:
    """So that R-hat can tell.  Mutant killed: starts that are draws of the proposal itself."""
    target, _, learnt = problem()
    state = begin_walkers(target, learnt.proposal, 2000, 1, 0)
    assert target.supports(state.z).all()
    assert np.array_equal(state.log_p, target(state.z))
    assert np.isfinite(state.log_p).all()
    drawn, _ = learnt.proposal.draw(2000, target.supports, np.random.RandomState(2))
    assert (state.z.std(axis=0) > 1.15 * drawn.std(axis=0)).all()


def test_starts_in_a_corner_of_the_priors_are_mirrored_into_it() -> None:
    """Of a record that says nothing, where hardly a draw would be inside.

    Mutants killed: no mirror, no way inwards.
    """
    target = seen("step", 1e6 * SIGMA, free=("k_s", "j_1", "t_f"))
    surface = LogDensity(target)
    d = len(surface.low)
    base = local_basis(surface.low + 1e-9 * surface.spread, np.diag(surface.spread), d)
    point = np.zeros((1, d)), np.zeros((1, 0)), np.zeros((1, 0, 0))
    mean, root = np.full((1, d), -400.0), 50.0 * np.eye(d)[None]
    beyond = mixture([fit_ridge(base, *point, 0, 0)], [0], np.ones(1), mean, root)
    state = begin_walkers(target, Proposal(beyond, 1e-6, 0.0), 64, 1, 0)
    assert target.supports(state.z).all()
    assert np.isfinite(state.log_p).all()
    assert np.linalg.matrix_rank(state.z - state.z.mean(axis=0)) == d


def test_no_walker_starts_where_it_would_wait() -> None:
    """Where hardly a wider draw is good, those of the proposal itself are.

    Mutant killed: what is not found wider is mirrored, wherever that be.
    """
    d = 5
    surface = humps(d, (1.0,), (1.0,), 0.0)
    none = np.zeros((1, d)), np.zeros((1, 0)), np.zeros((1, 0, 0))
    base = fit_ridge(local_basis(surface.means[0], surface.roots[0], d), *none, 0, 0)
    narrow = mixture([base], [0], np.ones(1), np.zeros((1, d)), 0.3 * np.eye(d)[None])
    middle = surface.means
    usual = float((surface.value(middle) - narrow.log_density(middle))[0])
    proposal = Proposal(narrow, 1.0, usual)
    state = begin_walkers(Known(surface), proposal, 500, 1, 0)
    assert (state.log_p <= proposal.high(narrow.log_density(state.z))).all()


def test_no_walker_starts_far_off_the_ridge() -> None:
    """It would never leave: a proposal knows nothing there.  Mutant killed: any density will do."""
    surface = ridged(1, 2)
    at = surface.at(np.full((1, 1), 0.1), np.zeros((1, 2)))[0]
    learnt = learn(surface, [at], np.random.RandomState(1), np.random.default_rng(2))
    far = replace(learnt.proposal, mixture=learnt.proposal.mixture.with_width(1.5))
    state = begin_walkers(Known(surface), far, 500, 1, 0)
    assert state.log_p.min() > state.log_p.max() - 50.0
    drawn = far.mixture.with_width(1.5).draw(2000, np.random.RandomState(3)).u
    assert surface.value(drawn).min() < state.log_p.max() - 100.0


class Known:
    """What a start asks of a posterior."""

    def __init__(self, surface: Walled) -> None:
        self.value, self.supports = surface.value, surface.inside

    def __call__(self, u: np.ndarray) -> np.ndarray:
        return self.value(u)


def test_walkers_start_on_all_maxima_alike() -> None:
    """Whatever each was found to hold: that is for the moves to find.

    Mutant killed: shares that were learnt, and may be wrong, kept for the starts.
    """
    surface = humps(2, (0.9, 0.1), (1.0, 0.5), 20.0)
    seed, rng = np.random.RandomState(1), np.random.default_rng(2)
    learnt = learn(surface, list(surface.means), seed, rng)
    state = begin_walkers(Known(surface), learnt.proposal, 4000, 1, 0)
    assert surface.belongs(state.z).mean() == pytest.approx(0.5, abs=0.05)


def test_workers_map_the_arrays_of_a_large_record(monkeypatch: pytest.MonkeyPatch) -> None:
    """And load what they will need.  Mutants killed: arrays that begin where others end, and workers
    that load nothing.
    """
    target, maxima, _ = problem()
    monkeypatch.setattr(workers, "PIPE", 1000)
    with WorkerPool(target, 2) as pool:
        pool.preload(("wave", "no_such_module"))  # what is missing is for those who need it to say
        there = pool.submit(Posterior.density, maxima).result()
        # A worker that starts late has loaded nothing, and may be the first that answers.
        asked = "__import__('time').sleep(0.01) or 'wave' in __import__('sys').modules"
        assert any(pool.submit_function(eval, asked).result() for _ in range(1000))
        assert one_thread_each(pool.submit_function(threadpool_info).result())
    assert np.array_equal(there, target.density(maxima))


def one_thread_each(libraries: Sequence[Mapping[str, Any]]) -> bool:
    return all(library["num_threads"] == 1 for library in libraries)


def test_what_workers_do_and_this_process_beside_them_is_done_on_one_thread() -> None:
    """Sums of many threads depend on how many there are, and so would a chain on the machine.

    Two threads of Python may each have a pool, of which the first to open is the first to close.
    Mutants killed: a process beside its workers with all of its threads, and with one for ever.
    """
    first, second = (WorkerPool(problem()[0], 1) for _ in range(2))
    with threadpool_limits(2):
        for pool in (first, second):
            pool.__enter__()
        first.__exit__()
        assert one_thread_each(threadpool_info())
        second.__exit__()
        assert not one_thread_each(threadpool_info())
