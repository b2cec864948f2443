"""Several runs side by side: what each says of every unknown, and how far apart they are."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.problem import Problem
from bayesdrill.insight.diagnostics import hdi

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """One run under its `name`: `draws (N, D)`, SI; `settings`: what a reader compares of two runs.

    `mark`: by which files say whose they are; `warning`: what its figures carry, `reasons`: why it must
    not be believed; empty where it may be.
    """

    name: str
    mark: str
    problem: Problem
    draws: Array
    settings: Mapping[str, str]
    warning: str = ""
    reasons: tuple[str, ...] = ()

    def of(self, symbol: Symbol) -> Array | None:
        """Draws `(N,)` of an unknown; None where it is none of this run."""
        if symbol not in self.problem.symbols:
            return None
        return self.draws[:, self.problem.symbols.index(symbol)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a run has a quantity, SI: mean, sd and the narrowest interval; all one where it is held."""

    mean: float
    sd: float
    low: float
    high: float

    @property
    def held(self) -> bool:
        return self.sd == 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """An unknown of some run; `places`, `nominal`: of each run, None where it has none.

    `apart`: the largest difference of two means over the root mean square of their sds, and `pair`
    the two runs; None where fewer than two have it as an unknown.
    """

    symbol: Symbol
    places: tuple[Place | None, ...]
    nominal: tuple[float | None, ...]
    apart: float | None
    pair: tuple[int, int] | None

    @property
    def agreed(self) -> float | None:
        """The nominal value, where all runs that have one have the same."""
        known = {value for value in self.nominal if value is not None}
        return known.pop() if len(known) == 1 else None

    @property
    def shared(self) -> bool:
        """Whether two runs have it as an unknown."""
        return self.pair is not None


def rows(layers: Sequence[Layer]) -> tuple[Row, ...]:
    """In the order of the runs and of their unknowns."""
    symbols = dict.fromkeys(s for layer in layers for s in layer.problem.symbols)
    return tuple(_row(symbol, layers) for symbol in symbols)


def _row(symbol: Symbol, layers: Sequence[Layer]) -> Row:
    places = tuple(_place(symbol, layer) for layer in layers)
    apart, pair = max(_distances(places), default=(None, None))
    return Row(
        symbol=symbol,
        places=places,
        nominal=tuple(layer.problem.nominal.get(symbol.name) for layer in layers),
        apart=apart,
        pair=pair,
    )


def _place(symbol: Symbol, layer: Layer) -> Place | None:
    x, held = layer.of(symbol), layer.problem.posterior.space.fixed.get(symbol.name)
    if x is not None:
        low, high = hdi(x)
        return Place(mean=float(x.mean()), sd=float(x.std(ddof=1)), low=low, high=high)
    return None if held is None else Place(mean=held, sd=0.0, low=held, high=held)


def _distances(places: Sequence[Place | None]) -> Iterator[tuple[float, tuple[int, int]]]:
    """Of all pairs that have an sd, in sds."""
    free = [(k, place) for k, place in enumerate(places) if place is not None and place.sd > 0]
    for (k, one), (j, other) in itertools.combinations(free, 2):
        sd = math.sqrt(0.5 * (one.sd**2 + other.sd**2))
        yield abs(one.mean - other.mean) / sd, (k, j)


def differing(layers: Sequence[Layer]) -> dict[str, tuple[str | None, ...]]:
    """What is not the same in all runs, and what it is in each; None where a run has no such thing."""
    names = dict.fromkeys(name for layer in layers for name in layer.settings)
    found = {name: tuple(layer.settings.get(name) for layer in layers) for name in names}
    return {name: values for name, values in found.items() if len(set(values)) > 1}
