"""Find other maxima of a density (aliases, lags), and decide which are distinct.

Two points on one ridge are the same maximum, however far apart they are.  To test this, a path is
followed from the first point in its loose (badly determined) directions.  After each step, the
path returns to the ridge in tight directions.  It ends at the second point if a ridge joins both.

Sampled at times t, oscillations at omega and |omega +- delta| look alike if delta is a peak of the
spectral window |sum exp(i delta t)|.  For even samples delta is 2 pi / step, and for two bursts
2 pi / gap (Scargle 1982; VanderPlas 2018).  Other ambiguities are maxima along one unknown: a lag
under a periodic drive, an angle that differs by a turn, or a sign.
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

FIRST_STEPS, LAST_STEPS = 8, 25  # steps of every climb, and further steps of the best climbs
MAX_STARTS = 10  # largest number of climbs after `FIRST_STEPS`, if they start all over the prior
MAX_NEARBY_STARTS = 128  # largest number of climbs after `FIRST_STEPS`, if they start near maxima
NEGLIGIBLE_DEPTH = 25.0  # in log density: a maximum this far below the highest has no mass
PATH_STEPS = 10  # number of steps of the path along a ridge from one point to another
SAME_MODE = 1e-3  # in priors' spreads: two points closer than this are the same maximum
CELL_SIZE = 1e-4  # in priors' spreads: only the highest point in a cell of this size climbs on
SAME_RIDGE_SDS = 3.0  # in standard deviations: a point this near to a ridge is on the ridge
VALLEY_BETWEEN_MODES = 0.5  # in log density: shallower valleys are ripples of one maximum
VALLEY_PROBES = 24  # points between two maxima at which the density is compared
GOLDEN_FRACTION = 0.5 * (5.0**0.5 - 1.0)  # for uneven spacing of the probes
KNOWN_BONUS = 1e-6  # in log density: a new point on a known ridge is dropped unless higher by this


def best_ends(
    surface: LogDensity, starts: Array, max_ends: int = MAX_STARTS
) -> tuple[Array, Array]:
    """Climb from `starts (n, D)`; return up to `max_ends` ends `(m, D)`, and log densities `(m,)`."""
    first = gauss_newton(surface, starts, FIRST_STEPS)
    order = np.argsort(-first.value, kind="stable")
    cells = np.rint((first.u[order] - surface.low) / (CELL_SIZE * surface.spread))
    best = order[np.sort(np.unique(cells, axis=0, return_index=True)[1])][:max_ends]
    climbed = gauss_newton(surface, first.u[best], LAST_STEPS)
    good = np.isfinite(climbed.value)
    return climbed.u[good], climbed.value[good]


def distinct_modes(
    surface: LogDensity, points: Array, values: Array, n_known: int = 0
) -> list[int]:
    """Return the indices of `points (n, D)` that are distinct maxima, the highest first.

    The first `n_known` points are known to be distinct, so they are not compared with each other.
    A new point replaces a known one that it is joined to only if it is higher.
    """
    rank = values + np.where(np.arange(len(values)) < n_known, KNOWN_BONUS, 0.0)
    order = [int(k) for k in np.argsort(-rank, kind="stable")]
    remaining = [k for k in order if values[k] >= values[order[0]] - NEGLIGIBLE_DEPTH]
    distinct: list[int] = []
    while remaining:
        highest, *lower = remaining
        distinct.append(highest)
        compared = [k for k in lower if k >= n_known or highest >= n_known]
        if not compared:
            return [*distinct, *lower]
        others = points[compared]
        same = (np.abs(others - points[highest]) < SAME_MODE * surface.spread).all(axis=1)
        same[~same] = joined_by_ridge(surface, points[highest], others[~same])
        same[~same] = ~split_by_valley(surface, points[highest], others[~same])
        dropped = {k for k, is_same in zip(compared, same, strict=True) if is_same}
        remaining = [k for k in lower if k not in dropped]
    return distinct


def split_by_valley(surface: LogDensity, start: Array, others: Array) -> Flags:
    """Return whether a valley lies between `start (D,)` and each of `others (n, D)`: `(n,)`.

    Densities on the straight line are compared.  Ripples and plateaus do not count as valleys.
    """
    between = np.sort(np.arange(1, VALLEY_PROBES + 1) * GOLDEN_FRACTION % 1.0)
    fraction = np.concatenate([[0.0], between, [1.0]])[:, None, None]
    lines = start + fraction * (others - start)
    value = surface.value(lines.reshape(-1, len(start))).reshape(lines.shape[:2])
    lower = np.minimum(value[0], value[-1])
    deep = value.min(axis=0) < lower - VALLEY_BETWEEN_MODES
    return np.asarray(deep | ~np.isfinite(lower))


def joined_by_ridge(surface: LogDensity, start: Array, others: Array) -> Flags:
    """Return whether the ridge through `start (D,)` leads to each of `others (n, D)`: `(n,)`.

    Without tight directions the whole prior is the ridge, so that only a valley separates points.
    """
    here = surface.quadratic_model(start[None], np.eye(len(start)))
    base, _ = ridge_tracing.split_directions(surface, start, here)
    psi, tau = base.split(others)
    if tau.shape[1] == 0:
        return ~split_by_valley(surface, start, others)
    on_ridge = previous = np.zeros_like(tau)
    steps = PATH_STEPS if psi.shape[1] else 1
    for k in range(1, steps + 1):
        guess = 2.0 * on_ridge - previous if k > 1 else on_ridge  # linear extrapolation
        previous = on_ridge
        on_ridge, roots, _, arrived = ridge_tracing.return_to_ridge(
            surface.quadratic_model, base, psi * (k / steps), guess
        )
    roots[~arrived] = np.eye(tau.shape[1])  # any solvable matrix: these points are not joined
    sds = np.linalg.solve(roots, (tau - on_ridge)[..., None])[..., 0]
    return np.asarray(arrived & (np.linalg.norm(sds, axis=1) < SAME_RIDGE_SDS))


def shares_held(posterior: Posterior, maxima: Array) -> Array:
    """Return the posterior mass of `maxima (M, D)` by Laplace's method: `(M,)`, sum 1."""
    if len(maxima) == 1:
        return np.ones(1)
    surface = LogDensity(posterior)
    here = surface.quadratic_model(maxima, np.eye(maxima.shape[1]))
    scaled = here.curvature * np.outer(surface.spread, surface.spread) + np.eye(maxima.shape[1])
    log_mass = here.value - 0.5 * np.linalg.slogdet(scaled)[1]
    log_mass = np.where(np.isfinite(log_mass), log_mass, -np.inf)
    mass = (
        np.exp(log_mass - log_mass.max()) if np.isfinite(log_mass).any() else np.ones(len(maxima))
    )
    return np.asarray(mass / mass.sum())


SAME_HEIGHT = 1e-6  # largest relative difference of equal log densities, by rounding
POLE_PAIRS = 2  # pairs of poles whose aliases are tried, the fastest first
MIN_IMAGINARY = 1e-6  # imaginary part / largest |pole|; a smaller ratio is a rounding error
SLOPE_STEP = 1e-5  # in priors' spreads: step of the finite differences of frequencies
MAX_ALIASES_TRIED = 384  # largest number of aliases of a pole pair, those with most similar samples
ALIAS_STEPS = 8  # Gauss-Newton steps of aliases before their posterior mass is compared
MAX_ALIASES = 96  # largest number of aliases used as starts, those with the largest mass
MAX_ITERATIONS = 12  # Newton iterations towards the frequency of an alias
SAME_ALIAS = 0.3  # phase error at the end of the record, in radians, that a climb can correct
MIN_ALIAS_HEIGHT = 0.3  # smallest height of a peak of the spectral window / height at zero
WINDOW_OVERSAMPLING = 4  # points of the spectral window per width of a peak
CELLS_PER_RADIAN, MAX_CELLS = 3, 2**19  # time bins per radian of the highest frequency; most bins
SCAN_POINTS, MAX_SCAN_POINTS = 240, 2000  # number of points along an unknown; most along a lag
SCAN_POINTS_PER_SAMPLE = 2  # points along a lag per sample, as maxima may be one sample apart
MAX_STARTS_PER_UNKNOWN = 96  # largest number of starts from maxima along an unknown
VALLEY_ALONG_LINE = 1.0  # in log density: shallower valleys along a line separate no maxima


@dataclass(frozen=True, slots=True)
class NearbyStarts:
    """Nearby starts `u (n, D)` leave out an estimated fraction `missed_share` of all maxima."""

    u: Array
    missed_share: float


def nearby_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield starts from which a search may find other maxima than the one at `u (D,)`."""
    yield from twin_starts(surface, u)
    yield from alias_starts(surface, u)
    yield from scan_starts(surface, u)


def twin_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield points of the same density as `u (D,)`, with two inertias and two shafts exchanged."""
    posterior = surface.posterior
    observations, free = posterior.likelihood.observations, posterior.space.free
    roles = observations[0].response.model.roles
    labels = ["", *(f"_{observation.label}" for observation in observations)]
    inertias = itertools.combinations(map(dataclasses.asdict, roles.inertias), 2)
    shafts = [*itertools.combinations(map(dataclasses.asdict, roles.shafts), 2)]
    for parts in itertools.product(inertias, shafts):
        pairs: dict[str, str] = {}
        for first, second in parts:
            names = [x for x in first if isinstance(first[x], str) and first[x] and second[x]]
            both = [(first[x], second[x]) for x in names]
            for ending in (f"{start}{label}" for start in ("", "_0") for label in labels):
                pairs |= {a + ending: b + ending for a, b in (*both, *((b, a) for a, b in both))}
        exchanged = [pairs.get(name, name) for name in free]
        if {*exchanged} == {*free} and exchanged != [*free]:
            twin = u[[free.index(name) for name in exchanged]]
            here, there = surface.value(np.stack([u, twin]))
            if abs(here - there) <= SAME_HEIGHT * (1.0 + abs(here)):
                yield NearbyStarts(twin[None], 0.0)


def alias_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield points where a pole pair has an alias of the frequency that it has at `u (D,)`."""
    posterior = surface.posterior
    here = frequencies(posterior, u[None])[0]
    slowest, fastest = _frequency_range(surface, u)
    limit = MAX_ALIASES_TRIED
    for pair in np.flatnonzero(here > 0):
        wanted = _aliases(posterior, here[pair], slowest[pair], fastest[pair])
        points = _at_frequencies(surface, u, int(pair), np.unique(wanted[:limit]))
        heaviest, mass = _heaviest(surface, points)
        yield NearbyStarts(heaviest, 1.0 - mass * limit / max(len(wanted), limit))


def _heaviest(surface: LogDensity, points: Array) -> tuple[Array, float]:
    """Return the `MAX_ALIASES` heaviest of `points (n, D)`, and the fraction of mass near them."""
    if len(points) <= MAX_ALIASES:
        return points, 1.0
    u = gauss_newton(surface, points, ALIAS_STEPS).u
    shares = shares_held(surface.posterior, u)
    heaviest = np.argsort(-shares, kind="stable")[:MAX_ALIASES]
    return u[heaviest], float(shares[heaviest].sum())


def scan_starts(surface: LogDensity, u: Array) -> Iterator[NearbyStarts]:
    """Yield maxima along each unknown through `u (D,)`, except the maximum at `u` itself."""
    posterior, limit = surface.posterior, MAX_STARTS_PER_UNKNOWN
    step = min(
        float(np.diff(observation.experiment.t).min(initial=np.inf))
        for observation in posterior.likelihood.observations
    )
    ends = posterior.coordinates.to_physical(np.stack([surface.low, surface.high]))
    for d, unknown in enumerate(posterior.space.unknowns):
        scanned = SCAN_POINTS
        if unknown.role == "sensor" and unknown.symbol.unit == "s":
            needed = SCAN_POINTS_PER_SAMPLE * (ends[1, d] - ends[0, d]) / step
            scanned = int(np.clip(needed, SCAN_POINTS, MAX_SCAN_POINTS))
        line = np.repeat(u[None], scanned + 1, axis=0)
        along = np.linspace(surface.low[d], surface.high[d], scanned)
        line[:, d] = np.sort(np.append(along, u[d]))
        value = surface.value(line)
        index = int(np.searchsorted(line[:, d], u[d]))
        modes = []
        for k in peaks(value, VALLEY_ALONG_LINE):
            valley = value[min(k, index) : max(k, index) + 1].min()
            if valley < min(value[k], value[index]) - VALLEY_ALONG_LINE:
                modes.append(k)
        modes.sort(key=lambda k: -value[k])
        high = sum(value[k] > value.max() - NEGLIGIBLE_DEPTH for k in modes)
        yield NearbyStarts(line[modes[:limit]], 1.0 - limit / max(high, limit))


def peaks(value: Array, valley: float) -> list[int]:
    """Return indices of maxima of `value (N,)`, between which valleys are deeper than `valley`."""
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


def _aliases(posterior: Posterior, omega: float, low: float, high: float) -> Array:
    """Return aliases of `omega` from `low` to `high` [rad/s], in order of decreasing similarity."""
    patterns: dict[bytes, Array] = {}
    for observation in posterior.likelihood.observations:
        for sampled in observation.experiment.is_measured.T:
            t = observation.experiment.t[sampled]
            patterns[t.tobytes()] = t
    omegas, similarities = [np.empty(0)], [np.empty(0)]
    for t in patterns.values():
        delta, height = window_peaks(t, high + omega)
        aliases = np.abs(np.concatenate([omega - delta, omega + delta]))
        in_range = (aliases > low) & (aliases < high)
        omegas.append(aliases[in_range])
        similarities.append(np.tile(height, 2)[in_range])
    return np.concatenate(omegas)[np.argsort(-np.concatenate(similarities), kind="stable")]


def window_peaks(t: Array, highest: float) -> tuple[Array, Array]:
    """Return the peaks of the spectral window of times `t (N,)` in s, up to `highest` in rad/s.

    Returns frequencies in rad/s, and heights relative to that at zero (Scargle 1982).
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
    """Return the highest frequencies of poles, `(W, POLE_PAIRS)` in rad/s; 0 for missing pairs."""
    model = posterior.likelihood.observations[0].response.model
    theta = posterior.coordinates.to_physical(u)
    rig = posterior.likelihood.rig_parameters(theta)
    matrices = dynamics(model.linear(rig), model.states, len(u))
    poles = np.linalg.eigvals(np.where(np.isfinite(matrices), matrices, 0.0))
    size = np.abs(poles).max(axis=1, keepdims=True)
    swings = np.sort(np.where(poles.imag > MIN_IMAGINARY * size, poles.imag, 0.0), axis=1)
    return np.asarray(swings[:, ::-1][:, :POLE_PAIRS])


def _slopes(surface: LogDensity, u: Array, pair: int) -> tuple[Array, Array]:
    """Return log frequencies of a pole pair at `u (W, D)`, and their slopes per prior spread."""
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
    """Return the lowest and highest frequency of each pole pair, in rad/s, within the priors."""
    ranges = []
    for pair in range(POLE_PAIRS):
        slope = _slopes(surface, u[None], pair)[1][0]
        slow = np.where(slope > 0, surface.low, np.where(slope < 0, surface.high, u))
        fast = np.where(slope > 0, surface.high, np.where(slope < 0, surface.low, u))
        ranges.append(frequencies(surface.posterior, np.array([slow, fast]))[:, pair])
    low, high = np.array(ranges).T
    return low, high


def _at_frequencies(surface: LogDensity, u: Array, pair: int, frequencies: Array) -> Array:
    """Return points `(m, D)` at which a pole pair has `frequencies (n,)` in rad/s.

    Each point is near `u (D,)`, in priors' spreads.  A frequency that priors exclude has no point.
    """
    observations = surface.posterior.likelihood.observations
    span = max(float(np.ptp(observation.experiment.t)) for observation in observations)
    tolerance = SAME_ALIAS / (span * frequencies)
    points = np.repeat(u[None], len(frequencies), axis=0)
    for _ in range(MAX_ITERATIONS):
        logs, slope = _slopes(surface, points, pair)
        change = np.log(frequencies) - logs
        done = np.abs(change) < tolerance
        # Unknowns at bounds do not move outwards.  A point stops if its pair no longer oscillates.
        towards = slope * np.where(np.isfinite(change), change, 0.0)[:, None]
        stuck = (points <= surface.low) & (towards < 0) | (points >= surface.high) & (towards > 0)
        slope[stuck] = 0.0
        size = (slope**2).sum(axis=1)
        going = np.isfinite(change) & ~done & (size > 0)
        if not going.any():
            break
        step = surface.spread * slope[going] * (change[going] / size[going])[:, None]
        points[going] = np.clip(points[going] + step, surface.low, surface.high)
    return points[done]
