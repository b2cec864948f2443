"""How fine the steps of a rig that rubs have to be, and what they cost in truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.stepped import Stepped

Array = NDArray[np.float64]

FINER = 16  # times as many pieces are taken for the truth
ENOUGH = 0.1  # of the noise: what steps may do to a sample
SAFE = 0.7  # of that, where they are chosen: elsewhere than where they are looked at in the end
NUMBERS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # of pieces that are taken by themselves
MOST = NUMBERS[-1]
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


def chosen(posterior: Posterior, theta: Array) -> Posterior:
    """With as few pieces, of `NUMBERS`, as are enough at `theta (D,)`."""
    likelihood = posterior.likelihood
    full = likelihood.space.full(theta[None])
    made, apart = (
        tuple(_fine(one, full, theta) if isinstance(one.response, Stepped) else one for one in some)
        for some in (likelihood.observations, likelihood.apart)
    )
    likelihood = dataclasses.replace(likelihood, observations=made, apart=apart)
    return dataclasses.replace(posterior, likelihood=likelihood)


def _stepped(likelihood: Likelihood) -> Iterator[tuple[Observation, Stepped]]:
    for one in likelihood.observations:
        if isinstance(one.response, Stepped):
            yield one, one.response


def _fine(one: Observation, full: Array, theta: Array) -> Observation:
    response, tried = one.response, one
    assert isinstance(response, Stepped)
    for pieces in NUMBERS:
        tried = dataclasses.replace(one, response=response.finer(pieces))
        if not _error(tried, full, theta).worst > SAFE * ENOUGH:
            break
    return tried


def _error(one: Observation, full: Array, theta: Array) -> StepError:
    """A walker that overflows has no error."""
    response = one.response
    assert isinstance(response, Stepped)
    finer = max(1, min(FINER, MOST_STEPS // (response.pieces * len(response.experiment.t))))
    told = one.told(full)
    truth = response.finer(response.pieces * max(2, finer)).signals(told)[0]
    off = np.abs(response.signals(told)[0] - truth)
    with np.errstate(invalid="ignore"):
        shares = np.where(response.experiment.seen, off / one.scales(theta[None])[0], 0.0)
    return StepError(
        label=one.label,
        channels=response.experiment.names,
        pieces=response.pieces,
        errors=tuple(float(np.nan_to_num(share)) for share in shares.max(axis=0)),
    )
