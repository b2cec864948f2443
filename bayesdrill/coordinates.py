"""Coordinates in which the sampler walks, and their Jacobians.

All unknowns are positive.  `physical` walks in the unknowns themselves, `log` in their logs, and
`modal` in what the model's chart makes of the logs, which straightens the ridges of the posterior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesdrill.models.linear import Chart

Array = NDArray[np.float64]


class Coordinates(Protocol):
    """`z` and `theta` are `(W, D)`; the Jacobian is log |d theta / d z|, `(W,)`.

    Coordinates that belong to no positive unknowns give NaN.
    """

    def from_physical(self, theta: Array) -> Array: ...

    def to_physical(self, z: Array) -> Array: ...

    def with_jacobian(self, z: Array) -> tuple[Array, Array]: ...


@dataclass(frozen=True, slots=True)
class Physical:
    def from_physical(self, theta: Array) -> Array:
        return theta

    def to_physical(self, z: Array) -> Array:
        return z

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        return z, np.zeros(len(z))


@dataclass(frozen=True, slots=True)
class Log:
    def from_physical(self, theta: Array) -> Array:
        return np.log(theta)

    def to_physical(self, z: Array) -> Array:
        return self.with_jacobian(z)[0]

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        with np.errstate(over="ignore"):
            return np.exp(z), z.sum(axis=-1)


@dataclass(frozen=True, slots=True)
class Modal:
    """The chart acts on the logs of the first `n_charted` unknowns, the rest are plain logs."""

    chart: Chart
    n_charted: int

    def from_physical(self, theta: Array) -> Array:
        logs = np.log(theta)
        logs[:, : self.n_charted] = self.chart.straighten(logs[:, : self.n_charted])
        return logs

    def to_physical(self, z: Array) -> Array:
        return self.with_jacobian(z)[0]

    def with_jacobian(self, z: Array) -> tuple[Array, Array]:
        logs = z.copy()
        with np.errstate(all="ignore"):
            logs[:, : self.n_charted], log_det = self.chart.bend(z[:, : self.n_charted])
            return np.exp(logs), logs.sum(axis=-1) + log_det


def choose(name: str, chart: Chart | None, n_charted: int) -> Coordinates:
    """The coordinates called `name`; `auto` is modal where the model brings a chart, else log."""
    if name == "auto":
        name = "log" if chart is None else "modal"
    return COORDINATES[name](chart, n_charted)


def _modal(chart: Chart | None, n_charted: int) -> Modal:
    if chart is None:
        raise ValueError("modal coordinates need a model that brings a chart")
    return Modal(chart, n_charted)


COORDINATES: Mapping[str, Callable[[Chart | None, int], Coordinates]] = MappingProxyType(
    {
        "physical": lambda chart, n: Physical(),
        "log": lambda chart, n: Log(),
        "modal": _modal,
    }
)
