"""Angles that begin again after a turn, and speeds that are differences of an angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CLEAR = 0.1  # of a period: so near half of it a jump may be one way or the other
SHARED = 0.02  # of what a speed's own past leaves, at most, and its noise is that of the angle
FEWEST = 50  # samples
AROUND = 3  # samples on either side that a filter may use
SLOWEST = 0.95  # of the last value that a filter keeps; with all of it, sums are no differences


def ambiguous(x: Array, period: float) -> NDArray[np.intp]:
    """Samples before which the jump is of nearly half a period, so that its way cannot be told."""
    jumps = np.abs(np.diff(x)) / period
    return np.flatnonzero(np.abs(jumps - np.round(jumps)) > 0.5 - CLEAR) + 1


def unwrapped(x: Array, period: float) -> tuple[Array, int]:
    """`x (T,)` with every jump of more than half a period taken back, and how many there were."""
    turns = np.round(np.diff(x) / period)
    return x - period * np.concatenate([[0.0], np.cumsum(turns)]), int(np.sum(turns != 0))


def held_speeds(x: Array, t: Array) -> Array:
    """`(T,)`: an angle `x (T,)` that is straight between its samples turns at these speeds after each.

    Of the last one nothing is known: it is that of the one before.
    """
    speeds = np.diff(x) / np.diff(t)
    return np.append(speeds, speeds[-1:] if len(speeds) else 0.0)


def turned(w: Array, t: Array, begin: float) -> Array:
    """The angle `(T,)` again, of speeds `w (T,)` that are held after each sample."""
    return np.concatenate([[begin], begin + np.cumsum(w[:-1] * np.diff(t))])


def quotients(x: Array, t: Array) -> dict[str, Array]:
    """Difference quotients of `x (T,)`, `(T - 2,)`, at all samples but the first and the last."""
    slopes = np.diff(x) / np.diff(t)
    central = (x[2:] - x[:-2]) / (t[2:] - t[:-2])
    return {"backward": slopes[:-1], "forward": slopes[1:], "central": central}


def nearest_quotient(x: Array, w: Array, t: Array) -> tuple[str, float]:
    """Which difference quotient of `x` `w (T,)` is like, and its rms distance over the rms of `w`."""
    middle = w[1:-1]
    size = float(np.sqrt(np.mean(middle**2))) or 1.0
    off = {
        kind: float(np.sqrt(np.mean((middle - one) ** 2))) / size
        for kind, one in quotients(x, t).items()
    }
    kind = min(off, key=lambda name: off[name])
    return kind, off[kind]


def differenced(x: Array, w: Array, dt: float) -> bool:
    """Whether `w (T,)` is no measurement of its own, but differences of `x`, perhaps filtered.

    What the past of `w` does not foretell is its own noise, unless the newest steps of `x` foretell it.
    """
    if len(x) < FEWEST or not np.any(np.diff(w)):
        return False
    step, n = np.diff(x, prepend=x[0]) / dt, len(w)

    def lagged(y: Array, lags: range) -> list[Array]:
        return [y[AROUND - k : n - AROUND - k] for k in lags]

    (now,) = lagged(w, range(1))
    alone, _ = _left(now, lagged(w, range(1, AROUND + 1)))
    both, factors = _left(now, [*lagged(w, range(1, 2)), *lagged(step, range(-AROUND, AROUND + 1))])
    rough = alone > 1e-9 * float(np.ptp(w))  # less is rounding
    return rough and both < SHARED * alone and float(factors[0]) < SLOWEST


def _left(y: Array, causes: list[Array]) -> tuple[float, Array]:
    """Standard deviation of what no sum of the causes and a constant explains, and their factors."""
    design = np.stack([*causes, np.ones(len(y))], axis=-1)
    factors = np.linalg.lstsq(design, y, rcond=None)[0]
    return float(np.std(y - design @ factors)), factors
