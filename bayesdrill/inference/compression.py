"""Long records: an excerpt to search in, and all of it as a few hundred numbers.

A compression is made for rigs near a point, so a search begins on the first part of a record, as the
posterior of that says where the rest can be.  Which records are compressed follows from counted
operations alone: the same config does the same on every machine.
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

EXCERPT = 16384  # samples of which a search sees at first
GROWTH = 4  # times as many, where these say too little
POINTS = 256  # for which functions are chosen
SHARES = (8.0, 3.0, 1.0)  # standard deviations, times normal numbers
# Along directions that are known no better the record cannot tell rigs apart: they do alike.
MAX_SPREAD = 0.05
DEPTH = 40.0  # of the log posterior: maxima further below are nowhere

Compressions = Mapping[str, Compression]  # by label of the observation


def is_long(observation: Observation, shortest: int = COMPRESSED_FROM) -> bool:
    """Tell whether its record can be compressed, and is longer than the `shortest` for which it pays."""
    return len(observation.experiment.t) > shortest and not observation.exact_reason


@dataclass(frozen=True, slots=True, kw_only=True)
class CompressionCheck:
    """How a compressed likelihood compares with the exact one.

    `samples`: of the longest record, and `functions` that it has become.  Of `draws`, `exact` had the
    exact simulator; log likelihoods differ by `difference` at most.
    """

    samples: int
    functions: int
    draws: int
    exact: int
    difference: float


def check_draws(compressed: Posterior, theta: Array) -> CompressionCheck | None:
    """Compare log likelihoods of draws `theta (N, D)`, physical; None where nothing is compressed."""
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
    apart = [np.abs(compressed.likelihood(part) - exact.likelihood(part)).max() for part in parts]
    samples, functions = max(sizes)
    return CompressionCheck(
        samples=samples,
        functions=functions,
        draws=len(theta),
        exact=int(beyond.sum()),
        difference=float(max(apart)),
    )


def excerpt(posterior: Posterior, samples: int = EXCERPT) -> Posterior | None:
    """Return the posterior of the first samples of long records; None where no record is long."""
    observations = posterior.likelihood.observations
    short = [first_samples(observation, samples) for observation in observations]
    if all(new is old for new, old in zip(short, observations, strict=True)):
        return None
    likelihood = Likelihood(tuple(short), posterior.space)
    return Posterior(posterior.space, likelihood, posterior.coordinates)


def longer_excerpt(posterior: Posterior, short: Posterior, known: Compressions) -> Posterior | None:
    """Return a longer excerpt where the `short` one left long records that are not `known`; or None.

    None, too, where nothing is left that a longer one could say.
    """
    pairs = zip(posterior.likelihood.observations, short.likelihood.observations, strict=True)
    unknown = [
        len(part.experiment.t)
        for observation, part in pairs
        if is_long(observation) and observation.label not in known
    ]
    return excerpt(posterior, GROWTH * max(unknown)) if unknown else None


def first_samples(observation: Observation, samples: int) -> Observation:
    """Return the observation of the first samples of its record; the very same where it is not long."""
    if len(observation.experiment.t) <= samples or not is_long(observation):
        return observation
    return observation.for_record(observation.experiment.first(samples))


def nearby(posterior: Posterior, maxima: Array) -> Array:
    """Return points `(n, D)` about maxima `(M, D)`, the highest first, physical."""
    return np.concatenate([_about(posterior, theta) for theta in maxima])


def _about(posterior: Posterior, theta: Array) -> Array:
    """Return points `(n, D)` about a maximum, near enough for rigs to do alike, whatever the priors."""
    rng = np.random.default_rng(0)
    u = posterior.coordinates.from_physical(theta[None])
    quadratic = laplace.LogDensity(posterior).quadratic_model(u, np.eye(len(theta)))
    known, directions = np.linalg.eigh(quadratic.curvature[0])
    spread = np.where(known > MAX_SPREAD**-2, np.abs(known), np.inf) ** -0.5
    shifts = rng.standard_normal((POINTS, len(theta))) * spread @ directions.T
    shares = np.resize(SHARES, POINTS)[:, None]
    points = posterior.coordinates.to_physical(np.concatenate([u, u + shares * shifts]))
    log_l = posterior.likelihood(points)
    return np.asarray(points[np.isfinite(log_l)])


def compressions(
    posterior: Posterior, points: Array, shortest: int = COMPRESSED_FROM, *, strict: bool = False
) -> dict[str, Compression]:
    """Compress long records for rigs at `points (n, D)`, by label; the first is the reference.

    Records that cannot be compressed are left out, or raise `CompressionError` if `strict`.
    """
    full, made = posterior.space.full(points), {}
    for observation in posterior.likelihood.observations:
        if is_long(observation, shortest):
            variances = observation.scales(points).min(axis=0) ** 2
            weights = observation.square_weights(points)
            assert weights is not None  # or its record would not be compressed
            rigs, limits = observation.simulator_parameters(full), np.abs(weights).max(axis=0)
            try:
                made[observation.label] = compress(observation.response, rigs, variances, limits)
            except CompressionError as error:
                if strict:
                    message = f"{observation.entitled('the record')}: {error}"
                    raise CompressionError(message) from None
    return made


def uncompressed(posterior: Posterior) -> Posterior:
    """Return the posterior with all samples of all records."""
    return posterior.edit(each=lambda each: replace(each, response=each.response.by_samples))


def compressed(posterior: Posterior, known: Compressions) -> Posterior:
    """Return the posterior with these records compressed; the very same where there are none."""
    if not known:
        return posterior

    def each(observation: Observation) -> Observation:
        compression = known.get(observation.label)
        if compression is None:
            return observation
        return replace(observation, response=compression.applied(observation.response))

    return posterior.edit(each=each)
