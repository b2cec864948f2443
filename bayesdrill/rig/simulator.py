"""The contract of a simulator: what the channels of one experiment do at given parameters of a rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.sensing import Sensing

Array = NDArray[np.float64]


class Simulator(Protocol):
    """Parameters are `full (W, P)`, columns in the order of `parameters`, SI: those of the `model`, then
    those of sensors and start.  All is batch-first, and a walker whose numbers overflow gets NaN in its
    own row alone.
    """

    @property
    def parameters(self) -> tuple[str, ...]: ...

    @property
    def model(self) -> Model: ...

    @property
    def experiment(self) -> Experiment: ...

    @property
    def sensing(self) -> Sensing:
        """What it is told beside the rig's parameters."""
        ...

    def signals(self, full: Array) -> Array:
        """The channels without noise, `(W, T, K)`."""
        ...

    def squares(self, full: Array) -> Array:
        """Sums of squared residuals `(W, K)`, without a sample kept."""
        ...

    def neighbours(self, full: Array) -> Array:
        """Of residuals, likewise: `(W, K, 4)` sums of their squares and of products of those seen one
        after the other, the last and the first.
        """
        ...

    def logs(self, full: Array, weights: Array) -> Array:
        """Sums `(W, K)` of log(1 + weight times squared residual), with `weights (W, K)`."""
        ...

    def intervals(self, full: Array, over: Array, half: Array) -> Array:
        """Sums `(W, K)` of logs of the probability that a standard normal number is within `half (W, K)`
        of the residual times `over (W, K)`; `half` at least 0.2.
        """
        ...

    def sensitivities(self, full: Array, along: Array) -> Array:
        """d signal along q directions `(W, q, P)` in the space of parameters: `(W, q, T, K)`."""
        ...

    def normal(self, full: Array, along: Array, scales: Array) -> tuple[Array, Array, Array]:
        """As sums, all times `scales (W, K)`: squares of residuals `(W, K)`, their products with
        sensitivities `(W, q)`, and those of sensitivities with each other `(W, q, q)`.
        """
        ...

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        """Signals and sensitivities at once; q at least 1."""
        ...

    def of(self, experiment: Experiment) -> Simulator:
        """Of another experiment with the same sensors, which may have further channels."""
        ...

    def with_record(self, y: Array) -> Self:
        """The same experiment with another record `(T, K)`."""
        ...

    def with_series(self, series: Mapping[str, Array]) -> Self:
        """The same experiment under other measured inputs."""
        ...
