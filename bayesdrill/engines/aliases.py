"""Where else a record might have come from: starts of searches for other maxima, around a known one.

A swing of frequency omega that is seen at times t leaves nearly the same samples as one of
|omega +- delta|, where delta is a peak of the window |sum exp(i delta t)|: 2 pi over the step of even
samples, and 2 pi over the gap between two stretches (Scargle 1982; VanderPlas 2018).  What returns in
other unknowns, such as a lag under a periodic drive, an angle a turn further or a sign, shows as further
maxima along each of them by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from bayesdrill.engines import maxima
from bayesdrill.engines.climb import climb
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.surface import PosteriorSurface
from bayesdrill.rig.models.linear import dynamics

Array = NDArray[np.float64]

PAIRS = 2  # of poles that are looked at, the fastest
ALIKE = 0.3  # of the window's height: lower peaks are no aliases
MOST_TRIED = 384  # aliases of a pair of poles, the most alike first, of which ...
MOST_ALIASES, CLIMBED = (
    96,
    8,
)  # ... so many are starts: where they are more, what they lead to in so many steps
PER_RADIAN, MOST_CELLS = 3, 2**19  # cells of time for each radian of the fastest swing, at most
FINER = 4  # times that the window is drawn finer than its peaks are wide
ITERATIONS = 12
NEAR = 0.3  # radians over the whole record: what is left is for the search
STEP = 1e-5  # of the priors' spreads
OSCILLATES = 1e-6  # of the largest pole: an imaginary part above it is no rounding
SCANNED, PER_UNKNOWN = 240, 12  # points along each unknown, and starts that come of them
VALLEY = 1.0  # of the log density: what is less deep parts no maxima


@dataclass(frozen=True, slots=True)
class Around:
    """Starts `u (n, D)`, and the share of all aliases within the priors that they leave out."""

    u: Array
    left_out: float


def starts(surface: PosteriorSurface, u: Array) -> Around:
    """From where a search may find other maxima than the one at `u (D,)`."""
    aliased = swings(surface, u)
    return Around(np.concatenate([aliased.u, _returns(surface, u)]), aliased.left_out)


def swings(surface: PosteriorSurface, u: Array) -> Around:
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


def _heaviest(surface: PosteriorSurface, at: Array) -> tuple[Array, float]:
    """The `MOST_ALIASES` near `at (n, D)` that hold most, and their share of what all of them hold."""
    if len(at) <= MOST_ALIASES:
        return at, 1.0
    u = climb(surface, at, CLIMBED).u
    held = maxima.held(surface.posterior, u)
    most = np.argsort(-held, kind="stable")[:MOST_ALIASES]
    return u[most], float(held[most].sum())


def _returns(surface: PosteriorSurface, u: Array) -> Array:
    """Maxima along each unknown by itself, but for that of `u (D,)`: `(n, D)`."""
    found = []
    for d in range(len(u)):
        line = np.repeat(u[None], SCANNED + 1, axis=0)
        along = np.linspace(surface.low[d], surface.high[d], SCANNED)
        line[:, d] = np.sort(np.append(along, u[d]))
        value = surface.value(line)
        own = int(np.searchsorted(line[:, d], u[d]))
        tops = [k for k in peaks(value, VALLEY) if _apart(value, k, own)]
        tops = sorted(tops, key=lambda k: -value[k])
        found.append(line[tops[:PER_UNKNOWN]])
    return np.concatenate(found)


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
    return bool(between.min() < min(value[one], value[other]) - VALLEY)


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
    size = fft.next_fast_len(FINER * cells, real=True)
    height = np.abs(fft.rfft(counts, size)) / len(t)
    delta = 2.0 * np.pi * np.arange(len(height)) / size * (cells - 1) / span
    inner = (height[1:-1] >= height[:-2]) & (height[1:-1] > height[2:]) & (height[1:-1] > ALIKE)
    top = 1 + np.flatnonzero(inner & (delta[1:-1] <= highest))
    return delta[top], height[top]


def frequencies(posterior: Posterior, u: Array) -> Array:
    """Imaginary parts of the fastest pairs of poles at `u (W, D)`: `(W, PAIRS)`, 0 where none is."""
    model = posterior.likelihood.observations[0].response.model
    theta = posterior.coordinates.to_physical(u)
    full = dict(zip(model.parameters, posterior.likelihood.rig(theta).T, strict=True))
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


def _reach(surface: PosteriorSurface, u: Array) -> tuple[Array, Array]:
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


def _moved(surface: PosteriorSurface, u: Array, pair: int, wanted: Array) -> Array:
    """The unknowns nearest to `u (D,)`, in the priors' spreads, at which a pair swings as `wanted (n,)`;
    those that are found, `(m, D)`.
    """
    posterior, steps = surface.posterior, STEP * np.diag(surface.spread)
    span = max(float(np.ptp(one.experiment.t)) for one in posterior.likelihood.observations)
    near = NEAR / (span * wanted)
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
