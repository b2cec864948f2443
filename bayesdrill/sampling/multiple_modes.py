"""Other maxima of a density: where to look for them (aliases, lags), and how different ones are
told apart.

Two points of one ridge are joined by it, however far apart they are; two maxima are not.  So one
walks from one to the other along the loose directions of the first, led back to the ridge by its
tight ones at each step, and looks where one arrives.

A swing of frequency omega that is seen at times t leaves nearly the same samples as one of
|omega +- delta|, where delta is a peak of the window |sum exp(i delta t)|: 2 pi over the step of even
samples, and 2 pi over the gap between two stretches (Scargle 1982; VanderPlas 2018).  What returns in
other unknowns, such as a lag under a periodic drive, an angle a turn further or a sign, shows as further
maxima along each of them by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.laplace import LogDensity, PosteriorLogDensity
from bayesdrill.inference.posterior import Posterior
from bayesdrill.rig.models.linear import dynamics
from bayesdrill.sampling.gauss_newton import climb
from bayesdrill.sampling.proposal import ridge_tracing

FIRST_STEPS = 8  # of all starts, and then ...
BEST_STARTS = 10  # ... as many of those spread over the prior go on, ...
AROUND = 128  # ... or of those that are likely to lead to other maxima, for ...
MORE_STEPS = 25  # ... as many steps
LOWER = 25.0  # of the log density: a maximum lower than the highest by more holds nothing
PATH = 10  # steps between two points
SAME_MODE = 1e-3  # of the priors' spreads: the same point
CLOSE = 1e-4  # of the priors' spreads: points that are likely to end at the same maximum
SAME = 3.0  # standard deviations of the tight directions
# Of the log density: what is no deeper parts no maxima, but ripples of one.
VALLEY_BETWEEN_MODES = 0.5
ALONG = 24  # places between two points, at which one looks for a valley; at no even ...
UNEVEN = 0.5 * (5.0**0.5 - 1.0)  # ... distances, as a row of maxima has them
KNOWN = 1e-6  # of the log density: a point that is higher by less is no better than a known one


def scout(surface: LogDensity, starts: Array, most: int = BEST_STARTS) -> tuple[Array, Array]:
    """Where `starts (n, D)` lead: the `most` promising ones, `(m, D)`, and their log densities."""
    first = climb(surface, starts, FIRST_STEPS)
    order = np.argsort(-first.value, kind="stable")
    cells = np.rint((first.u[order] - surface.low) / (CLOSE * surface.spread))
    best = order[np.sort(np.unique(cells, axis=0, return_index=True)[1])][:most]
    found = climb(surface, first.u[best], MORE_STEPS)
    good = np.isfinite(found.value)
    return found.u[good], found.value[good]


def apart(surface: LogDensity, points: Array, values: Array, known: int = 0) -> list[int]:
    """Which of `points (n, D)` are maxima of their own, the highest first.

    The first `known` of them are so already, and stay what stands for their maximum.
    """
    rank = values + np.where(np.arange(len(values)) < known, KNOWN, 0.0)
    left = [int(k) for k in np.argsort(-rank, kind="stable")]
    left = [k for k in left if values[k] >= values[left[0]] - LOWER]
    chosen: list[int] = []
    while left:
        highest, *rest = left
        chosen.append(highest)
        fresh = [k for k in rest if k >= known]
        if not fresh:
            return [*chosen, *rest]
        others = points[fresh]
        same = (np.abs(others - points[highest]) < SAME_MODE * surface.spread).all(axis=1)
        same[~same] = joined(surface, points[highest], others[~same])
        same[~same] = ~valleys(surface, points[highest], others[~same])
        dropped = {k for k, one in zip(fresh, same, strict=True) if one}
        left = [k for k in rest if k not in dropped]
    return chosen


def valleys(surface: LogDensity, start: Array, others: Array) -> NDArray[np.bool_]:
    """Whether the density falls by `VALLEY` on the straight ways from `start (D,)` to `others (n, D)`.

    It does not between corners of a plateau, nor where one maximum has ripples.
    """
    between = np.sort(np.arange(1, ALONG + 1) * UNEVEN % 1.0)
    share = np.concatenate([[0.0], between, [1.0]])[:, None, None]
    ways = start + share * (others - start)
    value = surface.value(ways.reshape(-1, len(start))).reshape(ways.shape[:2])
    lower = np.minimum(value[0], value[-1])
    return np.asarray((value.min(axis=0) < lower - VALLEY_BETWEEN_MODES) | ~np.isfinite(lower))


def joined(surface: LogDensity, start: Array, others: Array) -> NDArray[np.bool_]:
    """Whether the ridge through `start (D,)` leads to each of `others (n, D)`: `(n,)`.

    Where nothing is tight all of the prior is the ridge, and a valley parts it.
    """
    here = surface.quadratic_model(start[None], np.eye(len(start)))
    base, _ = ridge_tracing.split(surface, start, here)
    psi, tau = base.split(others)
    if tau.shape[1] == 0:
        return ~valleys(surface, start, others)
    at = np.zeros_like(tau)
    before = np.zeros_like(tau)
    arrived = np.zeros(len(others), dtype=bool)
    roots = np.zeros((len(others), tau.shape[1], tau.shape[1]))
    steps = PATH if psi.shape[1] else 1
    for k in range(1, steps + 1):
        ahead = 2.0 * at - before if k > 1 else at  # straight on from the last two
        found, roots, _, arrived = ridge_tracing.led_back(
            surface.quadratic_model, base, psi * (k / steps), ahead
        )
        before, at = at, found
    roots[~arrived] = np.eye(tau.shape[1])  # of no use, where there is no density
    off = np.linalg.solve(roots, (tau - at)[..., None])[..., 0]
    return np.asarray(arrived & (np.linalg.norm(off, axis=1) < SAME))


def shares_held(posterior: Posterior, ends: Array) -> Array:
    """How much of the posterior each of the maxima `ends (M, D)` holds, by Laplace: `(M,)`, sum 1."""
    if len(ends) == 1:
        return np.ones(1)
    over = PosteriorLogDensity(posterior)
    here = over.quadratic_model(ends, np.eye(ends.shape[1]))
    scaled = here.curvature * np.outer(over.spread, over.spread) + np.eye(ends.shape[1])
    log_mass = here.value - 0.5 * np.linalg.slogdet(scaled)[1]
    log_mass = np.where(np.isfinite(log_mass), log_mass, -np.inf)
    mass = np.exp(log_mass - log_mass.max()) if np.isfinite(log_mass).any() else np.ones(len(ends))
    return np.asarray(mass / mass.sum())


PAIRS = 2  # of poles that are looked at, the fastest
ALIKE = 0.3  # of the window's height: lower peaks are no aliases
MOST_TRIED = 384  # aliases of a pair of poles, the most alike first, of which ...
MOST_ALIASES = 96  # ... so many are starts: where they are more, ...
CLIMBED = 8  # ... those that hold most of where they lead to in so many steps
PER_RADIAN, MOST_CELLS = 3, 2**19  # cells of time for each radian of the fastest swing, at most
FINER = 4  # times that the window is drawn finer than its peaks are wide
ITERATIONS = 12
SAME_ALIAS = 0.3  # radians over the whole record: what is left is for the search
STEP = 1e-5  # of the priors' spreads
OSCILLATES = 1e-6  # of the largest pole: an imaginary part above it is no rounding
SCANNED, MOST_SCANNED = 240, 2000  # points along each unknown; along a moment so many ...
PER_SAMPLE = 2  # ... from sample to sample, as what is written down in steps may repeat itself
PER_UNKNOWN = 96  # starts that come of them
VALLEY_ALONG_LINE = 1.0  # of the log density: what is less deep parts no maxima


@dataclass(frozen=True, slots=True)
class Around:
    """Starts `u (n, D)`, and the share of all aliases within the priors that they leave out."""

    u: Array
    left_out: float


def starts(surface: PosteriorLogDensity, u: Array) -> Around:
    """From where a search may find other maxima than the one at `u (D,)`."""
    aliased, returned = swings(surface, u), returns(surface, u)
    left_out = max(aliased.left_out, returned.left_out)
    return Around(np.concatenate([aliased.u, returned.u]), left_out)


def swings(surface: PosteriorLogDensity, u: Array) -> Around:
    """Where a pair of poles swings at an alias of its frequency at `u (D,)`."""
    posterior = surface.posterior
    here = frequencies(posterior, u[None])[0]
    slowest, fastest = _reach(surface, u)
    found, left_out = [np.empty((0, len(u)))], 0.0
    for pair in np.flatnonzero(here > 0):
        wanted = _aliases(posterior, here[pair], slowest[pair], fastest[pair])
        at = _moved(surface, u, int(pair), np.unique(wanted[:MOST_TRIED]))
        kept, share = _heaviest(surface, at)
        found.append(kept)
        left_out = max(left_out, 1.0 - share * MOST_TRIED / max(len(wanted), MOST_TRIED))
    return Around(np.concatenate(found), left_out)


def _heaviest(surface: PosteriorLogDensity, at: Array) -> tuple[Array, float]:
    """The `MOST_ALIASES` near `at (n, D)` that hold most, and their share of what all of them hold."""
    if len(at) <= MOST_ALIASES:
        return at, 1.0
    u = climb(surface, at, CLIMBED).u
    held = shares_held(surface.posterior, u)
    most = np.argsort(-held, kind="stable")[:MOST_ALIASES]
    return u[most], float(held[most].sum())


def returns(surface: PosteriorLogDensity, u: Array) -> Around:
    """Maxima along each unknown by itself, but for that of `u (D,)`."""
    posterior, found, left_out = surface.posterior, list[Array](), 0.0
    step = min(
        float(np.diff(one.experiment.t).min(initial=np.inf))
        for one in posterior.likelihood.observations
    )
    ends = posterior.coordinates.to_physical(np.stack([surface.low, surface.high]))
    for d, unknown in enumerate(posterior.space.unknowns):
        scanned = SCANNED
        if unknown.role == "sensor" and unknown.symbol.unit == "s":
            many = PER_SAMPLE * (ends[1, d] - ends[0, d]) / step
            scanned = int(np.clip(many, SCANNED, MOST_SCANNED))
        line = np.repeat(u[None], scanned + 1, axis=0)
        along = np.linspace(surface.low[d], surface.high[d], scanned)
        line[:, d] = np.sort(np.append(along, u[d]))
        value = surface.value(line)
        own = int(np.searchsorted(line[:, d], u[d]))
        tops = [k for k in peaks(value, VALLEY_ALONG_LINE) if _apart(value, k, own)]
        tops = sorted(tops, key=lambda k: -value[k])
        found.append(line[tops[:PER_UNKNOWN]])
        high = sum(value[k] > value.max() - LOWER for k in tops)
        left_out = max(left_out, 1.0 - PER_UNKNOWN / max(high, PER_UNKNOWN))
    return Around(np.concatenate(found), left_out)


def peaks(value: Array, valley: float) -> list[int]:
    """Indices of maxima of `value (N,)`, -inf allowed, with valleys deeper than `valley` between."""
    found: list[int] = []
    top, lowest, rising = 0, 0, True
    for k, x in enumerate(value):
        if rising and x < value[top] - valley:
            found.append(top)
            lowest, rising = k, False
        elif not rising and x > value[lowest] + valley:
            top, rising = k, True
        elif rising and x > value[top]:
            top = k
        elif not rising and x < value[lowest]:
            lowest = k
    return [*found, top] if rising and np.isfinite(value[top]) else found


def _apart(value: Array, one: int, other: int) -> bool:
    """Whether there is a valley between two places of a line."""
    between = value[min(one, other) : max(one, other) + 1]
    return bool(between.min() < min(value[one], value[other]) - VALLEY_ALONG_LINE)


def _aliases(posterior: Posterior, omega: float, low: float, high: float) -> Array:
    """Frequencies from `low` to `high` whose samples are like those of `omega`, the most alike first."""
    patterns: dict[bytes, Array] = {}
    for one in posterior.likelihood.observations:
        for seen in one.experiment.seen.T:
            t = one.experiment.t[seen]
            patterns[t.tobytes()] = t
    found, alike = [np.empty(0)], [np.empty(0)]
    for t in patterns.values():
        delta, height = window_peaks(t, high + omega)
        each = np.abs(np.concatenate([omega - delta, omega + delta]))
        inside = (each > low) & (each < high)
        found.append(each[inside])
        alike.append(np.tile(height, 2)[inside])
    return np.concatenate(found)[np.argsort(-np.concatenate(alike), kind="stable")]


def window_peaks(t: Array, highest: float) -> tuple[Array, Array]:
    """Angular frequencies up to `highest` at which the window of times `t (N,)` peaks, and its height
    there, as a share of that at zero.
    """
    span = float(t[-1] - t[0])
    if len(t) < 2 or not 0 < highest * span < MOST_CELLS / PER_RADIAN:
        return np.empty(0), np.empty(0)
    cells = int(np.ceil(PER_RADIAN * highest * span)) + 1
    counts = np.bincount(np.rint((t - t[0]) / span * (cells - 1)).astype(int), minlength=cells)
    size = scipy.fft.next_fast_len(FINER * cells, real=True)
    height = np.abs(scipy.fft.rfft(counts, size)) / len(t)
    delta = 2.0 * np.pi * np.arange(len(height)) / size * (cells - 1) / span
    inner = (height[1:-1] >= height[:-2]) & (height[1:-1] > height[2:]) & (height[1:-1] > ALIKE)
    top = 1 + np.flatnonzero(inner & (delta[1:-1] <= highest))
    return delta[top], height[top]


def frequencies(posterior: Posterior, u: Array) -> Array:
    """Imaginary parts of the fastest pairs of poles at `u (W, D)`: `(W, PAIRS)`, 0 where none is."""
    model = posterior.likelihood.observations[0].response.model
    theta = posterior.coordinates.to_physical(u)
    full = dict(zip(model.parameters, posterior.likelihood.rig_parameters(theta).T, strict=True))
    matrices = dynamics(model.linear(full), model.states, len(u))
    every = np.linalg.eigvals(np.where(np.isfinite(matrices), matrices, 0.0))
    size = np.abs(every).max(axis=1, keepdims=True)
    swings = np.sort(np.where(every.imag > OSCILLATES * size, every.imag, 0.0), axis=1)
    return np.asarray(swings[:, ::-1][:, :PAIRS])


def _slopes(posterior: Posterior, u: Array, pair: int, steps: Array) -> tuple[Array, Array]:
    """Logs of the frequency of a pair at `u (W, D)`, and their slopes over the priors' spreads."""
    n, d = u.shape
    around = [u[:, None] + side * steps for side in (1.0, -1.0)]
    every = np.concatenate([u, *(at.reshape(-1, d) for at in around)])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(frequencies(posterior, every)[:, pair])
        up, down = logs[n:].reshape(2, n, d)
        slope = (up - down) / (2 * STEP)
    return logs[:n], np.where(np.isfinite(slope), slope, 0.0)


def _reach(surface: PosteriorLogDensity, u: Array) -> tuple[Array, Array]:
    """The slowest and the fastest that each pair may be within the priors: where all unknowns are at
    the ends that slow it down, or speed it up, at `u (D,)`.
    """
    steps, ends = STEP * np.diag(surface.spread), []
    for pair in range(PAIRS):
        slope = _slopes(surface.posterior, u[None], pair, steps)[1][0]
        slow = np.where(slope > 0, surface.low, np.where(slope < 0, surface.high, u))
        fast = np.where(slope > 0, surface.high, np.where(slope < 0, surface.low, u))
        ends.append(frequencies(surface.posterior, np.array([slow, fast]))[:, pair])
    low, high = np.array(ends).T
    return low, high


def _moved(surface: PosteriorLogDensity, u: Array, pair: int, wanted: Array) -> Array:
    """The unknowns nearest to `u (D,)`, in the priors' spreads, at which a pair swings as `wanted (n,)`;
    those that are found, `(m, D)`.
    """
    posterior, steps = surface.posterior, STEP * np.diag(surface.spread)
    span = max(float(np.ptp(one.experiment.t)) for one in posterior.likelihood.observations)
    near = SAME_ALIAS / (span * wanted)
    at = np.repeat(u[None], len(wanted), axis=0)
    for _ in range(ITERATIONS):
        logs, slope = _slopes(posterior, at, pair, steps)
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
