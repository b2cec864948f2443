"""Evaluate the information of waveforms on targets, averaged over draws of the unknowns.

The sensitivities of a linear rig are linear in the levels of its input.  The responses to a unit pulse
in each hold interval are therefore simulated once for each draw, with their slopes.  The Fisher
information is then quadratic in the levels.  A QR decomposition reduces the whitened slopes of all
pulses to a few hundred rows, which keep all information of every waveform.  A rig with friction is
simulated for each waveform instead.

The criterion is the mean over draws of the log determinant of the covariance of the targets, which
has the prior knowledge in it (D_S-optimality; Atkinson, Donev and Tobias 2007).
"""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.design.source import RigLimit, SourceLimits
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.record.experiment import Experiment, channels_first, frozen, with_states
from bayesdrill.rig.simulators.contract import Simulator

MAX_BYTES = 6e8  # of the slopes of all pulses that are kept before they are reduced
TOLERANCE = 1e-6  # of a limit, over the size of what it limits
SEARCH_TIMES = 250  # times at which limits are kept in a search, at least; all count at its end


@dataclass(frozen=True, kw_only=True)
class ComingExperiment:
    """The coming experiment has the channels, the sensors and the noise of one that was recorded."""

    observation: Observation
    source: SourceLimits
    limits: tuple[RigLimit, ...] = ()

    @classmethod
    def like(
        cls, observation: Observation, source: SourceLimits, limits: tuple[RigLimit, ...]
    ) -> ComingExperiment:
        """Return the experiment with another input; further measured inputs are held at their means.

        Constant inputs stay, and series are added to them, as in `SensitivityStudy`.
        """
        recorded, t = observation.experiment, source.t
        steady = {name: float(np.mean(u)) for name, u in recorded.series.items()}
        constant = {**recorded.constant, **steady}
        model = observation.response.model
        experiment = dataclasses.replace(
            recorded, t=frozen(t), y=frozen(np.zeros((len(t), len(recorded.channels)))),
            constant=constant, series={name: np.zeros(len(t)) for name in model.inputs},
            first_order=False, t_start=0.0, told=(), odd=(), held_out=None, input_steps={},
        )  # fmt: skip
        assert observation.space is not None
        coming = observation.for_record(experiment).bind(observation.space)
        return cls(observation=coming, source=source, limits=limits)

    def posterior(self, *batch: Array) -> Posterior:
        """Return the posterior of records with these waveforms, whose samples are zero."""
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
    def _shown(self) -> Experiment:
        states = self.observation.response.model.states
        return with_states(self.observation.experiment, states, alone=self._states_alone)

    def _with_channels(self, shown: Array) -> Array:
        """Return channels and states of what a simulator of `_shown` gives."""
        if not self._states_alone:
            return shown
        states = self.observation.response.model.states
        return channels_first(self.observation.experiment, states, shown)

    def _driven(self, experiment: Experiment, levels: Array) -> Experiment:
        added = self.source.series(levels) - experiment.constant.get(self.source.input, 0.0)
        series = {**experiment.series, self.source.input: frozen(added)}
        return dataclasses.replace(experiment, series=series)

    def _simulator(self, levels: Array) -> Simulator:
        return self.observation.response.of(self._driven(self._shown, levels))

    @cached_property
    def _limited(self) -> Array:
        """Return weights `(K + X, L)` of channels and states in the limited sums."""
        channels = len(self.observation.experiment.channels)
        out = np.zeros((channels + len(self.observation.response.model.states), len(self.limits)))
        for column, limit in enumerate(self.limits):
            for name, weight in limit.weights.items():
                out[channels + self.observation.response.model.states.index(name), column] = weight
        return out

    def simulate(self, theta: Array, levels: Array) -> tuple[Array, Array]:
        """Return channels `(W, T, K)` and limited sums `(W, T, L)` at `theta (W, D)`."""
        assert self.observation.space is not None
        full = self.observation.simulator_parameters(self.observation.space.full(theta))
        both = self._with_channels(self._simulator(levels).signals(full))
        return both[:, :, : len(self.observation.experiment.channels)], both @ self._limited

    def course(self, theta: Array, levels: Array) -> tuple[Array, Array]:
        """Return slopes `(W, m, T, K)` by unknowns on natural scales, and limited sums `(W, T, L)`."""
        space = self.observation.space
        assert space is not None
        chosen = self.observation.simulator_parameters
        at = chosen(space.full(theta)), chosen(space.slopes(theta))
        signals, slopes = map(self._with_channels, self._simulator(levels).course(*at))
        channels = len(self.observation.experiment.channels)
        return slopes[..., :channels], signals @ self._limited

    def whitened(self, slopes: Array, theta: Array) -> Array:
        """Return slopes `(n, T, K)` over the noise at `theta (D,)`, as `(n, T K)`."""
        rows = self.observation.whitened_jacobian_at(slopes, theta)
        return np.asarray(rows.reshape(len(rows), -1))


def excess(limited: Array, limits: tuple[RigLimit, ...]) -> Array:
    """Return by how much limited sums `(..., L)` are beyond their ends; negative below the lower one."""
    low = np.array([limit.low for limit in limits])
    high = np.array([limit.high for limit in limits])
    return np.asarray(np.maximum(limited - high, 0.0) + np.minimum(limited - low, 0.0))


@dataclass(frozen=True, kw_only=True)
class TargetCovariance:
    """Covariances follow from `slopes (W, k, m)` of targets, and `precision (W, m, m)` before."""

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
    """The evaluation of a linear rig adds the slopes of pulses, times their levels, to those at rest."""

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
        self._roots, limited = (np.concatenate(each) for each in zip(*parts, strict=True))
        drive = max(abs(coming.source.low), abs(coming.source.high))
        end = limited[..., 0] + drive * limited[..., 1:].sum(axis=-1)
        self._size = np.maximum(np.abs(end).max(axis=(0, 1), initial=0.0), 1e-300)
        self._limited = limited / self._size[:, None]

    def with_first(self, draws: int) -> SuperposedPulses:
        """Return the evaluation of the first draws alone, which is faster."""
        fewer = copy.copy(self)
        fewer._roots, fewer._limited = self._roots[:draws], self._limited[:draws]
        slopes, precision = self.targets.slopes[:draws], self.targets.precision[:draws]
        fewer.targets = TargetCovariance(slopes=slopes, precision=precision)
        return fewer

    def _reduce(self, theta: Array) -> tuple[Array, Array]:
        """Return roots `(W, R m, S + 1)` of slopes, and limited sums `(W, t, L, S + 1)`."""
        coming, count = self.coming, self.coming.source.count
        still, levels = coming.course(theta, np.zeros(count)), np.eye(count)
        courses = [still, *(coming.course(theta, level) for level in levels)]
        thin = max(1, coming.source.samples_of_level // max(1, SEARCH_TIMES // count))
        rows, limited = [], []
        for number, (slopes, sums) in enumerate(courses):
            base, base_sums = still if number else (0.0, 0.0)
            rows.append([coming.whitened(x, p) for x, p in zip(slopes - base, theta, strict=True)])
            limited.append((sums - base_sums)[:, thin::thin])
        tall = np.stack([np.stack(each, axis=0) for each in rows], axis=1)  # (W, S + 1, m, T K)
        tall = tall.reshape(len(theta), -1, tall.shape[-1]).swapaxes(1, 2)
        reduced = np.stack([np.linalg.qr(each, mode="r") for each in tall])
        reduced = reduced.reshape(len(theta), -1, count + 1, self._m).swapaxes(2, 3)
        return (
            np.ascontiguousarray(reduced).reshape(len(theta), -1, count + 1),
            np.stack(limited, axis=-1),
        )

    def _root(self, levels: Array) -> Array:
        rows = self._roots @ np.append(1.0, levels)
        return np.asarray(rows.reshape(len(self._roots), -1, self._m))

    def information(self, levels: Array) -> Array:
        """Return the information `(W, m, m)` of a waveform at each draw."""
        root = self._root(levels)
        return np.asarray(root.swapaxes(1, 2) @ root)

    def value_and_slope(self, levels: Array) -> tuple[float, Array]:
        """Return the criterion and its derivative by the levels, `(S,)`."""
        root = self._root(levels)
        value, pull = self.targets.criterion(root.swapaxes(1, 2) @ root)
        flat = (root @ pull).reshape(len(root), 1, -1)
        return value, -2.0 * (flat @ self._roots)[:, 0].sum(axis=0)[1:]

    def search_excess(self, levels: Array) -> Array:
        """Return `excess` over the size of each limited sum at the draws of the search, `(W, t, L)`."""
        sums = (self._limited @ np.append(1.0, levels)) * self._size
        return np.asarray(excess(sums, self.coming.limits) / self._size)

    def penalty(self, levels: Array) -> tuple[float, Array]:
        """Return the sum of squares of `search_excess`, and its derivative by the levels, `(S,)`."""
        beyond = self.search_excess(levels)
        where = np.nonzero(beyond)
        amounts = beyond[where]
        return float(amounts @ amounts), 2.0 * (amounts @ self._limited[where])[1:]


class SimulatedSlopes:
    """The evaluation of a rig with friction simulates each waveform at each draw, with its slopes."""

    def __init__(self, coming: ComingExperiment, theta: Array, targets: TargetCovariance) -> None:
        self.coming, self.targets, self._theta = coming, targets, theta
        drive = max(coming.source.low, coming.source.high, key=abs)
        limited = coming.simulate(theta, np.full(coming.source.count, drive))[1]
        self._size = np.maximum(np.abs(limited).max(axis=(0, 1), initial=0.0), 1e-300)
        self._last: tuple[bytes, Array, Array] | None = None

    def _evaluate(self, levels: Array) -> tuple[Array, Array]:
        key = levels.tobytes()
        if self._last is None or self._last[0] != key:
            slopes, limited = self.coming.course(self._theta, levels)
            pairs = zip(slopes, self._theta, strict=True)
            rows = np.stack([self.coming.whitened(x, point) for x, point in pairs])
            self._last = key, rows @ rows.swapaxes(1, 2), limited
        return self._last[1:]

    def information(self, levels: Array) -> Array:
        """Return the information `(W, m, m)` of a waveform at each draw."""
        return self._evaluate(levels)[0]

    def search_excess(self, levels: Array) -> Array:
        """Return `excess` over the size of each limited sum at the draws of the search, `(W, T, L)`."""
        return np.asarray(excess(self._evaluate(levels)[1], self.coming.limits) / self._size)


Evaluation = SuperposedPulses | SimulatedSlopes  # knows what each waveform would show
