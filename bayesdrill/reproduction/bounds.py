"""How well an estimate can do at all: Cramer-Rao bounds, and for which record length."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.experiment import regular
from bayesdrill.identifiability.information import from_sensitivities
from bayesdrill.identifiability.scenes import Scenery
from bayesdrill.likelihood import Likelihood
from bayesdrill.response import Response

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Length:
    """Relative Cramer-Rao bounds at sigma 1 of a record of `duration` s at `rate` Hz, by unknown."""

    duration: float
    rate: float
    bounds: Mapping[str, float]


def bounds(likelihood: Likelihood, truth: Array) -> Array:
    """Cramer-Rao bounds of the unknowns `(D,)`, physical, for noise of sigma 1 in every channel."""
    scenery = Scenery(likelihood)
    scene = dataclasses.replace(scenery.as_it_is(truth), sigma=np.ones(likelihood.noise.n_channels))
    known = from_sensitivities(scenery.unknowns, scenery.sensitivities(truth, scene))
    return np.asarray(known.bounds() * truth)


def lengths(
    likelihood: Likelihood, truth: Array, grid: Sequence[tuple[float, float]]
) -> tuple[Length, ...]:
    """Of records of (duration [s], rate [Hz]), otherwise like the one there is."""
    found = []
    for duration, rate in grid:
        experiment = regular(likelihood.response.experiment, duration, rate)
        response = Response(likelihood.response.model, experiment)
        longer = dataclasses.replace(
            likelihood,
            response=response,
            noise=dataclasses.replace(likelihood.noise, n_samples=len(experiment.t)),
        )
        relative = bounds(longer, truth) / truth
        named = dict(zip(likelihood.space.free, map(float, relative), strict=True))
        found.append(Length(duration=duration, rate=rate, bounds=named))
    return tuple(found)
