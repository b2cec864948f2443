"""How well an estimate can do at all: Cramer-Rao bounds, and for which record length."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference import Likelihood
from bayesdrill.insight import Scenery, from_sensitivities
from bayesdrill.paper.studies import printed
from bayesdrill.record import regular
from bayesdrill.rig import Response

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
    sigma = likelihood.sigmas(truth[None])[0]
    rows = scenery.sensitivities(truth)
    each = (rows.reshape(-1, len(sigma), rows.shape[1]) * sigma[:, None]).reshape(rows.shape)
    known = from_sensitivities(scenery.unknowns, each)
    return np.asarray(known.bounds() * truth)


def at_sigma_1(likelihood: Likelihood, truth: Mapping[str, float]) -> dict[str, float]:
    """`bounds` relative to the truth, by unknown."""
    theta = likelihood.space.vector(truth)
    relative = bounds(likelihood, theta) / theta
    return dict(zip(likelihood.space.free, map(float, relative), strict=True))


def lengths(
    likelihood: Likelihood, truth: Mapping[str, float], grid: Sequence[tuple[float, float]]
) -> tuple[Length, ...]:
    """Of records of (duration [s], rate [Hz]), otherwise like the one there is."""
    found = []
    for duration, rate in grid:
        experiment = regular(likelihood.response.experiment, duration, rate)
        response = Response(likelihood.response.model, experiment)
        noise = likelihood.noise.for_length(len(experiment.t))
        longer = likelihood.with_alone(response=response, noise=noise)
        found.append(Length(duration=duration, rate=rate, bounds=at_sigma_1(longer, truth)))
    return tuple(found)


@dataclass(frozen=True, slots=True, kw_only=True)
class Implied:
    """Deviations of Table 2 in per cent, and the noise whose Cramer-Rao bound each is.

    `row`: the sigma_n of Table 2, `rms` over all of them, or `bound`: the bounds at 0.001.
    """

    row: str
    c_m_percent: float
    k_e_percent: float
    ratio: float
    noise_c_m: float
    noise_k_e: float


def implied_noise(one: Mapping[str, float]) -> tuple[Implied, ...]:
    """Given the relative bounds at sigma 1: what noise the printed deviations would come from."""
    table = {
        f"{sigma:g}": {name: cell.deviation for name, cell in row.items()}
        for sigma, row in printed.TWO_PARAMETERS.items()
    }
    squares = {
        name: float(np.mean([row[name] ** 2 for row in table.values()])) for name in printed.START
    }
    table["rms"] = {name: math.sqrt(square) for name, square in squares.items()}
    table["bound"] = {name: 100 * 1e-3 * one[name] for name in printed.START}
    return tuple(
        Implied(
            row=label,
            c_m_percent=row["c_m"],
            k_e_percent=row["k_e"],
            ratio=row["c_m"] / row["k_e"],
            noise_c_m=row["c_m"] / 100 / one["c_m"],
            noise_k_e=row["k_e"] / 100 / one["k_e"],
        )
        for label, row in table.items()
    )
