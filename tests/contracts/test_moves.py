"""Exact tests of every move: walkers that start as independent draws of the target stay such draws.

No chain has to converge and no error has to be estimated: after any number of steps of a correct kernel
the walkers of one ensemble are still independent draws, so a Kolmogorov-Smirnov test is exact.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import emcee
import numpy as np
import pytest
from support.case_tables import run_cases, slow_except
from support.handmade_proposals import advance_draws, rough
from support.known_targets import TARGETS, Target

from bayesdrill.config.schema.config import SamplerSpec
from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.ensemble import (
    MOVES,
    always_inside,
    moves_with_weights,
    step_trapped,
)
from bayesdrill.sampling.samplers.independence import LONG_LOG_RATIO, Mixture, Proposal

LEAST_P_VALUE = 1e-6  # one false alarm in a million
WALKERS, STEPS = 4000, 12
SIZES = (2, 5, 9)
STRAIGHT = {name: TARGETS[name] for name in ("mild", "wild")}
BENT = {name: target for name, target in TARGETS.items() if name != "mild"}
CUT = TARGETS["cut"]
# Every move where a ridge bends; of the targets that are harder in another way, each with one move.
PAIRS = [(move, "bent") for move in MOVES]
PAIRS += [("differential_evolution", name) for name in TARGETS if name not in ("mild", "bent")]
UNLEARNT = [name for name in MOVES if moves_with_weights({name: 1.0}, None, always_inside)]
INDEPENDENT = {"independence": 1.0}


def assert_kept(
    target: Target, d: int, moves: Mapping[str, float], proposal: Proposal | None
) -> None:
    piece = advance_draws(target, d, moves, proposal, STEPS)
    assert 0.03 < piece.accepted.mean() / STEPS < 0.95
    assert target.p_values(piece.state.z).min() > LEAST_P_VALUE


def sampler_of_emcee(
    target: Target, d: int, moves: object, steps: int, seed: int
) -> tuple[emcee.EnsembleSampler, np.ndarray]:
    """Advance draws of the target by emcee alone, and return its sampler and where they end."""
    z = target.draw(WALKERS, d, np.random.default_rng(seed))
    random = np.random.RandomState(seed).get_state()
    sampler = emcee.EnsembleSampler(WALKERS, d, target.log_density, moves=moves, vectorize=True)
    start = emcee.State(z, log_prob=target.log_density(z), random_state=random)
    return sampler, sampler.run_mcmc(start, steps, skip_initial_state_check=True).coords


@run_cases("name", TARGETS)
def test_draws_of_the_targets_follow_their_densities(name: str) -> None:
    target = TARGETS[name]
    for d in SIZES:
        x = target.draw(WALKERS, d, np.random.default_rng(d))
        assert target.p_values(x).min() > 1e-3
        assert target.in_support(x).all()
    if name in ("cut", "boxed"):
        return  # what is moved there leaves the support
    # Importance weights between the density and itself moved a little average to one.
    x = target.draw(200_000, 2, np.random.default_rng(1))
    shift = 0.02 * np.array(target.scales[:2])
    weights = np.exp(target.log_density(x + shift) - target.log_density(x))
    assert weights.mean() == pytest.approx(1.0, abs=5 * weights.std() / np.sqrt(len(x)))


@pytest.mark.parametrize("d", slow_except((5,), SIZES))
@run_cases("move, name", PAIRS)
def test_target_is_kept_exactly(move: str, name: str, d: int) -> None:
    """A move along a ridge or over it: bent, in units of its own, unlike the target."""
    assert_kept(TARGETS[name], d, {move: 1.0}, rough(TARGETS[name], d))


@pytest.mark.parametrize("d", slow_except((5,), SIZES))
@run_cases("target", BENT.values(), ids=BENT)
def test_target_is_kept_exactly_over_two_ridges(target: Target, d: int) -> None:
    """Ridges in units of their own, the draws of one likely on the other or never."""
    assert_kept(target, d, INDEPENDENT, rough(target, d, 2))


@run_cases("d", SIZES)
@run_cases("target", STRAIGHT.values(), ids=STRAIGHT)
@run_cases("move", UNLEARNT)
def test_target_is_kept_exactly_without_a_learnt_proposal(
    move: str, target: Target, d: int
) -> None:
    assert_kept(target, d, {move: 1.0}, None)


@run_cases("target", TARGETS.values(), ids=TARGETS)
def test_the_default_moves_keep_the_target_exactly(target: Target) -> None:
    assert_kept(target, 5, SamplerSpec().moves, rough(target, 5, 2))


def test_redraws_that_run_out_keep_the_target(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draws outside the prior are then proposed, and never accepted."""
    monkeypatch.setattr(independence, "MAX_REDRAWS", 1)
    piece = advance_draws(CUT, 5, INDEPENDENT, replace(rough(CUT, 5), share_inside=1.0), STEPS)
    assert CUT.in_support(piece.z.reshape(-1, 5)).all()
    assert CUT.p_values(piece.state.z).min() > LEAST_P_VALUE


@dataclass(frozen=True)
class StepTrapped:
    """A move of emcee that is nothing but the Metropolis steps of trapped walkers."""

    proposal: Proposal

    def propose(self, model, state):
        log_q = self.proposal.mixture.log_density(state.coords)
        return state, step_trapped(model, state, self.proposal, log_q)


@pytest.mark.parametrize(
    "case", slow_except((("bent", 2),), (("wild", 5), ("bent", 2), ("two_modes", 5)))
)
def test_steps_of_trapped_walkers_keep_the_target(case: tuple[str, int]) -> None:
    """About half of them step, since their limit is set where most of the target is."""
    name, d = case
    proposal = rough(TARGETS[name], d, 2)
    typical = proposal.typical_log_ratio - LONG_LOG_RATIO
    move = StepTrapped(replace(proposal, typical_log_ratio=typical))
    sampler, end = sampler_of_emcee(TARGETS[name], d, move, 200, 60 + d)
    assert 0.01 < sampler.acceptance_fraction.mean() < 0.5
    assert TARGETS[name].p_values(end).min() > LEAST_P_VALUE


class Stretch(emcee.moves.StretchMove):
    """The factor z^(d - 1) with another exponent, times d - 1."""

    def __init__(self, exponent: float) -> None:
        super().__init__()
        self.exponent = exponent

    def get_proposal(self, s, c, random):
        q, factors = super().get_proposal(s, c, random)
        return q, factors * self.exponent


def is_rejected(move: emcee.moves.Move, d: int) -> bool:
    ends = [(t, sampler_of_emcee(t, d, move, 40, 200 + d)[1]) for t in STRAIGHT.values()]
    return any(target.p_values(end).min() < LEAST_P_VALUE for target, end in ends)


@pytest.mark.parametrize("d", slow_except((2,), (2, 5)))
def test_a_wrong_stretch_move_is_rejected(d: int) -> None:
    """The exact test has the power that it claims: a factor off by one power, and one forgotten."""
    assert is_rejected(Stretch(d / (d - 1.0)), d)
    assert is_rejected(Stretch(0.0), d)


def test_a_proposal_without_its_density_is_rejected() -> None:
    """Without q(old)/q(new) the walkers follow p q."""

    class WithoutDensity(Mixture):
        def log_density_at(self, y, jacobian):
            return np.zeros(y.shape[1])

    mixture = rough(CUT, 2).mixture
    wrong = WithoutDensity(*(getattr(mixture, field.name) for field in fields(Mixture)))
    proposal = replace(rough(CUT, 2), mixture=wrong, typical_log_ratio=np.inf)
    piece = advance_draws(CUT, 2, INDEPENDENT, proposal, STEPS)
    assert CUT.p_values(piece.state.z).min() < LEAST_P_VALUE
