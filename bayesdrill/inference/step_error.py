"""How fine the steps of a rig with friction have to be, and what they cost in truth."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS, Simulator, Stepping

Taken = tuple[int, int]  # steps to a sample, and parts of those in which something turns

FINER = 16  # times as many pieces are taken for the truth
ENOUGH = 0.1  # of the noise: what steps may do to a sample
SAFE = 0.5  # of that, where they are chosen: elsewhere than where they are looked at in the end
POINTS, SCATTER = 8, 0.1  # looked at: as many as take no longer than one; and how far apart
STRANGE = 1  # of them, which need not have enough
MOST = 64
# Pieces, and parts of those in which something turns, that are taken by themselves.
TRIED = (
    (1, 1),
    *((pieces, REVERSAL_SUBSTEPS) for pieces in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MOST)),
)
MOST_STEPS = 4_000_000  # that a truth may take
WEIGHED, LEAST = 1000, 16  # draws for the evidence, and where a truth is dear
AT_ONCE = 50  # of them
ALL_STEPS = 400_000_000  # that the truths of these may take together
HALF = 2  # of the steps of the truth: what it lacks is about as far as from there to it


@dataclass(frozen=True, slots=True, kw_only=True)
class StepError:
    """`errors (K,)`: the most that steps do to a sample of each channel, in sd of its noise."""

    label: str
    channels: tuple[str, ...]
    pieces: int
    errors: tuple[float, ...]

    @property
    def worst(self) -> float:
        return max(self.errors)

    @property
    def fine(self) -> bool:
        return self.worst <= ENOUGH


def evidence_shift(posterior: Posterior, draws: Array) -> tuple[float, float] | None:
    """What the truth adds to a log evidence that was found in steps, and its standard error.

    From its draws `(N, D)`, physical; None where nothing is stepped, or no truth is finite.

    The ratio of the evidences is the mean over the posterior of the ratio of the likelihoods, in finer
    steps and in its own.
    """
    every = _stepped(posterior.likelihood)
    if not every:
        return None
    steps = sum(
        _steps(_truth(observation.response)).pieces * len(observation.experiment.t)
        for observation in every
    )
    most = min(max(ALL_STEPS // steps, LEAST), WEIGHED)
    some = draws[:: max(1, -(-len(draws) // most))]

    def finer(part: int) -> Posterior:
        return _with(posterior, lambda observation: _truth(observation.response, part))

    here, errors = _log_likelihood(posterior, some), []
    for part in (HALF, 1):
        logs = np.nan_to_num(_log_likelihood(finer(part), some) - here, nan=-np.inf)
        top = float(logs.max())
        if not math.isfinite(top):
            return None
        weights = np.exp(logs - top)
        errors.append(top + math.log(weights.mean()))
    spread = float(weights.std(ddof=1) / weights.mean()) / math.sqrt(len(weights))
    return errors[1], math.hypot(spread, errors[1] - errors[0])


def _log_likelihood(posterior: Posterior, draws: Array) -> Array:
    """In turn: noise that asks for samples keeps all of them."""
    parts = np.array_split(draws, -(-len(draws) // AT_ONCE))
    return np.concatenate([posterior.likelihood(some) for some in parts])


def step_errors(likelihood: Likelihood, theta: Array) -> tuple[StepError, ...]:
    """Of all experiments that are stepped, at `theta (D,)`."""
    full = likelihood.space.full(theta[None])
    return tuple(
        StepError(
            label=observation.label,
            channels=observation.experiment.names,
            pieces=_steps(observation.response).pieces,
            errors=tuple(
                map(float, _errors(observation, observation.response, full, theta[None])[0])
            ),
        )
        for observation in _stepped(likelihood)
    )


def chosen(posterior: Posterior, theta: Array, most: int = MOST) -> Posterior:
    """With as few pieces, of `TRIED` up to `most`, as are enough at `theta (D,)` and at other points
    about it.
    """
    points = _about(posterior, theta)
    full = posterior.likelihood.space.full(points)
    tried = [(pieces, turns) for pieces, turns in TRIED if pieces <= most]
    return _with(posterior, lambda observation: _fine(observation, tried, full, points))


def taken(posterior: Posterior) -> dict[str, Taken]:
    """By the labels of experiments, where they were chosen."""
    every = (*posterior.likelihood.observations, *posterior.likelihood.apart)
    steps = [(observation.label, observation.response.stepping) for observation in every]
    return {label: (step.pieces, step.turns) for label, step in steps if step and step.chosen}


def taking(posterior: Posterior, steps: Mapping[str, Taken]) -> Posterior:
    """With steps as `taken` told them; the very same where they are what it takes."""
    if steps.items() <= taken(posterior).items():
        return posterior

    def made(observation: Observation) -> Simulator:
        told = steps.get(observation.label)
        return (
            observation.response.with_substeps(*told, adaptive=True)
            if told
            else observation.response
        )

    return _with(posterior, made)


def _with(posterior: Posterior, made: Callable[[Observation], Simulator]) -> Posterior:
    """With other simulators where they are stepped."""

    def each(observation: Observation) -> Observation:
        return (
            dataclasses.replace(observation, response=made(observation))
            if observation.response.stepping
            else observation
        )

    return posterior.edit(each=each)


def _about(posterior: Posterior, theta: Array) -> Array:
    """`theta` first, `(POINTS, D)`: at one point alone speeds may turn where it does no harm."""
    rng = np.random.default_rng(0)
    share = rng.uniform(-SCATTER, SCATTER, (POINTS, len(theta)))
    share[0] = 0.0
    ends = [(prior.low, prior.high) for prior in posterior.space.priors.values()]
    low, high = np.array(ends).reshape(-1, 2).T
    return np.clip(theta * (1.0 + share), low, high)


def _stepped(likelihood: Likelihood) -> list[Observation]:
    return [observation for observation in likelihood.observations if observation.response.stepping]


def _steps(response: Simulator) -> Stepping:
    """Of one that has some."""
    assert response.stepping
    return response.stepping


def _fine(observation: Observation, tried: Sequence[Taken], full: Array, theta: Array) -> Simulator:
    made = observation.response
    for pieces, turns in tried:
        made = observation.response.with_substeps(pieces, turns, adaptive=True)
        worst = np.sort(_errors(observation, made, full, theta).max(axis=1))
        if not worst[-1 - STRANGE] > SAFE * ENOUGH:
            break
    return made


def _truth(response: Simulator, part: int = 1) -> Simulator:
    """`FINER` times as fine or as `MOST_STEPS` allow, twice at least; `part`: by so much less."""
    pieces = _steps(response).pieces
    allowed = MOST_STEPS // (pieces * len(response.experiment.t))
    return response.with_substeps(pieces * max(1, max(2, min(FINER, allowed)) // part))


def _errors(observation: Observation, response: Simulator, full: Array, theta: Array) -> Array:
    """The most that the steps of `response` do to a sample `(W, K)`, over its sd.  A walker that
    overflows has none.
    """
    told = observation.told(full)
    truth = _truth(response).signals(told)
    off = np.abs(response.signals(told) - truth)
    with np.errstate(invalid="ignore"):
        shares = np.where(response.experiment.seen, off / observation.scales(theta)[:, None], 0.0)
    return np.asarray(np.nan_to_num(shares).max(axis=1))
