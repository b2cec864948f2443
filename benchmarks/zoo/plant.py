"""A rig at its true values, one step at a time, for what is decided while it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.records import simulation
from bayesdrill.rig.models.linear import dynamics

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """`x` after a step: `keep @ x + shift + begin * v + rise * (change of v)`."""

    states: tuple[str, ...]
    first_order: bool
    keep: Array
    shift: Array
    begin: Array
    rise: Array

    @classmethod
    def of(cls, case: ResolvedCase, dt: float) -> Self:
        """Without a load; exact for a voltage that is held, or goes straight, for `dt` [s]."""
        (one,), model = case.experiments, case.model
        linear = model.linear(simulation.truth(one))
        n = len(model.states)
        whole = np.zeros((n + 3, n + 3))  # and: one, the voltage, its change in a step
        whole[:n, :n] = dynamics(linear, model.states, 1)[0]
        for k, state in enumerate(model.states):
            whole[k, n] = linear.c.get(state, 0.0)
            whole[k, n + 1] = linear.B.get((state, "v"), 0.0)
        whole[n + 1, n + 2] = 1.0 / dt
        after = expm(whole * dt)
        measured = case.config.measured_inputs
        return cls(
            states=model.states,
            first_order=any(spec.hold == "first" for spec in measured.values()),
            keep=after[:n, :n],
            shift=after[:n, n],
            begin=after[:n, n + 1],
            rise=after[:n, n + 2],
        )

    def rest(self) -> Array:
        return np.zeros(len(self.states))

    def step(self, x: Array, begin: float, end: float) -> Array:
        """From `x`, with a voltage that goes from `begin` to `end`."""
        return self.keep @ x + self.shift + self.begin * begin + self.rise * (end - begin)
