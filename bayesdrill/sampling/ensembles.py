"""Independent ensembles: prepared, advanced side by side until the targets are met, and kept in a
backend.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference.laplace import PosteriorLogDensity, QuadraticModel, concatenate_models
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import MAX_BELIEVABLE_RMS
from bayesdrill.inference.step_error import evidence_shift
from bayesdrill.output_files import steps_of_chain
from bayesdrill.sampling.convergence import (
    Convergence,
    Length,
    Targets,
    assess,
    futile,
    length,
    thinned,
)
from bayesdrill.sampling.evidence import Evidence, evidence
from bayesdrill.sampling.gauss_newton import climb
from bayesdrill.sampling.multiple_modes import SAME_MODE
from bayesdrill.sampling.proposal.learning import AGAIN, Learnt, Nowhere, learn
from bayesdrill.sampling.proposal.ridge_tracing import bound
from bayesdrill.sampling.samplers.ensemble import Piece, State, advance
from bayesdrill.sampling.samplers.independence import Proposal
from bayesdrill.sampling.workers import Crew


class Shelf(Protocol):
    """`pieces`: those of one ensemble in order; `save`: the piece that begins at `first_step`."""

    def pieces(self, ensemble: int) -> list[Piece]: ...

    def save(self, ensemble: int, first_step: int, piece: Piece) -> None: ...


@dataclass(frozen=True, slots=True)
class Memory:
    """For chains that are not worth a folder."""

    kept: dict[int, list[Piece]] = field(default_factory=dict)

    def pieces(self, ensemble: int) -> list[Piece]:
        return list(self.kept.get(ensemble, []))

    def save(self, ensemble: int, first_step: int, piece: Piece) -> None:
        self.kept.setdefault(ensemble, []).append(piece)


UPWARD = 25  # steps from a maximum over the unknowns to one over the coordinates
MOST_SLOPES = 20_000  # of a point, of records with samples of their own
SHARED = 64  # points that one process expands at a time
START_SPREAD = 1.5  # ensembles start wider than the proposal, so that R-hat can tell
START_TRIES = 20  # of drawing points to start at, wider or not, and of mirroring others
DEEP = 50.0  # of the log density below the highest start: far off a bent ridge is no place to start


def prepare(
    crew: Crew, posterior: Posterior, maxima: Array, seed: int, report: Reporter = SILENT
) -> Learnt:
    """The proposal, the same whatever the number of processes."""

    def expand(u: Array, directions: Array) -> QuadraticModel:
        if len(u) <= SHARED:
            return expanded(posterior, u, directions)
        parts = [u[k : k + SHARED] for k in range(0, len(u), SHARED)]
        tasks = [crew.submit(expanded, part, directions) for part in parts]
        return concatenate_models([task.result() for task in tasks])

    report.update(0.0, "learning the proposal")
    random = np.random.RandomState(seeds.bits(seed, "learn", 0))
    z = posterior.coordinates.from_physical(maxima)
    again, tops = (AGAIN, z) if fits(posterior, maxima) else (0, z[:1])
    surface = PosteriorLogDensity(posterior)
    with threadpool_limits(1):
        rng = seeds.stream(seed, "learn", 1)
        # Where the density over the coordinates is highest, most of the posterior is near.
        central, settle = climb(surface, tops, UPWARD).u, not dear(posterior)
        for k in range(1, len(tops)):  # one is not moved to where another is
            near = np.abs(central[:k] - central[k]) < SAME_MODE * surface.spread
            if near.all(axis=1).any():
                central[k] = tops[k]
        return learn(surface, expand, list(central), random, rng, again, report, settle=settle)


def fits(posterior: Posterior, maxima: Array) -> bool:
    """Whether the best fit leaves about the noise.

    If it leaves far more it is not believed, however well it is sampled, and little is spent on it.
    """
    left = float(posterior.likelihood.mean_square(maxima[:1])[0])
    return left < MAX_BELIEVABLE_RMS**2


def dear(posterior: Posterior) -> bool:
    """Whether slopes are no way home, as they jump where friction lets go, or so many that a walk along
    settled ridges, of some 1e5 points, takes minutes: where each sample has its own, and not sums alone.
    """
    observations = posterior.likelihood.observations
    each = [one for one in observations if not one.response.exact]
    numbers = sum(len(one.experiment.t) for one in each) * len(posterior.space.free)
    return numbers > MOST_SLOPES or any(one.response.model.frictions for one in observations)


def expanded(posterior: Posterior, u: Array, directions: Array) -> QuadraticModel:
    """See `LogDensity.quadratic_model`."""
    return PosteriorLogDensity(posterior).quadratic_model(u, directions)


def begin_walkers(
    posterior: Posterior, proposal: Proposal, n: int, seed: int, ensemble: int
) -> State:
    """Walkers around all maxima alike, wider than the proposal: shares are for the moves to find.

    But none starts where the proposal would hardly ever lead it away: where it is not found wider, it
    is drawn from the proposal itself.  Where hardly a draw is inside the prior, those outside are
    mirrored at its ends, nearer and nearer to the first maximum.
    """
    random = np.random.RandomState(seeds.bits(seed, "start", ensemble))
    proposal = bound(proposal, posterior).widest
    mixture = proposal.mixture
    centre, wide = mixture.sheets[0].frame.centre, mixture.widened(START_SPREAD)
    z, log_p = np.empty((n, len(centre))), np.full(n, -np.inf)
    missing = np.ones(n, dtype=bool)
    for attempt in range(3 * START_TRIES):
        wanted, mirrored = int(missing.sum()), attempt - 2 * START_TRIES
        if attempt < START_TRIES:
            fresh = wide.draw(wanted, random).u
        elif mirrored < 0:
            fresh = proposal.draw(wanted, posterior.supports, random)[0]
        else:
            fresh = centre + 0.25**mirrored * (wide.draw(wanted, random).u - centre)
            ends = PosteriorLogDensity(posterior)
            fresh = np.where(fresh < ends.low, 2.0 * ends.low - fresh, fresh)
            fresh = np.where(fresh > ends.high, 2.0 * ends.high - fresh, fresh)
        z[missing], log_p[missing] = fresh, posterior(fresh)
        missing = ~(log_p > log_p.max() - DEEP)
        if mirrored < 0:
            missing |= log_p > proposal.high(mixture.log_density(z))
        if not missing.any():
            return State(z, log_p, seeds.legacy_state(seed, "walk", ensemble))
    raise Nowhere("no point of finite posterior was found around the maximum")


FIRST_CHECK = 200  # steps
PIECE = 250  # steps between savings, at most, and ...
PIECE_SECONDS = 2.0  # ... about as many as take this long: what Ctrl-C waits for
ENOUGH_OF_A_MISFIT = 800  # steps


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    ensembles: int
    walkers: int
    moves: Mapping[str, float]
    targets: Targets
    max_steps: int
    seed: int

    def most_steps(self, unknowns: int) -> int:
        """`max_steps`, or as many as a chain of this size may have."""
        return min(self.max_steps, steps_of_chain(self.ensembles, self.walkers, unknowns))


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """`names`: unknowns whose priors end too near to their nominal values.

    `draws (N, D)`: of the posterior with these ends moved; None where it did not converge, so that
    nothing can be said of what depends on them.  `pressed`: those whose draws crowd there as well.
    `kept`: whether the run has left what it found, or it is unknown.
    """

    names: tuple[str, ...]
    draws: Array | None
    pressed: tuple[str, ...]
    kept: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled:
    """`theta (E, S, W, D)` physical; `pieces` of each ensemble as they were saved.

    `learnt`: what the proposal was learnt from, and `held (M,)`: how many of the draws each maximum
    has; None where a chain was only read again.  `evidence`: where it was asked for, see `weighed`.
    `beyond`: what is seen beyond ends of priors that are in the way, None where none is.
    """

    pieces: list[list[Piece]]
    theta: Array
    convergence: Convergence
    learnt: Learnt | None = None
    held: Array | None = None
    evidence: Evidence | None = None
    beyond: Opened | None = None

    def doubted(self, reasons: tuple[str, ...]) -> Sampled:
        """With further `reasons` not to believe it."""
        convergence = self.convergence
        every = (*convergence.reasons, *reasons)
        return dataclasses.replace(
            self, convergence=dataclasses.replace(convergence, reasons=every)
        )

    @property
    def draws(self) -> Array:
        """`(E, N, D)`: nearly independent draws of `theta`."""
        return thinned(self.theta, self.convergence.burn_in, self.convergence.thin)

    @property
    def log_p(self) -> Array:
        """`(E, N)`: log density over the sampler's coordinates, of the same draws."""
        every = _stack([[piece.log_p for piece in pieces] for pieces in self.pieces])
        return thinned(every, self.convergence.burn_in, self.convergence.thin)

    @property
    def acceptance(self) -> Array:
        """`(E,)` shares of proposals accepted."""
        return np.array([sum(p.accepted.mean() for p in ps) / _steps(ps) for ps in self.pieces])

    @property
    def failures(self) -> int:
        """Proposals inside the prior whose response overflowed."""
        return sum(piece.failures for pieces in self.pieces for piece in pieces)


def loaded(_: Posterior) -> None:
    """For a process that has nothing else to do yet: loads what its ensembles will need."""
    importlib.import_module("emcee")


def walk(
    posterior: Posterior,
    state: State,
    n_steps: int,
    moves: Mapping[str, float],
    proposal: Proposal,
) -> Piece:
    """`n_steps` of one ensemble further."""
    own = bound(proposal, posterior)
    return advance(posterior.evaluate, state, n_steps, moves, own, posterior.supports)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Walk:
    """Ensembles under way: their `pieces`, and the same steps in physical unknowns, `theta`."""

    crew: Crew
    posterior: Posterior
    proposal: Proposal
    plan: Plan
    shelf: Shelf
    pieces: list[list[Piece]]
    theta: list[list[Array]]

    @property
    def steps(self) -> list[int]:
        return [_steps(pieces) for pieces in self.pieces]

    def advance_to(self, goal: int, tell: Callable[[int], None]) -> None:
        """All ensembles to `goal` steps; each goes on as soon as its last piece is in.

        `tell`: of how many steps all have made.
        """
        running: dict[Future[Piece], int] = {}
        length = PIECE

        def submit(ensemble: int) -> None:
            left = goal - self.steps[ensemble]
            if left > 0:
                arguments = min(length, left), dict(self.plan.moves), self.proposal
                running[self.crew.submit(walk, self._state(ensemble), *arguments)] = ensemble

        for ensemble in range(self.plan.ensembles):
            submit(ensemble)
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                ensemble = running.pop(future)
                piece = future.result()
                length = int(np.clip(PIECE_SECONDS * len(piece.z) / piece.seconds, 1, PIECE))
                first = self.steps[ensemble]
                self.pieces[ensemble].append(piece)
                if not self.crew.alone:
                    submit(ensemble)  # first, so that others walk on while this process writes
                self.shelf.save(ensemble, first, piece)
                self.theta[ensemble].append(_physical(self.posterior, piece))
                tell(min(self.steps))
                if self.crew.alone:
                    submit(ensemble)

    def first(self, n: int) -> Array:
        """`(E, n, W, D)`, physical."""
        return np.array([np.concatenate(parts)[:n] for parts in self.theta])

    def _state(self, ensemble: int) -> State:
        if self.pieces[ensemble]:
            return self.pieces[ensemble][-1].state
        return begin_walkers(
            self.posterior, self.proposal, self.plan.walkers, self.plan.seed, ensemble
        )


def sample(
    crew: Crew, posterior: Posterior, maxima: Array, plan: Plan, shelf: Shelf, report: Reporter
) -> Sampled:
    """Continue what `shelf` holds until converged or `max_steps`; every piece is saved.

    `maxima (M, D)`: physical, each of which may hold some of the posterior.
    """
    learnt = prepare(crew, posterior, maxima, plan.seed, report)
    where = "the ridge" if len(learnt.off) == 1 else f"{len(learnt.off)} ridges"
    report.say(
        f"proposal: learnt along {where} of the posterior, accepted {learnt.acceptance:.0%} of the "
        "time"
    )
    pieces = [shelf.pieces(ensemble) for ensemble in range(plan.ensembles)]
    under_way = _Walk(
        crew=crew,
        posterior=posterior,
        proposal=learnt.proposal,
        plan=plan,
        shelf=shelf,
        pieces=pieces,
        theta=[[_physical(posterior, piece) for piece in chain] for chain in pieces],
    )
    have, most = max(under_way.steps), plan.most_steps(maxima.shape[1])
    if not fits(posterior, maxima):
        most = min(most, ENOUGH_OF_A_MISFIT)
    sampled = _until_judged(under_way, have, most, learnt, report)
    report.update(1.0, "")
    z = posterior.coordinates.from_physical(sampled.draws.reshape(-1, maxima.shape[1]))
    return dataclasses.replace(sampled, held=learnt.shares(z, len(maxima)))


def weighed(posterior: Posterior, sampled: Sampled, seed: int) -> Sampled:
    """With the evidence of the posterior, as far as a proposal has been learnt."""
    if sampled.learnt is None:
        return sampled
    since = sampled.convergence.burn_in
    z, log_p = (
        _stack([[getattr(piece, name) for piece in chain] for chain in sampled.pieces])[:, since:]
        for name in ("z", "log_p")
    )
    with threadpool_limits(1):
        found = evidence(posterior, sampled.learnt.proposal, z, log_p, seed)
        draws = sampled.draws.reshape(-1, z.shape[-1])
        shift = None if found is None else evidence_shift(posterior, draws)
    if found is not None and shift is not None:
        found = found.in_finer_steps(*shift)
    return dataclasses.replace(sampled, evidence=found)


def _until_judged(
    under_way: _Walk, have: int, most: int, learnt: Learnt, report: Reporter
) -> Sampled:
    """On and on until the targets are met, nothing more helps, or `most` steps are made.

    Where it looks depends on nothing but the chain: not on how it was cut.
    """
    plan, last = under_way.plan, max(most, have)
    goal = min(FIRST_CHECK, last)
    trail: list[tuple[int, float]] = []
    share = 0.01

    def tell(steps: int) -> None:
        report.update(share, f"{steps} of {goal} steps to the next look")

    report.update(0.0, "the ensembles go on" if have else "starting the walkers")
    while True:
        under_way.advance_to(goal, tell)
        theta = under_way.first(goal)
        seen = length(theta)
        trail.append((goal, seen.n_tau))
        hopeless = futile(trail, plan.targets.n_tau, plan.max_steps, most)
        ending = bool(hopeless) or goal == last
        following = min(seen.next_check(goal, plan.targets.n_tau), last)
        # Shorter lengths were judged before an interruption, and found wanting.
        if goal >= have and (ending or seen.n_tau >= plan.targets.n_tau):
            sampled = _judge(under_way.posterior, plan, under_way.pieces, theta, seen)
            convergence = sampled.convergence
            # How much of the way to the targets, as far as length goes.
            far = convergence.n_tau / plan.targets.n_tau
            known = float(np.min(convergence.ess_bulk)) / plan.targets.ess
            share = min(float(np.clip(min(far, known), 0.0, 0.99)), goal / following)
            report.update(share, _state_of(convergence))
            if hopeless and not convergence.converged:
                reasons = (*convergence.reasons, hopeless)
                convergence = dataclasses.replace(convergence, reasons=reasons, enough=None)
            if convergence.converged or ending:
                return dataclasses.replace(sampled, convergence=convergence, learnt=learnt)
        else:
            share = min(seen.n_tau / plan.targets.n_tau, 0.99)
            report.update(share, f"{goal} steps: {seen.n_tau:.0f} autocorrelation times")
        goal = following


def _judge(
    posterior: Posterior,
    plan: Plan,
    pieces: list[list[Piece]],
    theta: Array,
    seen: Length | None = None,
) -> Sampled:
    """`theta (E, S, W, D)`: all of the pieces, physical; `seen`: its length, if that is known."""
    log_p = _stack([[piece.log_p for piece in chain] for chain in pieces])
    convergence = assess(theta, posterior.space.free, plan.targets, log_p, seen)
    return Sampled(pieces=pieces, theta=theta, convergence=convergence)


def _steps(pieces: list[Piece]) -> int:
    return sum(len(piece.z) for piece in pieces)


def _physical(posterior: Posterior, piece: Piece) -> Array:
    z = piece.z
    return posterior.coordinates.to_physical(z.reshape(-1, z.shape[-1])).reshape(z.shape)


def _stack(chains: list[list[Array]]) -> Array:
    return np.array([np.concatenate(parts) for parts in chains])


def _state_of(c: Convergence) -> str:
    """With the beginning of the first reason why it is not enough."""
    missing = f"; {c.reasons[0].partition(':')[0]}" if c.reasons else ""
    return (
        f"{c.steps} steps: R-hat {np.max(c.r_hat):.4f}, {c.n_tau:.0f} autocorrelation times, "
        f"ESS {np.min(c.ess_bulk):.0f}{missing}"
    )


def stored(
    posterior: Posterior, plan: Plan, pieces: Callable[[int], list[Piece]], place: str
) -> Sampled:
    """The `pieces` of each ensemble, judged again; raises `InputError` where `place` lacks some."""
    chains = [pieces(ensemble) for ensemble in range(plan.ensembles)]
    steps = min(map(_steps, chains))
    first = min(FIRST_CHECK, plan.most_steps(len(posterior.space.free)))
    if steps < first or max(map(_steps, chains)) != steps:
        raise InputError.one(
            place, "the run stopped before its first check; continue it with --resume"
        )
    theta = [[_physical(posterior, piece) for piece in chain] for chain in chains]
    return _judge(posterior, plan, chains, _stack(theta))
