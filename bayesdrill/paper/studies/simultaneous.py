"""All unknowns at once, from many starts: where the searches end, and how far from the truth.

An exact symmetry leaves the misfit as it is, so that a search may end anywhere along it.  An end is
as far from the truth as the logs of its unknowns; that distance has a part along each symmetry,
which no misfit can show, and the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import seeds
from bayesdrill.engines import Crew, Optimum
from bayesdrill.inference import Posterior
from bayesdrill.insight import Exponents
from bayesdrill.paper.studies import misfit

Array = NDArray[np.float64]

EVALUATIONS = 8000
SAME = 4.0  # of the paper's misfit: ends nearer to the least one are equally good
WITHIN = 0.5  # starts are drawn from 1 - this to 1 + this of the configured one


@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """Of one search.  `misfit`: per measured number (1: the noise).

    `reached`: no more than noise is left; `best`: as good as the best of all searches.
    `scales`: log distance from the truth along each symmetry; `rest`: root mean square of the logs'
    distance off all of them; `distance`: of all of it.
    """

    way: str
    misfit: float
    reached: bool
    best: bool
    settled: bool
    scales: tuple[float, ...]
    rest: float
    distance: float


def many(
    crew: Crew,
    posterior: Posterior,
    reference: Array,
    symmetries: Sequence[Exponents],
    starts: int,
    seed: int,
) -> tuple[End, ...]:
    """From the configured start and others around it, each way; distances are from `reference (D,)`."""
    centre = posterior.space.vector(posterior.space.start)
    rng = seeds.stream(seed, "starts")
    around = rng.uniform(1 - WITHIN, 1 + WITHIN, (starts - 1, len(centre)))
    points = np.vstack([centre, centre * around])
    tasks = [(way, crew.submit(_search, way, point)) for way in misfit.WAYS for point in points]
    found = [(way, task.result()) for way, task in tasks]
    likelihood = posterior.likelihood
    misfits = likelihood.per_number(np.array([end.theta for _, end in found]))
    _, floor = misfit.expected(likelihood.numbers)
    least = misfits.min() + SAME / likelihood.numbers
    ends = []
    for (way, end), left in zip(found, misfits, strict=True):
        scales, rest, distance = apart(end.theta, reference, symmetries)
        ends.append(
            End(
                way=way,
                misfit=float(left),
                reached=bool(left < floor),
                best=bool(left < least),
                settled=end.settled,
                scales=scales,
                rest=rest,
                distance=distance,
            )
        )
    return tuple(ends)


def apart(
    theta: Array, reference: Array, symmetries: Sequence[Exponents]
) -> tuple[tuple[float, ...], float, float]:
    """Log distance along each symmetry, and the root mean square off them all, and of everything."""
    logs = np.log(theta / reference)
    rows = np.zeros((len(symmetries), len(theta)))
    for row, exponents in zip(rows, symmetries, strict=True):
        row[: len(exponents)] = exponents  # noise levels have no part in them
    scales = np.linalg.lstsq(rows.T, logs, rcond=None)[0]
    rest = logs - scales @ rows
    return (
        tuple(map(float, scales)),
        float(np.sqrt(np.mean(rest**2))),
        float(np.sqrt(np.mean(logs**2))),
    )


def _search(posterior: Posterior, way: str, point: Array) -> Optimum:
    return misfit.WAYS[way](misfit.task(posterior), point, EVALUATIONS)
