"""Whether the record is as the posterior predicts it: where each sample lies in its own prediction.

The probability integral transform (PIT) of a sample is the share of its prediction below it; where model
and noise are right they are uniform.  Each is of the posterior without that sample, for a sample that
helps to predict itself is predicted too well: draws weigh as one over what they give that sample, but
none more than the root of their number times the mean (Ionides 2008).  Pareto smoothing would refuse
samples at which all draws agree, such as the first of a rig at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.insight.calibration.bands import Band, ecdf_band
from bayesdrill.insight.calibration.ranks import shape
from bayesdrill.record.experiment import Channel

Array = NDArray[np.float64]

BINS = 100
MOST = 2000  # samples of a channel that are looked at
FALSE_ALARM = 0.01  # of records of the model, with its noise, leave any band, at most
SAYS = {
    "posterior too low": "measured lies above",
    "posterior too high": "measured lies below",
    "posterior too narrow": "prediction too narrow",
    "posterior too wide": "prediction too wide",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Of one channel: `pit (T,)`, and the band of their distribution; `label`: of its experiment."""

    channel: Channel
    pit: Array
    band: Band
    label: str = ""

    @property
    def ranks(self) -> NDArray[np.int64]:
        """In which of `BINS` equal parts of its prediction each sample lies."""
        return np.minimum((BINS * self.pit).astype(np.int64), BINS - 1)

    @property
    def holds(self) -> bool:
        return self.band.holds(self.ranks)

    @property
    def says(self) -> str:
        """What is wrong with the prediction; empty where chance explains all."""
        if self.holds:
            return ""
        return SAYS.get(shape(self.ranks, BINS - 1) or "", "not as predicted")


def checks(likelihood: Likelihood, theta: Array) -> tuple[Check, ...]:
    """Of each channel, by draws `theta (N, D)`."""
    every = [
        (one, *found) for one in likelihood.observations for found in _pits(likelihood, one, theta)
    ]
    lengths = {len(pit) for *_, pit in every}
    bands = {n: ecdf_band(n, BINS - 1, FALSE_ALARM / len(every)) for n in lengths}
    return tuple(
        Check(channel=channel, label=one.label, pit=pit, band=bands[len(pit)])
        for one, channel, pit in every
    )


def _pits(
    likelihood: Likelihood, one: Observation, theta: Array
) -> Iterator[tuple[Channel, Array]]:
    pit = leave_one_out(likelihood, one, theta)
    for k, channel in enumerate(one.experiment.channels):
        seen = ~np.isnan(pit[:, k])
        if seen.any():
            yield channel, pit[seen, k]


def leave_one_out(likelihood: Likelihood, one: Observation, theta: Array) -> Array:
    """PITs `(T, K)` of at most `MOST` samples, evenly spaced; NaN where nothing was measured.

    What is left of a sample is whitened, so that each counts on those before it where the noise
    remembers them.
    """
    rest = one.residuals(likelihood.space.full(theta)).samples
    n = len(one.experiment.t)
    seen = np.unique(np.linspace(0, n - 1, min(n, MOST)).round().astype(int))
    below = ndtr(one.whiten(rest, theta)[:, seen])
    log_p = one.pointwise(rest, theta)[:, seen]
    weights = np.exp(log_p.min(axis=0) - log_p)
    weights = np.minimum(weights, weights.mean(axis=0) * len(theta) ** 0.5)
    return np.asarray((weights * below).sum(axis=0) / weights.sum(axis=0))
