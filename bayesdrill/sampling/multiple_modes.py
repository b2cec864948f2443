"""Find other maxima of a density (aliases, lags), and tell distinct ones apart.

Two points of one ridge are joined by it, however far apart they are; two maxima are not.  So one
walks from one to the other along the loose directions of the first, led back to the ridge by its
tight ones at each step, and looks where one arrives.

A swing of frequency omega that is seen at times t leaves nearly the same samples as one of |omega
+- delta|, where delta is a peak of the window |sum exp(i delta t)|: 2 pi over the step of even
samples, and 2 pi over the gap between two stretches (Scargle 1982; VanderPlas 2018).  What returns
in other unknowns, such as a lag under a periodic drive, an angle a turn further or a sign, shows as
further maxima along each of them by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.models.linear import dynamics
from bayesdrill.sampling.gauss_newton import gauss_newton
from bayesdrill.sampling.proposal import ridge_tracing


@dataclass(frozen=True, slots=True)
class ModeComparisonSettings:
    """How many starts a search for other modes has, and when two modes are one."""

    first_steps: int = 8  # of all starts, and then ...
    max_starts: int = 10  # ... as many of those spread over the prior go on, ...
    last_steps: int = 25  # ... as many steps
    # of the log density: a maximum lower than the highest by more holds nothing
    negligible_depth: float = 25.0
    path_steps: int = 10  # steps between two points
    # of the priors' spreads: points that are likely to end at the same maximum
    cell_size: float = 1e-4
    same_ridge_sds: float = 3.0  # standard deviations of the tight directions
    # Of the log density: what is no deeper parts no maxima, but ripples of one.
    valley_between_modes: float = 0.5
    # places between two points, at which one looks for a valley; at no even ...
    valley_probes: int = 24
    golden_fraction: float = 0.5 * (5.0**0.5 - 1.0)  # ... distances, as a row of maxima has them
    # of the log density: a point that is higher by less is no better than a known one
    known_bonus: float = 1e-6
    pole_pairs: int = 2  # of poles that are looked at, the fastest
    min_alias_height: float = 0.3  # of the window's height: lower peaks are no aliases
    max_aliases_tried: int = 384  # aliases of a pair of poles, the most alike first, of which ...
    alias_steps: int = 8  # ... those that hold most of where they lead to in so many steps
    window_oversampling: int = 4  # times that the window is drawn finer than its peaks are wide
    max_iterations: int = 12
    same_alias: float = 0.3  # radians over the whole record: what is left is for the search
    slope_step: float = 1e-5  # of the priors' spreads
    min_imaginary: float = 1e-6  # of the largest pole: an imaginary part above it is no rounding
    # ... from sample to sample, as what is written down in steps may repeat itself
    scan_points_per_sample: int = 2
    max_starts_per_unknown: int = 96  # starts that come of them
    valley_along_line: float = 1.0  # of the log density: what is less deep parts no maxima


SETTINGS = ModeComparisonSettings()

MAX_NEARBY_STARTS = 128  # ... or of those that are likely to lead to other maxima, for ...
SAME_MODE = 1e-3  # of the priors' spreads: the same point


def best_ends(
    surface: LogDensity, starts: Array, most: int = SETTINGS.max_starts
) -> tuple[Array, Array]:
    """Climb from `starts (n, D)`: the `most` promising ends `(m, D)`, and their log densities."""
    first = gauss_newton(surface, starts, SETTINGS.first_steps)
    order = np.argsort(-first.value, kind="stable")
    cells = np.rint((first.u[order] - surface.low) / (SETTINGS.cell_size * surface.spread))
    best = order[np.sort(np.unique(cells, axis=0, return_index=True)[1])][:most]
    climbed = gauss_newton(surface, first.u[best], SETTINGS.last_steps)
    good = np.isfinite(climbed.value)
    return climbed.u[good], climbed.value[good]


def distinct_modes(surface: LogDensity, points: Array, values: Array, known: int = 0) -> list[int]:
    """Return which of `points (n, D)` are maxima of their own, the highest first.

    The first `known` of them are so already, and stay what stands for their maximum.
    """
    rank = values + np.where(np.arange(len(values)) < known, SETTINGS.known_bonus, 0.0)
    order = [int(k) for k in np.argsort(-rank, kind="stable")]
    remaining = [k for k in order if values[k] >= values[order[0]] - SETTINGS.negligible_depth]
    distinct: list[int] = []
    while remaining:
        highest, *lower = remaining
        distinct.append(highest)
        fresh = [k for k in lower if k >= known]
        if not fresh:
            return [*distinct, *lower]
        others = points[fresh]
        same = (np.abs(others - points[highest]) < SAME_MODE * surface.spread).all(axis=1)
        same[~same] = joined_by_ridge(surface, points[highest], others[~same])
        same[~same] = ~split_by_valley(surface, points[highest], others[~same])
        dropped = {k for k, is_same in zip(fresh, same, strict=True) if is_same}
        remaining = [k for k in lower if k not in dropped]
    return distinct


def split_by_valley(surface: LogDensity, start: Array, others: Array) -> NDArray[np.bool_]:
    """Return whether a valley parts `start (D,)` from each of `others (n, D)`, on a straight way.

    It does not between corners of a plateau, nor where one maximum has ripples.
    """
    between = np.sort(np.arange(1, SETTINGS.valley_probes + 1) * SETTINGS.golden_fraction % 1.0)
    share = np.concatenate([[0.0], between, [1.0]])[:, None, None]
    ways = start + share * (others - start)
    value = surface.value(ways.reshape(-1, len(start))).reshape(ways.shape[:2])
    lower = np.minimum(value[0], value[-1])
    deep = value.min(axis=0) < lower - SETTINGS.valley_between_modes
    return np.asarray(deep | ~np.isfinite(lower))


def joined_by_ridge(surface: LogDensity, start: Array, others: Array) -> NDArray[np.bool_]:
    """Return whether the ridge through `start (D,)` leads to each of `others (n, D)`: `(n,)`.

    Where nothing is tight all of the prior is the ridge, and a valley parts it.
    """
    here = surface.quadratic_model(start[None], np.eye(len(start)))
    base, _ = ridge_tracing.split_directions(surface, start, here)
    psi, tau = base.split(others)
    if tau.shape[1] == 0:
        return ~split_by_valley(surface, start, others)
    at = np.zeros_like(tau)
    before = np.zeros_like(tau)
    arrived = np.zeros(len(others), dtype=bool)
    roots = np.zeros((len(others), tau.shape[1], tau.shape[1]))
    steps = SETTINGS.path_steps if psi.shape[1] else 1
    for k in range(1, steps + 1):
        ahead = 2.0 * at - before if k > 1 else at  # straight on from the last two
        ridge_tau, roots, _, arrived = ridge_tracing.return_to_ridge(
            surface.quadratic_model, base, psi * (k / steps), ahead
        )
        before, at = at, ridge_tau
    roots[~arrived] = np.eye(tau.shape[1])  # of no use, where there is no density
    off = np.linalg.solve(roots, (tau - at)[..., None])[..., 0]
    return np.asarray(arrived & (np.linalg.norm(off, axis=1) < SETTINGS.same_ridge_sds))


def shares_held(posterior: Posterior, ends: Array) -> Array:
    """Return the share of the posterior of each maximum `ends (M, D)`, by Laplace: `(M,)`, sum 1."""
    if len(ends) == 1:
        return np.ones(1)
    over = LogDensity(posterior)
    here = over.quadratic_model(ends, np.eye(ends.shape[1]))
    scaled = here.curvature * np.outer(over.spread, over.spread) + np.eye(ends.shape[1])
    log_mass = here.value - 0.5 * np.linalg.slogdet(scaled)[1]
    log_mass = np.where(np.isfinite(log_mass), log_mass, -np.inf)
    mass = np.exp(log_mass - log_mass.max()) if np.isfinite(log_mass).any() else np.ones(len(ends))
    return np.asarray(mass / mass.sum())


MAX_ALIASES = 96  # ... so many are starts: where they are more, ...
# cells of time for each radian of the fastest swing, at most
CELLS_PER_RADIAN, MAX_CELLS = 3, 2**19
SCAN_POINTS, MAX_SCAN_POINTS = 240, 2000  # points along each unknown; along a moment so many ...


@dataclass(frozen=True, slots=True)
class NearbyStarts:
    """Starts `u (n, D)`, and the share of all aliases within the priors that they leave out."""

    u: Array
    missed_share: float


def nearby_starts(surface: LogDensity, u: Array) -> NearbyStarts:
    """Return starts from which a search may find other maxima than the one at `u (D,)`."""
    aliased, returned = alias_starts(surface, u), scan_starts(surface, u)
    missed_share = max(aliased.missed_share, returned.missed_share)
    return NearbyStarts(np.concatenate([aliased.u, returned.u]), missed_share)


def alias_starts(surface: LogDensity, u: Array) -> NearbyStarts:
    """Return points where a pair of poles swings at an alias of its frequency at `u (D,)`."""
    posterior = surface.posterior
    here = frequencies(posterior, u[None])[0]
    slowest, fastest = _frequency_range(surface, u)
    aliases, missed_share, most = [np.empty((0, len(u)))], 0.0, SETTINGS.max_aliases_tried
    for pair in np.flatnonzero(here > 0):
        wanted = _aliases(posterior, here[pair], slowest[pair], fastest[pair])
        at = _at_frequencies(surface, u, int(pair), np.unique(wanted[:most]))
        heaviest, share = _heaviest(surface, at)
        aliases.append(heaviest)
        missed_share = max(missed_share, 1.0 - share * most / max(len(wanted), most))
    return NearbyStarts(np.concatenate(aliases), missed_share)


def _heaviest(surface: LogDensity, at: Array) -> tuple[Array, float]:
    """The `MAX_ALIASES` near `at (n, D)` that hold most, and their share of what all of them hold."""
    if len(at) <= MAX_ALIASES:
        return at, 1.0
    u = gauss_newton(surface, at, SETTINGS.alias_steps).u
    shares = shares_held(surface.posterior, u)
    most = np.argsort(-shares, kind="stable")[:MAX_ALIASES]
    return u[most], float(shares[most].sum())


def scan_starts(surface: LogDensity, u: Array) -> NearbyStarts:
    """Return maxima along each unknown by itself, but for that of `u (D,)`."""
    posterior, maxima, missed_share = surface.posterior, list[Array](), 0.0
    step = min(
        float(np.diff(observation.experiment.t).min(initial=np.inf))
        for observation in posterior.likelihood.observations
    )
    ends = posterior.coordinates.to_physical(np.stack([surface.low, surface.high]))
    for d, unknown in enumerate(posterior.space.unknowns):
        scanned = SCAN_POINTS
        if unknown.role == "sensor" and unknown.symbol.unit == "s":
            many = SETTINGS.scan_points_per_sample * (ends[1, d] - ends[0, d]) / step
            scanned = int(np.clip(many, SCAN_POINTS, MAX_SCAN_POINTS))
        line = np.repeat(u[None], scanned + 1, axis=0)
        along = np.linspace(surface.low[d], surface.high[d], scanned)
        line[:, d] = np.sort(np.append(along, u[d]))
        value = surface.value(line)
        index = int(np.searchsorted(line[:, d], u[d]))
        tops = peaks(value, SETTINGS.valley_along_line)
        modes = [k for k in tops if _valley_between(value, k, index)]
        modes.sort(key=lambda k: -value[k])
        most = SETTINGS.max_starts_per_unknown
        maxima.append(line[modes[:most]])
        high = sum(value[k] > value.max() - SETTINGS.negligible_depth for k in modes)
        missed_share = max(missed_share, 1.0 - most / max(high, most))
    return NearbyStarts(np.concatenate(maxima), missed_share)


def peaks(value: Array, valley: float) -> list[int]:
    """Return indices of maxima of `value (N,)` parted by more than `valley`; -inf is allowed."""
    maxima: list[int] = []
    top, lowest, rising = 0, 0, True
    for k, x in enumerate(value):
        if rising and x < value[top] - valley:
            maxima.append(top)
            lowest, rising = k, False
        elif not rising and x > value[lowest] + valley:
            top, rising = k, True
        elif rising and x > value[top]:
            top = k
        elif not rising and x < value[lowest]:
            lowest = k
    return [*maxima, top] if rising and np.isfinite(value[top]) else maxima


def _valley_between(value: Array, first: int, second: int) -> bool:
    """Whether there is a valley between two places of a line."""
    between = value[min(first, second) : max(first, second) + 1]
    return bool(between.min() < min(value[first], value[second]) - SETTINGS.valley_along_line)


def _aliases(posterior: Posterior, omega: float, low: float, high: float) -> Array:
    """Frequencies from `low` to `high` whose samples are like those of `omega`, the most alike first."""
    patterns: dict[bytes, Array] = {}
    for observation in posterior.likelihood.observations:
        for sampled in observation.experiment.seen.T:
            t = observation.experiment.t[sampled]
            patterns[t.tobytes()] = t
    omegas, similarities = [np.empty(0)], [np.empty(0)]
    for t in patterns.values():
        delta, height = window_peaks(t, high + omega)
        each = np.abs(np.concatenate([omega - delta, omega + delta]))
        inside = (each > low) & (each < high)
        omegas.append(each[inside])
        similarities.append(np.tile(height, 2)[inside])
    return np.concatenate(omegas)[np.argsort(-np.concatenate(similarities), kind="stable")]


def window_peaks(t: Array, highest: float) -> tuple[Array, Array]:
    """Return the peaks of the spectral window of times `t (N,)` up to the frequency `highest`.

    Angular frequencies, and heights as shares of that at zero (Scargle 1982; VanderPlas 2018).
    """
    span = float(t[-1] - t[0])
    if len(t) < 2 or not 0 < highest * span < MAX_CELLS / CELLS_PER_RADIAN:
        return np.empty(0), np.empty(0)
    cells = int(np.ceil(CELLS_PER_RADIAN * highest * span)) + 1
    counts = np.bincount(np.rint((t - t[0]) / span * (cells - 1)).astype(int), minlength=cells)
    size = scipy.fft.next_fast_len(SETTINGS.window_oversampling * cells, real=True)
    height = np.abs(scipy.fft.rfft(counts, size)) / len(t)
    delta = 2.0 * np.pi * np.arange(len(height)) / size * (cells - 1) / span
    here = height[1:-1]
    inner = (here >= height[:-2]) & (here > height[2:]) & (here > SETTINGS.min_alias_height)
    top = 1 + np.flatnonzero(inner & (delta[1:-1] <= highest))
    return delta[top], height[top]


def frequencies(posterior: Posterior, u: Array) -> Array:
    """Return imaginary parts of the fastest poles at `u (W, D)`: `(W, POLE_PAIRS)`, 0 if none."""
    model = posterior.likelihood.observations[0].response.model
    theta = posterior.coordinates.to_physical(u)
    rig = posterior.likelihood.rig_parameters(theta)
    matrices = dynamics(model.linear(rig), model.states, len(u))
    poles = np.linalg.eigvals(np.where(np.isfinite(matrices), matrices, 0.0))
    size = np.abs(poles).max(axis=1, keepdims=True)
    swings = np.sort(np.where(poles.imag > SETTINGS.min_imaginary * size, poles.imag, 0.0), axis=1)
    return np.asarray(swings[:, ::-1][:, : SETTINGS.pole_pairs])


def _slopes(surface: LogDensity, u: Array, pair: int) -> tuple[Array, Array]:
    """Logs of the frequency of a pair at `u (W, D)`, and their slopes over the priors' spreads."""
    n, d = u.shape
    steps = SETTINGS.slope_step * np.diag(surface.spread)
    around = [u[:, None] + side * steps for side in (1.0, -1.0)]
    points = np.concatenate([u, *(at.reshape(-1, d) for at in around)])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(frequencies(surface.posterior, points)[:, pair])
        up, down = logs[n:].reshape(2, n, d)
        slope = (up - down) / (2 * SETTINGS.slope_step)
    return logs[:n], np.where(np.isfinite(slope), slope, 0.0)


def _frequency_range(surface: LogDensity, u: Array) -> tuple[Array, Array]:
    """Return the slowest and fastest of each pair of poles from `u (D,)` to the ends of the priors."""
    ends = []
    for pair in range(SETTINGS.pole_pairs):
        slope = _slopes(surface, u[None], pair)[1][0]
        slow = np.where(slope > 0, surface.low, np.where(slope < 0, surface.high, u))
        fast = np.where(slope > 0, surface.high, np.where(slope < 0, surface.low, u))
        ends.append(frequencies(surface.posterior, np.array([slow, fast]))[:, pair])
    low, high = np.array(ends).T
    return low, high


def _at_frequencies(surface: LogDensity, u: Array, pair: int, wanted: Array) -> Array:
    """Return the points `(m, D)` nearest to `u (D,)` at which a pair swings as `wanted (n,)`.

    Nearest in the priors' spreads; those that are not reached are left out.
    """
    records = (each.experiment for each in surface.posterior.likelihood.observations)
    span = max(float(np.ptp(record.t)) for record in records)
    near = SETTINGS.same_alias / (span * wanted)
    at = np.repeat(u[None], len(wanted), axis=0)
    for _ in range(SETTINGS.max_iterations):
        logs, slope = _slopes(surface, at, pair)
        off = np.log(wanted) - logs
        done = np.abs(off) < near
        # At the walls only what leads away from them can help.
        towards = slope * off[:, None]
        stuck = (at <= surface.low) & (towards < 0) | (at >= surface.high) & (towards > 0)
        slope[stuck] = 0.0
        size = (slope**2).sum(axis=1)
        going = np.isfinite(off) & ~done & (size > 0)
        if not going.any():
            break
        step = surface.spread * slope[going] * (off[going] / size[going])[:, None]
        at[going] = np.clip(at[going] + step, surface.low, surface.high)
    return at[done]
