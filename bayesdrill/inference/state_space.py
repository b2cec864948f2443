"""The likelihood of a record with a latent torque: a state-space model, by a Kalman filter.

What the simulator leaves is then a Gaussian process whose covariance follows from the rig: a
likelihood of its own kind, of a state space, and no noise of residuals.  Slopes are exact; the
curvature is that of Gauss and Newton of the whitened residuals, with what their standard
deviations change, which on average is the Fisher information.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.likelihood import Directions, Observation
from bayesdrill.inference.noise.mixed import Mixed, Part
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.unknowns import ParameterSpace, Unknown
from bayesdrill.rig.models.latent_torque import SIZE, TIME
from bayesdrill.rig.simulators.contract import Simulator
from bayesdrill.rig.simulators.kalman import KalmanFilter

MOST_BYTES = 6e7  # of slopes at a time


@dataclass(frozen=True, slots=True, kw_only=True)
class ShakenObservation(Observation):
    """`noise`: of the sensors, white; `filtered`: of the simulator's rig and experiment; `process`: of
    `SIZE` and `TIME` of the torque, the number or the unknown.

    All `own (W, n + P)` are its unknowns, and then the parameters of the simulator.  `fixed (P,)`:
    those that count instead, where given: the covariance is that of one rig, whatever the
    residuals are of.
    """

    filtered: KalmanFilter
    process: Mapping[str, float | Unknown]
    space: ParameterSpace | None = None
    fixed: tuple[float, ...] | None = None

    def placed(self, space: ParameterSpace) -> ShakenObservation:
        return dataclasses.replace(Observation.placed(self, space), space=space)

    def simulated(self, response: Simulator, parameters: Sequence[str]) -> ShakenObservation:
        filtered = KalmanFilter(response.model, self.filtered.torque, response.experiment)
        return dataclasses.replace(
            self, response=response, parameters=parameters, filtered=filtered
        )

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        unknowns = (u for u in self.process.values() if isinstance(u, Unknown))
        return (*self.noise.unknowns, *unknowns)

    @property
    def white(self) -> bool:
        return False

    @property
    def kind(self) -> str:
        """As it was called when it was a noise: by that results know it."""
        return (
            f"Shaken(within={self.noise!r}, filtered={self.filtered!r}, torque={self.process!r}, "
            "pinned=None)"
        )

    @property
    def torque(self) -> ShakenObservation:
        return self

    def pinned(self, theta: Array) -> ShakenObservation:
        assert self.space is not None
        told = self.told(self.space.full(theta[None]))[0]
        return dataclasses.replace(self, fixed=tuple(map(float, told)))

    def times(self, factor: float) -> ShakenObservation:
        size = self.process[SIZE]
        if isinstance(size, Unknown):
            return self
        return dataclasses.replace(self, process={**self.process, SIZE: size * factor})

    def showing(self, response: Simulator, sigma: float) -> ShakenObservation:
        k, n = self.noise.n_channels, len(response.experiment.t)
        more = White(n_samples=n, known={0: sigma}, n_channels=1)
        noise = Mixed((Part(self.noise, tuple(range(k))), Part(more, (k,))))
        made = dataclasses.replace(self, noise=noise)
        return made.simulated(response, self.parameters)

    # What it is told.

    def _own(self, theta: Array, full: Array | None = None) -> Array:
        assert self.space is not None
        told = self.told(self.space.full(theta) if full is None else full)
        return np.concatenate([theta[:, self.noise_columns], told], axis=1)

    def _levels(self, noise_values: Array) -> Array:
        return noise_values[..., : len(self.noise.unknowns)]

    def _of_process(self, noise_values: Array) -> Array:
        """Of the rig and its torque, `(..., P + 2)`."""
        first, count = len(self.unknowns), len(self.filtered.model.parameters)
        rig = noise_values[..., first : first + count]
        if self.fixed is not None:
            rig = np.broadcast_to(np.array(self.fixed[:count]), (*noise_values.shape[:-1], count))
        return np.concatenate([rig, self._sizes(noise_values)], axis=-1)

    def _sizes(self, noise_values: Array) -> Array:
        """Size and time of the torque, `(..., 2)`."""
        out = np.empty((*noise_values.shape[:-1], 2))
        column = len(self.noise.unknowns)
        for k, name in enumerate((SIZE, TIME)):
            value = self.process[name]
            if isinstance(value, Unknown):
                out[..., k] = noise_values[..., column]
                column += 1
            else:
                out[..., k] = value
        return out

    def _scales(self, noise_values: Array) -> Array:
        return self.noise.scales(self._levels(noise_values))

    def sizes(self, theta: Array) -> Array:
        return self._sizes(theta[:, self.noise_columns])

    def scales(self, theta: Array) -> Array:
        """Of the sensors alone."""
        return self._scales(theta[:, self.noise_columns])

    # Densities.

    def by_channel(self, full: Array, theta: Array) -> Array:
        torque_values, record = self._own(theta, full), self.response.record
        if self.fixed is None and record is not None:
            return self.filtered.log_density(
                self._of_process(torque_values), self._scales(torque_values), record
            )
        return np.asarray(
            np.nansum(self._pointwise(self.residuals(full).samples, torque_values), axis=1)
        )

    def pointwise(self, samples: Array, theta: Array) -> Array:
        return self._pointwise(samples, self._own(theta))

    def _pointwise(self, samples: Array, noise_values: Array) -> Array:
        white, variances = self._whitened(samples, noise_values)
        return np.asarray(-0.5 * (math.log(2 * math.pi) + np.log(variances) + white**2))

    def whiten(self, samples: Array, theta: Array) -> Array:
        return self._whitened(samples, self._own(theta))[0]

    def innovations(self, samples: Array, theta: Array) -> Array:
        white, variances = self._whitened(samples, self._own(theta))
        return white * np.sqrt(variances)

    def inform(self, shifts: Array, theta: Array) -> Array:
        return np.nan_to_num(self.whiten(shifts, theta))

    def draw(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        torque_values = self._own(theta)
        with np.errstate(all="ignore"):
            result = self.filtered.draw(
                self._of_process(torque_values), self._scales(torque_values), rng
            )[1]
        return np.asarray(signals + result)

    def smooth(self, samples: Array, theta: Array) -> Array:
        torque_values = self._own(theta)
        with np.errstate(all="ignore"):
            result = self.filtered.smooth(
                self._of_process(torque_values), self._scales(torque_values), samples
            )
        return np.asarray(result)

    def followed(self, full: Array, theta: Array) -> Array:
        signals = self.signals(full)
        states = self.smooth(self.experiment.y - signals, theta)
        return signals + np.asarray(states @ self.filtered.weights.T)

    def known(self, samples: Array, theta: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        torque_values = self._own(theta)
        with np.errstate(all="ignore"):
            fresh, shown = self.filtered.draw(
                self._of_process(torque_values), self._scales(torque_values), rng
            )
        drawn = fresh + self.smooth(samples - shown, theta)
        return drawn, np.asarray(drawn @ self.filtered.weights.T)

    def again(self, signals: Array, theta: Array, rng: np.random.Generator) -> Array:
        moved = self.known(self.experiment.y - signals, theta, rng)[1]
        return self.noise.draw(signals + moved, self._levels(theta[:, self.noise_columns]), rng)

    def _whitened(self, samples: Array, noise_values: Array) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            return self.filtered.whiten(
                self._of_process(noise_values), self._scales(noise_values), samples
            )

    # Slopes.

    def expand(self, at: Directions) -> Iterator[tuple[Array, Array]]:
        """Of all together, as parameters are in the covariance too."""
        levels = (at.slopes[:, None, :] * at.columns.T)[..., self.noise_columns]
        along = at.along
        if along is None:
            along = np.zeros((*levels.shape[:2], at.full.shape[1]))
        turned = self.told(along)
        signals, shifts = self.response.course(self.told(at.full), turned)
        left = np.nan_to_num(self.experiment.y - signals)
        torque_values = self._own(at.theta, at.full)
        yield self._slopes(left, -shifts, torque_values, np.concatenate([levels, turned], axis=-1))

    def _slopes(
        self, left: Array, slopes: Array, noise_values: Array, along: Array
    ) -> tuple[Array, Array]:
        """Slope `(W, q)` and curvature `(W, q, q)` of the log likelihood, where `left (W, T, K)`
        changes by `slopes (W, q, T, K)` and what it is told, `noise_values`, by `along (W, q, n + P)`.
        """
        n, q = along.shape[:2]
        slope, curvature = np.empty((n, q)), np.empty((n, q, q))
        chunk = max(1, int(MOST_BYTES / (64 * q * max(left[0].size, 1))))
        for rows in (slice(k, k + chunk) for k in range(0, n, chunk)):
            told, levels = (
                np.repeat(noise_values[rows], q, axis=0),
                along[rows].reshape(-1, along.shape[2]),
            )
            with np.errstate(all="ignore"):
                result = self.filtered.slopes(
                    (self._of_process(told), self._slopes_of_process(levels)),
                    (
                        self._scales(told),
                        self._scales(levels) - self._scales(np.zeros_like(levels)),
                    ),
                    (
                        np.repeat(left[rows], q, axis=0),
                        slopes[rows].reshape(-1, *left.shape[1:]),
                    ),
                )
            white, change, variance, wider = (
                part.reshape(len(told) // q, q, -1) for part in result
            )
            ratio = 0.5 * wider / variance
            slope[rows] = -(white * change).sum(axis=-1) - ratio.sum(axis=-1)
            curvature[rows] = change @ change.swapaxes(1, 2) + ratio @ ratio.swapaxes(1, 2)
        return slope, curvature

    def _slopes_of_process(self, along: Array) -> Array:
        """What is held does not move."""
        result = self._of_process(along)
        count = result.shape[-1] - 2
        if self.fixed is not None:
            result[..., :count] = 0.0
        for k, name in enumerate((SIZE, TIME)):
            if not isinstance(self.process[name], Unknown):
                result[..., count + k] = 0.0
        return result

    def expected(self, theta: Array) -> Array:
        torque_values, count = self._own(theta[None]), len(self.unknowns)
        along = np.zeros((1, count, torque_values.shape[1]))
        along[:, range(count), range(count)] = torque_values[:, :count]
        shape = self.experiment.y.shape
        curvature = self._slopes(
            np.zeros((1, *shape)), np.zeros((1, count, *shape)), torque_values, along
        )[1]
        return np.asarray(2.0 * np.diagonal(curvature[0]))

    def fitted(self, samples: Array, theta: Array) -> Array:
        """As they are: of one record the levels cannot be told in a sum."""
        return theta[self.noise_columns]
