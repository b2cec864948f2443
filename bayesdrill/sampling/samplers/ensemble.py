"""Advance one emcee ensemble segment by segment, and register its moves.

The chain is the same however it is cut.

Where the density p is far higher than the proposal q foresees, a walker waits for about p/q steps.
Those whose p/q is above a limit step by themselves, along the ridge that is likely theirs, to where
p/q is above the limit too: that is Metropolis and Hastings on the density cut to such places.  No
other walker is touched, so the whole density is kept exactly.

The moves are emcee's own stretch and differential evolution, written over whole arrays: emcee 3.1.6
loops over the walkers, which costs more than the model does here.  Its snooker move is not among
them: its Hastings factor is wrong (it shrinks a unit normal in five dimensions to a standard
deviation of 0.84).  A move enters here after it has passed `tests/contracts/test_moves.py`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.basics.registry import Registry, check_callable
from bayesdrill.sampling.samplers.independence import (
    CachedLogDensity,
    Inside,
    Mixture,
    Proposal,
    Random,
)
from bayesdrill.sampling.samplers.ridge import RidgeMap

LOCAL_SHARE = 0.2  # of the steps: the model is as dear for one walker as for thirty
MIN_LENGTH, MAX_LENGTH = 0.01, 1.0  # of a component's widths, over the root of the dimension


def local_steps(mixture: Mixture, u: Array, random: Random) -> tuple[Array, Array, Array]:
    """Return new points from `u (n, D)`, their Hastings factors (logs) and their log q, `(n,)`.

    The component is drawn by its share of q, which is another where the step ends; the step has its
    shape, and a length between far and near.
    """
    n, d = u.shape
    walker = np.arange(n)
    y, before = mixture.straightened(u)
    parts = mixture.log_parts(y, before)
    shares = np.exp(parts - parts.max(axis=0)).cumsum(axis=0)
    k = (shares < shares[-1] * random.random_sample(n)).sum(axis=0)
    length = MIN_LENGTH * (MAX_LENGTH / MIN_LENGTH) ** random.random_sample((n, 1)) / np.sqrt(d)
    step = np.einsum("nij,nj->ni", mixture.roots[k], random.standard_normal((n, d)))
    sheet = mixture.sheet[k]
    fresh = np.empty_like(u)
    for s in np.unique(sheet):
        mine = sheet == s
        fresh[mine] = mixture.sheets[s].from_ridge_coordinates((y[s] + length * step)[mine])[0]
    y, after = mixture.straightened(fresh)
    parts_after = mixture.log_parts(y, after)
    log_q, log_q_after = (np.logaddexp.reduce(some, axis=0) for some in (parts, parts_after))
    share, share_after = parts[k, walker] - log_q, parts_after[k, walker] - log_q_after
    factor = share_after - share + after[sheet, walker] - before[sheet, walker]
    return fresh, factor, log_q_after


STRETCH_SCALE = 2.0  # Goodman and Weare's a
GAMMA = 2.38  # over sqrt(2 D): ter Braak's scale of a difference
GAMMA_SPREAD = 1e-5  # relative: a little noise keeps walkers out of a common plane


class Move(Protocol):
    """A move by emcee's contract."""

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Advance all walkers by a step; `state` is changed in place and given back."""


@dataclass(frozen=True, slots=True)
class SplitEnsembleMove:
    """A move of each half of the walkers, split at random, by where the other half stands.

    `proposal(walkers, others, random)`: new points and their Hastings factors (logs).  `along`: the
    ridge in whose coordinates that happens, where there is one.
    """

    proposal: Callable[[Array, Array, Random], tuple[Array, Array]]
    along: RidgeMap | None = None

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Advance one half of the walkers, then the other."""
        accepted = np.zeros(len(state.coords), dtype=bool)
        order = model.random.permutation(len(state.coords))
        middle = len(order) // 2
        for half, others in ((order[:middle], order[middle:]), (order[middle:], order[:middle])):
            fresh, factor = self._proposed(state.coords, half, others, model.random)
            accepted[half] = _accept(model, state, half, fresh, factor)
        return state, accepted

    def _proposed(
        self, walkers: Array, half: Indices, others: Indices, random: Random
    ) -> tuple[Array, Array]:
        if self.along is None:
            return self.proposal(walkers[half], walkers[others], random)
        y, before = self.along.to_ridge_coordinates(walkers)
        there, factor = self.proposal(y[half], y[others], random)
        fresh, after = self.along.from_ridge_coordinates(there)
        return fresh, factor + after - before[half]


@dataclass(frozen=True, slots=True)
class IndependenceMove:
    """A move of all walkers at once, to points that do not depend on where any of them stands.

    After a share of the steps, those that would wait long for such a point take a step by
    themselves.
    """

    proposal: Proposal
    inside: Inside
    remembered: CachedLogDensity

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Advance all walkers by a draw of the proposal, and perhaps by local steps."""
        everyone = np.arange(len(state.coords))
        proposal, known = self.proposal, self.remembered
        before = known.at(state.coords)
        fresh, after = proposal.draw(len(everyone), self.inside, model.random)
        moved = _accept(model, state, everyone, fresh, before - after)
        known.keep(state.coords, np.where(moved, after, before))
        if model.random.random_sample() < LOCAL_SHARE:
            moved |= step_trapped(model, state, proposal, known.at(state.coords))
        return state, moved


def step_trapped(model: Any, state: Any, proposal: Proposal, log_q: Array) -> Flags:
    """Step those walkers that would wait long; `log_q (W,)` is the proposal's where they stand."""
    moved = np.zeros(len(log_q), dtype=bool)
    which = np.flatnonzero(state.log_prob > proposal.high(log_q))
    if len(which) > 0:
        fresh, factor, there = local_steps(proposal.mixture, state.coords[which], model.random)
        moved[which] = _accept(model, state, which, fresh, factor, proposal.high(there))
    return moved


def _accept(
    model: Any,
    state: Any,
    which: Indices,
    fresh: Array,
    factor: Array,
    above: Array | float = -np.inf,
) -> Flags:
    """Metropolis and Hastings for the walkers `which`: `(len(which),)` whether each has moved.

    `above`: what the density, a log, is cut to.
    """
    log_p = np.asarray(model.log_prob_fn(fresh))
    with np.errstate(divide="ignore"):
        threshold = np.log(model.random.random_sample(len(which)))
    moved: Flags = threshold < log_p - state.log_prob[which] + factor
    moved &= log_p > above
    state.coords[which[moved]] = fresh[moved]
    state.log_prob[which[moved]] = log_p[moved]
    return moved


def differential_evolution(walkers: Array, others: Array, random: Random) -> tuple[Array, Array]:
    """Move along the difference of two others (ter Braak 2006; Nelson et al. 2014)."""
    n, d = walkers.shape
    first, offset = random.randint(len(others), size=n), random.randint(1, len(others), size=n)
    second = (first + offset) % len(others)
    gamma = GAMMA / np.sqrt(2 * d) * (1.0 + GAMMA_SPREAD * random.standard_normal((n, 1)))
    return walkers + gamma * (others[first] - others[second]), np.zeros(n)


def stretch(walkers: Array, others: Array, random: Random) -> tuple[Array, Array]:
    """Move along the line through one of the others (Goodman and Weare 2010)."""
    n, d = walkers.shape
    uniform = np.asarray(random.random_sample(n))
    factor = np.square((STRETCH_SCALE - 1.0) * uniform + 1.0) / STRETCH_SCALE
    centre = others[random.randint(len(others), size=n)]
    return centre + factor[:, None] * (walkers - centre), (d - 1.0) * np.log(factor)


MoveFactory = Callable[[Proposal | None, Inside], Move | None]


def halves(proposal: Callable[[Array, Array, Random], tuple[Array, Array]]) -> MoveFactory:
    """Return a factory of moves along the first ridge, where one has been learnt."""
    return lambda learnt, _: SplitEnsembleMove(
        proposal, learnt.mixture.sheets[0] if learnt else None
    )


def _independent(learnt: Proposal | None, inside: Inside) -> Move | None:
    """None as long as nothing has been learnt."""
    if learnt is None:
        return None
    return IndependenceMove(learnt, inside, CachedLogDensity(learnt.mixture))


MOVES: Registry[MoveFactory] = Registry(
    "move",
    {
        "differential_evolution": halves(differential_evolution),
        "stretch": halves(stretch),
        "independence": _independent,
    },
    judge=check_callable,
)


def moves_with_weights(
    weights: Mapping[str, float], learnt: Proposal | None, inside: Inside
) -> list[tuple[Move, float]]:
    """Return what emcee takes as `moves`; those that need a proposal only where one is learnt."""
    built = [(MOVES[name](learnt, inside), share) for name, share in weights.items() if share > 0]
    return [(move, share) for move, share in built if move is not None]


@dataclass(frozen=True, slots=True)
class State:
    """All that the future of an ensemble depends on. `random` is a legacy NumPy state tuple."""

    z: Array
    log_p: Array
    random: tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainSegment:
    """Consecutive steps: `z (S, W, D)`, `log_p (S, W)`, `accepted (W,)` counts, and the end.

    `seconds`: how long they took; nothing but the length of the next segment depends on it.
    """

    z: Array
    log_p: Array
    accepted: Array
    failures: int
    state: State
    seconds: float


def always_inside(z: Array) -> Flags:
    """Return that every point of `z (n, D)` may have a density."""
    return np.ones(len(z), dtype=bool)


def advance(
    evaluate: Callable[[Array], tuple[Array, int]],
    state: State,
    n_steps: int,
    moves: Mapping[str, float],
    proposal: Proposal | None = None,
    inside: Callable[[Array], Flags] = always_inside,
) -> ChainSegment:
    """Advance an ensemble by `n_steps`; `evaluate` gives log densities of a batch and its failures.

    `proposal`: what the independence move draws from; without it that move is left out. `inside`:
    whether points `(n, D)` may have a density at all, cheaper than asking for it.
    """
    import emcee  # late: it takes half a second to load

    failures = 0

    def target(z: Array) -> Array:
        nonlocal failures
        log_p, failed = evaluate(z)
        failures += failed
        return log_p

    begun = time.perf_counter()
    n_walkers, n_dim = state.z.shape
    sampler = emcee.EnsembleSampler(
        n_walkers, n_dim, target, moves=moves_with_weights(moves, proposal, inside), vectorize=True
    )
    start = emcee.State(state.z, log_prob=state.log_p, random_state=state.random)
    end = sampler.run_mcmc(start, n_steps, skip_initial_state_check=True)
    return ChainSegment(
        z=sampler.get_chain(),
        log_p=sampler.get_log_prob(),
        accepted=sampler.backend.accepted.copy(),
        failures=failures,
        state=State(end.coords, end.log_prob, tuple(end.random_state)),
        seconds=time.perf_counter() - begun,
    )
