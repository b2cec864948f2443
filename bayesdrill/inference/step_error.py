"""Errors of the time steps of a rig with friction, and the steps that keep them small."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator, Stepping

StepSizes = tuple[int, int]  # steps to a sample, and parts of those in which something turns

TRUTH_REFINEMENT = 16  # times as many pieces are taken for the truth
MAX_ERROR_OVER_NOISE = 0.1  # of the noise: what steps may do to a sample
# Of that, where they are chosen: elsewhere than where they are looked at in the end.
CHOICE_MARGIN = 0.5
N_POINTS, SCATTER = 8, 0.1  # looked at: as many as take no longer than one; and how far apart
N_OUTLIERS = 1  # of them, which need not have enough
MAX_CHOSEN_PIECES = 64
# Pieces, and parts of those in which something turns, that are taken by themselves.
CANDIDATE_STEPS = (
    (1, 1),
    *(
        (pieces, REVERSAL_SUBSTEPS)
        for pieces in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MAX_CHOSEN_PIECES)
    ),
)
MAX_TRUTH_STEPS = 4_000_000  # that a truth may take
# Draws for the evidence, and where a truth is dear.
MAX_EVIDENCE_DRAWS, MIN_EVIDENCE_DRAWS = 1000, 16
DRAWS_PER_BATCH = 50  # of them
MAX_TOTAL_STEPS = 400_000_000  # that the truths of these may take together
COARSER_TRUTH = 2  # of the steps of the truth: what it lacks is about as far as from there to it


@dataclass(frozen=True, slots=True, kw_only=True)
class StepError:
    """The largest errors that steps cause; `errors (K,)`: in sd of each channel's noise."""

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
        """Whether the steps are fine enough."""
        return self.worst <= MAX_ERROR_OVER_NOISE


def evidence_shift(posterior: Posterior, draws: Array) -> tuple[float, float] | None:
    """Return what finer steps add to a log evidence, and its standard error, from draws `(N, D)`.

    They are physical.  None where nothing is stepped, or no finer response is finite.  The ratio of
    evidences is the mean over the posterior of that of likelihoods, in finer steps and in its own.
    """
    observations = _stepped(posterior.likelihood)
    if not observations:
        return None
    finest = [(_steps(_truth(each.response)), each.experiment) for each in observations]
    steps = sum(stepping.pieces * len(experiment.t) for stepping, experiment in finest)
    n_draws = min(max(MAX_TOTAL_STEPS // steps, MIN_EVIDENCE_DRAWS), MAX_EVIDENCE_DRAWS)
    thinned = draws[:: max(1, -(-len(draws) // n_draws))]

    def finer(part: int) -> Posterior:
        return _with_simulators(posterior, lambda observation: _truth(observation.response, part))

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
    """In turn: noise that asks for samples keeps all of them."""
    parts = np.array_split(draws, -(-len(draws) // DRAWS_PER_BATCH))
    return np.concatenate([posterior.likelihood(batch) for batch in parts])


def step_errors(likelihood: Likelihood, theta: Array) -> tuple[StepError, ...]:
    """Return the errors of all experiments that are stepped, at `theta (D,)`."""
    full = likelihood.space.full(theta[None])
    return tuple(
        StepError(
            label=each.label,
            channels=each.experiment.names,
            pieces=_steps(each.response).pieces,
            errors=tuple(map(float, _errors(each, each.response, full, theta[None])[0])),
        )
        for each in _stepped(likelihood)
    )


def choose_steps(posterior: Posterior, theta: Array, most: int = MAX_CHOSEN_PIECES) -> Posterior:
    """Return it with as few `CANDIDATE_STEPS`, up to `most` pieces, as do about `theta (D,)`."""
    points = _points_around(posterior, theta)
    full = posterior.likelihood.space.full(points)
    candidates = [(pieces, turns) for pieces, turns in CANDIDATE_STEPS if pieces <= most]
    return _with_simulators(posterior, lambda each: _fine_enough(each, candidates, full, points))


def chosen_steps(posterior: Posterior) -> dict[str, StepSizes]:
    """Return the steps by labels of experiments, where they were chosen."""
    observations = (*posterior.likelihood.observations, *posterior.likelihood.held_out)
    return {
        each.label: (stepping.pieces, stepping.turns)
        for each in observations
        if (stepping := each.response.stepping) and stepping.chosen
    }


def with_steps(posterior: Posterior, steps: Mapping[str, StepSizes]) -> Posterior:
    """Return it with steps as of `chosen_steps`; the very same where it has these."""
    if steps.items() <= chosen_steps(posterior).items():
        return posterior

    def simulator_of(observation: Observation) -> Simulator:
        size, response = steps.get(observation.label), observation.response
        return response.with_substeps(*size, adaptive=True) if size else response

    return _with_simulators(posterior, simulator_of)


def _with_simulators(
    posterior: Posterior, simulator_of: Callable[[Observation], Simulator]
) -> Posterior:
    """With other simulators where they are stepped."""

    def each(observation: Observation) -> Observation:
        if not observation.response.stepping:
            return observation
        return dataclasses.replace(observation, response=simulator_of(observation))

    return posterior.edit(each=each)


def _points_around(posterior: Posterior, theta: Array) -> Array:
    """`theta` first, `(N_POINTS, D)`: at one point alone speeds may turn where it does no harm."""
    rng = np.random.default_rng(0)
    share = rng.uniform(-SCATTER, SCATTER, (N_POINTS, len(theta)))
    share[0] = 0.0
    bounds = [(prior.low, prior.high) for prior in posterior.space.priors.values()]
    low, high = np.array(bounds).reshape(-1, 2).T
    return np.clip(theta * (1.0 + share), low, high)


def _stepped(likelihood: Likelihood) -> list[Observation]:
    return [observation for observation in likelihood.observations if observation.response.stepping]


def _steps(response: Simulator) -> Stepping:
    """Of one that has some."""
    assert response.stepping
    return response.stepping


def _fine_enough(
    observation: Observation, candidates: Sequence[StepSizes], full: Array, theta: Array
) -> Simulator:
    response = observation.response
    for pieces, turns in candidates:
        response = observation.response.with_substeps(pieces, turns, adaptive=True)
        worst = np.sort(_errors(observation, response, full, theta).max(axis=1))
        if not worst[-1 - N_OUTLIERS] > CHOICE_MARGIN * MAX_ERROR_OVER_NOISE:
            break
    return response


def _truth(response: Simulator, part: int = 1) -> Simulator:
    """Refine by `TRUTH_REFINEMENT`, or as `MAX_TRUTH_STEPS` allow, twice at least; a `part` of it."""
    pieces = _steps(response).pieces
    allowed = MAX_TRUTH_STEPS // (pieces * len(response.experiment.t))
    return response.with_substeps(pieces * max(1, max(2, min(TRUTH_REFINEMENT, allowed)) // part))


def _errors(observation: Observation, response: Simulator, full: Array, theta: Array) -> Array:
    """Return the largest error of a sample `(W, K)` by steps of `response`, over its sd, if finite."""
    parameters = observation.simulator_parameters(full)
    truth = _truth(response).signals(parameters)
    errors = np.abs(response.signals(parameters) - truth)
    with np.errstate(invalid="ignore"):
        shares = errors / observation.scales(theta)[:, None]
        shares = np.where(response.experiment.seen, shares, 0.0)
    return np.asarray(np.nan_to_num(shares).max(axis=1))
