"""Which quantities are unknown and which are held: vectors to names and back, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesdrill.priors import Prior, Uniform, draw

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ParameterSpace:
    """The D unknowns in their order: the model's free parameters, then unknown noise levels.

    `model` lists all P parameters of the model; `fixed` holds the values of those not in
    `priors`.  `theta` is `(W, D)`, physical, SI.
    """

    model: tuple[str, ...]
    priors: Mapping[str, Prior]
    fixed: Mapping[str, float]
    start: Mapping[str, float]

    @property
    def free(self) -> tuple[str, ...]:
        return tuple(self.priors)

    def full(self, theta: Array) -> Array:
        """`(W, P)` parameters of the model, in its order."""
        out = np.empty((len(theta), len(self.model)))
        for column, name in enumerate(self.model):
            out[:, column] = (
                self.fixed[name] if name in self.fixed else theta[:, self.free.index(name)]
            )
        return out

    def slopes(self, theta: Array) -> Array:
        """d parameter of the model / d log unknown at `theta (D,)`, noise left out: `(m, P)`."""
        named = [name for name in self.free if name in self.model]
        out = np.zeros((len(named), len(self.model)))
        for row, name in enumerate(named):
            out[row, self.model.index(name)] = theta[row]
        return out

    def vector(self, values: Mapping[str, float]) -> Array:
        """`(D,)` from named values."""
        return np.array([values[name] for name in self.free])

    def log_prior(self, theta: Array) -> Array:
        """`(W,)`; -inf outside the support, NaN included."""
        columns, low, high, log_density = self.box
        boxed = theta[:, columns]
        with np.errstate(invalid="ignore"):
            inside = ((boxed >= low) & (boxed <= high) & (boxed > 0)).all(axis=1)
        total = np.where(inside, log_density, -np.inf)
        for column, prior in enumerate(self.priors.values()):
            if not isinstance(prior, Uniform):
                total += prior.logpdf(theta[:, column])
        return total

    @cached_property
    def box(self) -> tuple[list[int], Array, Array, float]:
        """All uniform priors at once: columns, lower and upper ends, log density inside."""
        boxes = {c: p for c, p in enumerate(self.priors.values()) if isinstance(p, Uniform)}
        low = np.array([p.low for p in boxes.values()])
        high = np.array([p.high for p in boxes.values()])
        return list(boxes), low, high, -float(np.log(high - low).sum())

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """`(n, D)` draws from the prior."""
        return np.stack([draw(prior, n, rng) for prior in self.priors.values()], axis=-1)
