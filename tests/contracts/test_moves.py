"""Exact tests of every move: walkers that start i.i.d. from the target stay i.i.d. from it.

No chain has to converge and no error has to be estimated: after any number of steps of a correct
kernel the walkers of one ensemble are still independent draws, so a Kolmogorov-Smirnov test is
exact.  Mutants killed: the Hastings factor dropped or off by one power, emcee 3.1.6's snooker.
"""

from __future__ import annotations

from collections.abc import Callable

import emcee
import numpy as np
import pytest
from targets import TARGETS, Target

from bayesdrill.config import SamplerSpec
from bayesdrill.samplers.ensemble import State, advance, everywhere
from bayesdrill.samplers.independence import Proposal, learn
from bayesdrill.samplers.moves import MOVES

FAIL = 1e-6  # one false alarm in a million
WALKERS = 4000
STEPS = 60

MIXTURES = {name: {name: 1.0} for name in MOVES} | {"default": SamplerSpec().moves}


def begin(target: Target, d: int, seed: int) -> State:
    z = target.draw(WALKERS, d, np.random.default_rng(seed))
    random = np.random.RandomState(seed).get_state()
    return State(z, target.log_density(z), random)


def rough_proposal(target: Target, d: int) -> Proposal:
    """Learnt from draws that are shifted: a proposal need not be good to be exact."""
    draws = target.draw(2000, d, np.random.default_rng(9)) + 0.2 * np.array(target.scales[:d])
    return learn(draws, everywhere, np.random.RandomState(3))


def through(
    move: Callable[[], emcee.moves.Move], target: Target, d: int, seed: int, steps: int = STEPS
) -> np.ndarray:
    """Where emcee alone brings the walkers with one move."""
    state = begin(target, d, seed)
    sampler = emcee.EnsembleSampler(WALKERS, d, target.log_density, moves=move(), vectorize=True)
    start = emcee.State(state.z, log_prob=state.log_p, random_state=state.random)
    return sampler.run_mcmc(start, steps, skip_initial_state_check=True).coords


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_draws_of_the_targets_follow_their_densities(target: Target) -> None:
    for d in (2, 3, 5):
        assert target.p_values(target.draw(WALKERS, d, np.random.default_rng(d))).min() > 1e-3
    # Importance weights between the density and itself moved a little average to one.
    x = target.draw(200_000, 2, np.random.default_rng(1))
    shift = 0.1 * np.array(target.scales[:2])
    weights = np.exp(target.log_density(x + shift) - target.log_density(x))
    assert weights.mean() == pytest.approx(1.0, abs=5 * weights.std() / np.sqrt(len(x)))


@pytest.mark.parametrize("d", [2, 3, 5])
@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("name", MIXTURES)
def test_target_is_kept_exactly(name: str, target: Target, d: int) -> None:
    piece = advance(
        lambda z: (target.log_density(z), 0),
        begin(target, d, 100 + d),
        STEPS,
        MIXTURES[name],
        rough_proposal(target, d),
    )
    assert 0.05 < piece.accepted.mean() / STEPS < 0.95
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


WRONG = [
    *((move, d) for move in (StretchOffByOne, StretchWithoutFactor) for d in (2, 3, 5)),
    *(pytest.param(emcee.moves.DESnookerMove, d, marks=pytest.mark.slow) for d in (3, 5)),
]


@pytest.mark.parametrize(("wrong", "d"), WRONG, ids=lambda x: getattr(x, "__name__", x))
def test_a_wrong_move_is_found_out(wrong: type[emcee.moves.Move], d: int) -> None:
    """The exact test has the power that it claims; emcee 3.1.6's snooker move fails it."""
    found = [t.p_values(through(wrong, t, d, 200 + d)).min() for t in TARGETS.values()]
    assert min(found) < FAIL


def test_the_snooker_move_is_not_registered() -> None:
    made = [make(rough_proposal(TARGETS["mild"], 2), everywhere) for make in MOVES.values()]
    assert not any(isinstance(move, emcee.moves.DESnookerMove) for move in made)
