"""Declare which quantities are unknown or fixed, and define the coordinates of the sampler.

Equations of rigs contain products and ratios, so the logarithm is the natural coordinate.  The
logarithm does not suit an unknown whose prior reaches down to zero, since the log's density has an
endless tail there.  A number between two ends, such as a correlation, has its probit as coordinate.  A
uniform prior is a Gaussian over the probit, which a Gaussian proposal covers; over the logit it has
exponential tails. A number that may be negative, such as an offset, is its own coordinate.
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
from bayesdrill.basics.duals import Dual, dual
from bayesdrill.basics.formulas import Expression
from bayesdrill.basics.symbols import Symbol, superscript
from bayesdrill.inference.priors import Prior, prior_sd

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)
TINIEST = float(np.nextafter(0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Convert between physical unknowns `theta (W, D)` and the sampler's coordinates `z (W, D)`.

    `logs` says for each of the D unknowns whether its coordinate is its log.  `bounded` lists
    `(column, low, high)` of unknowns whose coordinate is the probit between two ends.  `signed`
    lists `(column, step)` of unknowns that need not be positive; `step` is the natural unit.
    """

    logs: tuple[bool, ...]
    bounded: tuple[tuple[int, float, float], ...] = ()
    signed: tuple[tuple[int, float], ...] = ()

    def from_physical(self, theta: Array) -> Array:
        """Return the coordinates `(W, D)` of `theta`."""
        z = theta.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            z[:, self.logs] = np.log(theta[:, self.logs])
        for column, low, high in self.bounded:
            z[:, column] = scipy.special.ndtri((theta[:, column] - low) / (high - low))
        return z

    def to_physical(self, z: Array) -> Array:
        """Return the unknowns `(W, D)` at `z`."""
        theta = z.copy()
        with np.errstate(over="ignore"):
            theta[:, self.logs] = np.exp(z[:, self.logs])
        for column, low, high in self.bounded:
            theta[:, column] = low + (high - low) * scipy.special.ndtr(z[:, column])
        return theta

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        """Return the unknowns at `z`, and log |d theta / d z| `(W,)`."""
        jacobian = np.ascontiguousarray(z[:, self.logs]).sum(axis=-1)
        for column, low, high in self.bounded:
            jacobian += np.log(high - low) - LOG_ROOT_2PI - 0.5 * z[:, column] ** 2
        return self.to_physical(z), jacobian

    def slopes(self, theta: Array) -> Array:
        """Return d unknown / d its coordinate, `(W, D)`."""
        out = np.where(self.logs, theta, 1.0)
        for column, low, high in self.bounded:
            probit = scipy.special.ndtri((theta[:, column] - low) / (high - low))
            out[:, column] = (high - low) * np.exp(-0.5 * probit**2 - LOG_ROOT_2PI)
        return out

    def jacobian_derivatives(self, z: Array) -> tuple[Array, Array]:
        """Return first and minus second derivatives of the log Jacobian, `(W, D)` each."""
        slope = np.tile(np.array(self.logs, dtype=np.float64), (len(z), 1))
        curvature = np.zeros_like(slope)
        for column, *_ in self.bounded:
            slope[:, column], curvature[:, column] = -z[:, column], 1.0
        return slope, curvature

    def natural(self, theta: Array) -> Array:
        """Return d unknown / d natural scale (the log, or unknown / step), `(W, D)`."""
        out = theta.copy()
        for column, step in self.signed:
            out[:, column] = step
        return out

    def slopes_by_natural(self, theta: Array) -> Array:
        """Return d coordinate / d natural scale of its unknown, `(W, D)`."""
        return self.natural(theta) / self.slopes(theta)


@dataclass(frozen=True, slots=True, kw_only=True)
class Directions:
    """Slopes are taken along q directions at unknowns `theta (W, D)`.

    `full (W, P)` are parameters at `theta`.  `columns (D, q)` are directions of coordinates, and
    `parameter_directions (W, q, P)` those of parameters, or None if no parameter moves.  `slopes
    (W, D)` is d unknown / d coordinate, and `by_log (W, D)` is d natural scale of the unknown / d
    coordinate.
    """

    theta: Array
    full: Array
    columns: Array
    parameter_directions: Array | None
    slopes: Array
    by_log: Array


def directional_slope(slope: Array, directions: Array) -> Array:
    """Return `slope (W, D)` along `directions (D, q)`: `(W, q)`.

    Each point is multiplied separately, since rounding in a joint product depends on the number of
    points.
    """
    return np.asarray((slope[:, None, :] @ directions)[:, 0])


def directional_curvature(directions: Array, curvature: Array) -> Array:
    """Return the diagonal `curvature (W, D)` along `directions (D, q)`: `(W, q, q)`."""
    return np.asarray((curvature[:, None, :] * directions.T) @ directions)


# An offset is a parameter of the rig that may be negative, such as the tilt of an arm.
Role = Literal["rig", "quantity", "offset", "sensor", "start", "noise"]
RIG_ROLES: tuple[Role, ...] = ("rig", "quantity")  # such unknowns are positive, and come first
# Unknowns with these roles are parameters of a simulator.
SIMULATOR_ROLES: tuple[Role, ...] = ("rig", "quantity", "offset", "sensor", "start")
Transform = Literal["log", "plain"] | tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """An unknown is declared by the part that it belongs to; a search begins at `start`, in SI.

    `transform` gives the coordinate of the sampler: "log", "plain", or the ends of a probit.  None
    chooses the log if the prior allows it, or else the unknown itself.
    """

    symbol: Symbol
    role: Role
    prior: Prior
    start: float
    transform: Transform | None = None

    @property
    def name(self) -> str:
        """Return the name of its symbol."""
        return self.symbol.name

    def for_experiment(self, label: str) -> Unknown:
        """Return a copy of this unknown that belongs to the experiment `label`."""
        return dataclasses.replace(self, symbol=labelled_symbol(self.symbol, label))

    @property
    def between(self) -> tuple[float, float] | None:
        """Return the ends of the probit, or None if another coordinate is used."""
        return self.transform if isinstance(self.transform, tuple) else None

    @property
    def signed(self) -> bool:
        """Return whether the unknown may be zero or negative, so that it has no logarithm."""
        small = self.role in ("offset", "sensor", "start") and not self.in_logs
        return self.between is not None or self.prior.low < 0 or small

    @property
    def scale(self) -> float:
        """Return the unit of the natural scale for an unknown that may be negative."""
        return 1.0 if self.between is not None else prior_sd(self.prior)

    @property
    def in_logs(self) -> bool:
        """Return whether the coordinate is the logarithm."""
        return self.prior.in_logs if self.transform is None else self.transform == "log"


def labelled_name(name: str, label: str) -> str:
    """Return the name in the experiment `label`, which is empty if there is only one."""
    return f"{name}_{label}" if label else name


def labelled_symbol(symbol: Symbol, label: str) -> Symbol:
    """Return the symbol in the experiment `label`, which is empty if there is only one."""
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
    """A parameter space has D `unknowns`, and P parameters of the `model` that follow from them.

    Unknowns of the noise come last.  `model` names the parameters of rig, sensors and starts.  Each
    is unknown, `fixed`, or follows from others by `relations`; only `signed` ones may be negative.
    `theta (W, D)` is always physical, SI.
    """

    model: tuple[str, ...]
    unknowns: tuple[Unknown, ...]
    fixed: Mapping[str, float]
    relations: Mapping[str, Expression] = field(default_factory=dict)
    signed: frozenset[str] = frozenset()

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
        """Return the start values of a search by name."""
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
        """Return d model parameter / d natural scale of unknowns at `theta (W, D)`: `(W, m, P)`.

        The m unknowns are those of the simulator.
        """
        duals = self.named_slopes(theta)
        out = np.zeros((len(theta), len(self.columns(*SIMULATOR_ROLES)), len(self.model)))
        for column, name in enumerate(self.model):
            out[:, :, column] = dual(duals[name]).slope
        return out

    def named_slopes(self, theta: Array) -> dict[str, Dual | float]:
        """Return `named` with slopes `(W, m)` by the unknowns of the simulator; see `slopes`."""
        columns, steps = self.columns(*SIMULATOR_ROLES), self.coordinates.natural(theta)
        duals: dict[str, Dual | float] = dict(self.fixed)
        for column, unit in zip(columns, np.eye(len(columns)), strict=True):
            name, x = self.free[column], theta[:, column, None]
            duals[name] = Dual(x, steps[:, column, None] * unit)
        return duals | {name: r.value(duals) for name, r in self.relations.items()}

    def vector(self, values: Mapping[str, float]) -> Array:
        """Return `(D,)` from named values."""
        return np.array([values[name] for name in self.free])

    def log_prior(self, theta: Array) -> Array:
        """Return the log prior `(W,)`, -inf outside the support and at NaN."""
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
            for name in self.bounding:  # a parameter that is not positive is impossible
                total[~(np.asarray(named[name]) > 0)] = -np.inf
        return total

    @cached_property
    def bounding(self) -> tuple[str, ...]:
        """Return positive parameters whose relation may give a number that is not positive."""
        negative = {unknown.name for unknown in self.unknowns if unknown.prior.low < 0}
        negative |= {name for name, value in self.fixed.items() if value <= 0}
        return tuple(
            name
            for name, r in self.relations.items()
            if name not in self.signed and not (r.positive and negative.isdisjoint(r.names))
        )

    @cached_property
    def box(self) -> tuple[list[int], Array, Array, float]:
        """Return the columns, ends and joint log density of all uniform priors."""
        boxes = {c: u for c, u in enumerate(self.unknowns) if u.prior.flat}
        low = np.array([u.prior.low for u in boxes.values()])
        high = np.array([u.prior.high for u in boxes.values()])
        # Zero is excluded if the coordinate is a log.
        least = np.where([u.signed for u in boxes.values()], low, np.maximum(low, TINIEST))
        return list(boxes), least, high, -float(np.log(high - low).sum())

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Draw `(n, D)` from the priors, without regard to `bounding` relations."""
        return np.stack([p.quantile(rng.random(n)) for p in self.priors.values()], axis=-1)
