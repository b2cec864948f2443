"""The log posterior over the sampler's coordinates, with slopes and curvature, point by point.

Slopes of the response are exact (`models.tangent`), its curvature is that of Gauss and Newton: what
a straight response would have.  That is positive, and right where the fit leaves only noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Directions, along, weighted
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.unknowns import MOVES, Unknown

Array = NDArray[np.float64]

SHARES = 200  # of equal mass, which the spread of a prior is taken from
ROUNDED = 1e-9  # of a prior's spread
STEP = 1e-4  # of its spread, over which a prior is differentiated
NOTHING = 1e-9  # of a prior that has no end lies beyond where one searches


@dataclass(frozen=True, slots=True)
class Expansion:
    """At W points along q directions: `value (W,)`, `slope (W, q)`, `curvature (W, q, q)`.

    `curvature` is minus the second derivative.  Where the response overflows `value` is -inf and
    the others are zero.
    """

    value: Array
    slope: Array
    curvature: Array


def joined(parts: Sequence[Expansion]) -> Expansion:
    """Of the points of all parts, in order."""
    return Expansion(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in dataclasses.fields(Expansion)
        )
    )


class Surface(Protocol):
    """A log density over `u (W, D)`; `low`, `high` `(D,)`: the ends between which one searches.

    `spread (D,)`: how far each unknown may go before the record is seen.
    """

    @property
    def low(self) -> Array: ...

    @property
    def high(self) -> Array: ...

    @property
    def spread(self) -> Array: ...

    @property
    def middle(self) -> Array: ...

    def value(self, u: Array) -> Array: ...

    def inside(self, u: Array) -> NDArray[np.bool_]: ...

    def expand(self, u: Array, directions: Array) -> Expansion:
        """`directions (D, q)`: columns along which slopes are wanted."""
        ...


class PosteriorSurface:
    """That of a posterior."""

    def __init__(self, posterior: Posterior, *, physical: bool = False) -> None:
        """`physical`: the density over the unknowns themselves, whose maximum is the MAP."""
        self.posterior = posterior
        self.physical = physical
        self._priors = tuple(posterior.space.priors.values())
        ends = np.array([_ends(one) for one in posterior.space.unknowns]).T
        self.low, self.high = posterior.coordinates.from_physical(ends)
        shares = (np.arange(SHARES) + 0.5) / SHARES
        quantiles = np.stack([prior.quantile(shares) for prior in self._priors], axis=-1)
        usual = posterior.coordinates.from_physical(_within(posterior, quantiles))
        self.middle, self.spread = usual.mean(axis=0), usual.std(axis=0)
        # What lies at an end must not be rounded beyond it.
        self.low, self.high = self.low + ROUNDED * self.spread, self.high - ROUNDED * self.spread

    def value(self, u: Array) -> Array:
        if not self.physical:
            return self.posterior(u)
        return self.posterior.density(self.posterior.coordinates.to_physical(u))

    def inside(self, u: Array) -> NDArray[np.bool_]:
        return self.posterior.supports(u)

    def expand(self, u: Array, directions: Array) -> Expansion:
        here = self.bent(u, directions)
        with np.errstate(all="ignore"):
            return dataclasses.replace(here, value=here.value + self.value(u))

    def bent(self, u: Array, directions: Array) -> Expansion:
        """`expand` without the value, which takes another response: 0, or -inf."""
        with np.errstate(all="ignore"):
            theta = self.posterior.coordinates.to_physical(u)
            slope, curvature = self.of_record(theta, directions)
        prior_slope, prior_curvature = self._of_prior(u)
        slope += along(prior_slope, directions)
        curvature += weighted(directions, prior_curvature)
        good = np.isfinite(slope).all(axis=1) & np.isfinite(curvature).all(axis=(1, 2))
        slope[~good], curvature[~good] = 0.0, 0.0
        return Expansion(np.where(good, 0.0, -np.inf), slope, curvature)

    def of_record(self, theta: Array, directions: Array) -> tuple[Array, Array]:
        """Slope `(W, q)` and curvature `(W, q, q)` of the log likelihood."""
        space, coordinates = self.posterior.space, self.posterior.coordinates
        # d log unknown / d coordinate, or d unknown / d coordinate where it need not be positive
        steps = coordinates.slopes(theta)
        by_log = steps / coordinates.natural(theta)
        m = len(space.columns(*MOVES))
        full, moved = space.full(theta), None
        if m:
            turned = space.slopes(theta).swapaxes(1, 2) @ (by_log[:, :m, None] * directions[:m])
            moved = turned.swapaxes(1, 2)
        at = Directions(
            theta=theta, full=full, columns=directions, along=moved, slopes=steps, by_log=by_log
        )
        slope = np.zeros((len(theta), directions.shape[1]))
        curvature = np.zeros((len(theta), directions.shape[1], directions.shape[1]))
        for one in self.posterior.likelihood.observations:
            for pulled, bent in one.expand(at):
                slope, curvature = slope + pulled, curvature + bent
        return slope, curvature

    def _of_prior(self, u: Array) -> tuple[Array, Array]:
        """Slopes of the log prior by each coordinate, and minus its second derivatives."""
        step = STEP * self.spread
        middle = np.clip(u, self.low + 2 * step, self.high - 2 * step)
        theta = self.posterior.coordinates.to_physical(
            np.concatenate([middle + k * step for k in (-1, 0, 1)])
        )
        values = np.stack([p.logpdf(theta[:, d]) for d, p in enumerate(self._priors)], axis=-1)
        down, here, up = np.split(values, 3)
        with np.errstate(invalid="ignore"):
            slope = np.nan_to_num((up - down) / (2 * step))
            curvature = np.maximum(np.nan_to_num(-(up - 2 * here + down) / step**2), 0.0)
        if not self.physical:
            tilt, bend = self.posterior.coordinates.jacobian_bends(u)
            slope, curvature = slope + tilt, curvature + bend
        return slope, curvature


def _ends(unknown: Unknown) -> tuple[float, float]:
    """Of the support, or of nearly all of it."""
    prior = unknown.prior
    if unknown.between is not None:
        low, high = unknown.between
        inset = NOTHING * (high - low)
        return max(prior.low, low + inset), min(prior.high, high - inset)
    bounded = np.isfinite(prior.low) and prior.low != 0  # where nothing itself may be impossible
    low = prior.low if bounded else float(prior.quantile(np.array(NOTHING)))
    high = prior.high if np.isfinite(prior.high) else float(prior.quantile(np.array(1 - NOTHING)))
    return low, high


def _within(posterior: Posterior, theta: Array) -> Array:
    """Where coordinates are numbers."""
    floor = [-np.inf if one.signed else 1e-300 for one in posterior.space.unknowns]
    return np.maximum(theta, floor)
