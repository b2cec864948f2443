"""Advance one emcee ensemble segment by segment, and register its moves.

The chain does not depend on the lengths of the segments.

If the density p is far above the proposal q at a walker, the independence move leaves the walker
there for about p/q steps.  So walkers with p/q above a limit also take a local Metropolis-Hastings
step, restricted to the set {p/q > limit}.  Other walkers skip this step, so p stays invariant.

The other moves are stretch and differential evolution as in emcee, but vectorised: emcee 3.1.6
loops over the walkers, which costs more here than the model.  emcee's snooker move is left out, as
its Hastings factor is wrong (a unit normal in five dimensions gets a standard deviation of 0.84).
A new move has to pass `tests/contracts/test_moves.py`.
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

LOCAL_SHARE = 0.2  # local steps follow this fraction of moves, as one point costs as much as 30 do
MIN_LENGTH, MAX_LENGTH = 0.01, 1.0  # lengths of local steps, in component widths / sqrt(D)


def local_steps(mixture: Mixture, u: Array, random: Random) -> tuple[Array, Array, Array]:
    """Return new points from `u (n, D)`, their log Hastings factors and their log q, `(n,)` each.

    Component k is drawn with the probability q_k / q, its fraction of the density at `u`.  In its
    coordinates, the step is Gaussian with the component's shape and a log-uniform length.  The
    Hastings factor includes q_k / q at both points.
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
    log_q, log_q_after = (np.logaddexp.reduce(logs, axis=0) for logs in (parts, parts_after))
    share, share_after = parts[k, walker] - log_q, parts_after[k, walker] - log_q_after
    factor = share_after - share + after[sheet, walker] - before[sheet, walker]
    return fresh, factor, log_q_after


STRETCH_SCALE = 2.0  # the parameter a of Goodman and Weare (2010)
GAMMA = 2.38  # ter Braak's (2006) scale of a difference of two walkers, times sqrt(2 D)
GAMMA_SPREAD = 1e-5  # relative noise of `GAMMA`, so that walkers leave a common plane


class Move(Protocol):
    """A move advances an ensemble, by emcee's contract (`emcee.moves.Move`)."""

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Advance all walkers by one step.

        Parameters
        ----------
        model : emcee.model.Model
            Its `log_prob_fn` takes points `(n, D)` and returns log densities `(n,)`; `random` is the
            random stream.
        state : emcee.State
            Points `coords (W, D)` and log densities `log_prob (W,)`, which are changed in place.

        Returns
        -------
        state : emcee.State
            The same state.
        accepted : array of bool, shape (W,)
            Whether each walker has moved.
        """


@dataclass(frozen=True, slots=True)
class SplitEnsembleMove:
    """The move splits walkers at random, and advances each half by the positions of the other half.

    `proposal(walkers, others, random)` returns new points `(n, D)` and their log Hastings factors
    `(n,)`.  The proposal acts in the coordinates of the `ridge`, if there is one.
    """

    proposal: Callable[[Array, Array, Random], tuple[Array, Array]]
    ridge: RidgeMap | None = None

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
        if self.ridge is None:
            return self.proposal(walkers[half], walkers[others], random)
        y, before = self.ridge.to_ridge_coordinates(walkers)
        y_fresh, factor = self.proposal(y[half], y[others], random)
        fresh, after = self.ridge.from_ridge_coordinates(y_fresh)
        return fresh, factor + after - before[half]


@dataclass(frozen=True, slots=True)
class IndependenceMove:
    """The move proposes to all walkers draws that do not depend on the walkers' positions.

    With probability `LOCAL_SHARE`, trapped walkers also take a local step (`step_trapped`).
    """

    proposal: Proposal
    in_support: Inside
    remembered: CachedLogDensity

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Advance all walkers by a draw of the proposal and, in some steps, by local steps."""
        everyone = np.arange(len(state.coords))
        proposal, known = self.proposal, self.remembered
        before = known.at(state.coords)
        fresh, after = proposal.draw(len(everyone), self.in_support, model.random)
        moved = _accept(model, state, everyone, fresh, before - after)
        known.keep(state.coords, np.where(moved, after, before))
        if model.random.random_sample() < LOCAL_SHARE:
            moved |= step_trapped(model, state, proposal, known.at(state.coords))
        return state, moved


def step_trapped(model: Any, state: Any, proposal: Proposal, log_q: Array) -> Flags:
    """Take a local step with each walker whose p/q is too large; `log_q (W,)` is that of all walkers."""
    moved = np.zeros(len(log_q), dtype=bool)
    which = np.flatnonzero(state.log_prob > proposal.trapping_log_p(log_q))
    if len(which) > 0:
        fresh, factor, log_q = local_steps(proposal.mixture, state.coords[which], model.random)
        moved[which] = _accept(model, state, which, fresh, factor, proposal.trapping_log_p(log_q))
    return moved


def _accept(
    model: Any,
    state: Any,
    indices: Indices,
    proposed: Array,
    factor: Array,
    above: Array | float = -np.inf,
) -> Flags:
    """Accept or reject new points by Metropolis-Hastings; return which walkers have moved.

    The target is restricted to points with log p > `above`.
    """
    log_p = np.asarray(model.log_prob_fn(proposed))
    with np.errstate(divide="ignore"):
        threshold = np.log(model.random.random_sample(len(indices)))
    moved: Flags = threshold < log_p - state.log_prob[indices] + factor
    moved &= log_p > above
    state.coords[indices[moved]] = proposed[moved]
    state.log_prob[indices[moved]] = log_p[moved]
    return moved


def differential_evolution(walkers: Array, others: Array, random: Random) -> tuple[Array, Array]:
    """Move along the difference of two other walkers (ter Braak 2006; Nelson et al. 2014)."""
    n, d = walkers.shape
    first, offset = random.randint(len(others), size=n), random.randint(1, len(others), size=n)
    second = (first + offset) % len(others)
    gamma = GAMMA / np.sqrt(2 * d) * (1.0 + GAMMA_SPREAD * random.standard_normal((n, 1)))
    return walkers + gamma * (others[first] - others[second]), np.zeros(n)


def stretch(walkers: Array, others: Array, random: Random) -> tuple[Array, Array]:
    """Move along the line through one of the other walkers (Goodman and Weare 2010)."""
    n, d = walkers.shape
    uniform = np.asarray(random.random_sample(n))
    factor = np.square((STRETCH_SCALE - 1.0) * uniform + 1.0) / STRETCH_SCALE
    centre = others[random.randint(len(others), size=n)]
    return centre + factor[:, None] * (walkers - centre), (d - 1.0) * np.log(factor)


MoveFactory = Callable[[Proposal | None, Inside], Move | None]


def halves(proposal: Callable[[Array, Array, Random], tuple[Array, Array]]) -> MoveFactory:
    """Return a factory of moves in two halves, in the coordinates of the first ridge if known."""
    return lambda learnt, _: SplitEnsembleMove(
        proposal, learnt.mixture.sheets[0] if learnt else None
    )


def _independent(proposal: Proposal | None, in_support: Inside) -> Move | None:
    """Return the independence move, or None if no proposal has been learnt."""
    if proposal is None:
        return None
    return IndependenceMove(proposal, in_support, CachedLogDensity(proposal.mixture))


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
    weights: Mapping[str, float], proposal: Proposal | None, in_support: Inside
) -> list[tuple[Move, float]]:
    """Return the argument `moves` of emcee, without moves that need a proposal if there is none."""
    built = [
        (MOVES[name](proposal, in_support), weight)
        for name, weight in weights.items()
        if weight > 0
    ]
    return [(move, weight) for move, weight in built if move is not None]


@dataclass(frozen=True, slots=True)
class State:
    """The state of an ensemble is `z (W, D)`, `log_p (W,)` and NumPy's legacy tuple `random`.

    The next steps only depend on this state.
    """

    z: Array
    log_p: Array
    random: tuple[Any, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainSegment:
    """A segment has consecutive steps `z (S, W, D)`, `log_p (S, W)`, and counts `accepted (W,)`.

    `failures` counts responses that overflowed, and `state` is the state after the last step.
    `seconds` is the computing time, which only affects the length of the next segment.
    """

    z: Array
    log_p: Array
    accepted: Array
    failures: int
    state: State
    seconds: float


def always_inside(z: Array) -> Flags:
    """Return True for every point of `z (n, D)`, for densities without bounds."""
    return np.ones(len(z), dtype=bool)


def advance(
    evaluate: Callable[[Array], tuple[Array, int]],
    state: State,
    n_steps: int,
    moves: Mapping[str, float],
    proposal: Proposal | None = None,
    in_support: Callable[[Array], Flags] = always_inside,
) -> ChainSegment:
    """Advance an ensemble by `n_steps`.

    `evaluate` returns the log densities of points `(n, D)` and the number of responses that overflowed.
    Without a `proposal` the independence move is left out.  `in_support` tests cheaply whether points
    `(n, D)` are inside the prior.
    """
    import emcee  # imported here, as loading takes half a second

    failures = 0

    def target(z: Array) -> Array:
        nonlocal failures
        log_p, failed = evaluate(z)
        failures += failed
        return log_p

    started = time.perf_counter()
    n_walkers, n_dim = state.z.shape
    sampler = emcee.EnsembleSampler(
        n_walkers,
        n_dim,
        target,
        moves=moves_with_weights(moves, proposal, in_support),
        vectorize=True,
    )
    start = emcee.State(state.z, log_prob=state.log_p, random_state=state.random)
    end = sampler.run_mcmc(start, n_steps, skip_initial_state_check=True)
    return ChainSegment(
        z=sampler.get_chain(),
        log_p=sampler.get_log_prob(),
        accepted=sampler.backend.accepted.copy(),
        failures=failures,
        state=State(end.coords, end.log_prob, tuple(end.random_state)),
        seconds=time.perf_counter() - started,
    )
