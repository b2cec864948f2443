"""How fine the steps of a rig that rubs have to be, and what they cost in truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.stepped import TURNS, Stepped

Array = NDArray[np.float64]
Taken = tuple[int, int]  # steps to a sample, and parts of those in which something turns

FINER = 16  # times as many pieces are taken for the truth
ENOUGH = 0.1  # of the noise: what steps may do to a sample
SAFE = 0.5  # of that, where they are chosen: elsewhere than where they are looked at in the end
POINTS, SCATTER = (
    8,
    0.1,
)  # that are looked at: as many as take no longer than one; and how far they are
STRANGE = 1  # of them, which need not have enough
MOST = 64
# Pieces, and parts of those in which something turns, that are taken by themselves.
TRIED = ((1, 1), *((pieces, TURNS) for pieces in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MOST)))
MOST_STEPS = 4_000_000  # that a truth may take


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


def step_errors(likelihood: Likelihood, theta: Array) -> tuple[StepError, ...]:
    """Of all experiments that are stepped, at `theta (D,)`."""
    full = likelihood.space.full(theta[None])
    return tuple(_error(one, full, theta) for one, _ in _stepped(likelihood))


def chosen(posterior: Posterior, theta: Array, most: int = MOST) -> Posterior:
    """With as few pieces, of `TRIED` up to `most`, as are enough at `theta (D,)` and at other points
    about it.
    """
    points = _about(posterior, theta)
    full = posterior.likelihood.space.full(points)
    tried = [(pieces, turns) for pieces, turns in TRIED if pieces <= most]
    return _with(posterior, lambda one, response: _fine(one, response, tried, full, points))


def taken(posterior: Posterior) -> dict[str, Taken]:
    """By the labels of experiments, where they were chosen."""
    every = (*posterior.likelihood.observations, *posterior.likelihood.apart)
    return {
        one.label: (one.response.pieces, one.response.turns)
        for one in every
        if isinstance(one.response, Stepped) and one.response.chosen
    }


def taking(posterior: Posterior, steps: Mapping[str, Taken]) -> Posterior:
    """With steps as `taken` told them; the very same where they are what it takes."""
    if steps.items() <= taken(posterior).items():
        return posterior
    return _with(
        posterior,
        lambda one, response: _in(one, response, *steps[one.label]) if one.label in steps else one,
    )


def _with(posterior: Posterior, made: Callable[[Observation, Stepped], Observation]) -> Posterior:
    """With other observations where they are stepped."""
    likelihood = posterior.likelihood
    every, apart = (
        tuple(made(one, one.response) if isinstance(one.response, Stepped) else one for one in some)
        for some in (likelihood.observations, likelihood.apart)
    )
    likelihood = dataclasses.replace(likelihood, observations=every, apart=apart)
    return dataclasses.replace(posterior, likelihood=likelihood)


def _in(one: Observation, response: Stepped, pieces: int, turns: int) -> Observation:
    response = dataclasses.replace(response.finer(pieces, turns), chosen=True)
    return dataclasses.replace(one, response=response)


def _about(posterior: Posterior, theta: Array) -> Array:
    """`theta` first, `(POINTS, D)`: at one point alone speeds may turn where it does no harm."""
    rng = np.random.default_rng(0)
    share = rng.uniform(-SCATTER, SCATTER, (POINTS, len(theta)))
    share[0] = 0.0
    ends = [(prior.low, prior.high) for prior in posterior.space.priors.values()]
    low, high = np.array(ends).reshape(-1, 2).T
    return np.clip(theta * (1.0 + share), low, high)


def _stepped(likelihood: Likelihood) -> Iterator[tuple[Observation, Stepped]]:
    for one in likelihood.observations:
        if isinstance(one.response, Stepped):
            yield one, one.response


def _fine(
    one: Observation, response: Stepped, tried: Sequence[Taken], full: Array, theta: Array
) -> Observation:
    made = one
    for pieces, turns in tried:
        made = _in(one, response, pieces, turns)
        worst = np.sort(_errors(made, full, theta).max(axis=1))
        if not worst[-1 - STRANGE] > SAFE * ENOUGH:
            break
    return made


def _error(one: Observation, full: Array, theta: Array) -> StepError:
    response = one.response
    assert isinstance(response, Stepped)
    return StepError(
        label=one.label,
        channels=response.experiment.names,
        pieces=response.pieces,
        errors=tuple(map(float, _errors(one, full, theta[None])[0])),
    )


def _errors(one: Observation, full: Array, theta: Array) -> Array:
    """The most that steps do to a sample `(W, K)`, over its sd.  A walker that overflows has none."""
    response = one.response
    assert isinstance(response, Stepped)
    finer = max(1, min(FINER, MOST_STEPS // (response.pieces * len(response.experiment.t))))
    told = one.told(full)
    truth = response.finer(response.pieces * max(2, finer)).signals(told)
    off = np.abs(response.signals(told) - truth)
    with np.errstate(invalid="ignore"):
        shares = np.where(response.experiment.seen, off / one.scales(theta)[:, None], 0.0)
    return np.asarray(np.nan_to_num(shares).max(axis=1))
