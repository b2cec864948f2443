"""Define prior families: normalised one-dimensional densities, SI.

Nearly every parameter of a rig is positive, so a family that reaches below zero is truncated there
and renormalised.  Unknowns of sensors and starts, and angles of rigs, may be negative: their priors
have a `low` below zero or at minus infinity.  `logpdf` is -inf outside the support and never NaN.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy
from pydantic import Field

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, dual, log
from bayesdrill.basics.entries import SMALLEST, NonNegative, Number, Positive

_LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


class Prior:
    """A prior family fulfils this contract; the support is from `low` to `high`."""

    __slots__ = ()
    # Whether the density is constant between the ends.
    flat: ClassVar[bool] = False
    # Whether the density of the logarithm is constant between the ends.
    flat_in_logs: ClassVar[bool] = False
    # Whether the density vanishes at the ends, so that no draw comes close to them.
    vanishes_at_ends: ClassVar[bool] = False
    # The template of `describe`, which is filled with the fields.
    words: ClassVar[str] = ""

    low: float
    high: float

    @property
    def in_logs(self) -> bool:
        """Return whether the logarithm is sampled: only if the density near zero vanishes."""
        return self.low > 0 or self.vanishes_at_ends

    def logpdf(self, x: Array) -> Array:
        """Return the log density at `x (N,)`: `(N,)`."""
        with np.errstate(all="ignore"):
            return self.log_density(x)

    def log_density(self, x: Array) -> Array:
        """Return `logpdf` without switching off NumPy's warnings, which would take 3 us."""
        above = x >= self.low if self.low else x > 0  # zero has no logarithm
        return np.where(above & (x <= self.high), self._log_density(x), -np.inf)

    def derivatives(self, x: Array) -> tuple[Array, Array]:
        """Return first and second derivatives of the log density inside the support, `(N,)` each."""
        density = dual(self._log_density(Dual(Dual(x, 1.0), Dual(1.0, 0.0))))
        first = dual(density.slope)
        zeros = np.zeros_like(x)  # broadcast derivatives that do not depend on x
        return first.value + zeros, first.slope + zeros

    def _log_density(self, x: Any) -> Any:
        """Return the log density inside the support, at an array or at dual numbers."""
        raise NotImplementedError

    def quantile(self, u: Array) -> Array:
        """Return the quantiles at the probabilities `u (N,)`."""
        raise NotImplementedError

    def scaled(self: Any, factor: float) -> Prior:
        """Return the prior of the unknown times `factor` > 0, as for another unit."""
        names = (field.name for field in dataclasses.fields(self))
        moved = {name: getattr(self, name) * factor for name in names if name != "sd_log"}
        scaled: Prior = dataclasses.replace(self, **moved)
        return scaled

    def describe(self: Any) -> str:
        """Describe the prior in words, without a unit."""
        return str(self.words.format_map(dataclasses.asdict(self)))


class _Positive(Prior):
    """The support of these families is all positive numbers."""

    __slots__ = ()
    low: float = 0.0
    high: float = math.inf


@dataclass(frozen=True, slots=True)
class Uniform(Prior):
    """The density is the same everywhere between low and high."""

    flat: ClassVar[bool] = True
    words: ClassVar[str] = "uniform from {low:.6g} to {high:.6g}"

    low: NonNegative
    high: Positive

    def _log_density(self, x: Any) -> float:
        return -math.log(self.high - self.low)

    def quantile(self, u: Array) -> Array:
        return self.low + (self.high - self.low) * u


@dataclass(frozen=True, slots=True)
class LogUniform(Prior):
    """The logarithm is uniform between log(low) and log(high)."""

    flat_in_logs: ClassVar[bool] = True
    words: ClassVar[str] = "log-uniform from {low:.6g} to {high:.6g}"

    low: Positive
    high: Positive

    def _log_density(self, x: Any) -> Any:
        return -log(x) - math.log(math.log(self.high / self.low))

    def quantile(self, u: Array) -> Array:
        return self.low * (self.high / self.low) ** u


@dataclass(frozen=True, slots=True)
class TruncatedNormal(Prior):
    """x is Normal(mean, sd) given low <= x <= high; mean and sd are those before truncation."""

    mean: Number
    sd: Positive
    low: NonNegative = 0.0
    high: Positive = math.inf

    def _log_density(self, x: Any) -> Any:
        z = (x - self.mean) / self.sd
        return -0.5 * z**2 - _LOG_SQRT_2PI - math.log(self.sd) - self._log_mass()

    def quantile(self, u: Array) -> Array:
        # Work in the nearer tail, where the normal integral keeps its digits.
        ndtr, (a, b) = scipy.special.ndtr, self._ends()
        if a > 0:
            z = -scipy.special.ndtri(ndtr(-b) + (1 - u) * (ndtr(-a) - ndtr(-b)))
        else:
            z = scipy.special.ndtri(ndtr(a) + u * (ndtr(b) - ndtr(a)))
        return np.asarray(np.clip(self.mean + self.sd * z, self.low, self.high))

    def describe(self) -> str:
        """Describe the prior in words, without a unit."""
        begin = "" if math.isinf(self.low) else f", from {self.low:.6g}"
        end = "" if math.isinf(self.high) else f" to {self.high:.6g}"
        return f"normal {self.mean:.6g} +- {self.sd:.6g}{begin}{end}"

    def _ends(self) -> tuple[float, float]:
        return (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd

    def _log_mass(self) -> float:
        a, b = self._ends()
        if a > 0:
            a, b = -b, -a
        below, above = scipy.special.log_ndtr(a), scipy.special.log_ndtr(b)
        return float(above + np.log1p(-np.exp(below - above)))


_SD_LOG = "Standard deviation of the natural logarithm."


@dataclass(frozen=True, slots=True)
class LogNormal(_Positive):
    """log x is normal with mean log(median) and standard deviation `sd_log`."""

    vanishes_at_ends: ClassVar[bool] = True
    words: ClassVar[str] = "log-normal, median {median:.6g}, sd of the log {sd_log:.6g}"

    median: Positive
    sd_log: Annotated[float, Field(ge=SMALLEST, le=20, description=_SD_LOG)]

    def _log_density(self, x: Any) -> Any:
        log_x = log(x)
        z = (log_x - math.log(self.median)) / self.sd_log
        return -0.5 * z**2 - _LOG_SQRT_2PI - math.log(self.sd_log) - log_x

    def quantile(self, u: Array) -> Array:
        return np.asarray(self.median * np.exp(self.sd_log * scipy.special.ndtri(u)))


@dataclass(frozen=True, slots=True)
class HalfNormal(_Positive):
    """x is the absolute value of a Normal(0, scale) number."""

    words: ClassVar[str] = "half-normal, scale {scale:.6g}"

    scale: Positive

    def _log_density(self, x: Any) -> Any:
        constant = math.log(2.0) - _LOG_SQRT_2PI - math.log(self.scale)
        return constant - 0.5 * (x / self.scale) ** 2

    def quantile(self, u: Array) -> Array:
        return np.asarray(self.scale * scipy.special.ndtri(0.5 * (1.0 + u)))


def flat_in_logs(prior: Prior | None) -> bool:
    """Return whether there is a prior and it is flat in the log of the unknown."""
    return prior is not None and prior.flat_in_logs


def normal(mean: Number, sd: Positive) -> TruncatedNormal:
    """Return a normal prior that is truncated at zero, as most parameters are positive."""
    return TruncatedNormal(mean, sd)


def uncut_normal(mean: Number, sd: Positive) -> TruncatedNormal:
    """Return a normal prior without truncation."""
    return TruncatedNormal(mean, sd, -math.inf, math.inf)


# Keys are names in a config.  Annotated fields of the families are entries with bounds.
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
# Priors of unknowns of sensors and starts; the ends of these priors may be below zero.
SIGNED_PRIORS: Mapping[str, Callable[..., Prior]] = MappingProxyType(
    {n: prior for n, prior in PRIORS.items() if n not in ("log_uniform", "half_normal")}
    | {"normal": uncut_normal}
)


_PROBABILITIES = (np.arange(2000) + 0.5) / 2000  # midpoints of intervals with equal mass


def prior_sd(prior: Prior) -> float:
    """Return the standard deviation of 2000 quantiles at equally spaced probabilities."""
    return float(np.std(prior.quantile(_PROBABILITIES)))


def prior_log_sd(prior: Prior) -> float:
    """Return the standard deviation of the logarithms of the quantiles that `prior_sd` uses."""
    return float(np.std(np.log(np.maximum(prior.quantile(_PROBABILITIES), 1e-300))))
