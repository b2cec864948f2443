"""Prior families: normalised one-dimensional densities, SI.

Every parameter of a rig is positive, so a family that reaches below zero is cut there and
renormalised; of a sensor or a start, which may be negative, it has an end `low` below zero, or none.
`logpdf` is -inf outside the support and never NaN.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr, ndtri

Array = NDArray[np.float64]

_LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


class Prior(Protocol):
    """`low`, `high`: the ends of the support; `quantile` is the inverse of the distribution."""

    @property
    def flat(self) -> bool:
        """Whether its density is the same everywhere between its ends."""
        ...

    @property
    def flat_in_logs(self) -> bool:
        """Whether it says of the log what a uniform prior says of a quantity itself."""
        ...

    @property
    def vanishes_at_ends(self) -> bool:
        """Whether its density does, so that they are no bounds, only improbable."""
        ...

    @property
    def low(self) -> float: ...

    @property
    def high(self) -> float: ...

    @property
    def in_logs(self) -> bool:
        """Whether its log is the scale of the unknown: not where zero itself has a density."""
        ...

    def logpdf(self, x: Array) -> Array: ...

    def quantile(self, u: Array) -> Array: ...

    def extended(self, low: float, high: float) -> Prior:
        """The same density with other ends, where it has some."""
        ...

    def describe(self) -> str: ...


class _Family:
    """What most families are."""

    __slots__ = ()
    flat: ClassVar[bool] = False
    flat_in_logs: ClassVar[bool] = False
    vanishes_at_ends: ClassVar[bool] = False

    def extended(self: Prior, low: float, high: float) -> Prior:
        return self


class _Ended(_Family):
    """And those with ends of their own."""

    __slots__ = ()

    def extended(self: Any, low: float, high: float) -> Prior:
        made: Prior = dataclasses.replace(self, low=low, high=high)
        return made


@dataclass(frozen=True, slots=True)
class Uniform(_Ended):
    flat: ClassVar[bool] = True

    low: float
    high: float

    @property
    def in_logs(self) -> bool:
        return self.low > 0

    def logpdf(self, x: Array) -> Array:
        inside = (x >= self.low) & (x <= self.high) & _possible(self, x)
        return np.where(inside, -math.log(self.high - self.low), -np.inf)

    def quantile(self, u: Array) -> Array:
        return self.low + (self.high - self.low) * u

    def describe(self) -> str:
        return f"uniform from {self.low:.6g} to {self.high:.6g}"


@dataclass(frozen=True, slots=True)
class LogUniform(_Ended):
    flat_in_logs: ClassVar[bool] = True

    low: float
    high: float

    @property
    def in_logs(self) -> bool:
        return True

    def logpdf(self, x: Array) -> Array:
        inside = (x >= self.low) & (x <= self.high)
        safe = np.where(inside, x, 1.0)
        return np.where(inside, -np.log(safe) - math.log(math.log(self.high / self.low)), -np.inf)

    def quantile(self, u: Array) -> Array:
        return self.low * (self.high / self.low) ** u

    def describe(self) -> str:
        return f"log-uniform from {self.low:.6g} to {self.high:.6g}"


@dataclass(frozen=True, slots=True)
class TruncatedNormal(_Ended):
    """Normal(mean, sd) given low <= x <= high; mean and sd are those before truncation."""

    mean: float
    sd: float
    low: float = 0.0
    high: float = math.inf

    @property
    def in_logs(self) -> bool:
        return self.low > 0

    def logpdf(self, x: Array) -> Array:
        inside = (x >= self.low) & (x <= self.high) & _possible(self, x)
        z = (np.where(inside, x, self.mean) - self.mean) / self.sd
        density = -0.5 * z**2 - _LOG_SQRT_2PI - math.log(self.sd) - self._log_mass()
        return np.where(inside, density, -np.inf)

    def quantile(self, u: Array) -> Array:
        # Work in the tail that is nearer, where the normal integral keeps its digits.
        a, b = self._ends()
        if a > 0:
            below = ndtr(-b) + (1 - u) * (ndtr(-a) - ndtr(-b))
            z = -ndtri(below)
        else:
            z = ndtri(ndtr(a) + u * (ndtr(b) - ndtr(a)))
        return np.asarray(np.clip(self.mean + self.sd * z, self.low, self.high))

    def describe(self) -> str:
        begin = "" if math.isinf(self.low) else f", from {self.low:.6g}"
        end = "" if math.isinf(self.high) else f" to {self.high:.6g}"
        return f"normal {self.mean:.6g} +- {self.sd:.6g}{begin}{end}"

    def _ends(self) -> tuple[float, float]:
        return (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd

    def _log_mass(self) -> float:
        a, b = self._ends()
        if a > 0:
            a, b = -b, -a
        return float(log_ndtr(b) + np.log1p(-np.exp(log_ndtr(a) - log_ndtr(b))))


@dataclass(frozen=True, slots=True)
class LogNormal(_Family):
    """log x is normal with mean log(median) and standard deviation `sd_log`."""

    vanishes_at_ends: ClassVar[bool] = True

    median: float
    sd_log: float

    @property
    def low(self) -> float:
        return 0.0

    @property
    def high(self) -> float:
        return math.inf

    @property
    def in_logs(self) -> bool:
        return True

    def logpdf(self, x: Array) -> Array:
        inside = x > 0
        log_x = np.log(np.where(inside, x, 1.0))
        z = (log_x - math.log(self.median)) / self.sd_log
        density = -0.5 * z**2 - _LOG_SQRT_2PI - math.log(self.sd_log) - log_x
        return np.where(inside, density, -np.inf)

    def quantile(self, u: Array) -> Array:
        return np.asarray(self.median * np.exp(self.sd_log * ndtri(u)))

    def describe(self) -> str:
        return f"log-normal, median {self.median:.6g}, sd of the log {self.sd_log:.6g}"


@dataclass(frozen=True, slots=True)
class HalfNormal(_Family):
    """|Normal(0, scale)|."""

    scale: float

    @property
    def low(self) -> float:
        return 0.0

    @property
    def high(self) -> float:
        return math.inf

    @property
    def in_logs(self) -> bool:
        return False

    def logpdf(self, x: Array) -> Array:
        inside = x > 0
        z = np.where(inside, x, 0.0) / self.scale
        constant = math.log(2.0) - _LOG_SQRT_2PI - math.log(self.scale)
        return np.where(inside, constant - 0.5 * z**2, -np.inf)

    def quantile(self, u: Array) -> Array:
        return np.asarray(self.scale * ndtri(0.5 * (1.0 + u)))

    def describe(self) -> str:
        return f"half-normal, scale {self.scale:.6g}"


@dataclass(frozen=True, slots=True)
class InUnits(_Family):
    """`si`, of a quantity that is written in a unit of `factor` SI."""

    si: Prior
    factor: float

    @property
    def flat_in_logs(self) -> bool:  # type: ignore[override]
        return self.si.flat_in_logs

    @property
    def low(self) -> float:
        return self.si.low / self.factor

    @property
    def high(self) -> float:
        return self.si.high / self.factor

    @property
    def in_logs(self) -> bool:
        return self.si.in_logs

    def logpdf(self, x: Array) -> Array:
        return self.si.logpdf(np.asarray(x) * self.factor) + math.log(self.factor)

    def quantile(self, u: Array) -> Array:
        return self.si.quantile(u) / self.factor

    def describe(self) -> str:
        """In numbers of that unit."""
        si: Any = self.si
        scaled = ("low", "high", "mean", "sd", "median", "scale")
        given = [one.name for one in dataclasses.fields(si) if one.name in scaled]
        own = {name: getattr(si, name) / self.factor for name in given}
        described: str = dataclasses.replace(si, **own).describe()
        return described


def _possible(prior: Prior, x: Array) -> NDArray[np.bool_] | bool:
    """Of what cannot be negative zero itself is left out: it has no log."""
    return signed(prior) or x > 0


def signed(prior: Prior) -> bool:
    """Whether it allows numbers below zero."""
    return prior.low < 0


def flat_in_logs(prior: Prior | None) -> bool:
    return prior is not None and prior.flat_in_logs


def normal(mean: float, sd: float) -> TruncatedNormal:
    """A normal prior of a positive quantity: cut at zero and renormalised."""
    return TruncatedNormal(mean, sd)


PRIORS: Mapping[str, Callable[..., Prior]] = MappingProxyType(
    {
        "uniform": Uniform,
        "log_uniform": LogUniform,
        "normal": normal,
        "truncated_normal": TruncatedNormal,
        "log_normal": LogNormal,
        "half_normal": HalfNormal,
    }
)


def draw(prior: Prior, n: int, rng: np.random.Generator) -> Array:
    """`(n,)` independent draws."""
    return prior.quantile(rng.random(n))


def spread(prior: Prior) -> float:
    """Standard deviation, from the quantiles (midpoints of 2000 equal shares)."""
    shares = (np.arange(2000) + 0.5) / 2000
    return float(np.std(prior.quantile(shares)))


def spread_of_log(prior: Prior) -> float:
    """Standard deviation of the log, the same way."""
    shares = (np.arange(2000) + 0.5) / 2000
    return float(np.std(np.log(np.maximum(prior.quantile(shares), 1e-300))))
