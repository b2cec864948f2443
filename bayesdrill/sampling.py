"""Independent ensembles, advanced side by side until the targets are met."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayesdrill import seeds
from bayesdrill.convergence import Convergence, Targets, assess, futile, thinned
from bayesdrill.crew import Crew
from bayesdrill.errors import InputError
from bayesdrill.learning import AGAIN, Learnt, Nowhere, learn
from bayesdrill.posterior import Posterior
from bayesdrill.progress import Reporter
from bayesdrill.samplers.ensemble import Piece, State, advance
from bayesdrill.samplers.independence import Proposal
from bayesdrill.shelf import Shelf
from bayesdrill.store import Folder
from bayesdrill.surface import Expansion, PosteriorSurface, joined

Array = NDArray[np.float64]

FIRST_CHECK = 200  # steps, and then whenever a quarter more
GROWTH = 1.25
PIECE = 250  # steps between savings, at most, and ...
PIECE_SECONDS = 2.0  # ... about as many as take this long: what Ctrl-C waits for
SHARED = 32  # points that one process expands at a time
START_SPREAD = 1.5  # ensembles start wider than the proposal, so that R-hat can tell
FAR_TOO_LARGE = 1.5  # rms of what is left over the noise, from which on less is learnt
ENOUGH_OF_A_MISFIT = 800  # steps
MOST_NUMBERS = 64_000_000  # of a chain, half a gigabyte: no more steps are taken
START_TRIES = 40  # of drawing points of finite density


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
        return min(self.max_steps, MOST_NUMBERS // (self.ensembles * self.walkers * unknowns))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled:
    """`theta (E, S, W, D)` physical; `pieces` of each ensemble as they were saved.

    `learnt`: what the proposal was learnt from, and `held (M,)`: how many of the draws each maximum
    has; None where a chain was only read again.
    """

    pieces: list[list[Piece]]
    theta: Array
    convergence: Convergence
    learnt: Learnt | None = None
    held: Array | None = None

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


def begin(posterior: Posterior, proposal: Proposal, n: int, seed: int, ensemble: int) -> State:
    """Walkers around all maxima alike, wider than the proposal: shares are for the moves to find."""
    random = np.random.RandomState(seeds.bits(seed, "start", ensemble))
    kept: list[Array] = []
    have = 0
    wide = proposal.mixture.widened(START_SPREAD)
    for attempt in range(START_TRIES):
        source = wide if attempt < START_TRIES // 2 else proposal.mixture
        z = source.draw(2 * n, random).u
        z = z[posterior.supports(z)]
        kept.append(z[np.isfinite(posterior(z))])
        have += len(kept[-1])
        if have >= n:
            z = np.concatenate(kept)[:n]
            return State(z, posterior(z), seeds.legacy_state(seed, "walk", ensemble))
    raise Nowhere("no point of finite posterior was found around the maximum")


def walk(
    posterior: Posterior,
    state: State,
    n_steps: int,
    moves: Mapping[str, float],
    proposal: Proposal | None,
) -> Piece:
    return advance(posterior.evaluate, state, n_steps, moves, proposal, posterior.supports)


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

    def advance_to(self, goal: int) -> None:
        """All ensembles to `goal` steps; each goes on as soon as its last piece is in."""
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
                if self.crew.alone:
                    submit(ensemble)

    def _state(self, ensemble: int) -> State:
        if self.pieces[ensemble]:
            return self.pieces[ensemble][-1].state
        return begin(self.posterior, self.proposal, self.plan.walkers, self.plan.seed, ensemble)


def sample(
    crew: Crew, posterior: Posterior, maxima: Array, plan: Plan, shelf: Shelf, report: Reporter
) -> Sampled:
    """Continue what `shelf` holds until converged or `max_steps`; every piece is saved.

    `maxima (M, D)`: physical, each of which may hold some of the posterior.
    """
    learnt = prepare(crew, posterior, maxima, plan.seed)
    report.say(_said(learnt))
    under_way = _taken_up(crew, posterior, learnt.proposal, plan, shelf)
    have, most = max(under_way.steps), plan.most_steps(maxima.shape[1])
    if not fits(posterior, maxima):
        most = min(most, ENOUGH_OF_A_MISFIT)
    trail = _trail(under_way, plan, have)
    # Shorter lengths were judged before an interruption, and found wanting.
    for goal in [goal for goal in _checks(most) if goal >= have] or [have]:
        under_way.advance_to(goal)
        sampled = _judge(posterior, plan, under_way.pieces, under_way.theta, learnt)
        convergence = sampled.convergence
        report.update(_share(convergence, plan.targets), _state_of(convergence))
        if convergence.converged:
            break
        trail.append((convergence.steps, convergence.n_tau))
        if hopeless := futile(trail, plan.targets.n_tau, plan.max_steps, most):
            reasons = (*convergence.reasons, hopeless)
            convergence = dataclasses.replace(convergence, reasons=reasons)
            sampled = dataclasses.replace(sampled, convergence=convergence)
            break
    report.update(1.0, "")
    z = posterior.coordinates.from_physical(sampled.draws.reshape(-1, maxima.shape[1]))
    return dataclasses.replace(sampled, held=learnt.shares(z, len(maxima)))


def _trail(under_way: _Walk, plan: Plan, have: int) -> list[tuple[int, float]]:
    """What checks before an interruption saw, where a later one looks back to it."""
    names, least = under_way.posterior.space.free, min(under_way.steps)
    goals = _checks(plan.most_steps(len(names)))
    before = [goal for goal in goals if have // 4 <= goal < have and goal <= least]
    if not before:
        return []
    # Ensembles may have been cut at different steps.
    theta = np.array([np.concatenate(parts)[:least] for parts in under_way.theta])
    return [(n, assess(theta[:, :n], names, plan.targets).n_tau) for n in before]


def prepare(crew: Crew, posterior: Posterior, maxima: Array, seed: int) -> Learnt:
    """The proposal, the same whatever the number of processes."""

    def expand(u: Array, directions: Array) -> Expansion:
        parts = [u[k : k + SHARED] for k in range(0, len(u), SHARED)]
        tasks = [crew.submit(expanded, part, directions) for part in parts]
        return joined([task.result() for task in tasks])

    random = np.random.RandomState(seeds.bits(seed, "learn", 0))
    z = posterior.coordinates.from_physical(maxima)
    again, tops = (AGAIN, list(z)) if fits(posterior, maxima) else (0, list(z[:1]))
    with threadpool_limits(1):
        rng = seeds.stream(seed, "learn", 1)
        return learn(PosteriorSurface(posterior), expand, tops, random, rng, again)


def fits(posterior: Posterior, maxima: Array) -> bool:
    """Whether the best fit leaves about the noise.

    If it leaves far more it is not believed, however well it is sampled, and little is spent on it.
    """
    left = float(posterior.likelihood.per_number(maxima[:1])[0])
    return left < FAR_TOO_LARGE**2


def expanded(posterior: Posterior, u: Array, directions: Array) -> Expansion:
    """See `surface.Surface.expand`."""
    return PosteriorSurface(posterior).expand(u, directions)


def _said(learnt: Learnt) -> str:
    """What has been learnt, in a line."""
    ridges = len(learnt.off)
    where = "the ridge" if ridges == 1 else f"{ridges} ridges"
    return (
        f"proposal: learnt along {where} of the posterior, accepted {learnt.acceptance:.0%} of the "
        "time"
    )


def _taken_up(
    crew: Crew, posterior: Posterior, proposal: Proposal, plan: Plan, shelf: Shelf
) -> _Walk:
    """From where `shelf` was left."""
    pieces = [shelf.pieces(ensemble) for ensemble in range(plan.ensembles)]
    return _Walk(
        crew=crew,
        posterior=posterior,
        proposal=proposal,
        plan=plan,
        shelf=shelf,
        pieces=pieces,
        theta=[[_physical(posterior, piece) for piece in chain] for chain in pieces],
    )


def _judge(
    posterior: Posterior,
    plan: Plan,
    pieces: list[list[Piece]],
    theta: list[list[Array]],
    learnt: Learnt | None = None,
) -> Sampled:
    physical = _stack(theta)
    log_p = _stack([[piece.log_p for piece in chain] for chain in pieces])
    names = posterior.space.free
    convergence = assess(physical, names, plan.targets, log_p)
    return Sampled(pieces=pieces, theta=physical, convergence=convergence, learnt=learnt)


def _checks(most: int) -> Iterator[int]:
    """When to judge: at steps that do not depend on how the run was cut."""
    steps = FIRST_CHECK
    while steps < most:
        yield steps
        steps = int(steps * GROWTH)
    yield most


def _steps(pieces: list[Piece]) -> int:
    return sum(len(piece.z) for piece in pieces)


def _physical(posterior: Posterior, piece: Piece) -> Array:
    z = piece.z
    return posterior.coordinates.to_physical(z.reshape(-1, z.shape[-1])).reshape(z.shape)


def _stack(chains: list[list[Array]]) -> Array:
    return np.array([np.concatenate(parts) for parts in chains])


def _share(convergence: Convergence, targets: Targets) -> float:
    """How much of the way to the targets, as far as length goes."""
    share = min(
        convergence.n_tau / targets.n_tau, float(np.min(convergence.ess_bulk)) / targets.ess
    )
    return float(np.clip(share, 0.0, 0.99))


def _state_of(c: Convergence) -> str:
    return (
        f"{c.steps} steps: R-hat {np.max(c.r_hat):.4f}, {c.n_tau:.0f} autocorrelation times, "
        f"ESS {np.min(c.ess_bulk):.0f}"
    )


def stored(posterior: Posterior, plan: Plan, folder: Folder) -> Sampled:
    """What `folder` holds, judged again; raises `InputError` where ensembles are missing."""
    chains = [folder.pieces(ensemble) for ensemble in range(plan.ensembles)]
    steps = min(map(_steps, chains))
    first = next(_checks(plan.most_steps(len(posterior.space.free))))
    if steps < first or max(map(_steps, chains)) != steps:
        raise InputError.one(
            str(folder.path), "the run stopped before its first check; continue it with --resume"
        )
    theta = [[_physical(posterior, piece) for piece in chain] for chain in chains]
    return _judge(posterior, plan, chains, theta)
