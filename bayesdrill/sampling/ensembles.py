"""Run independent ensembles side by side until the targets are met, and keep them in a backend."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference.compression import CompressionCheck
from bayesdrill.inference.laplace import LogDensity, QuadraticModel, concatenate_models
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import MAX_BELIEVABLE_RMS
from bayesdrill.inference.step_error import evidence_shift
from bayesdrill.output_files import steps_of_chain
from bayesdrill.sampling.convergence import (
    ChainLength,
    Convergence,
    Targets,
    assess,
    chain_length,
    futility,
    thinned,
)
from bayesdrill.sampling.evidence import Evidence, evidence
from bayesdrill.sampling.gauss_newton import gauss_newton
from bayesdrill.sampling.multiple_modes import SAME_MODE
from bayesdrill.sampling.proposal.learning import (
    MAX_ADDED_RIDGES,
    LearnedProposal,
    NoSupportError,
    learn,
)
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State, advance
from bayesdrill.sampling.samplers.independence import Proposal
from bayesdrill.sampling.workers import WorkerPool


class Backend(Protocol):
    """Storage of the chains of a run."""

    def segments(self, ensemble: int) -> list[ChainSegment]:
        """Return the segments of one ensemble in order."""

    def save(self, ensemble: int, first_step: int, segment: ChainSegment) -> None:
        """Store the segment of an ensemble that begins at `first_step`."""


@dataclass(frozen=True, slots=True)
class MemoryBackend:
    """A backend in memory, for chains that are not worth a folder."""

    saved: dict[int, list[ChainSegment]] = field(default_factory=dict)

    def segments(self, ensemble: int) -> list[ChainSegment]:
        """Return the segments of one ensemble in order."""
        return list(self.saved.get(ensemble, []))

    def save(self, ensemble: int, first_step: int, segment: ChainSegment) -> None:
        """Append a segment to those of its ensemble."""
        self.saved.setdefault(ensemble, []).append(segment)


CLIMB_STEPS = 25  # steps from a maximum over the unknowns to one over the coordinates
MAX_SLOPES = 20_000  # of a point, of records with samples of their own
POINTS_PER_TASK = 64  # points that one process expands at a time
START_SPREAD = 1.5  # ensembles start wider than the proposal, so that R-hat can tell
MAX_START_TRIES = 20  # of drawing points to start at, wider or not, and of mirroring others
MAX_START_DEPTH = 50.0  # of the log density, below the highest: far off a ridge nothing starts
FIRST_CHECK = 200  # steps
MAX_SEGMENT_STEPS = 250  # steps between savings, at most, and ...
SEGMENT_SECONDS = 2.0  # ... about as many as take this long: what Ctrl-C waits for
MOST_MISSED = 0.05  # of the posterior, by a proposal: with less the log evidence is off by less
MAX_STEPS_OF_A_MISFIT = 800  # steps


class _PooledLogDensity(LogDensity):
    """The log density over the sampler's coordinates, of which processes share many points."""

    def __init__(self, pool: WorkerPool) -> None:
        super().__init__(pool.posterior)
        self._pool = pool

    def quadratic_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return value, slopes and curvature along `directions (D, q)`."""
        n = POINTS_PER_TASK
        if len(u) <= n:
            return super().quadratic_model(u, directions)
        parts = [u[k : k + n] for k in range(0, len(u), n)]
        tasks = [self._pool.submit(_quadratic_model, part, directions) for part in parts]
        return concatenate_models([task.result() for task in tasks])


def _quadratic_model(posterior: Posterior, u: Array, directions: Array) -> QuadraticModel:
    return LogDensity(posterior).quadratic_model(u, directions)


def prepare(
    pool: WorkerPool, maxima: Array, seed: int, report: Reporter = SILENT
) -> LearnedProposal:
    """Learn the proposal; it is the same whatever the number of processes."""
    posterior = pool.posterior
    report.update(0.0, "learning the proposal")
    random = np.random.RandomState(seeds.bits(seed, "learn", 0))
    z = posterior.coordinates.from_physical(maxima)
    max_added_ridges, modes = (MAX_ADDED_RIDGES, z) if fits(posterior, maxima) else (0, z[:1])
    surface = _PooledLogDensity(pool)
    rng = seeds.stream(seed, "learn", 1)
    # Where the density over the coordinates is highest, most of the posterior is near.
    central = gauss_newton(surface, modes, CLIMB_STEPS).u
    check = not slopes_are_expensive(posterior)
    for k in range(1, len(modes)):  # one is not moved to where another is
        near = np.abs(central[:k] - central[k]) < SAME_MODE * surface.spread
        if near.all(axis=1).any():
            central[k] = modes[k]
    return learn(surface, list(central), random, rng, max_added_ridges, report, check=check)


def fits(posterior: Posterior, maxima: Array) -> bool:
    """Return whether the best fit leaves about the noise."""
    misfit = float(posterior.likelihood.mean_square(maxima[:1])[0])
    return misfit < MAX_BELIEVABLE_RMS**2


def slopes_are_expensive(posterior: Posterior) -> bool:
    """Return whether it is too expensive to look along Newton ridges for what a proposal misses.

    Slopes jump where friction lets go. And some 1e5 points take minutes where each sample has slopes
    of its own, and not sums alone.
    """
    observations = posterior.likelihood.observations
    each = [observation for observation in observations if not observation.response.exact]
    numbers = sum(len(observation.experiment.t) for observation in each) * len(posterior.space.free)
    return numbers > MAX_SLOPES or any(
        observation.response.model.frictions for observation in observations
    )


def begin_walkers(
    posterior: Posterior, proposal: Proposal, n: int, seed: int, ensemble: int
) -> State:
    """Place walkers around all maxima alike, wider than the proposal: shares are for moves to find.

    But none starts where the proposal would hardly ever lead it away: where it is not found wider,
    it is drawn from the proposal itself.  Where hardly a draw is inside the prior, those outside
    are mirrored at its ends, nearer and nearer to the first maximum.
    """
    random = np.random.RandomState(seeds.bits(seed, "start", ensemble))
    mixture = proposal.mixture
    centre, wide = mixture.sheets[0].frame.centre, mixture.with_width(START_SPREAD)
    z, log_p = np.empty((n, len(centre))), np.full(n, -np.inf)
    missing = np.ones(n, dtype=bool)
    for attempt in range(3 * MAX_START_TRIES):
        wanted, mirrored = int(missing.sum()), attempt - 2 * MAX_START_TRIES
        if attempt < MAX_START_TRIES:
            fresh = wide.draw(wanted, random).u
        elif mirrored < 0:
            fresh = proposal.draw(wanted, posterior.supports, random)[0]
        else:
            fresh = centre + 0.25**mirrored * (wide.draw(wanted, random).u - centre)
            ends = LogDensity(posterior)
            fresh = np.where(fresh < ends.low, 2.0 * ends.low - fresh, fresh)
            fresh = np.where(fresh > ends.high, 2.0 * ends.high - fresh, fresh)
        z[missing], log_p[missing] = fresh, posterior(fresh)
        missing = ~(log_p > log_p.max() - MAX_START_DEPTH)
        if mirrored < 0:
            missing |= log_p > proposal.high(mixture.log_density(z))
        if not missing.any():
            return State(z, log_p, seeds.legacy_state(seed, "walk", ensemble))
    raise NoSupportError("no point of finite posterior was found around the maximum")


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """How ensembles are run: their number and size, moves, targets, and the seed."""

    ensembles: int
    walkers: int
    moves: Mapping[str, float]
    targets: Targets
    max_steps: int
    seed: int

    def most_steps(self, unknowns: int) -> int:
        """Return `max_steps`, or as many steps as a chain of this size may have."""
        return min(self.max_steps, steps_of_chain(self.ensembles, self.walkers, unknowns))


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingResult:
    """The chains of a run, and what was learnt from them.

    `theta (E, S, W, D)` physical; `segments` of each ensemble as they were saved.  `learnt`: what the
    proposal was learnt from, and `mode_shares (M,)`: how many of the draws each maximum has; None
    where a chain was only read again.  `evidence`: where it was asked for, see `with_evidence`.
    `compression`: how the likelihood of long records compares with the exact one.  `missed`: about
    how much of the posterior the proposal hardly ever reaches, 0 where none was found.
    """

    segments: list[list[ChainSegment]]
    theta: Array
    convergence: Convergence
    learnt: LearnedProposal | None = None
    mode_shares: Array | None = None
    evidence: Evidence | None = None
    compression: CompressionCheck | None = None
    missed: float = 0.0

    def with_missed(self, missed: float) -> SamplingResult:
        """Return a copy that is not believed where the proposal has `missed` much of the posterior."""
        sampled = dataclasses.replace(self, missed=missed)
        much = missed > MOST_MISSED
        return sampled.with_reasons((sampled.coverage("all numbers are rough"),) if much else ())

    def coverage(self, consequence: str) -> str:
        """Return what the proposal misses, and its `consequence`; empty where it misses nothing."""
        share = (
            f"about {100 * self.missed:.2g} % of the posterior lies where the proposal hardly ever"
        )
        said = f"coverage: {share} leads, so {consequence}; narrow the priors that span decades"
        return said if self.missed else ""

    def with_reasons(self, reasons: tuple[str, ...]) -> SamplingResult:
        """Return a copy with further `reasons` not to believe it."""
        all_reasons = (*self.convergence.reasons, *reasons)
        convergence = dataclasses.replace(self.convergence, reasons=all_reasons)
        return dataclasses.replace(self, convergence=convergence)

    @property
    def draws(self) -> Array:
        """Nearly independent draws of `theta`, `(E, N, D)`."""
        return thinned(self.theta, self.convergence.burn_in, self.convergence.thin)

    @property
    def log_p(self) -> Array:
        """The log density of the draws over the sampler's coordinates, `(E, N)`."""
        log_p = _stack(self.segments, "log_p")
        return thinned(log_p, self.convergence.burn_in, self.convergence.thin)

    @property
    def acceptance(self) -> Array:
        """The shares of proposals accepted, `(E,)`."""
        return np.array([sum(p.accepted.mean() for p in ps) / _steps(ps) for ps in self.segments])

    @property
    def failures(self) -> int:
        """The number of proposals inside the prior whose response overflowed."""
        return sum(segment.failures for segments in self.segments for segment in segments)


def walk(
    posterior: Posterior,
    state: State,
    n_steps: int,
    moves: Mapping[str, float],
    proposal: Proposal,
) -> ChainSegment:
    """Advance one ensemble by `n_steps`."""
    return advance(posterior.evaluate, state, n_steps, moves, proposal, posterior.supports)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Walk:
    """Ensembles under way, and their `segments` so far."""

    pool: WorkerPool
    proposal: Proposal
    plan: Plan
    backend: Backend
    segments: list[list[ChainSegment]]

    @property
    def steps(self) -> list[int]:
        return [_steps(segments) for segments in self.segments]

    def advance_to(self, goal: int, tell: Callable[[int], None]) -> None:
        """All ensembles to `goal` steps; each goes on as soon as its last segment is in.

        `tell`: of how many steps all have made.
        """
        running: dict[Future[ChainSegment], int] = {}
        length = MAX_SEGMENT_STEPS

        def submit(ensemble: int) -> None:
            remaining = goal - self.steps[ensemble]
            if remaining > 0:
                arguments = min(length, remaining), dict(self.plan.moves), self.proposal
                running[self.pool.submit(walk, self._state(ensemble), *arguments)] = ensemble

        for ensemble in range(self.plan.ensembles):
            submit(ensemble)
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                ensemble = running.pop(future)
                segment = future.result()
                in_time = SEGMENT_SECONDS * len(segment.z) / segment.seconds
                length = int(np.clip(in_time, 1, MAX_SEGMENT_STEPS))
                first = self.steps[ensemble]
                self.segments[ensemble].append(segment)
                if not self.pool.in_process:
                    submit(ensemble)  # first, so that others walk on while this process writes
                self.backend.save(ensemble, first, segment)
                tell(min(self.steps))
                if self.pool.in_process:
                    submit(ensemble)

    def _state(self, ensemble: int) -> State:
        if self.segments[ensemble]:
            return self.segments[ensemble][-1].state
        posterior, plan = self.pool.posterior, self.plan
        return begin_walkers(posterior, self.proposal, plan.walkers, plan.seed, ensemble)


def sample(
    pool: WorkerPool, maxima: Array, plan: Plan, backend: Backend, report: Reporter
) -> SamplingResult:
    """Continue the chains of `backend` until converged or `max_steps`, and save every segment.

    `maxima (M, D)`: physical, each of which may hold some of the posterior.
    """
    posterior, learnt = pool.posterior, prepare(pool, maxima, plan.seed, report)
    segments = [backend.segments(ensemble) for ensemble in range(plan.ensembles)]
    under_way = _Walk(
        pool=pool, proposal=learnt.proposal, plan=plan, backend=backend, segments=segments
    )
    most = plan.most_steps(maxima.shape[1])
    if not fits(posterior, maxima):
        most = min(most, MAX_STEPS_OF_A_MISFIT)
    sampled = _run_until_converged(under_way, most, report)
    report.update(1.0, "")
    z = posterior.coordinates.from_physical(sampled.draws.reshape(-1, maxima.shape[1]))
    shares = learnt.shares(z, len(maxima))
    sampled = dataclasses.replace(sampled, learnt=learnt, mode_shares=shares)
    return sampled.with_missed(learnt.missed)


def with_evidence(posterior: Posterior, sampled: SamplingResult, seed: int) -> SamplingResult:
    """Return a copy with the evidence of the posterior, as far as a proposal has been learnt."""
    if sampled.learnt is None:
        return sampled
    since = sampled.convergence.burn_in
    z, log_p = (_stack(sampled.segments, name)[:, since:] for name in ("z", "log_p"))
    estimate = evidence(posterior, sampled.learnt.proposal, z, log_p, seed)
    draws = sampled.draws.reshape(-1, z.shape[-1])
    shift = None if estimate is None else evidence_shift(posterior, draws)
    if estimate is not None and shift is not None:
        estimate = estimate.in_finer_steps(*shift)
    return dataclasses.replace(sampled, evidence=estimate)


def _run_until_converged(under_way: _Walk, most: int, report: Reporter) -> SamplingResult:
    """On and on until the targets are met, nothing more helps, or `most` steps are made.

    Where it looks depends on nothing but the chain: not on how it was cut.
    """
    posterior, plan, have = under_way.pool.posterior, under_way.plan, max(under_way.steps)
    last = max(most, have)
    goal = min(FIRST_CHECK, last)
    trail: list[tuple[int, float]] = []
    share = 0.01

    def tell(steps: int) -> None:
        report.update(share, f"{steps} of {goal} steps to the next look")

    report.update(0.0, "the ensembles go on" if have else "starting the walkers")
    while True:
        under_way.advance_to(goal, tell)
        if not trail:  # this process looks at the walkers, which may have arrived
            under_way.pool.preload(under_way.pool.afterwards)
        theta = _physical(posterior, _stack(under_way.segments, "z", goal))
        measured = chain_length(theta)
        trail.append((goal, measured.n_tau))
        hopeless = futility(trail, plan.targets.n_tau, plan.max_steps, most)
        ending = bool(hopeless) or goal == last
        following = min(measured.next_check(goal, plan.targets.n_tau), last)
        # Shorter lengths were judged before an interruption, and found wanting.
        if goal >= have and (ending or measured.n_tau >= plan.targets.n_tau):
            sampled = _assess(posterior, plan, under_way.segments, theta, measured)
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
                return dataclasses.replace(sampled, convergence=convergence)
        else:
            share = min(measured.n_tau / plan.targets.n_tau, 0.99)
            report.update(share, f"{goal} steps: {measured.n_tau:.0f} autocorrelation times")
        goal = following


def _assess(
    posterior: Posterior,
    plan: Plan,
    segments: list[list[ChainSegment]],
    theta: Array,
    measured: ChainLength | None = None,
) -> SamplingResult:
    """`theta (E, S, W, D)`: all of the segments, physical; `measured`: its length, if that is known."""
    log_p = _stack(segments, "log_p")
    convergence = assess(theta, posterior.space.free, plan.targets, log_p, measured)
    return SamplingResult(segments=segments, theta=theta, convergence=convergence)


def _steps(segments: list[ChainSegment]) -> int:
    return sum(len(segment.z) for segment in segments)


def _physical(posterior: Posterior, z: Array) -> Array:
    return posterior.coordinates.to_physical(z.reshape(-1, z.shape[-1])).reshape(z.shape)


def _stack(
    chains: list[list[ChainSegment]], name: Literal["z", "log_p"], n: int | None = None
) -> Array:
    """The first `n` steps of each chain, or all."""
    return np.array([np.concatenate([getattr(p, name) for p in ps])[:n] for ps in chains])


def _state_of(c: Convergence) -> str:
    """With the beginning of the first reason why it is not enough."""
    missing = f"; {c.reasons[0].partition(':')[0]}" if c.reasons else ""
    return (
        f"{c.steps} steps: R-hat {np.max(c.r_hat):.4f}, {c.n_tau:.0f} autocorrelation times, "
        f"ESS {np.min(c.ess_bulk):.0f}{missing}"
    )


def load_sampled(
    posterior: Posterior, plan: Plan, segments: Callable[[int], list[ChainSegment]], location: str
) -> SamplingResult:
    """Judge the stored `segments` of each ensemble; raises `InputError` if some are missing."""
    chains = [segments(ensemble) for ensemble in range(plan.ensembles)]
    steps = min(map(_steps, chains))
    first = min(FIRST_CHECK, plan.most_steps(len(posterior.space.free)))
    if steps < first or max(map(_steps, chains)) != steps:
        raise InputError.at(
            location, "the run stopped before its first check; continue it with --resume"
        )
    return _assess(posterior, plan, chains, _physical(posterior, _stack(chains, "z")))
