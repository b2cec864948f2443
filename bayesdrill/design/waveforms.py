"""Make the usual waveforms, with which a design is compared and from which searches begin."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.design.source import SourceLimits

SEQUENCES = 8  # number of random sequences, of which the best is used
STAIRS = 5  # number of levels of a staircase
SINES = 6  # number of sines of a multisine


def _scaled(source: SourceLimits, shape: Array) -> Array:
    """Return levels for a `shape (S,)`, where -1 and 1 are the ends of a source's range."""
    half = 0.5 * (source.high - source.low)
    return np.asarray(source.low + half * (1.0 + np.clip(shape, -1.0, 1.0)))


def _phase(source: SourceLimits) -> Array:
    return np.asarray((np.arange(source.count) + 0.5) / source.count)


def step(source: SourceLimits, rng: np.random.Generator) -> Iterator[Array]:
    """Yield a step from zero to the end of the range with the larger absolute value."""
    end = source.high if source.high >= -source.low else source.low
    yield np.full(source.count, end)


def prbs(source: SourceLimits, rng: np.random.Generator) -> Iterator[Array]:
    """Yield pseudo-random binary sequences."""
    for _ in range(SEQUENCES):
        yield _scaled(source, np.where(rng.random(source.count) < 0.5, -1.0, 1.0))


def chirp(source: SourceLimits, rng: np.random.Generator) -> Iterator[Array]:
    """Yield sines whose frequency rises from one period per record, and the reversed sines."""
    x = _phase(source)
    for periods in (source.count / 8, source.count / 4):
        rising = np.cos(2 * np.pi * (x + 0.5 * (periods - 1.0) * x**2))
        yield _scaled(source, rising)
        yield _scaled(source, rising[::-1])


def multisine(source: SourceLimits, rng: np.random.Generator) -> Iterator[Array]:
    """Yield sums of sines with Schroeder's phases (1970), which keep the peaks low."""
    for spread in (1, 2, 3):
        k = np.arange(1, SINES + 1)
        angles = 2 * np.pi * spread * k * _phase(source)[:, None] - np.pi * k * (k - 1) / SINES
        total = np.cos(angles).sum(axis=1)
        yield _scaled(source, total / np.abs(total).max())


def stairs(source: SourceLimits, rng: np.random.Generator) -> Iterator[Array]:
    """Yield a staircase that goes up, and another that goes up and down."""
    x = _phase(source)
    yield _scaled(source, 2.0 * np.floor(STAIRS * x) / (STAIRS - 1) - 1.0)
    folded = 1.0 - np.abs(2.0 * x - 1.0)
    yield _scaled(source, 2.0 * np.minimum(np.floor(STAIRS * folded) / (STAIRS - 1), 1.0) - 1.0)


def coast(source: SourceLimits, rng: np.random.Generator) -> Iterator[Array]:
    """Yield waveforms of three parts: high, nearest to zero, low; and high, low, high."""
    third = np.minimum(np.floor(3 * _phase(source)), 2).astype(int)
    idle = float(np.clip(0.0, source.low, source.high))
    yield np.array([source.high, idle, source.low])[third]
    yield np.array([source.high, source.low, source.high])[third]


Family = Callable[[SourceLimits, np.random.Generator], Iterator[Array]]
FAMILIES: Mapping[str, Family] = MappingProxyType(
    {
        "step": step,
        "prbs": prbs,
        "chirp": chirp,
        "multisine": multisine,
        "steps": stairs,
        "coast": coast,
    }
)
FREE = "free"  # the family of waveforms with any levels
