"""Records with a latent torque: filtered, smoothed and drawn, all walkers at once.

What is left of a record, over the response without the torque, is a state that is zero at the start
and that the torque moves; the torque is as large at the start as ever.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.kernels.compiling import HIGH_OPT_LEVEL, Kernel, compile_kernel
from bayesdrill.rig.kernels.exponential import Layout, weight_kinds
from bayesdrill.rig.kernels.kalman_filter import BLOCKS, StateSpace, smoother_size, write_filter
from bayesdrill.rig.kernels.lanes import LANES
from bayesdrill.rig.kernels.steady_state_kalman import BLOCK_SAMPLES, write_steady_state
from bayesdrill.rig.kernels.steady_state_kalman import BLOCKS as STEADY_BLOCKS
from bayesdrill.rig.models.latent_torque import MissingTorque, Pushed, pushed
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.simulators.contract import in_groups
from bayesdrill.rig.simulators.exact import constant_block, layout

CLOCK = 1e-9  # of the usual step: what steps may differ by and be one
MOST_STEPS = 64  # lengths of steps, each with matrices of its own
NONE = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Steps:
    """`node (T,)`: which of `spans (M,)` leads from a sample to the next; `lead`: whether the last of
    them leads from the start to the first sample.
    """

    spans: Array
    node: NDArray[np.int64]
    lead: bool


def steps_of(experiment: Experiment) -> Steps:
    """Raises `ValueError` where they have too many lengths."""
    t = np.asarray(experiment.t)
    if experiment.uniform:
        spans, node = np.array([experiment.dt]), np.zeros(len(t), np.int64)
    else:
        steps = np.diff(t)
        usual = float(np.median(steps))
        spans, one = np.unique(np.round(steps / (CLOCK * usual)), return_inverse=True)
        spans, node = spans * CLOCK * usual, np.append(one, 0).astype(np.int64)
        if len(spans) > MOST_STEPS:
            raise ValueError(
                f"its samples are {len(spans)} different lengths of time apart, and a missing torque "
                f"allows for {MOST_STEPS}; give `record.time: {{rate: ...}}` where only its clock "
                "trembles, or put the record on a grid of times"
            )
    ahead = float(t[0] - experiment.t_start)
    if ahead > 0.0:
        spans = np.append(spans, ahead)
    return Steps(np.ascontiguousarray(spans), node, ahead > 0.0)


@dataclass(frozen=True)
class Filtered:
    """`parameters (W, P + 2)`: of the rig, then size and time of its missing torque; `sigmas (W, K)` of
    white noise; `left (W, T, K)`: measured minus model, NaN where nothing was measured.
    """

    model: Model
    torque: MissingTorque
    experiment: Experiment

    def __getstate__(self) -> dict[str, Any]:
        """Without what is compiled."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @cached_property
    def pushed(self) -> Pushed:
        weights = [channel.weights for channel in self.experiment.channels]
        return pushed(self.model, self.torque, weights)

    @cached_property
    def system(self) -> StateSpace:
        return StateSpace(self.pushed, weight_kinds(self.weights))

    @cached_property
    def weights(self) -> Array:
        """Of channels, `(K, n)`."""
        return np.array([self.pushed.shown(c.weights) for c in self.experiment.channels])

    @cached_property
    def steps(self) -> Steps:
        return steps_of(self.experiment)

    @cached_property
    def _shared(self) -> dict[str, Array | NDArray[np.int64]]:
        seen = np.ascontiguousarray(self.experiment.seen, dtype=np.float64)
        same = np.zeros(len(seen), np.int64)
        same[1:] = (seen[1:] == seen[:-1]).all(axis=1) & (
            self.steps.node[1:] == self.steps.node[:-1]
        )
        return {
            "seen": seen,
            "node": self.steps.node,
            "same": same,
            "spans": self.steps.spans,
            "weights": self.weights,
        }

    def log_density(self, parameters: Array, sigmas: Array, record: tuple[int, int]) -> Array:
        """Of the `Simulator.record` that lies there: `(W, K)`, what the start is worth shared by all
        channels alike.
        """
        k, t_count = self.system.k, len(self.experiment.t)
        told = in_groups(parameters, sigmas**2)
        out = np.empty((2 * k + 1, len(told) * LANES))
        (y, u), (_, shown) = record, self._shown
        places = {"told": told.ctypes.data, "constants": self._constants[1], "y": y, "u": u}
        places |= {"shown": shown, "out": out.ctypes.data}
        blocks = [places[name] for name in STEADY_BLOCKS]
        self._steadily["steadily"](len(told), t_count, *blocks)
        logs = np.log(out[k:])
        spread = t_count * (logs[:k] + 0.5 * math.log(2 * math.pi)) + logs[k] / (2 * k)
        return np.asarray((out[:k] - spread)[:, : len(parameters)].T)

    @cached_property
    def _shown(self) -> tuple[Array, int]:
        """Scratch, and its address."""
        made = np.empty(((len(self.experiment.t) // BLOCK_SAMPLES + 1) * self.system.n, LANES))
        return made, made.ctypes.data

    @cached_property
    def _steadily(self) -> Kernel:
        return compile_kernel(write_steady_state, self.system, self._layout, effort=HIGH_OPT_LEVEL)

    @cached_property
    def _layout(self) -> Layout:
        found = layout(self.pushed, self.experiment)
        return dataclasses.replace(found, channels=self.system.channels)

    @cached_property
    def _constants(self) -> tuple[Array, int]:
        """What the kernel is told of the experiment, and its address."""
        start = self.pushed.begun(self.experiment.start)
        made = constant_block(self.experiment, start, self.weights)
        return made, made.ctypes.data

    def whiten(self, parameters: Array, sigmas: Array, left: Array) -> tuple[Array, Array]:
        """Independent standard normal numbers `(W, T, K)`, NaN where nothing was seen, and the variances
        `(W, T, K)` of one sample given those before it.
        """
        found = self._run("whiten", [parameters], [sigmas**2], [self._given(left)], 2)
        return self._hidden(found[..., 0]), found[..., 1]

    def slopes(
        self,
        parameters: tuple[Array, Array],
        sigmas: tuple[Array, Array],
        left: tuple[Array, Array],
    ) -> tuple[Array, Array, Array, Array]:
        """Of pairs (value, slope): the whitened, its slope, the variances, their slope, `(W, T,
        K)` each; zero where nothing was seen.
        """
        sizes, changes = sigmas
        variances = [sizes**2, 2.0 * sizes * changes]
        rests = [self._given(one) for one in left]
        found = self._run("slopes", list(parameters), variances, rests, 4)
        return found[..., 0], found[..., 1], found[..., 2], found[..., 3]

    def smooth(self, parameters: Array, sigmas: Array, left: Array) -> Array:
        """What all samples say of the states of `pushed`: `(W, T, n)`; the torque's over its size."""
        return self._run("smooth", [parameters], [sigmas**2], [self._given(left)], 0)

    def draw(
        self, parameters: Array, sigmas: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """States `(W, T, n)`, and what channels show of them with their noise `(W, T, K)`."""
        shape = (len(parameters), len(self.experiment.t), self.system.n + self.system.k)
        found = self._run("draw", [parameters], [sigmas**2], [rng.standard_normal(shape)], 0)
        return found[..., : self.system.n], found[..., self.system.n :]

    def _given(self, left: Array) -> Array:
        return np.where(self.experiment.seen, left, 0.0)

    def _hidden(self, samples: Array) -> Array:
        samples[:, ~self.experiment.seen] = np.nan
        return samples

    def _run(
        self,
        name: str,
        parameters: list[Array],
        variances: list[Array],
        left: list[Array],
        each: int,
    ) -> Array:
        """`each`: numbers of a channel that come out; zero for states (and channels)."""
        system, width = self.system, len(parameters)
        n_walkers, t_count = len(parameters[0]), len(self.experiment.t)
        columns = system.k * each if each else system.n + (system.k if name == "draw" else 0)
        rows = _in_turn(left)
        out = np.empty((len(rows), t_count * columns, LANES))
        blocks: dict[str, Any] = self._shared | {
            "parameters": _in_turn(parameters),
            "variances": _in_turn(variances),
            "left": rows,
            "table": np.empty((len(self.steps.spans) * 2 * system.n**2 * width, LANES)),
            "kept": np.empty((t_count * smoother_size(system), LANES))
            if name == "smooth"
            else NONE,
            "out": out,
        }
        counts = (len(out), t_count, len(self.steps.spans), int(self.steps.lead))
        kernel = compile_kernel(write_filter, system, name)
        kernel[name](*counts, *(blocks[block].ctypes.data for block in BLOCKS))
        made = out.transpose(0, 2, 1).reshape(-1, t_count, columns)[:n_walkers]
        return np.ascontiguousarray(made.reshape(n_walkers, t_count, -1, each) if each else made)


def _in_turn(parts: list[Array]) -> Array:
    """Values `(W, ...)` and their slopes, in turn, in groups."""
    return in_groups(np.stack(parts, axis=-1))
