"""Estimate errors by finite time steps of rigs with friction, and choose sufficient steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator

StepSizes = tuple[int, int]  # steps per sample, and substeps of a step with a reversal

TRUTH_REFINEMENT = 16  # number of steps: reference solution / present solution
MAX_ERROR_OVER_NOISE = 0.1  # largest accepted error of a sample, in sds of its noise
# Errors of chosen steps are below this fraction of the limit, as other points may exceed them.
CHOICE_MARGIN = 0.5
N_POINTS = 8  # number of points at which steps are tried, together as fast as one point
SCATTER = 0.1  # largest relative deviation of an unknown at these points
N_OUTLIERS = 1  # number of these points that may have a larger error
MAX_CHOSEN_PIECES = 64  # largest number of steps per sample that is chosen
# Candidates are tried in this order, the fastest first.
PIECES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MAX_CHOSEN_PIECES)
CANDIDATE_STEPS = ((1, 1), *((pieces, REVERSAL_SUBSTEPS) for pieces in PIECES))
MAX_TRUTH_STEPS = 4_000_000  # largest number of steps of a reference solution
# Limits of the number of draws for the evidence; a costly reference solution gets fewer draws.
MAX_EVIDENCE_DRAWS, MIN_EVIDENCE_DRAWS = 1000, 16
DRAWS_PER_BATCH = 50  # bounds memory, as some noises need all samples
MAX_TOTAL_STEPS = 400_000_000  # largest number of steps of all reference solutions together
COARSER_TRUTH = 2  # step ratio of a coarser reference, which shows the reference's own error


@dataclass(frozen=True, slots=True, kw_only=True)
class StepError:
    """Time steps of an experiment cause errors of at most `errors (K,)`, in sds of the noise."""

    label: str
    channels: tuple[str, ...]
    pieces: int
    errors: tuple[float, ...]

    @property
    def worst(self) -> float:
        """Return the largest error."""
        return max(self.errors)

    @property
    def fine(self) -> bool:
        """Return whether the steps are fine enough."""
        return self.worst <= MAX_ERROR_OVER_NOISE


def evidence_shift(posterior: Posterior, draws: Array) -> tuple[float, float] | None:
    """Return how much finer steps change a log evidence, and the standard error of this change.

    The ratio of evidences is the mean, over physical `draws (N, D)` of the posterior, of the ratio
    L(finer steps) / L(present steps).  The result is None without steps or a finite response.
    """
    references = [_truth(each.response) for each in posterior.likelihood.observations]
    steps = sum(
        each.stepping.pieces * len(each.experiment.t) for each in references if each.stepping
    )
    if not steps:
        return None
    n_draws = min(max(MAX_TOTAL_STEPS // steps, MIN_EVIDENCE_DRAWS), MAX_EVIDENCE_DRAWS)
    thinned = draws[:: max(1, -(-len(draws) // n_draws))]

    def finer(part: int) -> Posterior:
        return posterior.with_simulators(lambda each: _truth(each.response, part))

    coarse, shifts = _log_likelihood(posterior, thinned), []
    for part in (COARSER_TRUTH, 1):
        logs = np.nan_to_num(_log_likelihood(finer(part), thinned) - coarse, nan=-np.inf)
        top = float(logs.max())
        if not math.isfinite(top):
            return None
        weights = np.exp(logs - top)
        shifts.append(top + math.log(weights.mean()))
    standard_error = float(weights.std(ddof=1) / weights.mean()) / math.sqrt(len(weights))
    return shifts[1], math.hypot(standard_error, shifts[1] - shifts[0])


def _log_likelihood(posterior: Posterior, draws: Array) -> Array:
    """Return log likelihoods `(N,)`, in batches as some noises keep all samples."""
    parts = np.array_split(draws, -(-len(draws) // DRAWS_PER_BATCH))
    return np.concatenate([posterior.likelihood(batch) for batch in parts])


def step_errors(likelihood: Likelihood, theta: Array) -> tuple[StepError, ...]:
    """Return the errors of all stepped experiments at physical `theta (D,)`."""
    full = likelihood.space.full(theta[None])
    return tuple(
        StepError(
            label=each.label,
            channels=each.experiment.names,
            pieces=each.response.stepping.pieces,
            errors=tuple(map(float, _errors(each, each.response, full, theta[None])[0])),
        )
        for each in likelihood.observations
        if each.response.stepping
    )


def choose_steps(
    posterior: Posterior, theta: Array, max_steps: int = MAX_CHOSEN_PIECES
) -> Posterior:
    """Return the posterior with the fastest sufficient steps, up to `max_steps`, near `theta (D,)`."""
    # At one point alone, errors may be small by coincidence.
    relative = np.random.default_rng(0).uniform(-SCATTER, SCATTER, (N_POINTS, len(theta)))
    relative[0] = 0.0
    bounds = [(prior.low, prior.high) for prior in posterior.space.priors.values()]
    low, high = np.array(bounds).reshape(-1, 2).T
    points = np.clip(theta * (1.0 + relative), low, high)
    full = posterior.likelihood.space.full(points)
    candidates = [(pieces, turns) for pieces, turns in CANDIDATE_STEPS if pieces <= max_steps]
    return posterior.with_simulators(lambda each: _fine_enough(each, candidates, full, points))


def chosen_steps(posterior: Posterior) -> dict[str, StepSizes]:
    """Return the steps that were chosen automatically, by the label of the experiment."""
    observations = (*posterior.likelihood.observations, *posterior.likelihood.held_out)
    steppings = {observation.label: observation.response.stepping for observation in observations}
    return {label: (s.pieces, s.turns) for label, s in steppings.items() if s and s.chosen}


def with_steps(posterior: Posterior, steps: Mapping[str, StepSizes]) -> Posterior:
    """Return the posterior with `steps` by label, or itself if it has these steps already."""
    if steps.items() <= chosen_steps(posterior).items():
        return posterior

    def simulator_of(observation: Observation) -> Simulator:
        size, response = steps.get(observation.label), observation.response
        if not (size and response.stepping):
            return response
        return response.with_substeps(*size, adaptive=True)

    return posterior.with_simulators(simulator_of)


def _fine_enough(
    observation: Observation, candidates: Sequence[StepSizes], full: Array, theta: Array
) -> Simulator:
    response = observation.response
    for pieces, turns in candidates if response.stepping else ():
        response = observation.response.with_substeps(pieces, turns, adaptive=True)
        worst = np.sort(_errors(observation, response, full, theta).max(axis=1))
        if not worst[-1 - N_OUTLIERS] > CHOICE_MARGIN * MAX_ERROR_OVER_NOISE:
            break
    return response


def _truth(response: Simulator, part: int = 1) -> Simulator:
    """Return the reference solution, at least twice as fine; `part` divides the refinement."""
    if not response.stepping:
        return response
    pieces = response.stepping.pieces
    allowed = MAX_TRUTH_STEPS // (pieces * len(response.experiment.t))
    return response.with_substeps(pieces * max(1, max(2, min(TRUTH_REFINEMENT, allowed)) // part))


def _errors(observation: Observation, response: Simulator, full: Array, theta: Array) -> Array:
    """Return the largest error `(W, K)` that the steps of `response` cause, in sds of noise."""
    parameters = observation.simulator_parameters(full)
    truth = _truth(response).signals(parameters)
    errors = np.abs(response.signals(parameters) - truth)
    with np.errstate(invalid="ignore"):
        relative = errors / observation.scales(theta)[:, None]
        relative = np.where(response.experiment.is_measured, relative, 0.0)
    return np.asarray(np.nan_to_num(relative).max(axis=1))
