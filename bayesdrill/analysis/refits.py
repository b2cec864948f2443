"""Refit a candidate model of a record: its maximum, its evidence by Laplace, and what it leaves."""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import step_error
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.residual_checks import ResidualSummary, residual_summaries
from bayesdrill.sampling.gauss_newton import gauss_newton

# Where in its prior what is new is sought from, beside the start that its config gives it: with the
# maximum that is known they fill a group of eight walkers, which takes no longer than one.
START_QUANTILES = (0.58, 0.05, 0.42, 0.2, 0.8, 0.65)
ROTATION = 2  # quantiles, by which those of one unknown are turned against those of the next
FIRST_STEPS, LAST_STEPS, CLIMBED_STARTS = 4, 30, 8  # uphill: of all starts, and of the best
NEAR_END = 1e-3  # of the spread of a prior
MERGED = 1e-3  # of the spreads: points that are as near lead to one maximum
# another maximum: so little lower, and so far, in spreads of the priors and in sds
OTHER_MAXIMUM_DEPTH, SAME_MAXIMUM, SAME_MAXIMUM_SDS = 3.0, 0.1, 5.0
ROUNDING = 1e-14  # of the largest eigenvalue of a curvature: what is smaller is rounding
VAGUE = 0.5  # of the spread of a prior: an sd from which on the record says little
MAX_CORRELATION = 0.98  # of two unknowns: from there on they stand for each other


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitMaximum:
    """The maximum of a posterior, found by Gauss and Newton from several starts.

    `values`, `sds`: of the unknowns, SI; `log_z`: the log evidence by Laplace; `fit`: what it leaves;
    `at_ends`: unknowns at an end of their prior, -1 at the lower one and 1 at the upper; `several`:
    there is another, about as high, with other values of what is new; `alike`: pairs of what is new that
    stand for each other; `vague`: unknowns of which it says little beyond their priors; `seconds` that
    an evaluation takes; `hidden`: share of the samples that it leaves out.
    """

    values: Mapping[str, float]
    sds: Mapping[str, float]
    log_posterior: float
    log_z: float
    fit: tuple[ResidualSummary, ...]
    at_ends: Mapping[str, int]
    several: bool
    alike: tuple[tuple[str, str], ...]
    vague: tuple[str, ...]
    seconds: float
    hidden: float


Records = Mapping[tuple[str, str], Array]


def measured_samples(likelihood: Likelihood) -> dict[tuple[str, str], Array]:
    """Return all measured samples `(n,)` by experiment and channel."""
    return {
        (observation.label, name): y[~np.isnan(y)]
        for observation in likelihood.observations
        for name, y in zip(observation.experiment.names, observation.experiment.y.T, strict=True)
    }


def refit_candidate(
    posterior: Posterior,
    near: Mapping[str, float],
    least: float,
    alone: Mapping[str, float] = MappingProxyType({}),
    records: Records = MappingProxyType({}),
    starts: Sequence[Mapping[str, float]] = (),
) -> RefitMaximum | None:
    """Refit a candidate: return the maximum of its `posterior`; None without a finite response.

    It starts at `near`, values of unknowns that are known, and at values where what is new was `alone`;
    and at `starts`, or else over the priors of what is new.  One that promises no more than the log
    density `least` is not followed to its very end.  The log evidence is that of a Gaussian with the
    curvature at the maximum; the priors count in it as Gaussians of their spread, so that a direction
    which the record does not determine costs each candidate the same (MacKay 2003, ch. 27).  Samples of
    the `records` that the candidate hides count as unexplained: they are Gaussian about the mean of
    their channel, as wide as the channel is; or with its noise about where the rig was held at first.
    """
    space, coordinates = posterior.space, posterior.coordinates
    surface = LogDensity(posterior, physical=True)
    unseen, _ = _hidden(posterior.likelihood, records)
    physical = _starts(posterior, near, alone, starts)
    rows = np.clip(coordinates.from_physical(physical), surface.low, surface.high)
    first = gauss_newton(surface, rows, FIRST_STEPS, merged=MERGED)
    if not np.isfinite(first.value).any():
        return None
    begun = time.perf_counter()  # its code is compiled by now
    surface.value(rows)
    seconds = (time.perf_counter() - begun) / len(rows)
    best = np.argsort(-first.value, kind="stable")[:CLIMBED_STARTS]
    best = best[np.isfinite(first.value[best])]  # elsewhere the gain may be infinite too
    u = first.u[best]
    promising = (first.value[best] + first.gain[best]).max() + unseen > least
    if promising and step_error.chosen_steps(posterior):
        posterior = step_error.choose_steps(posterior, coordinates.to_physical(u)[0])
        surface = LogDensity(posterior, physical=True)
    top = gauss_newton(surface, u, LAST_STEPS if promising else 0, merged=MERGED)
    order = np.argsort(-top.value, kind="stable")
    u, heights = top.u[order], top.value[order]
    if not np.isfinite(heights[0]):
        return None
    theta = coordinates.to_physical(u[:1])[0]
    log_z, covariance = _laplace(posterior, u[:1])
    own_sds = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    sds = own_sds * np.abs(coordinates.slopes(theta[None])[0])
    low, high = np.stack([u[0] - surface.low, surface.high - u[0]]) < NEAR_END * surface.spread
    # Along a ridge of what is known all is one maximum.
    new = [k for k, name in enumerate(space.free) if name not in near]
    same = np.maximum(SAME_MAXIMUM * surface.spread, SAME_MAXIMUM_SDS * own_sds)
    apart = (np.abs(u[1:] - u[0]) > same)[:, new].any(axis=1)
    again = apart & (heights[1:] > heights[0] - OTHER_MAXIMUM_DEPTH)
    alike = np.abs(covariance / np.outer(own_sds, own_sds)) > MAX_CORRELATION
    pairs, fit = itertools.combinations(new, 2), residual_summaries(posterior.likelihood, theta)
    unseen, squares = _hidden(posterior.likelihood, records, theta)
    samples = posterior.likelihood.n_measured, sum(map(len, records.values()))
    return RefitMaximum(
        values=dict(zip(space.free, theta.tolist(), strict=True)),
        sds=dict(zip(space.free, sds.tolist(), strict=True)),
        log_posterior=float(heights[0]) + unseen,
        log_z=log_z + unseen,
        fit=tuple(_of_all(row, squares.get((row.experiment, row.channel))) for row in fit),
        at_ends={space.free[k]: 1 if high[k] else -1 for k in np.flatnonzero(low | high)},
        several=bool(again.any()),
        alike=tuple((space.free[j], space.free[k]) for j, k in pairs if alike[j, k]),
        vague=tuple(itertools.compress(space.free, own_sds > VAGUE * surface.spread)),
        seconds=seconds,
        hidden=1.0 - samples[0] / max(samples),
    )


def _starts(
    posterior: Posterior,
    near: Mapping[str, float],
    alone: Mapping[str, float],
    starts: Sequence[Mapping[str, float]],
) -> Array:
    """Return physical starts `(8, D)`: the config's, what is known, and others of what is new.

    Where nothing is new the model is another one all the same, and all may be elsewhere.
    """
    space, count = posterior.space, len(START_QUANTILES)
    every = ({**alone}, {**near}, *({**near, **each} for each in starts))
    vectors = [space.vector({n: at.get(n, x) for n, x in space.start.items()}) for at in every]
    if starts:
        return np.array(vectors)
    first, known = vectors
    new = [k for k, name in enumerate(space.free) if name not in near]
    rows = np.repeat(known[None], count, axis=0)
    for place, k in enumerate(new or range(len(space.free))):
        shares = np.roll(START_QUANTILES, ROTATION * place)
        rows[:, k] = space.unknowns[k].prior.quantile(shares)
    return np.concatenate([[first, known], rows])


def _laplace(posterior: Posterior, u: Array) -> tuple[float, Array]:
    """Return the log evidence, and the covariance `(D, D)` about the maximum `u (1, D)`."""
    surface = LogDensity(posterior)
    here = surface.curvature_model(u, np.eye(u.shape[1]))
    # What a prior bends by itself is in the curvature already: of a box it is nothing.
    flat = np.maximum(1.0 / surface.spread**2 - surface.prior_derivatives(u)[1][0], 0.0)
    matrix = here.curvature[0] + np.diag(flat)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    values = np.maximum(values, ROUNDING)
    log_det = np.log(values).sum() - 2.0 * np.log(scale).sum()
    covariance = (vectors / values) @ vectors.T * scale[:, None] * scale
    value = float(surface.value(u)[0])
    return value + 0.5 * (u.shape[1] * math.log(2.0 * math.pi) - float(log_det)), covariance


def _hidden(
    likelihood: Likelihood, records: Records, theta: Array | None = None
) -> tuple[float, dict[tuple[str, str], Array]]:
    """Return the log density of samples of the `records` that a candidate hides.

    Those at the beginning may show a rig that is held: they may have the noise at `theta (D,)` about one
    value.  And by experiment and channel the sums of squares about the mean of what is shown, of what is
    hidden, and of all.
    """
    log_density, squares = 0.0, dict[tuple[str, str], Array]()
    sigmas = dict[tuple[str, str], float]()
    if theta is not None:
        for each in likelihood.observations:
            scales = zip(each.experiment.names, each.scales(theta[None])[0].tolist(), strict=True)
            sigmas |= {(each.label, name): sigma for name, sigma in scales}
    for place, y in measured_samples(likelihood).items():
        given = records.get(place, y)
        count, variance = len(given) - len(y), float(given.var())
        if count <= 0 or variance == 0.0:
            continue
        total = len(given) * variance
        left = max(total - float(np.sum((y - given.mean()) ** 2)), 0.0)
        density = -0.5 * (count * math.log(2 * math.pi * variance) + left / variance)
        if place in sigmas and np.array_equal(given[count:], y):
            noise = sigmas[place] ** 2
            still = count * float(given[:count].var()) / noise
            unknown = math.log(max(count * variance / noise, 1.0))  # the place where it is held
            held = -0.5 * (count * math.log(2 * math.pi * noise) + still + unknown)
            density = max(density, held)
        log_density += density
        squares[place] = np.array([len(y) * y.var(), left, total])
    return log_density, squares


def _of_all(row: ResidualSummary, squares: Array | None) -> ResidualSummary:
    """Return what is left of all samples, where some are hidden."""
    if squares is None:
        return row
    shown, left, total = squares.tolist()
    names = ("share", "simulated", "ahead")
    of_all = (math.sqrt((getattr(row, n) ** 2 * shown + left) / total) for n in names)
    every: dict[str, Any] = dict(zip(names, of_all, strict=True))
    return dataclasses.replace(row, **every)
