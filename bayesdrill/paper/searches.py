"""All unknowns at once from many starts, the paper's pairwise heuristic, and the control of it.

An exact symmetry leaves the misfit as it is, so that a search may end anywhere along it.  An end is
as far from the truth as the logs of its unknowns; that distance has a part along each symmetry,
which no misfit can show, and the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis import Exponents
from bayesdrill.basics import Array, seeds
from bayesdrill.inference import Posterior
from bayesdrill.paper import forward, precision
from bayesdrill.sampling import Crew, Optimiser, Optimum

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


def many_searches(
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
    tasks = [
        (way, crew.submit(_searched, optimiser, EVALUATIONS, point))
        for way, optimiser in precision.WAYS.items()
        for point in points
    ]
    found = [(way, task.result()) for way, task in tasks]
    likelihood = posterior.likelihood
    misfits = likelihood.per_number(np.array([end.theta for _, end in found]))
    _, floor = precision.expected_misfit(likelihood.numbers)
    least = misfits.min() + SAME / likelihood.numbers
    ends = []
    for (way, end), left in zip(found, misfits, strict=True):
        scales, rest, distance = distinct_ends(end.theta, reference, symmetries)
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


def distinct_ends(
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


def _searched(
    posterior: Posterior, optimiser: Optimiser, evaluations: int, point: Array
) -> Optimum:
    return optimiser(precision.misfit_task(posterior), point, evaluations)


AROUND = 0.2  # other starts are from 1 - this to 1 + this of the configured one


@dataclass(frozen=True, slots=True, kw_only=True)
class Heuristic:
    """`guess`, `estimate` `(D,)` physical; `misfits`: per measured number, at the guess and then after
    each iteration; `others (S, D)`: estimates from other starts, `others_misfits (S,)` theirs;
    `stepped (D,)`: the estimate with the paper's integrator, whose misfit it is that `stepped_misfit`
    tells; None with a measured input, which the paper does not have.
    """

    guess: Array
    estimate: Array
    misfits: Array
    others: Array
    others_misfits: Array
    stepped: Array | None
    stepped_misfit: float | None


def run_heuristic(
    crew: Crew, posterior: Posterior, optimiser: Optimiser, evaluations: int, starts: int, seed: int
) -> Heuristic:
    """From the configured start, and from `starts` others around it."""
    guess = posterior.space.vector(posterior.space.start)
    rng = seeds.stream(seed, "around")
    around = rng.uniform(1 - AROUND, 1 + AROUND, (starts, len(guess)))
    by_integrator = None
    if forward.applies(posterior.likelihood):  # first, because it takes longest
        by_integrator = crew.submit(_search_stepped, optimiser, evaluations, guess)
    points = [guess, *(guess * around)]
    tasks = [crew.submit(_searched, optimiser, evaluations, point) for point in points]
    found, *rest = [task.result() for task in tasks]
    first = precision.misfit_per_number(posterior, guess)
    # The misfit is -2 log likelihood but for a constant, which the first point tells.
    density = posterior.likelihood(guess[None])[0]
    path = first - 2.0 * (np.array(found.history) - density) / posterior.likelihood.numbers
    others = np.array([other.theta for other in rest]).reshape(starts, len(guess))
    end = None if by_integrator is None else by_integrator.result().theta
    return Heuristic(
        guess=guess,
        estimate=found.theta,
        misfits=np.array([first, *path]),
        others=others,
        others_misfits=posterior.likelihood.per_number(others),
        stepped=end,
        stepped_misfit=None if end is None else forward.stepped_misfit(posterior.likelihood, end),
    )


def _search_stepped(
    posterior: Posterior, optimiser: Optimiser, evaluations: int, point: Array
) -> Optimum:
    task = forward.stepped_task(precision.misfit_task(posterior), posterior.likelihood)
    return optimiser(task, point, evaluations)


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Largest distance of the estimates of a parameter from its true value; 0: it never moved."""

    sigma: float
    parameter: str
    largest_percent: float
    records: int


def control(
    crew: Crew,
    posterior: Posterior,
    optimiser: Optimiser,
    evaluations: int,
    sigmas: Sequence[float],
    records: int,
    seed: int,
) -> tuple[Control, ...]:
    """Of records made at the configured start, which the search begins at too, by noise."""
    truth = posterior.space.vector(posterior.space.start)
    tasks = {
        sigma: [
            crew.submit(_estimate, optimiser, evaluations, truth, sigma, seed, k)
            for k in range(records)
        ]
        for sigma in sigmas
    }
    found = []
    for sigma, own in tasks.items():
        estimates = np.array([task.result() for task in own])
        largest = 100 * np.abs(estimates / truth - 1).max(axis=0)
        found += [
            Control(sigma=sigma, parameter=name, largest_percent=float(off), records=records)
            for name, off in zip(posterior.space.free, largest, strict=True)
        ]
    return tuple(found)


def _estimate(
    posterior: Posterior,
    optimiser: Optimiser,
    evaluations: int,
    truth: Array,
    sigma: float,
    seed: int,
    index: int,
) -> Array:
    target = precision.made_record(precision.with_sigma(posterior, sigma), truth, seed, index)
    return _searched(target, optimiser, evaluations, truth).theta
