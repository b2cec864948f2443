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

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.models.linear import dynamics
from bayesdrill.sampling.gauss_newton import gauss_newton
from bayesdrill.sampling.proposal import ridge_tracing

FIRST_STEPS = 8  # of all starts, and then ...
MAX_STARTS = 10  # ... as many of those spread over the prior go on, ...
MAX_NEARBY_STARTS = 128  # ... or of those that are likely to lead to other maxima, for ...
LAST_STEPS = 25  # ... as many steps
NEGLIGIBLE_DEPTH = 25.0  # of the log density: a maximum lower by more than that holds nothing
PATH_STEPS = 10  # steps between two points
SAME_MODE = 1e-3  # of the priors' spreads: the same point
CELL_SIZE = 1e-4  # of the priors' spreads: points that are likely to end at the same maximum
SAME_RIDGE_SDS = 3.0  # standard deviations of the tight directions
VALLEY_BETWEEN_MODES = 0.5  # of the log density: what is no deeper parts no maxima, but ripples
VALLEY_PROBES = 24  # places between two points, at which one looks for a valley; at no even ...
GOLDEN_FRACTION = 0.5 * (5.0**0.5 - 1.0)  # ... distances, as a row of maxima has them
KNOWN_BONUS = 1e-6  # of the log density: a point higher by less is no better than a known one


def best_ends(surface: LogDensity, starts: Array, most: int = MAX_STARTS) -> tuple[Array, Array]:
    """Climb from `starts (n, D)`: the `most` promising ends `(m, D)`, and their log densities."""
    first = gauss_newton(surface, starts, FIRST_STEPS)
    order = np.argsort(-first.value, kind="stable")
    cells = np.rint((first.u[order] - surface.low) / (CELL_SIZE * surface.spread))
    best = order[np.sort(np.unique(cells, axis=0, return_index=True)[1])][:most]
    climbed = gauss_newton(surface, first.u[best], LAST_STEPS)
    good = np.isfinite(climbed.value)
    return climbed.u[good], climbed.value[good]


def distinct_modes(surface: LogDensity, points: Array, values: Array, known: int = 0) -> list[int]:
    """Return which of `points (n, D)` are maxima of their own, the highest first.

    The first `known` of them are so already, and stay what stands for their maximum.
    """
    rank = values + np.where(np.arange(len(values)) < known, KNOWN_BONUS, 0.0)
    order = [int(k) for k in np.argsort(-rank, kind="stable")]
    remaining = [k for k in order if values[k] >= values[order[0]] - NEGLIGIBLE_DEPTH]
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


def split_by_valley(surface: LogDensity, start: Array, others: Array) -> Flags:
    """Return whether a valley parts `start (D,)` from each of `others (n, D)`, on a straight way.

    It does not between corners of a plateau, nor where one maximum has ripples.
    """
    between = np.sort(np.arange(1, VALLEY_PROBES + 1) * GOLDEN_FRACTION % 1.0)
    share = np.concatenate([[0.0], between, [1.0]])[:, None, None]
    ways = start + share * (others - start)
    value = surface.value(ways.reshape(-1, len(start))).reshape(ways.shape[:2])
    lower = np.minimum(value[0], value[-1])
    deep = value.min(axis=0) < lower - VALLEY_BETWEEN_MODES
    return np.asarray(deep | ~np.isfinite(lower))


def joined_by_ridge(surface: LogDensity, start: Array, others: Array) -> Flags:
    """Return whether the ridge through `start (D,)` leads to each of `others (n, D)`: `(n,)`.

    Where nothing is tight all of the prior is the ridge, and a valley parts it.
    """
    here = surface.quadratic_model(start[None], np.eye(len(start)))
    base, _ = ridge_tracing.split_directions(surface, start, here)
    psi, tau = base.split(others)
    if tau.shape[1] == 0:
        return ~split_by_valley(surface, start, others)
    at = before = np.zeros_like(tau)
    steps = PATH_STEPS if psi.shape[1] else 1
    for k in range(1, steps + 1):
        ahead = 2.0 * at - before if k > 1 else at  # straight on from the last two
        ridge_tau, roots, _, arrived = ridge_tracing.return_to_ridge(
            surface.quadratic_model, base, psi * (k / steps), ahead
        )
        before, at = at, ridge_tau
    roots[~arrived] = np.eye(tau.shape[1])  # of no use, where there is no density
    off = np.linalg.solve(roots, (tau - at)[..., None])[..., 0]
    return np.asarray(arrived & (np.linalg.norm(off, axis=1) < SAME_RIDGE_SDS))


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


SAME_HEIGHT = 1e-6  # of the log density, relative: of what is the same but for names
POLE_PAIRS = 2  # of poles that are looked at, the fastest
MIN_IMAGINARY = 1e-6  # of the largest pole: an imaginary part above it is no rounding
SLOPE_STEP = 1e-5  # of the priors' spreads
MAX_ALIASES_TRIED = 384  # aliases of a pair of poles, the most alike first, of which ...
MAX_ALIASES = 96  # ... so many are starts: where they are more, ...
ALIAS_STEPS = 8  # ... those that hold most of where they lead to in so many steps
MAX_ITERATIONS = 12  # on the way to an alias
SAME_ALIAS = 0.3  # radians over the whole record: what is left is for the search
MIN_ALIAS_HEIGHT = 0.3  # of the window's height: lower peaks are no aliases
WINDOW_OVERSAMPLING = 4  # times that the window is drawn finer than its peaks are wide
CELLS_PER_RADIAN, MAX_CELLS = 3, 2**19  # cells of time for a radian of the fastest swing, at most
SCAN_POINTS, MAX_SCAN_POINTS = 240, 2000  # points along each unknown; along a moment so many ...
SCAN_POINTS_PER_SAMPLE = 2  # ... from sample to sample, as what is written in steps may repeat
MAX_STARTS_PER_UNKNOWN = 96  # starts that come of them
VALLEY_ALONG_LINE = 1.0  # of the log density: what is less deep parts no maxima


@dataclass(frozen=True, slots=True)
class NearbyStarts:
    """Starts `u (n, D)`, and the share of all aliases within the priors that they leave out."""

    u: Array
    missed_share: float


def nearby_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield starts from which a search may find other maxima than the one at `u (D,)`."""
    yield from twin_starts(surface, u)
    yield from alias_starts(surface, u)
    yield from scan_starts(surface, u)


def twin_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield the twins of `u (D,)`: two inertias on shafts are exchanged that nothing tells apart."""
    posterior = surface.posterior
    observations, free = posterior.likelihood.observations, posterior.space.free
    roles, labels = (
        observations[0].response.model.roles,
        ["", *(f"_{x.label}" for x in observations)],
    )
    inertias = itertools.combinations(map(dataclasses.asdict, roles.inertias), 2)
    shafts = [*itertools.combinations(map(dataclasses.asdict, roles.shafts), 2)]
    for parts in itertools.product(inertias, shafts):
        pairs: dict[str, str] = {}
        for first, second in parts:
            both = [
                (first[x], second[x])
                for x in first
                if isinstance(first[x], str) and first[x] and second[x]
            ]
            for ending in (f"{start}{label}" for start in ("", "_0") for label in labels):
                pairs |= {a + ending: b + ending for a, b in (*both, *((b, a) for a, b in both))}
        exchanged = [pairs.get(name, name) for name in free]
        if {*exchanged} == {*free} and exchanged != [*free]:
            twin = u[[free.index(name) for name in exchanged]]
            here, there = surface.value(np.stack([u, twin]))
            if abs(here - there) <= SAME_HEIGHT * (1.0 + abs(here)):
                yield NearbyStarts(twin[None], 0.0)


def alias_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield points where each pair of poles swings at an alias of its frequency at `u (D,)`."""
    posterior = surface.posterior
    here = frequencies(posterior, u[None])[0]
    slowest, fastest = _frequency_range(surface, u)
    most = MAX_ALIASES_TRIED
    for pair in np.flatnonzero(here > 0):
        wanted = _aliases(posterior, here[pair], slowest[pair], fastest[pair])
        at = _at_frequencies(surface, u, int(pair), np.unique(wanted[:most]))
        heaviest, share = _heaviest(surface, at)
        yield NearbyStarts(heaviest, 1.0 - share * most / max(len(wanted), most))


def _heaviest(surface: LogDensity, at: Array) -> tuple[Array, float]:
    """The `MAX_ALIASES` near `at (n, D)` that hold most, and their share of what all of them hold."""
    if len(at) <= MAX_ALIASES:
        return at, 1.0
    u = gauss_newton(surface, at, ALIAS_STEPS).u
    shares = shares_held(surface.posterior, u)
    most = np.argsort(-shares, kind="stable")[:MAX_ALIASES]
    return u[most], float(shares[most].sum())


def scan_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield maxima along each unknown by itself, but for that of `u (D,)`."""
    posterior, most = surface.posterior, MAX_STARTS_PER_UNKNOWN
    step = min(
        float(np.diff(observation.experiment.t).min(initial=np.inf))
        for observation in posterior.likelihood.observations
    )
    ends = posterior.coordinates.to_physical(np.stack([surface.low, surface.high]))
    for d, unknown in enumerate(posterior.space.unknowns):
        scanned = SCAN_POINTS
        if unknown.role == "sensor" and unknown.symbol.unit == "s":
            many = SCAN_POINTS_PER_SAMPLE * (ends[1, d] - ends[0, d]) / step
            scanned = int(np.clip(many, SCAN_POINTS, MAX_SCAN_POINTS))
        line = np.repeat(u[None], scanned + 1, axis=0)
        along = np.linspace(surface.low[d], surface.high[d], scanned)
        line[:, d] = np.sort(np.append(along, u[d]))
        value = surface.value(line)
        index = int(np.searchsorted(line[:, d], u[d]))
        tops = peaks(value, VALLEY_ALONG_LINE)
        modes = [k for k in tops if _valley_between(value, k, index)]
        modes.sort(key=lambda k: -value[k])
        high = sum(value[k] > value.max() - NEGLIGIBLE_DEPTH for k in modes)
        yield NearbyStarts(line[modes[:most]], 1.0 - most / max(high, most))


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
    return bool(between.min() < min(value[first], value[second]) - VALLEY_ALONG_LINE)


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
    size = scipy.fft.next_fast_len(WINDOW_OVERSAMPLING * cells, real=True)
    height = np.abs(scipy.fft.rfft(counts, size)) / len(t)
    delta = 2.0 * np.pi * np.arange(len(height)) / size * (cells - 1) / span
    here = height[1:-1]
    inner = (here >= height[:-2]) & (here > height[2:]) & (here > MIN_ALIAS_HEIGHT)
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
    swings = np.sort(np.where(poles.imag > MIN_IMAGINARY * size, poles.imag, 0.0), axis=1)
    return np.asarray(swings[:, ::-1][:, :POLE_PAIRS])


def _slopes(surface: LogDensity, u: Array, pair: int) -> tuple[Array, Array]:
    """Logs of the frequency of a pair at `u (W, D)`, and their slopes over the priors' spreads."""
    n, d = u.shape
    steps = SLOPE_STEP * np.diag(surface.spread)
    around = [u[:, None] + side * steps for side in (1.0, -1.0)]
    points = np.concatenate([u, *(at.reshape(-1, d) for at in around)])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(frequencies(surface.posterior, points)[:, pair])
        up, down = logs[n:].reshape(2, n, d)
        slope = (up - down) / (2 * SLOPE_STEP)
    return logs[:n], np.where(np.isfinite(slope), slope, 0.0)


def _frequency_range(surface: LogDensity, u: Array) -> tuple[Array, Array]:
    """Return the slowest and fastest of each pair of poles from `u (D,)` to the ends of the priors."""
    ends = []
    for pair in range(POLE_PAIRS):
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
    near = SAME_ALIAS / (span * wanted)
    at = np.repeat(u[None], len(wanted), axis=0)
    for _ in range(MAX_ITERATIONS):
        logs, slope = _slopes(surface, at, pair)
        off = np.log(wanted) - logs
        done = np.abs(off) < near
        # At the walls only what leads away from them can help; where nothing swings, nothing leads on.
        towards = slope * np.where(np.isfinite(off), off, 0.0)[:, None]
        stuck = (at <= surface.low) & (towards < 0) | (at >= surface.high) & (towards > 0)
        slope[stuck] = 0.0
        size = (slope**2).sum(axis=1)
        going = np.isfinite(off) & ~done & (size > 0)
        if not going.any():
            break
        step = surface.spread * slope[going] * (off[going] / size[going])[:, None]
        at[going] = np.clip(at[going] + step, surface.low, surface.high)
    return at[done]
