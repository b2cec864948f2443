"""Run independent ensembles in parallel until the targets are met, and store the chains."""

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
from bayesdrill.basics.findings import Finding
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
    """A backend stores the chains of a run."""

    def segments(self, ensemble: int) -> list[ChainSegment]:
        """Return the segments of one ensemble in order."""

    def save(self, ensemble: int, first_step: int, segment: ChainSegment) -> None:
        """Store the segment of an ensemble that begins at `first_step`."""


@dataclass(frozen=True, slots=True)
class MemoryBackend:
    """The backend in memory keeps chains without files."""

    saved: dict[int, list[ChainSegment]] = field(default_factory=dict)

    def segments(self, ensemble: int) -> list[ChainSegment]:
        """Return the segments of one ensemble in order."""
        return list(self.saved.get(ensemble, []))

    def save(self, ensemble: int, first_step: int, segment: ChainSegment) -> None:
        """Store the segment of an ensemble that begins at `first_step`."""
        self.saved.setdefault(ensemble, []).append(segment)


CLIMB_STEPS = 25  # limit of steps from the MAP over unknowns to the MAP over their coordinates
MAX_SLOPES = 20_000  # with more slopes (samples x unknowns), the check for missed mass is too slow
POINTS_PER_TASK = 64  # points of a quadratic model that one process computes at a time
START_SPREAD = 1.5  # width of the starts / width of the proposal; wide, so R-hat shows slow mixing
MAX_START_TRIES = 20  # tries with each of the three distributions of `begin_walkers`
MAX_START_DEPTH = 50.0  # in log density: a walker this far below the highest is placed again
FIRST_CHECK = 200  # steps before convergence is first assessed
MAX_SEGMENT_STEPS = 250  # largest number of steps of a segment
SEGMENT_SECONDS = 2.0  # approximate computing time of a segment, which Ctrl-C has to wait for
MOST_MISSED = 0.05  # posterior mass; if the proposal misses more, the result is not believed
MAX_STEPS_OF_A_MISFIT = 800  # limit of steps if the model does not fit, as a chain then says little


class _PooledLogDensity(LogDensity):
    """The processes of a pool share the evaluation of quadratic models at many points."""

    def __init__(self, pool: WorkerPool) -> None:
        super().__init__(pool.posterior)
        self._pool = pool

    def quadratic_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return value, slopes and curvature at `u (N, D)` along `directions (D, q)`."""
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
    """Learn the proposal from `maxima (M, D)` in SI; the number of processes has no effect."""
    posterior = pool.posterior
    report.update(0.0, "learning the proposal")
    random = np.random.RandomState(seeds.bits(seed, "learn", 0))
    z = posterior.coordinates.from_physical(maxima)
    max_added_ridges, modes = (MAX_ADDED_RIDGES, z) if model_fits(posterior, maxima) else (0, z[:1])
    surface = _PooledLogDensity(pool)
    rng = seeds.stream(seed, "learn", 1)
    # Ridges begin at maxima of the density over the coordinates, where most of the mass is.
    central = gauss_newton(surface, modes, CLIMB_STEPS).u
    check = not slopes_are_expensive(posterior)
    for k in range(1, len(modes)):  # equal maxima would give one ridge twice
        same = np.abs(central[:k] - central[k]) < SAME_MODE * surface.spread
        if same.all(axis=1).any():
            central[k] = modes[k]
    return learn(surface, list(central), random, rng, max_added_ridges, report, check=check)


def model_fits(posterior: Posterior, maxima: Array) -> bool:
    """Return whether the residuals at the highest of `maxima (M, D)` are about as large as the noise."""
    misfit = float(posterior.likelihood.mean_square(maxima[:1])[0])
    return misfit < MAX_BELIEVABLE_RMS**2


def slopes_are_expensive(posterior: Posterior) -> bool:
    """Return whether the check for missed mass, along Newton ridges, is impossible or too slow.

    With friction the slopes jump where a rotor breaks away.  A simulator that is not exact computes
    slopes of each sample, which takes minutes for the 1e5 points of the check.
    """
    observations = posterior.likelihood.observations
    stepped = [observation for observation in observations if not observation.response.exact]
    samples = sum(len(observation.experiment.t) for observation in stepped)
    return samples * len(posterior.space.free) > MAX_SLOPES or any(
        observation.response.model.frictions for observation in observations
    )


def begin_walkers(
    posterior: Posterior, proposal: Proposal, n: int, seed: int, ensemble: int
) -> State:
    """Draw `n` walkers around all maxima, from a mixture wider than the proposal.

    A walker is drawn again at a low density, or where p/q (posterior / proposal) would trap it.
    After some tries, the proposal itself is used.  Then draws are mirrored at the priors' ends and
    moved towards the first maximum, without regard to p/q.  At last, `NoSupportError` is raised.
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
            surface = LogDensity(posterior)
            fresh = np.where(fresh < surface.low, 2.0 * surface.low - fresh, fresh)
            fresh = np.where(fresh > surface.high, 2.0 * surface.high - fresh, fresh)
        z[missing], log_p[missing] = fresh, posterior(fresh)
        missing = ~(log_p > log_p.max() - MAX_START_DEPTH)
        if mirrored < 0:
            missing |= log_p > proposal.trapping_log_p(mixture.log_density(z))
        if not missing.any():
            return State(z, log_p, seeds.legacy_state(seed, "walk", ensemble))
    raise NoSupportError("no point of finite posterior was found around the maximum")


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A plan has the settings of a run: ensembles and walkers, weights of moves, targets and seed."""

    ensembles: int
    walkers: int
    moves: Mapping[str, float]
    targets: Targets
    max_steps: int
    seed: int

    def most_steps(self, unknowns: int) -> int:
        """Return the limit of steps: `max_steps`, or fewer if the chain would not fit in memory."""
        return min(self.max_steps, steps_of_chain(self.ensembles, self.walkers, unknowns))


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingResult:
    """A sampling result has the chains of a run, their convergence, and estimates from them.

    `theta (E, S, W, D)` is in SI, and `segments` are the saved segments of each ensemble.
    `mode_shares (M,)` are the fractions of the draws at each maximum; they and the
    `proposal` are None for a chain read from files.  `with_evidence` computes `evidence`.
    `compression` compares compressed likelihoods with exact ones.  `missed` estimates the posterior
    mass that the proposal hardly reaches.
    """

    segments: list[list[ChainSegment]]
    theta: Array
    convergence: Convergence
    proposal: LearnedProposal | None = None
    mode_shares: Array | None = None
    evidence: Evidence | None = None
    compression: CompressionCheck | None = None
    missed: float = 0.0

    def with_missed(self, missed: float) -> SamplingResult:
        """Return a copy with the `missed` mass and, above `MOST_MISSED`, a reason for disbelief."""
        much = missed > MOST_MISSED
        sampled, percent = dataclasses.replace(self, missed=missed), {"percent": 100 * missed}
        return sampled.with_reasons((Finding("much missed", {}, percent),) if much else ())

    def with_reasons(self, reasons: tuple[Finding, ...]) -> SamplingResult:
        """Return a copy with additional `reasons` not to believe the result."""
        all_reasons = (*self.convergence.reasons, *reasons)
        convergence = dataclasses.replace(self.convergence, reasons=all_reasons)
        return dataclasses.replace(self, convergence=convergence)

    @property
    def draws(self) -> Array:
        """Return the nearly independent draws of `theta` in SI, `(E, N, D)`."""
        return thinned(self.theta, self.convergence.burn_in, self.convergence.thin)

    @property
    def log_p(self) -> Array:
        """Return the log density of the draws over the sampler's coordinates, `(E, N)`."""
        log_p = _stack(self.segments, "log_p")
        return thinned(log_p, self.convergence.burn_in, self.convergence.thin)

    @property
    def acceptance(self) -> Array:
        """Return the fraction of accepted proposals in each ensemble, `(E,)`."""
        return np.array([sum(p.accepted.mean() for p in ps) / _steps(ps) for ps in self.segments])

    @property
    def failures(self) -> int:
        """Return the number of proposals inside the prior whose response overflowed."""
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
    """A walk has the `segments` that the ensembles of a run have made so far."""

    pool: WorkerPool
    proposal: Proposal
    plan: Plan
    backend: Backend
    segments: list[list[ChainSegment]]

    @property
    def steps(self) -> list[int]:
        return [_steps(segments) for segments in self.segments]

    def advance_to(self, goal: int, tell: Callable[[int], None]) -> None:
        """Advance all ensembles to `goal` steps, each without waiting for the others.

        After each segment, `tell` is called with the number of steps of the slowest ensemble.
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
                    submit(ensemble)  # before saving, so that workers go on during the writing
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
    """Continue the chains of `backend` to convergence or `max_steps` steps; save every segment.

    `maxima (M, D)`, in SI, are those about which the posterior may have mass, the highest first.
    """
    posterior, learnt = pool.posterior, prepare(pool, maxima, plan.seed, report)
    segments = [backend.segments(ensemble) for ensemble in range(plan.ensembles)]
    under_way = _Walk(
        pool=pool, proposal=learnt.proposal, plan=plan, backend=backend, segments=segments
    )
    most = plan.most_steps(maxima.shape[1])
    if not model_fits(posterior, maxima):
        most = min(most, MAX_STEPS_OF_A_MISFIT)
    sampled = _run_until_converged(under_way, most, report)
    report.update(1.0, "")
    z = posterior.coordinates.from_physical(sampled.draws.reshape(-1, maxima.shape[1]))
    shares = learnt.mode_fractions(z, len(maxima))
    sampled = dataclasses.replace(sampled, proposal=learnt, mode_shares=shares)
    return sampled.with_missed(learnt.missed)


def with_evidence(posterior: Posterior, sampled: SamplingResult, seed: int) -> SamplingResult:
    """Return a copy with the evidence of the posterior; without a learnt proposal, `sampled` itself."""
    if sampled.proposal is None:
        return sampled
    since = sampled.convergence.burn_in
    z, log_p = (_stack(sampled.segments, name)[:, since:] for name in ("z", "log_p"))
    estimate = evidence(posterior, sampled.proposal.proposal, z, log_p, seed)
    draws = sampled.draws.reshape(-1, z.shape[-1])
    shift = None if estimate is None else evidence_shift(posterior, draws)
    if estimate is not None and shift is not None:
        estimate = estimate.in_finer_steps(*shift)
    return dataclasses.replace(sampled, evidence=estimate)


def _run_until_converged(under_way: _Walk, step_limit: int, report: Reporter) -> SamplingResult:
    """Advance until the targets are met, more steps would not help, or there are `step_limit` steps.

    Only the chain determines the steps of the checks, so a resumed run checks at the same steps.
    """
    posterior, plan, have = under_way.pool.posterior, under_way.plan, max(under_way.steps)
    last = max(step_limit, have)
    goal = min(FIRST_CHECK, last)
    trail: list[tuple[int, float]] = []
    done = 0.01

    def tell(steps: int) -> None:
        report.update(done, f"{steps} of {goal} steps to the next check")

    report.update(0.0, "continuing the ensembles" if have else "starting the walkers")
    while True:
        under_way.advance_to(goal, tell)
        theta = _physical(posterior, _stack(under_way.segments, "z", goal))
        measured = chain_length(theta)
        trail.append((goal, measured.n_tau))
        hopeless = futility(trail, plan.targets.n_tau, plan.max_steps, step_limit)
        ending = hopeless is not None or goal == last
        following = min(measured.next_check(goal, plan.targets.n_tau), last)
        # A resumed run need not assess its shorter chains again: they had not converged.
        if goal >= have and (ending or measured.n_tau >= plan.targets.n_tau):
            sampled = _assess(posterior, plan, under_way.segments, theta, measured)
            convergence = sampled.convergence
            done = min(convergence.progress(plan.targets), 0.99, goal / following)
            report.update(done, _state_of(convergence))
            if hopeless is not None and not convergence.converged:
                reasons = (*convergence.reasons, hopeless)
                convergence = dataclasses.replace(convergence, reasons=reasons, enough=None)
            if convergence.converged or ending:
                return dataclasses.replace(sampled, convergence=convergence)
        else:
            done = min(measured.n_tau / plan.targets.n_tau, 0.99)
            report.update(done, f"{goal} steps: {measured.n_tau:.0f} autocorrelation times")
        goal = following


def _assess(
    posterior: Posterior,
    plan: Plan,
    segments: list[list[ChainSegment]],
    theta: Array,
    measured: ChainLength | None = None,
) -> SamplingResult:
    """Return the result of `segments`, whose steps are `theta (E, S, W, D)` in SI."""
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
    """Return the first `n` steps (default: all) of each chain as one array `(E, S, W, ...)`."""
    return np.array([np.concatenate([getattr(p, name) for p in ps])[:n] for ps in chains])


def _state_of(c: Convergence) -> str:
    """Describe the state of the chains, with the first reason to go on."""
    missing = f"; {c.reasons[0].kind}" if c.reasons else ""
    return (
        f"{c.steps} steps: R-hat {np.max(c.r_hat):.4f}, {c.n_tau:.0f} autocorrelation times, "
        f"ESS {np.min(c.ess_bulk):.0f}{missing}"
    )


def load_sampled(
    posterior: Posterior, plan: Plan, segments: Callable[[int], list[ChainSegment]], location: str
) -> SamplingResult:
    """Return the result of the stored `segments` of each ensemble.

    Raises `InputError` at `location` if the run stopped before its first check.
    """
    chains = [segments(ensemble) for ensemble in range(plan.ensembles)]
    steps = min(map(_steps, chains))
    first = min(FIRST_CHECK, plan.most_steps(len(posterior.space.free)))
    if steps < first or max(map(_steps, chains)) != steps:
        raise InputError.at(
            location, "the run stopped before its first check; continue it with --resume"
        )
    return _assess(posterior, plan, chains, _physical(posterior, _stack(chains, "z")))
