"""Which quantities are unknown and which are held: vectors to names and back, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.duals import Dual
from bayesdrill.basics.formulas import Expression
from bayesdrill.inference.priors import Prior, Uniform, draw

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ParameterSpace:
    """The D unknowns: the model's free parameters, quantities, unknown noise levels, in this order.

    `model` lists all P parameters of the model: those not in `priors` have their values in `fixed`,
    or follow from others by `relations`, in names of `priors` and `fixed`.  `quantities` are the
    names in `priors` and `fixed` that are no parameters.  `theta` is `(W, D)`, physical, SI.
    """

    model: tuple[str, ...]
    priors: Mapping[str, Prior]
    fixed: Mapping[str, float]
    start: Mapping[str, float]
    relations: Mapping[str, Expression] = field(default_factory=dict)
    quantities: tuple[str, ...] = ()

    @property
    def free(self) -> tuple[str, ...]:
        return tuple(self.priors)

    def full(self, theta: Array) -> Array:
        """`(W, P)` parameters of the model, in its order."""
        named = self.named(theta)
        out = np.empty((len(theta), len(self.model)))
        for column, name in enumerate(self.model):
            out[:, column] = named[name]
        return out

    def named(self, theta: Array) -> dict[str, Array | float]:
        """All parameters of the model and all quantities, each `(W,)` or a number."""
        named: dict[str, Array | float] = dict(self.fixed)
        for name in self.free:
            named[name] = theta[:, self.free.index(name)]
        return named | {name: r.value(named) for name, r in self.relations.items()}

    def slopes(self, theta: Array) -> Array:
        """d parameter of the model / d log unknown at `theta (W, D)`, noise left out: `(W, m, P)`."""
        charted = [name for name in self.free if name in self.model or name in self.quantities]
        duals: dict[str, Dual | float] = dict(self.fixed)
        for row, name in enumerate(charted):
            column_ = theta[:, row, None]
            duals[name] = Dual(column_, column_ * np.eye(len(charted))[row])
        duals |= {name: r.value(duals) for name, r in self.relations.items()}
        out = np.zeros((len(theta), len(charted), len(self.model)))
        for column, name in enumerate(self.model):
            value = duals[name]
            if isinstance(value, Dual):
                out[:, :, column] = value.slope
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
        if self.bounding:
            named = self.named(theta)
            for name in self.bounding:  # what no positive number comes out of is impossible
                total[~(np.asarray(named[name]) > 0)] = -np.inf
        return total

    @cached_property
    def bounding(self) -> tuple[str, ...]:
        """Parameters whose relation may give something else than a positive number."""
        return tuple(name for name, r in self.relations.items() if r.monomial() is None)

    @cached_property
    def box(self) -> tuple[list[int], Array, Array, float]:
        """All uniform priors at once: columns, lower and upper ends, log density inside."""
        boxes = {c: p for c, p in enumerate(self.priors.values()) if isinstance(p, Uniform)}
        low = np.array([p.low for p in boxes.values()])
        high = np.array([p.high for p in boxes.values()])
        return list(boxes), low, high, -float(np.log(high - low).sum())

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """`(n, D)` draws from the prior, those that `bounding` relations exclude included."""
        return np.stack([draw(prior, n, rng) for prior in self.priors.values()], axis=-1)
