"""Evaluate the information of waveforms on targets, averaged over draws of the unknowns.

The derivatives of a linear rig's signals by the unknowns (slopes) are linear in the levels of the
input.  The slopes of the response to a unit pulse in each hold interval are therefore simulated
once for each draw.  The Fisher information is quadratic in the levels.  A QR decomposition reduces
the whitened slopes of all pulses to a few hundred rows, which keep all information of every
waveform.  A rig with friction is simulated for each waveform instead.

The criterion is the log determinant of the targets' covariance, averaged over draws.  The
covariance includes the prior knowledge (D_S-optimality; Atkinson, Donev and Tobias 2007).
"""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.errors import InputError
from bayesdrill.design.source import SourceLimits
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.record.experiment import Experiment, channels_first, frozen, with_states
from bayesdrill.rig.simulators.contract import Simulator

MAX_BYTES = 6e8  # upper limit of memory [bytes] for the slopes of all pulses, before the QR step


@dataclass(frozen=True, kw_only=True)
class ComingExperiment:
    """The coming experiment has the channels, sensors and noise of a recorded one."""

    observation: Observation
    source: SourceLimits

    @classmethod
    def from_observation(cls, observation: Observation, source: SourceLimits) -> ComingExperiment:
        """Return the experiment with `source`; all other measured inputs are held at their means.

        A mean is added to a constant input of the same name, as in `SensitivityStudy`.
        """
        recorded, t = observation.experiment, source.t
        constant = dict(recorded.constant)
        for name, u in recorded.series.items():
            constant[name] = constant.get(name, 0.0) + float(np.mean(u))
        model = observation.response.model
        experiment = dataclasses.replace(
            recorded, t=frozen(t), y=frozen(np.zeros((len(t), len(recorded.channels)))),
            constant=constant, series={name: np.zeros(len(t)) for name in model.inputs},
            first_order=False, t_start=0.0, notes=(), anomalies=(), held_out=None, input_steps={},
        )  # fmt: skip
        assert observation.space is not None
        coming = observation.for_record(experiment).bind(observation.space)
        return cls(observation=coming, source=source)

    def with_samples(self, is_measured: Flags) -> ComingExperiment:
        """Return the experiment without the samples for which `is_measured (T, K)` is false.

        Raises `ValueError` if the noise needs every sample.
        """
        recorded, space = self.observation.experiment, self.observation.space
        assert space is not None
        experiment = dataclasses.replace(recorded, y=frozen(np.where(is_measured, 0.0, np.nan)))
        observation = self.observation.for_record(experiment).bind(space)
        return dataclasses.replace(self, observation=observation)

    def posterior(self, *batch: Array) -> Posterior:
        """Return the joint posterior of a record per waveform in `batch`; all samples are zero."""
        space, parts = self.observation.space, []
        assert space is not None
        for levels in batch:
            record = self._driven(self.observation.experiment, levels)
            response = self.observation.response.of(record)
            parts.append(dataclasses.replace(self.observation, response=response))
        return Posterior(space, Likelihood(tuple(parts), space), space.coordinates)

    @property
    def _states_alone(self) -> bool:
        return self.observation.response.sensing.empty

    @cached_property
    def _shown_states(self) -> Experiment:
        states = self.observation.response.model.states
        return with_states(self.observation.experiment, states, alone=self._states_alone)

    def _with_channels(self, rig_states: Array) -> Array:
        """Return channels, then states, from the output `rig_states` of the simulator."""
        if not self._states_alone:
            return rig_states
        states = self.observation.response.model.states
        return channels_first(self.observation.experiment, states, rig_states)

    def _driven(self, experiment: Experiment, levels: Array) -> Experiment:
        added = self.source.series(levels) - experiment.constant.get(self.source.input, 0.0)
        series = {**experiment.series, self.source.input: frozen(added)}
        return dataclasses.replace(experiment, series=series)

    def _simulator(self, levels: Array) -> Simulator:
        return self.observation.response.of(self._driven(self._shown_states, levels))

    def motion(self, theta: Array, levels: Array) -> tuple[Array, Array]:
        """Return channels `(W, T, K)` and states `(W, T, X)` at `theta (W, D)`."""
        assert self.observation.space is not None
        full = self.observation.simulator_parameters(self.observation.space.full(theta))
        channels = len(self.observation.experiment.channels)
        both = self._with_channels(self._simulator(levels).signals(full))
        return both[:, :, :channels], both[:, :, channels:]

    def slopes(self, theta: Array, levels: Array) -> Array:
        """Return derivatives `(W, m, T, K)` of the channels by unknowns on natural scales."""
        space = self.observation.space
        assert space is not None
        chosen = self.observation.simulator_parameters
        at = chosen(space.full(theta)), chosen(space.slopes(theta))
        driven = self._driven(self.observation.experiment, levels)
        return self.observation.response.of(driven).course(*at)[1]

    def whitened(self, slopes: Array, theta: Array) -> Array:
        """Return slopes `(n, T, K)`, whitened by the noise at `theta (D,)`, as `(n, T K)`."""
        rows = self.observation.whitened_jacobian_at(slopes, theta)
        return np.asarray(rows.reshape(len(rows), -1))


@dataclass(frozen=True, kw_only=True)
class TargetCovariance:
    """Covariances of targets follow from `slopes (W, k, m)` and a prior `precision (W, m, m)`."""

    slopes: Array
    precision: Array

    def covariances(self, information: Array) -> Array:
        """Return covariances `(W, k, k)` of targets with `information (W, m, m)` of an experiment."""
        spread = np.linalg.inv(information + self.precision)
        return np.asarray(self.slopes @ spread @ self.slopes.swapaxes(1, 2))

    def criterion(self, information: Array) -> tuple[float, Array]:
        """Return the mean log determinant, and minus its derivative by the information, `(W, m, m)`."""
        spread = np.linalg.inv(information + self.precision)
        along = self.slopes @ spread
        covariance = along @ self.slopes.swapaxes(1, 2)
        value = np.linalg.slogdet(covariance)[1].mean()
        pull = along.swapaxes(1, 2) @ np.linalg.solve(covariance, along) / len(along)
        return float(value), pull


class SuperposedPulses:
    """The evaluation of a linear rig superposes the slopes of pulses, weighted by the levels."""

    def __init__(self, coming: ComingExperiment, theta: Array, targets: TargetCovariance) -> None:
        self.coming, self.targets = coming, targets
        self._m = targets.slopes.shape[2]
        shape = coming.observation.experiment.y.shape
        size = 8.0 * (coming.source.count + 1) * self._m * shape[0] * shape[1]
        if size > MAX_BYTES:
            message = f"the slopes of all levels need {size / 1e9:.1f} GB of memory for each draw"
            raise InputError.at("--rate", f"{message}; give a lower rate, or hold levels longer")
        group = max(1, int(MAX_BYTES / size))
        parts = [self._reduce(theta[k : k + group]) for k in range(0, len(theta), group)]
        self._roots = np.concatenate(parts)

    def with_first(self, draws: int) -> SuperposedPulses:
        """Return the evaluation at only the first draws, which is faster."""
        fewer = copy.copy(self)
        fewer._roots = self._roots[:draws]
        slopes, precision = self.targets.slopes[:draws], self.targets.precision[:draws]
        fewer.targets = TargetCovariance(slopes=slopes, precision=precision)
        return fewer

    def _reduce(self, theta: Array) -> Array:
        """Return whitened slopes `(W, R m, S + 1)`, reduced by a QR decomposition for each draw."""
        coming, count = self.coming, self.coming.source.count
        still = coming.slopes(theta, np.zeros(count))
        courses = [still, *(coming.slopes(theta, level) for level in np.eye(count))]
        rows = []
        for number, slopes in enumerate(courses):
            base = still if number else 0.0
            rows.append([coming.whitened(x, p) for x, p in zip(slopes - base, theta, strict=True)])
        tall = np.stack([np.stack(each, axis=0) for each in rows], axis=1)  # (W, S + 1, m, T K)
        tall = tall.reshape(len(theta), -1, tall.shape[-1]).swapaxes(1, 2)
        reduced = np.stack([np.linalg.qr(each, mode="r") for each in tall])
        reduced = reduced.reshape(len(theta), -1, count + 1, self._m).swapaxes(2, 3)
        return np.ascontiguousarray(reduced).reshape(len(theta), -1, count + 1)

    def _root(self, levels: Array) -> Array:
        rows = self._roots @ np.append(1.0, levels)
        return np.asarray(rows.reshape(len(self._roots), -1, self._m))

    def information(self, levels: Array) -> Array:
        """Return the information `(W, m, m)` of a waveform at each draw."""
        root = self._root(levels)
        return np.asarray(root.swapaxes(1, 2) @ root)

    def value_and_slope(self, levels: Array) -> tuple[float, Array]:
        """Return the criterion and its gradient `(S,)` in the levels."""
        root = self._root(levels)
        value, pull = self.targets.criterion(root.swapaxes(1, 2) @ root)
        flat = (root @ pull).reshape(len(root), 1, -1)
        return value, -2.0 * (flat @ self._roots)[:, 0].sum(axis=0)[1:]


class SimulatedSlopes:
    """The evaluation of a rig with friction simulates each waveform at each draw, with its slopes."""

    def __init__(self, coming: ComingExperiment, theta: Array, targets: TargetCovariance) -> None:
        self.coming, self.targets, self._theta = coming, targets, theta

    def information(self, levels: Array) -> Array:
        """Return the information `(W, m, m)` of a waveform at each draw."""
        pairs = zip(self.coming.slopes(self._theta, levels), self._theta, strict=True)
        rows = np.stack([self.coming.whitened(x, point) for x, point in pairs])
        return np.asarray(rows @ rows.swapaxes(1, 2))


Evaluation = SuperposedPulses | SimulatedSlopes  # both return the information of any waveform
