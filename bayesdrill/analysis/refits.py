"""Refit a candidate model of a record: find its maximum, Laplace evidence and residuals."""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference import step_error
from bayesdrill.inference.laplace import LogDensity, QuadraticModel
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.residual_checks import ResidualSummary, residual_summaries
from bayesdrill.sampling.gauss_newton import gauss_newton, newton_gain

# New unknowns start at these six quantiles of their priors.  With the known maximum and the start of
# the config, these are eight points, which are simulated together in the time of one point.
START_QUANTILES = (0.58, 0.05, 0.42, 0.2, 0.8, 0.65)
FEW_STARTS = 3  # number of further starts, if a model with only the newest change has been fitted
ROTATION = 2  # cyclic shift of the quantiles from one unknown to the next
FIRST_STEPS, LAST_STEPS = 4, 30  # numbers of Gauss-Newton steps from all starts, and from the best
CLIMBED_STARTS = 8  # number of best starts from which the last steps are taken
NEAR_END = 1e-3  # distance from an end, relative to the prior's spread, that counts as at the end
HOPELESS_DEPTH = 30.0  # a search stops if it would end this far below the required log density
MERGED = 1e-3  # points that are this close, relative to the priors' spreads, lead to one maximum
# A second maximum counts if it is lower by at most this log density.  It must also be farther away than
# this fraction of the priors' spreads, and than this number of sds.
OTHER_MAXIMUM_DEPTH, SAME_MAXIMUM, SAME_MAXIMUM_SDS = 3.0, 0.1, 5.0
ROUNDING = 1e-14  # eigenvalues of a scaled curvature below this are rounding errors
VAGUE = 0.5  # sd divided by the spread of the prior, above which the record says little
MAX_CORRELATION = 0.98  # unknowns with a larger correlation are interchangeable


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitMaximum:
    """A refit has found this maximum of a posterior by Gauss-Newton steps from several starts.

    `values` and `sds` are those of the unknowns, SI, and `log_z` is the log evidence (Laplace).
    `at_ends` maps unknowns at an end of their prior to -1 (lower) or 1 (upper).  `has_rival` is true if
    another maximum with other values of new unknowns is about as high.  `exchangeable` are pairs of new
    unknowns that are interchangeable.  `vague` are unknowns that the record hardly determines.  One
    evaluation takes `seconds`; the refit has a `duration` [s] and a number of `evaluations`.
    `omitted` is the fraction of samples that the candidate leaves out.  A search that is not
    finished was stopped below its maximum.
    """

    values: Mapping[str, float]
    sds: Mapping[str, float]
    log_posterior: float
    log_z: float
    residuals: tuple[ResidualSummary, ...]
    at_ends: Mapping[str, int]
    has_rival: bool
    exchangeable: tuple[tuple[str, str], ...]
    vague: tuple[str, ...]
    seconds: float
    duration: float
    evaluations: int
    omitted: float
    is_finished: bool


Records = Mapping[tuple[str, str], Array]


class CountingDensity(LogDensity):
    """The density counts `evaluations` of responses and derivatives, which take equal time."""

    def __init__(self, posterior: Posterior, evaluations: int = 0) -> None:
        """Count from `evaluations` on."""
        super().__init__(posterior, physical=True)
        self.evaluations = evaluations

    def value(self, u: Array) -> Array:
        """Return the log density `(W,)` of `LogDensity`."""
        self.evaluations += len(u)
        return super().value(u)

    def curvature_model(self, u: Array, directions: Array) -> QuadraticModel:
        """Return the model of `LogDensity` at `u (W, D)` along `directions (D, q)`."""
        self.evaluations += len(u) * directions.shape[1]
        return super().curvature_model(u, directions)


def measured_samples(likelihood: Likelihood) -> dict[tuple[str, str], Array]:
    """Return all measured samples `(n,)` by experiment and channel, in the units of their columns."""
    return {
        (observation.label, channel.name): y[~np.isnan(y)] / channel.factor
        for observation in likelihood.observations
        for channel, y in zip(
            observation.experiment.channels, observation.experiment.y.T, strict=True
        )
    }


def refit_candidate(
    posterior: Posterior,
    initial: Mapping[str, float],
    threshold: float,
    single: Mapping[str, float] = MappingProxyType({}),
    records: Records = MappingProxyType({}),
    starts: Sequence[Mapping[str, float]] = (),
    rival: float = -math.inf,
) -> RefitMaximum | None:
    """Return the maximum of a candidate's `posterior`, or None without a finite response.

    Searches start from the values `initial`, from `starts`, and from `single`, the maximum of the model
    that has only the candidate's newest change.  Without `single` and `starts`, they also start at
    quantiles of new unknowns' priors.  A search stops if its next step promises less than the log
    density `threshold`.  It also stops if steps with the present gain would end far below `threshold`,
    or below `rival`, the log evidence of another candidate.  With a maximum `single`, no search begins
    if steps like the first one from the best start would not reach `rival`.

    The log evidence is that of a Gaussian with the curvature at the maximum (MacKay 2003, ch. 27).
    Priors count in it as Gaussians with their spreads, so that an undetermined direction costs each
    candidate the same.  Samples of `records` that the candidate leaves out count as Gaussian, with mean
    and variance of their channel.  Those at the beginning may instead be a constant with noise.
    """
    started = time.perf_counter()
    surface, coordinates = CountingDensity(posterior), posterior.coordinates
    physical = _starts(posterior, initial, single, starts)
    rows = np.clip(coordinates.from_physical(physical), surface.low, surface.high)
    if single:  # the best start comes first
        rows = rows[np.argsort(-surface.value(rows), kind="stable")]
    hopeful = not single or _can_reach(surface, rows[:1], records, rival)
    first_steps, rows = (FIRST_STEPS, rows) if hopeful else (0, rows[:1])
    first = gauss_newton(surface, rows, first_steps, merged=MERGED)
    if not np.isfinite(first.value).any():
        return None
    begun = time.perf_counter()  # the kernels are compiled by now
    surface.value(rows)
    seconds = (time.perf_counter() - begun) / len(rows)
    best = np.argsort(-first.value, kind="stable")[:CLIMBED_STARTS]
    best = best[np.isfinite(first.value[best])]  # if a value is infinite, its gain may be, too
    u, value, gain = first.u[best], first.value[best], first.gain[best]
    unseen, _ = _hidden(posterior.likelihood, records, coordinates.to_physical(u[:1])[0])
    needed = max(_height_of(surface, u[:1], records, rival), threshold - unseen - HOPELESS_DEPTH)
    promising = bool(hopeful and (value + gain).max() + unseen > threshold)
    promising &= bool((value + LAST_STEPS * gain).max() > needed)
    if promising and step_error.chosen_steps(posterior):
        posterior = step_error.choose_steps(posterior, coordinates.to_physical(u)[0])
        surface = CountingDensity(posterior, surface.evaluations)
    steps, depth = LAST_STEPS if promising else 0, OTHER_MAXIMUM_DEPTH
    top = gauss_newton(surface, u, steps, merged=MERGED, depth=depth, threshold=needed)
    order = np.argsort(-top.value, kind="stable")
    u, heights = top.u[order], top.value[order]
    if not np.isfinite(heights[0]):
        return None
    finished = bool(promising and heights[0] >= needed)
    clock = started, seconds
    return _summarise(surface, u, heights, initial, records, clock, finished=finished)


def _summarise(
    surface: CountingDensity,
    u: Array,
    heights: Array,
    initial: Mapping[str, float],
    records: Records,
    clock: tuple[float, float],
    *,
    finished: bool,
) -> RefitMaximum:
    """Summarise the highest of the maxima `u (W, D)`, whose log densities `heights (W,)` descend.

    The `clock` has the time at which the refit started, and the seconds of one evaluation.
    """
    started, seconds = clock
    posterior = surface.posterior
    space, coordinates = posterior.space, posterior.coordinates
    theta = coordinates.to_physical(u[:1])[0]
    log_z, covariance = _laplace(posterior, u[:1])
    own_sds = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    sds = own_sds * np.abs(coordinates.slopes(theta[None])[0])
    low, high = np.stack([u[0] - surface.low, surface.high - u[0]]) < NEAR_END * surface.spread
    # Only new unknowns distinguish maxima, as all other unknowns may differ along a ridge.
    new = [k for k, name in enumerate(space.free) if name not in initial]
    same = np.maximum(SAME_MAXIMUM * surface.spread, SAME_MAXIMUM_SDS * own_sds)
    is_other = (np.abs(u[1:] - u[0]) > same)[:, new].any(axis=1)
    is_other &= heights[1:] > heights[0] - OTHER_MAXIMUM_DEPTH
    are_linked = np.abs(covariance / np.outer(own_sds, own_sds)) > MAX_CORRELATION
    pairs, fit = itertools.combinations(new, 2), residual_summaries(posterior.likelihood, theta)
    unseen, squares = _hidden(posterior.likelihood, records, theta)
    samples = posterior.likelihood.n_measured, sum(map(len, records.values()))
    return RefitMaximum(
        values=dict(zip(space.free, theta.tolist(), strict=True)),
        sds=dict(zip(space.free, sds.tolist(), strict=True)),
        log_posterior=float(heights[0]) + unseen,
        log_z=log_z + unseen,
        residuals=tuple(_with_hidden(r, squares.get((r.experiment, r.channel))) for r in fit),
        at_ends={space.free[k]: 1 if high[k] else -1 for k in np.flatnonzero(low | high)},
        has_rival=bool(is_other.any()),
        exchangeable=tuple((space.free[j], space.free[k]) for j, k in pairs if are_linked[j, k]),
        vague=tuple(itertools.compress(space.free, own_sds > VAGUE * surface.spread)),
        seconds=seconds,
        duration=time.perf_counter() - started,
        evaluations=surface.evaluations,
        omitted=1.0 - samples[0] / max(samples),
        is_finished=finished,
    )


def _starts(
    posterior: Posterior,
    initial: Mapping[str, float],
    single: Mapping[str, float],
    starts: Sequence[Mapping[str, float]],
) -> Array:
    """Return physical starts `(W, D)`: from `initial` and `single`, and at quantiles of the priors.

    If no unknown is new, quantiles of all unknowns are taken, as the model differs nevertheless.
    If the maximum `single` is known, a few of `starts` are enough, without quantiles.
    """
    space = posterior.space
    points = [{**initial}, {**single}, *({**initial, **start} for start in starts)]
    if single:
        stride = math.ceil(len(starts) / FEW_STARTS) or 1
        points[1:] = (
            {**initial, **single},
            {**single, **initial},
            *points[2 + stride // 2 :: stride],
        )
    named = ({n: at.get(n, x) for n, x in space.start.items()} for at in points)
    vectors = [*dict.fromkeys(tuple(space.vector(values)) for values in named)]
    if single or starts:
        return np.array(vectors)
    new = [k for k, name in enumerate(space.free) if name not in initial]
    rows = np.repeat(np.array(vectors[:1]), len(START_QUANTILES), axis=0)
    for place, k in enumerate(new or range(len(space.free))):
        probabilities = np.roll(START_QUANTILES, ROTATION * place)
        rows[:, k] = space.unknowns[k].prior.quantile(probabilities)
    return np.concatenate([vectors, rows])


def _can_reach(surface: LogDensity, u: Array, records: Records, rival: float) -> bool:
    """Return whether steps from `u (1, D)` reach log evidence `rival` if all gain like the first."""
    value = float(surface.value(u)[0])
    if not (math.isfinite(rival) and math.isfinite(value)):
        return True
    gain = newton_gain(surface, u, surface.curvature_model(u, np.eye(u.shape[1])))
    needed = _height_of(surface, u, records, rival)
    return value + (FIRST_STEPS + LAST_STEPS) * float(gain[0]) > needed


def _height_of(surface: LogDensity, u: Array, records: Records, log_z: float) -> float:
    """Convert a log evidence to a log density, by the difference between both at `u (1, D)`."""
    if not math.isfinite(log_z):
        return log_z
    posterior = surface.posterior
    theta = posterior.coordinates.to_physical(u)[0]
    unseen, _ = _hidden(posterior.likelihood, records, theta)
    return log_z + float(surface.value(u)[0]) - _laplace(posterior, u)[0] - unseen


def _laplace(posterior: Posterior, u: Array) -> tuple[float, Array]:
    """Return the log evidence, and the covariance `(D, D)` about the maximum `u (1, D)`."""
    surface = LogDensity(posterior)
    here = surface.curvature_model(u, np.eye(u.shape[1]))
    # A prior's own curvature is included already; it is zero for a uniform prior.
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
    """Return the log density of samples of `records` that a candidate leaves out, and sums of squares.

    Densities refer to the numbers in the file, so that a change of a column's unit has no advantage.
    Omitted samples at the beginning may be of a rig at rest: a constant with the noise at `theta (D,)`.
    The squares are sums of squared deviations from the mean, of kept, omitted and all samples of each
    experiment and channel.
    """
    log_density, squares = 0.0, dict[tuple[str, str], Array]()
    sigmas, factors = dict[tuple[str, str], float](), dict[tuple[str, str], float]()
    for observation in likelihood.observations:
        channels = observation.experiment.channels
        factors |= {(observation.label, channel.name): channel.factor for channel in channels}
        if theta is not None:
            scales = observation.scales(theta[None])[0].tolist()
            pairs = zip(channels, scales, strict=True)
            sigmas |= {(observation.label, c.name): sigma / c.factor for c, sigma in pairs}
    for place, y in measured_samples(likelihood).items():
        log_density += len(y) * math.log(factors[place])
        given = records.get(place, y)
        count, variance = len(given) - len(y), float(given.var())
        if count <= 0 or variance == 0.0:
            continue
        total = len(given) * variance
        hidden = max(total - float(np.sum((y - given.mean()) ** 2)), 0.0)
        density = -0.5 * (count * math.log(2 * math.pi * variance) + hidden / variance)
        if place in sigmas and np.allclose(given[count:], y, rtol=1e-12, atol=0.0):
            noise = sigmas[place] ** 2
            still = count * float(given[:count].var()) / noise
            unknown = math.log(max(count * variance / noise, 1.0))  # Occam factor of the held value
            held = -0.5 * (count * math.log(2 * math.pi * noise) + still + unknown)
            density = max(density, held)
        log_density += density
        squares[place] = np.array([len(y) * y.var(), hidden, total])
    return log_density, squares


def _with_hidden(row: ResidualSummary, squares: Array | None) -> ResidualSummary:
    """Return the row with `share`, `simulated`, `ahead` for all samples; omitted are unexplained."""
    if squares is None:
        return row
    kept, hidden, total = squares.tolist()
    ratios = (row.share, row.simulated, row.ahead)
    share, simulated, ahead = (math.sqrt((x**2 * kept + hidden) / total) for x in ratios)
    return dataclasses.replace(row, share=share, simulated=simulated, ahead=ahead)
