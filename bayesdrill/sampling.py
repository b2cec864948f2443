"""Independent ensembles, advanced side by side until the targets are met."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayesdrill import laplace, seeds
from bayesdrill.convergence import Convergence, Targets, assess, thinned
from bayesdrill.crew import Crew
from bayesdrill.errors import InputError
from bayesdrill.posterior import Posterior
from bayesdrill.progress import Reporter
from bayesdrill.samplers import independence
from bayesdrill.samplers.ensemble import Piece, State, advance
from bayesdrill.samplers.independence import Proposal
from bayesdrill.shelf import Shelf
from bayesdrill.store import Folder

Array = NDArray[np.float64]

FIRST_CHECK = 300  # steps after the pilot, at least as many as it had; then whenever a quarter more
GROWTH = 1.25
PIECE = 250  # steps between savings, at most, and ...
PIECE_SECONDS = 2.0  # ... about as many as take this long: what Ctrl-C waits for
FIRST_ROUND = 0.6  # of the pilot, before anything has been learnt
PILOT_EVERY = 5  # of the second half of a round, which a proposal is learnt from
TRIED = 3000  # draws that the acceptance of a proposal is estimated from, about
LEAST_ACCEPTANCE = 0.05  # below it the learnt proposal is not worth its share of the steps
START_SPREAD = 1.5  # ensembles start wider than the Gaussian approximation, so that R-hat can tell


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    ensembles: int
    walkers: int
    moves: Mapping[str, float]
    targets: Targets
    pilot: int
    max_steps: int
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled:
    """`theta (E, S, W, D)` physical; `pieces` of each ensemble as they were saved."""

    pieces: list[list[Piece]]
    theta: Array
    convergence: Convergence

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


def begin(posterior: Posterior, theta: Array, n: int, seed: int, ensemble: int) -> State:
    """Walkers around the MAP `theta (D,)`, from the Gaussian approximation there."""
    rng = seeds.stream(seed, "start", ensemble)
    z = laplace.draws(posterior, theta, n, rng, spread=START_SPREAD)
    return State(z, posterior(z), seeds.legacy_state(seed, "walk", ensemble))


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
    mode: Array
    plan: Plan
    shelf: Shelf
    pieces: list[list[Piece]]
    theta: list[list[Array]]

    @property
    def steps(self) -> list[int]:
        return [_steps(pieces) for pieces in self.pieces]

    def advance_to(self, goal: int, proposal: Proposal | None) -> None:
        """All ensembles to `goal` steps; each goes on as soon as its last piece is in."""
        running: dict[Future[Piece], int] = {}
        length = PIECE

        def submit(ensemble: int) -> None:
            left = goal - self.steps[ensemble]
            if left > 0:
                arguments = min(length, left), dict(self.plan.moves), proposal
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

    def learn(self, steps: slice, random: np.random.RandomState) -> tuple[Proposal, float]:
        """The independence proposal from these steps of all ensembles, and its acceptance."""
        z, log_p = (
            np.concatenate([np.concatenate(parts)[steps] for parts in chains])
            for chains in (
                [[piece.z for piece in pieces] for pieces in self.pieces],
                [[piece.log_p for piece in pieces] for pieces in self.pieces],
            )
        )
        draws, densities = z.reshape(-1, z.shape[-1]), log_p.ravel()
        some = slice(None, None, max(1, len(draws) // TRIED))
        target, inside = self.posterior, self.posterior.supports
        with threadpool_limits(1):
            proposal = independence.learn(draws, inside, random)
            share = independence.expected_acceptance(
                proposal, target, inside, draws[some], densities[some], random
            )
        return proposal, share

    def pilot(self, report: Reporter) -> Proposal | None:
        """The pilot in two rounds, each of which learns a proposal; None where it does not help.

        The second round walks with what the first has learnt, which brings the last walkers home.
        """
        wanted = self.plan.moves.get("independence", 0.0) > 0.0
        random = np.random.RandomState()
        random.set_state(seeds.legacy_state(self.plan.seed, "pilot"))
        proposal, share, begun = None, 0.0, 0
        for end in (int(FIRST_ROUND * self.plan.pilot), self.plan.pilot):
            self.advance_to(end, proposal)
            if wanted:
                learnt, share = self.learn(slice((begun + end) // 2, end, PILOT_EVERY), random)
                proposal = learnt if share >= LEAST_ACCEPTANCE else None
            begun = end
        if wanted and proposal is None:
            report.say(
                f"pilot: a proposal learnt from it would be accepted {share:.1%} of the time, too "
                "rarely to help; going on without"
            )
        elif wanted:
            report.say(
                f"pilot: {self.plan.pilot} steps; the proposal learnt from them is accepted "
                f"{share:.0%} of the time"
            )
        return proposal

    def _state(self, ensemble: int) -> State:
        if self.pieces[ensemble]:
            return self.pieces[ensemble][-1].state
        return begin(self.posterior, self.mode, self.plan.walkers, self.plan.seed, ensemble)


def sample(
    crew: Crew, posterior: Posterior, mode: Array, plan: Plan, shelf: Shelf, report: Reporter
) -> Sampled:
    """Continue what `shelf` holds until converged or `max_steps`; every piece is saved."""
    under_way = _taken_up(crew, posterior, mode, plan, shelf)
    proposal = under_way.pilot(report)
    have = max(under_way.steps)
    # Shorter lengths were judged before an interruption, and found wanting.
    for goal in [goal for goal in _checks(plan) if goal >= have] or [have]:
        under_way.advance_to(goal, proposal)
        sampled = _judge(posterior, plan, under_way.pieces, under_way.theta)
        convergence = sampled.convergence
        report.update(_share(convergence, plan.targets), _state_of(convergence))
        if convergence.converged:
            break
    report.update(1.0, "")
    return sampled


def _taken_up(crew: Crew, posterior: Posterior, mode: Array, plan: Plan, shelf: Shelf) -> _Walk:
    """From where `shelf` was left."""
    pieces = [shelf.pieces(ensemble) for ensemble in range(plan.ensembles)]
    return _Walk(
        crew=crew,
        posterior=posterior,
        mode=mode,
        plan=plan,
        shelf=shelf,
        pieces=pieces,
        theta=[[_physical(posterior, piece) for piece in chain] for chain in pieces],
    )


def _judge(
    posterior: Posterior, plan: Plan, pieces: list[list[Piece]], theta: list[list[Array]]
) -> Sampled:
    physical = _stack(theta)
    log_p = _stack([[piece.log_p for piece in chain] for chain in pieces])
    names = posterior.space.free
    convergence = assess(physical, names, plan.targets, plan.pilot, log_p)
    return Sampled(pieces=pieces, theta=physical, convergence=convergence)


def _checks(plan: Plan) -> Iterator[int]:
    """When to judge: at steps that do not depend on how the run was cut."""
    steps = max(FIRST_CHECK, plan.pilot)
    while plan.pilot + steps < plan.max_steps:
        yield plan.pilot + steps
        steps = int(steps * GROWTH)
    yield plan.max_steps


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
    if steps <= plan.pilot or max(map(_steps, chains)) != steps:
        raise InputError.one(
            str(folder.path), "the run stopped before its first check; continue it with --resume"
        )
    theta = [[_physical(posterior, piece) for piece in chain] for chain in chains]
    return _judge(posterior, plan, chains, theta)
