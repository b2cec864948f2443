"""A rig with dry friction that changes its sign, which the model of the package has not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.records import simulation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DryFriction:
    """Torques [N m]: `motor` at its own side of the gear, at rotor 1 `sliding`, and `sticking` at
    rest, between which it falls as exp(-|w_1| / `fading` [rad/s]).

    Integrated in equal parts of a sample, the speeds first, from rest.  Friction is the torque that
    would stop the speed within the part, as far as it goes.
    """

    motor: float = 0.0
    sliding: float = 0.0
    sticking: float = 0.0
    fading: float = 1.0
    parts: int = 40

    def measured(
        self, case: ResolvedCase, t: Array, v: Array, rng: np.random.Generator
    ) -> dict[str, Array]:
        """The columns of the channels of a case, with their noise, under the voltage `v (T,)`."""
        (one,), rig = case.experiments, case.model
        x = self.states(rig.i_m, simulation.truth(one), t, v)  # type: ignore[attr-defined]
        columns = {}
        for entry, spec in zip(one.channels, case.config.record.channels.values(), strict=True):
            clean = sum(
                weight * x[:, rig.states.index(state)]
                for state, weight in entry.channel.weights.items()
            )
            noise = entry.sigma * rng.standard_normal(len(t))  # type: ignore[operator]
            columns[str(spec.column)] = (clean + noise) / entry.channel.factor
        return columns

    def states(self, i_m: float, p: dict[str, float], t: Array, v: Array) -> Array:
        """`(T, 5)`: theta_1, theta_2, w_1, w_2, i; `t_f` of `p` counts for nothing."""
        h = float(t[1] - t[0]) / self.parts
        j_1, j_2 = p["j_1"], p["j_m"] / i_m**2  # both as the shaft sees them
        theta_1 = theta_2 = w_1 = w_2 = i = 0.0
        out = np.zeros((len(t), 5))
        for k in range(len(t)):
            out[k] = theta_1, theta_2, w_1, w_2, i
            for _ in range(self.parts):
                twist = p["k_s"] * (theta_1 - theta_2)
                force = twist + (p["k_T"] * i - p["c_m"] * w_2 / i_m) / i_m
                rise = v[k] - p["k_e"] * w_2 / i_m - p["r_m"] * i
                w_1 += h / j_1 * (-twist - _stopping(j_1 * w_1 / h - twist, self._bit(w_1)))
                w_2 += h / j_2 * (force - _stopping(j_2 * w_2 / h + force, self.motor / i_m))
                i += h * rise / p["l_m"]
                theta_1 += h * w_1
                theta_2 += h * w_2
        return out

    def _bit(self, w_1: float) -> float:
        fading = math.exp(-abs(w_1) / self.fading)
        return self.sliding + (self.sticking - self.sliding) * fading


def _stopping(torque: float, limit: float) -> float:
    return min(max(torque, -limit), limit)
