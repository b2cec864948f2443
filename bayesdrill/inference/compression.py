"""Search in an excerpt of a long record, and compress the whole record to a few hundred numbers.

A compression is accurate only near a point of the parameters, so this point must be known first.  A
search therefore begins on the first part of a record, whose posterior shows which parameters are
plausible.  Counted operations, and never measured times, decide which records are compressed, so
the same config gives the same results on every machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import laplace
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.rig.compression.basis import CompressionError
from bayesdrill.rig.compression.simulator import Compression, compress
from bayesdrill.rig.simulators import COMPRESSED_FROM
from bayesdrill.rig.simulators.contract import Simulator

EXCERPT = 16384  # number of samples in the first excerpt
GROWTH = 4  # factor by which an excerpt grows if it is too short
POINTS = 256  # number of points about a maximum at which the compression has to be accurate
POINT_SDS = (8.0, 3.0, 1.0)  # draw k of the points has POINT_SDS[k % 3] times the posterior sd
# Directions with a larger posterior sd are hardly determined: no points are spread along them.
MAX_SPREAD = 0.05
DEPTH = 40.0  # a maximum whose log density is this far below the highest has negligible mass

Compressions = Mapping[str, Compression]  # keys are labels of observations


def is_long(observation: Observation, max_exact: int = COMPRESSED_FROM) -> bool:
    """Return whether a record has more than `max_exact` samples and can be compressed."""
    return len(observation.experiment.t) > max_exact and not observation.exact_reason


@dataclass(frozen=True, slots=True, kw_only=True)
class CompressionCheck:
    """A check compares a compressed likelihood with the exact one.

    The longest record has `samples` samples, compressed to `functions` basis functions.  Of `draws`
    draws, `exact` needed the exact simulator.  Log likelihoods differ by at most `difference`.
    """

    samples: int
    functions: int
    draws: int
    exact: int
    difference: float


def check_draws(compressed: Posterior, theta: Array) -> CompressionCheck | None:
    """Compare log likelihoods at physical `theta (N, D)`; return None if nothing is compressed."""
    exact = uncompressed(compressed)
    full, beyond = compressed.space.full(theta), np.zeros(len(theta), dtype=bool)
    sizes = []
    for observation in compressed.likelihood.observations:
        response = observation.response
        if response.functions:
            beyond |= response.exceeds_bound(observation.simulator_parameters(full))
            sizes.append((len(observation.experiment.t), response.functions))
    if not sizes:
        return None
    parts = np.array_split(theta, max(1, len(theta) // 50))
    errors = [np.abs(compressed.likelihood(part) - exact.likelihood(part)).max() for part in parts]
    samples, functions = max(sizes)
    return CompressionCheck(
        samples=samples,
        functions=functions,
        draws=len(theta),
        exact=int(beyond.sum()),
        difference=float(max(errors)),
    )


def excerpt(posterior: Posterior, samples: int = EXCERPT) -> Posterior | None:
    """Return the posterior of the first samples of long records, or None if no record is long."""
    observations = posterior.likelihood.observations
    short = tuple(first_samples(observation, samples) for observation in observations)
    if all(new is old for new, old in zip(short, observations, strict=True)):
        return None
    return replace(posterior, likelihood=Likelihood(short, posterior.space))


def longer_excerpt(
    posterior: Posterior, previous: Posterior, compressions: Compressions
) -> Posterior | None:
    """Return an excerpt longer than `previous`, or None.

    None means that no record is longer, or that `compressions` includes all long records.
    """
    pairs = zip(posterior.likelihood.observations, previous.likelihood.observations, strict=True)
    parts = [part for each, part in pairs if is_long(each) and each.label not in compressions]
    unknown = [len(part.experiment.t) for part in parts]
    return excerpt(posterior, GROWTH * max(unknown)) if unknown else None


def first_samples(observation: Observation, samples: int) -> Observation:
    """Return the observation with the first samples of its record; a short record is unchanged."""
    if len(observation.experiment.t) <= samples or not is_long(observation):
        return observation
    return observation.for_record(observation.experiment.first(samples))


def points_about(posterior: Posterior, maxima: Array) -> Array:
    """Return physical points `(n, D)` about maxima `(M, D)`, spread by up to 8 posterior sds."""
    parts = []
    for theta in maxima:
        u, rng = posterior.coordinates.from_physical(theta[None]), np.random.default_rng(0)
        quadratic = laplace.LogDensity(posterior).quadratic_model(u, np.eye(len(theta)))
        curvature, directions = np.linalg.eigh(quadratic.curvature[0])
        sd = np.where(curvature > MAX_SPREAD**-2, np.abs(curvature), np.inf) ** -0.5
        shifts = rng.standard_normal((POINTS, len(theta))) * sd @ directions.T
        scales = np.resize(POINT_SDS, POINTS)[:, None]
        points = posterior.coordinates.to_physical(np.concatenate([u, u + scales * shifts]))
        parts.append(points[np.isfinite(posterior.likelihood(points))])
    return np.concatenate(parts)


def compressions(
    posterior: Posterior, points: Array, max_exact: int = COMPRESSED_FROM, *, strict: bool = False
) -> dict[str, Compression]:
    """Compress long records for rigs near `points (n, D)`; the reference rig is at the first.

    Records that cannot be compressed are left out, or raise `CompressionError` if `strict`.
    """
    full, made = posterior.space.full(points), {}
    for observation in posterior.likelihood.observations:
        if is_long(observation, max_exact):
            variances = observation.scales(points).min(axis=0) ** 2
            weights = observation.square_weights(points)
            assert weights is not None  # `is_long` requires weights of squares
            rigs, limits = observation.simulator_parameters(full), np.abs(weights).max(axis=0)
            try:
                made[observation.label] = compress(observation.response, rigs, variances, limits)
            except CompressionError as error:
                if strict:
                    message = f"{observation.title('the record')}: {error}"
                    raise CompressionError(message) from None
    return made


def uncompressed(posterior: Posterior) -> Posterior:
    """Return the posterior with all samples of all records."""
    return posterior.with_simulators(lambda old: old.response.by_samples)


def compressed(posterior: Posterior, compressions: Compressions) -> Posterior:
    """Return the posterior with `compressions`; without any, the posterior itself."""
    if not compressions:
        return posterior

    def simulator_of(observation: Observation) -> Simulator:
        compression, response = compressions.get(observation.label), observation.response
        return response if compression is None else compression.applied(response)

    return posterior.with_simulators(simulator_of)
