"""Exact tests of every move: walkers that start i.i.d. from the target stay i.i.d. from it.

No chain has to converge and no error has to be estimated: after any number of steps of a correct
kernel the walkers of one ensemble are still independent draws, so a Kolmogorov-Smirnov test is
exact.  Mutants killed: a Hastings factor dropped or off by one power, emcee 3.1.6's snooker, the
Jacobian of a ridge forgotten, its root taken at another point on the way back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import emcee
import numpy as np
import pytest
from support.case_tables import run_cases
from support.handmade_proposals import rough
from support.known_targets import TARGETS, Target

from bayesdrill.config.schema.config import SamplerSpec
from bayesdrill.sampling.samplers.ensemble import (
    MOVES,
    ChainSegment,
    State,
    advance,
    always_inside,
    moves_with_weights,
)
from bayesdrill.sampling.samplers.independence import Proposal

FAIL = 1e-6  # one false alarm in a million
WALKERS = 4000
STEPS = 12

STRAIGHT = {name: TARGETS[name] for name in ("mild", "wild")}
# Every move where a ridge bends; of the targets that are harder in another way, each with one move.
PAIRS = [(move, "bent") for move in MOVES]
PAIRS += [("differential_evolution", name) for name in TARGETS if name not in ("mild", "bent")]
WITHOUT = [name for name in MOVES if moves_with_weights({name: 1.0}, None, always_inside)]


def walked(
    target: Target,
    d: int,
    moves: Mapping[str, float],
    proposal: Proposal | None,
    steps: int = STEPS,
) -> ChainSegment:
    """From i.i.d. draws."""
    z = target.draw(WALKERS, d, np.random.default_rng(100 + d))
    state = State(z, target.log_density(z), np.random.RandomState(100 + d).get_state())
    evaluate = lambda z: (target.log_density(z), 0)  # noqa: E731
    return advance(evaluate, state, steps, moves, proposal, target.inside)


def through(move: Callable[[], emcee.moves.Move], target: Target, d: int, seed: int) -> np.ndarray:
    """Where emcee alone brings the walkers with one move."""
    z = target.draw(WALKERS, d, np.random.default_rng(seed))
    random = np.random.RandomState(seed).get_state()
    sampler = emcee.EnsembleSampler(WALKERS, d, target.log_density, moves=move(), vectorize=True)
    start = emcee.State(z, log_prob=target.log_density(z), random_state=random)
    return sampler.run_mcmc(start, 40, skip_initial_state_check=True).coords


@run_cases("name", TARGETS)
def test_draws_of_the_targets_follow_their_densities(name: str) -> None:
    target = TARGETS[name]
    for d in (2, 5, 9):
        x = target.draw(WALKERS, d, np.random.default_rng(d))
        assert target.p_values(x).min() > 1e-3
        assert target.inside(x).all()
    if name in ("cut", "boxed"):
        return  # what is moved there leaves the support
    # Importance weights between the density and itself moved a little average to one.
    x = target.draw(200_000, 2, np.random.default_rng(1))
    shift = 0.02 * np.array(target.scales[:2])
    weights = np.exp(target.log_density(x + shift) - target.log_density(x))
    assert weights.mean() == pytest.approx(1.0, abs=5 * weights.std() / np.sqrt(len(x)))


@run_cases("d", [2, 5, 9])
@run_cases("name, of", PAIRS)
def test_target_is_kept_exactly(name: str, of: str, d: int) -> None:
    """A move along a ridge or over it: bent, in units of its own, unlike the target."""
    target = TARGETS[of]
    piece = walked(target, d, {name: 1.0}, rough(target, d))
    assert 0.03 < piece.accepted.mean() / STEPS < 0.95
    assert target.p_values(piece.state.z).min() > FAIL


@run_cases("d", [2, 5, 9])
@run_cases("target", STRAIGHT.values(), ids=STRAIGHT)
@run_cases("name", WITHOUT)
def test_target_is_kept_exactly_where_nothing_has_been_learnt(
    name: str, target: Target, d: int
) -> None:
    piece = walked(target, d, {name: 1.0}, None)
    assert 0.03 < piece.accepted.mean() / STEPS < 0.95
    assert target.p_values(piece.state.z).min() > FAIL


@run_cases("target", TARGETS.values(), ids=TARGETS)
def test_the_default_mixture_keeps_the_target_exactly(target: Target) -> None:
    piece = walked(target, 5, SamplerSpec().moves, rough(target, 5, 2))
    assert target.p_values(piece.state.z).min() > FAIL


class StretchOffByOne(emcee.moves.StretchMove):
    """The factor z^(d - 1) with the exponent d."""

    def get_proposal(self, s, c, random):
        q, factors = super().get_proposal(s, c, random)
        return q, factors * s.shape[1] / (s.shape[1] - 1.0)


class StretchWithoutFactor(emcee.moves.StretchMove):
    """The factor z^(d - 1) forgotten."""

    def get_proposal(self, s, c, random):
        q, factors = super().get_proposal(s, c, random)
        return q, np.zeros_like(factors)


def is_found_out(wrong: type[emcee.moves.Move], d: int) -> bool:
    return any(
        target.p_values(through(wrong, target, d, 200 + d)).min() < FAIL
        for target in STRAIGHT.values()
    )


@run_cases(
    "wrong, d", [(move, d) for move in (StretchOffByOne, StretchWithoutFactor) for d in (2, 5)]
)
def test_a_wrong_move_is_found_out(wrong: type[emcee.moves.Move], d: int) -> None:
    """The exact test has the power that it claims."""
    assert is_found_out(wrong, d)


@pytest.mark.slow
@run_cases("d", [3, 5])
def test_the_snooker_move_of_emcee_is_found_out(d: int) -> None:
    """That of emcee 3.1.6 fails the exact test."""
    assert is_found_out(emcee.moves.DESnookerMove, d)


def test_the_snooker_move_is_not_registered() -> None:
    made = [make(rough(TARGETS["mild"], 2), always_inside) for make in MOVES.values()]
    assert not any(isinstance(move, emcee.moves.DESnookerMove) for move in made)
