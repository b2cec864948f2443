"""The paper's rig and two things that its model leaves out, both known constants.

j_2   inertia at the output side of the gearbox: rotor 2, the gear, the coupling
r_s   resistance in series with the motor: driver, leads, brushes

    l_m i' + (r_m + r_s) i + k_e theta_3' = v
    j_m theta_3'' + c_m theta_3' - k_T i + t_f = -i_m t_2
    t_2 = k_s (theta_2 - theta_1) + j_2 theta_2''              theta_2 = i_m theta_3
    j_1 theta_1'' + k_s (theta_1 - theta_2) = -t_1

Times i_m, the second equation with the third in it has (j_m + i_m^2 j_2) theta_2'': the rig is a
`motor_shaft` with that inertia and with the resistance r_m + r_s.  So a record shows no more of it:
both scales of a `motor_shaft` stay open, though they are no common factors here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesdrill.formulas import Monomial
from bayesdrill.models.linear import NO_RELATIONS, Array, Chart, Linear, Named
from bayesdrill.models.motor_shaft import PARAMETERS, MotorShaft


@dataclass(frozen=True, slots=True)
class TwoRotors:
    """`i_m` as in `MotorShaft`; `j_2` [kg m^2] and `r_s` [ohm] may be zero."""

    i_m: float = 1 / 8
    j_2: float = 0.0
    r_s: float = 0.0

    name: ClassVar[str] = "two_rotors"
    parameters: ClassVar[tuple[str, ...]] = PARAMETERS
    states: ClassVar[tuple[str, ...]] = MotorShaft.states
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    def _added(self) -> dict[str, float]:
        """To the motor's own values, what the rest of the rig adds to them."""
        return {"j_m": self.i_m**2 * self.j_2, "r_m": self.r_s}

    def whole(self, p: Named) -> Named:
        """Parameters of the `motor_shaft` which this rig is."""
        return {**p, **{name: p[name] + constant for name, constant in self._added().items()}}

    def linear(self, p: Named) -> Linear:
        return MotorShaft(self.i_m).linear(self.whole(p))

    def chart(
        self,
        v: float,
        free: tuple[str, ...],
        fixed: Mapping[str, float],
        relations: Mapping[str, Monomial] = NO_RELATIONS,
    ) -> AddedChart:
        """That of the `motor_shaft` which this rig is.

        A parameter in a relation counts there as if nothing were added to it: still valid, but
        less straight.
        """
        added = self._added()
        whole = {name: value + added.get(name, 0.0) for name, value in fixed.items()}
        inner = MotorShaft(self.i_m).chart(v, free, whole, relations)
        return AddedChart(inner, tuple(added.get(name, 0.0) for name in free))


@dataclass(frozen=True, slots=True)
class AddedChart:
    """`inner`, taken of the logs of parameters plus constants `added` (m,); see `Chart`.

    Coordinates of a sum that is no larger than its constant belong to no positive parameter.
    """

    inner: Chart
    added: tuple[float, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        return self.inner.labels

    def straighten(self, logs: Array) -> Array:
        return self.inner.straighten(self._sums(logs))

    def bend(self, z: Array) -> tuple[Array, Array]:
        sums, log_det = self.inner.bend(z)
        logs = sums.copy()
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for column, constant in enumerate(self.added):
                if constant > 0:
                    own = -constant * np.exp(-sums[:, column])
                    logs[:, column] += np.where(own > -1.0, np.log1p(own), np.nan)
        return logs, log_det + (sums - logs).sum(axis=1)

    def _sums(self, logs: Array) -> Array:
        sums = logs.copy()
        for column, constant in enumerate(self.added):
            if constant > 0:
                sums[:, column] = np.logaddexp(logs[:, column], np.log(constant))
        return sums
