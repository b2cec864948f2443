"""What the best fit leaves of a record, and whether noise alone leaves as much.

All that is said of the unknowns counts on the model and on white noise of the given size.  Both
show in what is left: its size over sigma, single samples far off, and whether one sample has
something to do with the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.likelihood import Likelihood, Observation

FALSE_ALARM = 0.01  # of records of the model, with its noise, would give any finding at most
FAR_TOO_LARGE = 1.5  # rms over sigma, from which on nothing that counts on the noise is believed
REMEMBERED = 0.6  # correlation of neighbours, from which on sds are too small by a factor of two
LOOKS = 5  # at each channel: size and correlation both ways, and the farthest sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What noise leaves in one channel of all: rms over sigma, correlation, farthest sample."""

    least: float
    most: float
    correlation: float
    farthest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """Of one channel: rms over sigma, the correlation of one sample with the next, and the sample
    that is farthest off, in sigmas, at `time` [s].  `share`: of the channel's spread about its mean;
    NaN where it has none.  `experiment`: its label among several.
    """

    channel: str
    rms: float
    share: float
    correlation: float
    farthest: float
    time: float
    limits: Limits
    experiment: str = ""

    @property
    def name(self) -> str:
        """In sentences."""
        return f"{self.channel} in {self.experiment}" if self.experiment else self.channel

    @property
    def large(self) -> bool:
        return self.rms > self.limits.most

    @property
    def small(self) -> bool:
        return self.rms < self.limits.least

    @property
    def correlated(self) -> bool:
        return abs(self.correlation) > self.limits.correlation

    @property
    def like_noise(self) -> bool:
        """Less than the noise is no evidence against the model: then sds are only too large."""
        return not (self.large or self.correlated or self.far)

    @property
    def unbelievable(self) -> bool:
        """Whether all that is said of the unknowns must not be believed."""
        return self.far_too_large or (self.correlated and self.correlation > REMEMBERED)

    @property
    def far_too_large(self) -> bool:
        return self.large and self.rms > FAR_TOO_LARGE

    @property
    def far(self) -> bool:
        """A few samples by themselves; where all are too large that is said already."""
        return self.farthest > self.limits.farthest and not self.large


def like_noise(found: Sequence[Left]) -> bool:
    """Whether no channel is left with more than its noise."""
    return all(one.like_noise for one in found)


def left(likelihood: Likelihood, theta: Array) -> tuple[Left, ...]:
    """At the unknowns `theta (D,)`; an unknown sigma fits the size, unless its prior keeps it off."""
    full, row = likelihood.space.full(theta[None]), theta[None]
    channels = sum(len(one.experiment.channels) for one in likelihood.observations)
    return tuple(
        found for one in likelihood.observations for found in _of(one, full, row, channels)
    )


def _of(one: Observation, full: Array, theta: Array, channels: int) -> Iterator[Left]:
    """`channels`: how many there are in all observations."""
    experiment = one.experiment
    remains = (experiment.y - one.followed(full, theta))[0]
    whitened = one.whiten(one.residuals(full).samples, theta)[0]
    for k, seen in enumerate(experiment.seen.T):
        residuals, n = whitened[seen, k], int(seen.sum())
        squares = float(residuals @ residuals)
        spread = float(experiment.y[seen, k].std())
        worst = int(np.abs(residuals).argmax())
        yield Left(
            channel=experiment.names[k],
            rms=math.sqrt(squares / n),
            share=math.sqrt(np.mean(remains[seen, k] ** 2)) / spread if spread > 0 else math.nan,
            correlation=float(residuals[1:] @ residuals[:-1]) / squares if squares > 0 else 0.0,
            farthest=float(abs(residuals[worst])),
            time=float(experiment.t[seen][worst]),
            limits=limits(n, channels, theta.shape[1]),
            experiment=one.label,
        )


def limits(samples: int, channels: int, unknowns: int) -> Limits:
    """A fit takes something away from what noise leaves, and never adds to it: the limits above are
    those without a fit, the one below allows for as many unknowns as there are.
    """
    tail = FALSE_ALARM / (LOOKS * channels)
    return Limits(
        least=math.sqrt(scipy.special.chdtri(max(samples - unknowns, 1), 1 - tail) / samples),
        most=math.sqrt(scipy.special.chdtri(samples, tail) / samples),
        correlation=-float(scipy.special.ndtri(tail)) / math.sqrt(samples),
        farthest=-float(scipy.special.ndtri(0.5 * tail / samples)),
    )
