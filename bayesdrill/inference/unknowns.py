"""Which quantities are unknown and which are fixed, and the coordinates of the sampler.

Rigs are made of products and ratios, so that logs are the natural scale.  They are none for an
unknown whose prior reaches down to zero: all of its lower end would lie in an endless tail.  What
lies between two ends, such as a correlation, goes by its probit between them, over which a uniform
prior is a bell: what is pressed against an end has no longer tail there.  (Over a logit it falls
off like an exponential, and no proposal made of bells gets there.)  What may be negative, such as
an offset, goes by itself.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual
from bayesdrill.basics.formulas import Expression
from bayesdrill.basics.symbols import Symbol, superscript
from bayesdrill.inference.priors import Prior, prior_sd

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)
TINIEST = float(np.nextafter(0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Coordinates:
    """The sampler's coordinates `z (W, D)` of physical unknowns `theta (W, D)`.

    `logs`: for each of the D unknowns, whether its log is its coordinate; `between`: columns whose
    probit between `low` and `high` is, as `(column, low, high)`.  `signed`: columns that need not
    be positive, these among them, each with the step that is one on its natural scale.
    """

    logs: tuple[bool, ...]
    between: tuple[tuple[int, float, float], ...] = ()
    signed: tuple[tuple[int, float], ...] = ()

    def from_physical(self, theta: Array) -> Array:
        """Return the coordinates `(W, D)` of `theta`."""
        z = theta.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            z[:, self.logs] = np.log(theta[:, self.logs])
        for column, low, high in self.between:
            z[:, column] = scipy.special.ndtri((theta[:, column] - low) / (high - low))
        return z

    def to_physical(self, z: Array) -> Array:
        """Return the unknowns `(W, D)` at `z`."""
        theta = z.copy()
        with np.errstate(over="ignore"):
            theta[:, self.logs] = np.exp(z[:, self.logs])
        for column, low, high in self.between:
            theta[:, column] = low + (high - low) * scipy.special.ndtr(z[:, column])
        return theta

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Return the unknowns at `z`, and log |d theta / d z| `(W,)`."""
        jacobian = np.ascontiguousarray(z[:, self.logs]).sum(axis=-1)
        for column, low, high in self.between:
            jacobian += np.log(high - low) - LOG_ROOT_2PI - 0.5 * z[:, column] ** 2
        return self.to_physical(z), jacobian

    def slopes(self, theta: Array) -> Array:
        """Return d unknown / d its coordinate, `(W, D)`."""
        out = np.where(self.logs, theta, 1.0)
        for column, low, high in self.between:
            probit = scipy.special.ndtri((theta[:, column] - low) / (high - low))
            out[:, column] = (high - low) * np.exp(-0.5 * probit**2 - LOG_ROOT_2PI)
        return out

    def jacobian_derivatives(self, z: Array) -> tuple[Array, Array]:
        """Return first and minus second derivatives of the log Jacobian, `(W, D)` each."""
        slope = np.tile(np.array(self.logs, dtype=np.float64), (len(z), 1))
        curvature = np.zeros_like(slope)
        for column, *_ in self.between:
            slope[:, column], curvature[:, column] = -z[:, column], 1.0
        return slope, curvature

    def natural(self, theta: Array) -> Array:
        """Return d unknown / d its natural scale `(W, D)`, which is its log or itself over its step."""
        out = theta.copy()
        for column, step in self.signed:
            out[:, column] = step
        return out

    def slopes_by_natural(self, theta: Array) -> Array:
        """Return d coordinate / d the natural scale of its unknown, `(W, D)`."""
        return self.natural(theta) / self.slopes(theta)


@dataclass(frozen=True, slots=True, kw_only=True)
class Directions:
    """Directions along which slopes are wanted, at unknowns `theta (W, D)`.

    `full (W, P)`: their parameters; `columns (D, q)`: directions of coordinates, and
    `parameter_directions (W, q, P)` of parameters, None where none moves.  `slopes (W, D)`: d
    unknown / d coordinate; `by_log`: of its log, or of itself where it need not be positive.
    """

    theta: Array
    full: Array
    columns: Array
    parameter_directions: Array | None
    slopes: Array
    by_log: Array


def directional_slope(slope: Array, directions: Array) -> Array:
    """Return `slope (W, D)` along `directions (D, q)`: `(W, q)`.

    Point by point: one product of all of them rounds as their number has it.
    """
    return np.asarray((slope[:, None, :] @ directions)[:, 0])


def directional_curvature(directions: Array, curvature: Array) -> Array:
    """Return the diagonal `curvature (W, D)` along `directions (D, q)`: `(W, q, q)`."""
    return np.asarray((curvature[:, None, :] * directions.T) @ directions)


Role = Literal["rig", "quantity", "sensor", "start", "noise"]
# What a simulator is told.
SIMULATOR_ROLES: tuple[Role, ...] = ("rig", "quantity", "sensor", "start")
Transform = Literal["log", "plain"] | tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """An unknown as the part that has it declares it, SI; `start`: where a search begins.

    `transform` gives the coordinate in which samplers walk: its log, itself, or the probit between
    two ends, where it need not be positive; None: log or itself, as the prior has it.  What the
    prior allows below zero goes by itself.
    """

    symbol: Symbol
    role: Role
    prior: Prior
    start: float
    transform: Transform | None = None

    @property
    def name(self) -> str:
        """Return its name."""
        return self.symbol.name

    def for_experiment(self, label: str) -> Unknown:
        """Return a copy of this unknown that belongs to the experiment `label`."""
        return dataclasses.replace(self, symbol=labelled_symbol(self.symbol, label))

    @property
    def between(self) -> tuple[float, float] | None:
        """Return the ends of its probit, if it has one."""
        return self.transform if isinstance(self.transform, tuple) else None

    @property
    def signed(self) -> bool:
        """Whether its log is no scale of it: it need not be positive, or may be next to nothing."""
        small = self.role in ("sensor", "start") and not self.in_logs
        return self.between is not None or self.prior.low < 0 or small

    @property
    def scale(self) -> float:
        """Return the step that counts as one, of what need not be positive."""
        return 1.0 if self.between is not None else prior_sd(self.prior)

    @property
    def in_logs(self) -> bool:
        """Whether its coordinate is its log."""
        return self.prior.in_logs if self.transform is None else self.transform == "log"


def labelled_name(name: str, label: str) -> str:
    """Return the name in one of several experiments; `label` is empty where there is only one."""
    return f"{name}_{label}" if label else name


def labelled_symbol(symbol: Symbol, label: str) -> Symbol:
    """Return the symbol in one of several experiments."""
    if not label:
        return symbol
    shown = label.replace("_", r"\_")
    return dataclasses.replace(
        symbol,
        name=labelled_name(symbol.name, label),
        latex=superscript(symbol.latex, rf"\mathrm{{{shown}}}"),
        meaning=f"{symbol.meaning}, of the experiment {label}",
    )


@dataclass(frozen=True, kw_only=True)
class ParameterSpace:
    """The D `unknowns`: free parameters of the rig, quantities, sensors and starts, then the noise's.

    `model` lists all P parameters of rig, sensors and starts: those that are not unknown have their
    values in `fixed`, or follow from others by `relations`, in names of unknowns and `fixed`.  `theta`
    is `(W, D)`, physical, SI.
    """

    model: tuple[str, ...]
    unknowns: tuple[Unknown, ...]
    fixed: Mapping[str, float]
    relations: Mapping[str, Expression] = field(default_factory=dict)

    @cached_property
    def free(self) -> tuple[str, ...]:
        """Return the names of the unknowns."""
        return tuple(unknown.name for unknown in self.unknowns)

    @cached_property
    def priors(self) -> Mapping[str, Prior]:
        """Return the priors by name."""
        return {unknown.name: unknown.prior for unknown in self.unknowns}

    @cached_property
    def start(self) -> Mapping[str, float]:
        """Return where a search begins, by name."""
        return {unknown.name: unknown.start for unknown in self.unknowns}

    def columns(self, *roles: Role) -> list[int]:
        """Return the columns of the unknowns that play one of these roles."""
        return [k for k, unknown in enumerate(self.unknowns) if unknown.role in roles]

    @cached_property
    def coordinates(self) -> Coordinates:
        """Return the coordinates in which samplers walk."""
        return Coordinates(
            tuple(unknown.in_logs for unknown in self.unknowns),
            tuple((k, *u.between) for k, u in enumerate(self.unknowns) if u.between is not None),
            tuple((k, u.scale) for k, u in enumerate(self.unknowns) if u.signed),
        )

    def full(self, theta: Array) -> Array:
        """Return the parameters of the model `(W, P)`, in its order."""
        named = self.named(theta)
        out = np.empty((len(theta), len(self.model)))
        for column, name in enumerate(self.model):
            out[:, column] = named[name]
        return out

    def named(self, theta: Array) -> dict[str, Array | float]:
        """Return all parameters of the model and all quantities, each `(W,)` or a number."""
        named: dict[str, Array | float] = dict(self.fixed)
        named |= zip(self.free, theta.T, strict=False)
        return named | {name: r.value(named) for name, r in self.relations.items()}

    def slopes(self, theta: Array) -> Array:
        """Return d parameter of the model / d log unknown at `theta (W, D)`: `(W, m, P)`.

        Noise is left out.  What need not be positive counts by itself over its `scale`.
        """
        columns, steps = self.columns(*SIMULATOR_ROLES), self.coordinates.natural(theta)
        duals: dict[str, Dual | float] = dict(self.fixed)
        for column, unit in zip(columns, np.eye(len(columns)), strict=True):
            name, x = self.free[column], theta[:, column, None]
            duals[name] = Dual(x, steps[:, column, None] * unit)
        duals |= {name: r.value(duals) for name, r in self.relations.items()}
        out = np.zeros((len(theta), len(columns), len(self.model)))
        for column, name in enumerate(self.model):
            value = duals[name]
            if isinstance(value, Dual):
                out[:, :, column] = value.slope
        return out

    def vector(self, values: Mapping[str, float]) -> Array:
        """Return `(D,)` from named values."""
        return np.array([values[name] for name in self.free])

    def log_prior(self, theta: Array) -> Array:
        """Return the log prior `(W,)`; -inf outside the support, NaN included."""
        columns, low, high, log_density = self.box
        boxed = theta[:, columns]
        with np.errstate(all="ignore"):
            inside = ((boxed >= low) & (boxed <= high)).all(axis=1)
            total = np.where(inside, log_density, -np.inf)
            for column, unknown in enumerate(self.unknowns):
                if not unknown.prior.flat:
                    total += unknown.prior.log_density(theta[:, column])
        if self.bounding:
            named = self.named(theta)
            for name in self.bounding:  # what no positive number comes out of is impossible
                total[~(np.asarray(named[name]) > 0)] = -np.inf
        return total

    @cached_property
    def bounding(self) -> tuple[str, ...]:
        """Return parameters whose relation may give something else than a positive number."""
        return tuple(name for name, r in self.relations.items() if not r.positive)

    @cached_property
    def box(self) -> tuple[list[int], Array, Array, float]:
        """Return all uniform priors at once: columns, least and greatest values, log density inside."""
        boxes = {c: u for c, u in enumerate(self.unknowns) if u.prior.flat}
        low = np.array([u.prior.low for u in boxes.values()])
        high = np.array([u.prior.high for u in boxes.values()])
        # Zero itself is none where a coordinate is a log.
        least = np.where([u.signed for u in boxes.values()], low, np.maximum(low, TINIEST))
        return list(boxes), least, high, -float(np.log(high - low).sum())

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Draw `(n, D)` from the prior, also what `bounding` relations exclude."""
        return np.stack([p.quantile(rng.random(n)) for p in self.priors.values()], axis=-1)
