"""Filter, smooth and draw records with a latent torque, for all walkers (parameter sets) at once.

Residuals are the record minus the response without the torque. They follow from a state of the rig that
is zero at the start and driven only by the torque. The torque begins with its stationary variance.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import HIGH_OPT_LEVEL, BoundFunction, compile_kernel
from bayesdrill.rig.kernels.exponential import present
from bayesdrill.rig.kernels.kalman_filter import StateSpace, smoother_size, write_filter
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.steady_state_kalman import BLOCK_SAMPLES, write_steady_state
from bayesdrill.rig.models.latent_torque import AugmentedModel, MissingTorque, augment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import in_groups
from bayesdrill.rig.simulators.long_record import input_layout

CLOCK_TOLERANCE = 1e-9  # relative to the median step: steps with a smaller difference are equal
MAX_STEP_LENGTHS = 64  # largest number of distinct step lengths; each needs its own matrices


@dataclass(frozen=True, slots=True)
class StepLengths:
    """Step lengths are the distinct lengths of the steps between samples.

    `node (T,)` is the index in `spans (M,)` of the step from each sample to the next. If `lead` is
    true, the last span is the step from the start to the first sample.
    """

    spans: Array
    node: NDArray[np.int64]
    lead: bool


def step_lengths(experiment: Experiment) -> StepLengths:
    """Return the distinct step lengths of an experiment; raises `ValueError` if they are too many."""
    t = np.asarray(experiment.t)
    if experiment.uniform:
        spans, node = np.array([experiment.dt]), np.zeros(len(t), np.int64)
    else:
        steps = np.diff(t)
        median = float(np.median(steps))
        spans, step_of = np.unique(
            np.round(steps / (CLOCK_TOLERANCE * median)), return_inverse=True
        )
        spans, node = spans * CLOCK_TOLERANCE * median, np.append(step_of, 0).astype(np.int64)
        if len(spans) > MAX_STEP_LENGTHS:
            raise ValueError(
                f"the steps between its samples have {len(spans)} different lengths; a missing torque "
                f"allows at most {MAX_STEP_LENGTHS}. Give `record.time: {{rate: ...}}` if only the "
                "clock jitters, or put the record on a grid of times"
            )
    ahead = experiment.lead
    if ahead > 0.0:
        spans = np.append(spans, ahead)
    return StepLengths(np.ascontiguousarray(spans), node, ahead > 0.0)


@dataclass(frozen=True)
class KalmanFilter:
    """The filter processes the residuals of a rig with a missing torque.

    `parameters (W, P + 2)` are those of the rig, then size and correlation time of the torque.
    `sigmas (W, K)` are the sds of white noise. `residuals (W, T, K)` are measured minus model, NaN
    where nothing was measured.
    """

    model: Model
    torque: MissingTorque
    experiment: Experiment

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without compiled kernels, for pickling."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @cached_property
    def augmented(self) -> AugmentedModel:
        """Return the rig with its torque."""
        weights = [channel.weights for channel in self.experiment.channels]
        return augment(self.model, self.torque, weights)

    @cached_property
    def system(self) -> StateSpace:
        """Return the state-space model for which kernels are specialised."""
        rows = self.output_matrix.tolist()
        known = (tuple(w if w in {-1.0, 0.0, 1.0} else None for w in row) for row in rows)
        return StateSpace(self.augmented, tuple(known))

    @cached_property
    def output_matrix(self) -> Array:
        """Return the weights of states in channels, `(K, n)`."""
        return np.array(
            [self.augmented.channel_weights(c.weights) for c in self.experiment.channels]
        )

    @cached_property
    def steps(self) -> StepLengths:
        """Return the step lengths of the experiment."""
        return step_lengths(self.experiment)

    @cached_property
    def _shared(self) -> dict[str, Array | NDArray[np.int64]]:
        observed = np.ascontiguousarray(self.experiment.is_measured, dtype=np.float64)
        same = np.zeros(len(observed), np.int64)
        same[1:] = (observed[1:] == observed[:-1]).all(axis=1) & (
            self.steps.node[1:] == self.steps.node[:-1]
        )
        return {
            "seen": observed,
            "node": self.steps.node,
            "same": same,
            "spans": self.steps.spans,
            "weights": self.output_matrix,
        }

    def log_density(self, parameters: Array, sigmas: Array, record: Mapping[str, Array]) -> Array:
        """Return the log-density `(W, K)` of the channels in `record`; see `Simulator.record`.

        The contribution of the start is divided equally among channels.
        """
        k, t_count = self.system.k, len(self.experiment.t)
        walkers = in_groups(parameters, sigmas**2)
        out = np.empty((2 * k + 1, len(walkers) * LANES))
        self._steady_state(groups=len(walkers), told=walkers, out=out, **record)
        logs = np.log(out[k:])
        spread = t_count * (logs[:k] + 0.5 * math.log(2 * math.pi)) + logs[k] / (2 * k)
        return np.asarray((out[:k] - spread).T)[: len(parameters)]

    @cached_property
    def _steady_state(self) -> BoundFunction:
        experiment, t_count = self.experiment, len(self.experiment.t)
        layout = input_layout(self.augmented, experiment)
        kernel = compile_kernel(write_steady_state, self.system, layout, effort=HIGH_OPT_LEVEL)
        scratch = np.empty(((t_count // BLOCK_SAMPLES + 1) * self.system.n, LANES))
        return kernel.bind(
            "steadily", samples=t_count, lead=int(experiment.lead > 0.0),
            spans=np.array([experiment.dt, experiment.lead]), weights=self.output_matrix,
            constants=np.array([*present(experiment.constant).values()]),
            start=np.array(self.augmented.initial_state(experiment.start)), shown=scratch,
        )  # fmt: skip

    def whiten(self, parameters: Array, sigmas: Array, residuals: Array) -> tuple[Array, Array]:
        """Return whitened residuals `(W, T, K)` and the variances `(W, T, K)` of innovations.

        Whitened residuals are independent standard normal numbers, NaN where nothing was observed.
        Each variance is that of a sample given all previous samples.
        """
        filtered = self._run("whiten", [parameters], [sigmas**2], [self._filled(residuals)], 2)
        whitened, variances = filtered[..., 0], filtered[..., 1]
        whitened[:, ~self.experiment.is_measured] = np.nan
        return whitened, variances

    def slopes(
        self,
        parameters: tuple[Array, Array],
        sigmas: tuple[Array, Array],
        residuals: tuple[Array, Array],
    ) -> tuple[Array, Array, Array, Array]:
        """Return whitened residuals and variances, each followed by its derivative, `(W, T, K)`.

        Arguments are pairs (value, derivative). Results are zero where nothing was observed.
        """
        sizes, changes = sigmas
        variances = [sizes**2, 2.0 * sizes * changes]
        filled = [self._filled(pair) for pair in residuals]
        filtered = self._run("slopes", list(parameters), variances, filled, 4)
        return filtered[..., 0], filtered[..., 1], filtered[..., 2], filtered[..., 3]

    def smooth(self, parameters: Array, sigmas: Array, residuals: Array) -> Array:
        """Return smoothed states of `augmented`, `(W, T, n)`; the torque is divided by its size."""
        return self._run("smooth", [parameters], [sigmas**2], [self._filled(residuals)], 0)

    def draw(
        self, parameters: Array, sigmas: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Draw states `(W, T, n)`, and channels `(W, T, K)` that include their noise."""
        shape = (len(parameters), len(self.experiment.t), self.system.n + self.system.k)
        drawn = self._run("draw", [parameters], [sigmas**2], [rng.standard_normal(shape)], 0)
        return drawn[..., : self.system.n], drawn[..., self.system.n :]

    def _filled(self, residuals: Array) -> Array:
        return np.where(self.experiment.is_measured, residuals, 0.0)

    def _run(
        self,
        name: str,
        parameters: list[Array],
        variances: list[Array],
        residuals: list[Array],
        each: int,
    ) -> Array:
        """Run a kernel; return `each` numbers per channel or, if `each` is 0, states (and channels)."""
        system, width = self.system, len(parameters)
        n_walkers, t_count = len(parameters[0]), len(self.experiment.t)
        columns = system.k * each if each else system.n + (system.k if name == "draw" else 0)
        smooths, steps = name == "smooth", len(self.steps.spans)
        function = compile_kernel(write_filter, system, name).bind(name, **self._shared)
        samples = function.run(
            n_walkers, (t_count, columns), samples=t_count, steps=steps, lead=int(self.steps.lead),
            parameters=_in_turn(parameters), variances=_in_turn(variances),
            left=_in_turn(residuals), table=np.empty((steps * 2 * system.n**2 * width, LANES)),
            kept=np.empty((t_count * smoother_size(system), LANES)) if smooths else 0,
        )  # fmt: skip
        return samples.reshape(n_walkers, t_count, -1, each) if each else samples


def _in_turn(parts: list[Array]) -> Array:
    """Interleave values `(W, ...)` with their derivatives, and arrange them in groups of lanes."""
    return in_groups(np.stack(parts, axis=-1))
