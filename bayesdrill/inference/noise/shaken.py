"""White noise, and a torque that the rig's equations are without (`rig.missing_torque`).

What is left of a record is then a Gaussian process whose covariance follows from the rig: it is
told the rig's parameters beside its own unknowns.  Slopes are exact; the curvature is that of
Gauss and Newton of the whitened residuals, with what their standard deviations change, which on
average is the Fisher information.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.noise.contract import Residuals
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.unknowns import Unknown
from bayesdrill.rig.filtered import Filtered
from bayesdrill.rig.missing_torque import SIZE, TIME
from bayesdrill.rig.response import Response
from bayesdrill.rig.simulator import Simulator

Array = NDArray[np.float64]

MOST_BYTES = 6e7  # of slopes at a time


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaken:
    """`within`: the sensors' own noise; `torque`: of `SIZE` and `TIME`, the number or the unknown.

    All `own (W, n + P)` are its unknowns, and then the parameters of the simulator.  `pinned
    (P,)`: those that count instead, where given: the covariance is that of one rig, whatever the
    residuals are of.
    """

    within: White
    filtered: Filtered
    torque: Mapping[str, float | Unknown]
    pinned: tuple[float, ...] | None = None

    white: ClassVar[bool] = False

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        return (*self.within.unknowns, *(u for u in self.torque.values() if isinstance(u, Unknown)))

    @property
    def n_channels(self) -> int:
        return self.within.n_channels

    def for_length(self, n_samples: int) -> Shaken:
        raise ValueError(
            f"a missing torque is that of a record; it has no other of {n_samples} samples"
        )

    def seeing(self, counts: tuple[int, ...]) -> Shaken:
        return dataclasses.replace(self, within=self.within.seeing(counts))

    def of_rig(self, response: Simulator) -> Shaken:
        """Of what a simulator is of."""
        made = Filtered(response.model, self.filtered.torque, response.experiment)
        return dataclasses.replace(self, filtered=made)

    def held(self) -> Mapping[int, object]:
        return self.within.held()

    def pin(self, parameters: Array) -> Shaken:
        """With the covariance that it has at these `(P,)` of the simulator."""
        return dataclasses.replace(self, pinned=tuple(map(float, parameters)))

    # What it is told.

    def _levels(self, own: Array) -> Array:
        return own[..., : len(self.within.unknowns)]

    def parameters(self, own: Array) -> Array:
        """Of the rig and its torque, `(..., P + 2)`."""
        first, count = len(self.unknowns), len(self.filtered.model.parameters)
        rig = own[..., first : first + count]
        if self.pinned is not None:
            rig = np.broadcast_to(np.array(self.pinned[:count]), (*own.shape[:-1], count))
        return np.concatenate([rig, self.sizes(own)], axis=-1)

    def sizes(self, own: Array) -> Array:
        """Size and time of the torque, `(..., 2)`."""
        out = np.empty((*own.shape[:-1], 2))
        column = len(self.within.unknowns)
        for k, name in enumerate((SIZE, TIME)):
            value = self.torque[name]
            if isinstance(value, Unknown):
                out[..., k] = own[..., column]
                column += 1
            else:
                out[..., k] = value
        return out

    def scales(self, own: Array) -> Array:
        """Of the sensors alone."""
        return self.within.scales(self._levels(own))

    # Densities.

    def log_likelihood(self, residuals: Residuals, own: Array) -> Array:
        response = getattr(residuals, "response", None)
        if self.pinned is None and isinstance(response, Response):
            return self.filtered.log_density(self.parameters(own), self.scales(own), response)
        return np.asarray(np.nansum(self.pointwise(residuals.samples, own), axis=1))

    def pointwise(self, samples: Array, own: Array) -> Array:
        white, variances = self._whitened(samples, own)
        return np.asarray(-0.5 * (math.log(2 * math.pi) + np.log(variances) + white**2))

    def whiten(self, samples: Array, own: Array) -> Array:
        return self._whitened(samples, own)[0]

    def inform(self, shifts: Array, own: Array) -> Array:
        return np.nan_to_num(self._whitened(shifts, own)[0])

    def pull(self, samples: Array, own: Array) -> Array:
        """What the noise of the sensors has to be, where the torque is what all samples say, over it."""
        left = samples - self.moved(samples, own)
        return np.asarray(np.nan_to_num(left) / self.scales(own)[:, None, :] ** 2)

    def draw(self, signals: Array, own: Array, rng: np.random.Generator) -> Array:
        with np.errstate(all="ignore"):
            found = self.filtered.draw(self.parameters(own), self.scales(own), rng)[1]
        return np.asarray(signals + found)

    def smooth(self, samples: Array, own: Array) -> Array:
        """States of the rig, as far as the torque moves them, and of the torque over its size `(W,
        T, n)`.
        """
        with np.errstate(all="ignore"):
            found = self.filtered.smooth(self.parameters(own), self.scales(own), samples)
        return np.asarray(found)

    def moved(self, samples: Array, own: Array) -> Array:
        """What the torque moves of each channel, as all samples say it: `(W, T, K)`."""
        states = self.smooth(samples, own)
        return np.asarray(states @ np.array(self.filtered.noisy.channels).T)

    def known(self, samples: Array, own: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """States drawn with all samples known `(W, T, n)`, as `smooth` has them, and what channels
        show of them `(W, T, K)`, without noise.
        """
        with np.errstate(all="ignore"):
            fresh, shown = self.filtered.draw(self.parameters(own), self.scales(own), rng)
        drawn = fresh + self.smooth(samples - shown, own)
        return drawn, np.asarray(drawn @ np.array(self.filtered.noisy.channels).T)

    def again(self, signals: Array, samples: Array, own: Array, rng: np.random.Generator) -> Array:
        """Signals `(W, T, K)` with the torque of this very record, and fresh noise."""
        moved = self.known(samples, own, rng)[1]
        return self.within.draw(signals + moved, self._levels(own), rng)

    def _whitened(self, samples: Array, own: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            return self.filtered.whiten(self.parameters(own), self.scales(own), samples)

    # Slopes.

    def expand(self, left: Array, slopes: Array, own: Array, along: Array) -> tuple[Array, Array]:
        """Slope `(W, q)` and curvature `(W, q, q)` of the log likelihood, where `left (W, T, K)`
        changes by `slopes (W, q, T, K)` and what it is told, `own`, by `along (W, q, n + P)`.
        """
        n, q = along.shape[:2]
        slope, curvature = np.empty((n, q)), np.empty((n, q, q))
        chunk = max(1, int(MOST_BYTES / (64 * q * max(left[0].size, 1))))
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            slope[rows], curvature[rows] = self._expanded(
                left[rows], slopes[rows], own[rows], along[rows]
            )
        return slope, curvature

    def _expanded(
        self, left: Array, slopes: Array, own: Array, along: Array
    ) -> tuple[Array, Array]:
        n, q = along.shape[:2]
        told, levels = np.repeat(own, q, axis=0), along.reshape(n * q, -1)
        with np.errstate(all="ignore"):
            found = self.filtered.slopes(
                (self.parameters(told), self._slopes_of_parameters(levels)),
                (self.scales(told), self._slopes_of_scales(levels)),
                (np.repeat(left, q, axis=0), slopes.reshape(n * q, *left.shape[1:])),
            )
        white, change, variance, wider = (part.reshape(n, q, -1) for part in found)
        ratio = 0.5 * wider / variance
        slope = -(white * change).sum(axis=-1) - ratio.sum(axis=-1)
        return slope, change @ change.swapaxes(1, 2) + ratio @ ratio.swapaxes(1, 2)

    def _slopes_of_parameters(self, along: Array) -> Array:
        """What is held does not move."""
        found = self.parameters(along)
        count = found.shape[-1] - 2
        if self.pinned is not None:
            found[..., :count] = 0.0
        for k, name in enumerate((SIZE, TIME)):
            if not isinstance(self.torque[name], Unknown):
                found[..., count + k] = 0.0
        return found

    def _slopes_of_scales(self, along: Array) -> Array:
        found = self.scales(along)
        found[..., list(self.within.known)] = 0.0
        return found

    def bend(self, residuals: Residuals, own: Array) -> tuple[Array, Array]:
        count = len(self.unknowns)
        along = np.zeros((len(own), count, own.shape[1]))
        along[:, range(count), range(count)] = own[:, :count]
        samples = np.nan_to_num(residuals.samples)
        nothing = np.zeros((len(own), count, *samples.shape[1:]))
        slope, curvature = self.expand(samples, nothing, own, along)
        return slope, np.diagonal(curvature, axis1=1, axis2=2)

    def expected(self, own: Array) -> Array:
        zero: Any = _Nothing(np.zeros((1, *self.filtered.experiment.y.shape)))
        return np.asarray(2.0 * self.bend(zero, own[None])[1][0])

    def fitted(self, samples: Array, own: Array) -> Array:
        """As they are: of one record the levels cannot be told in a sum."""
        return own[: len(self.unknowns)]


@dataclass(frozen=True, slots=True)
class _Nothing:
    samples: Array
