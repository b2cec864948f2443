"""Define the voltage of a servo with saturation, a dead band, and a goal whose speed is limited.

    wanted = supply duty (k_p (goal - angle) - k_d speed)       the voltage of a linear closed loop
    voltage = clip(wanted -+ dead, +-reach), and zero where |wanted| is below dead
    reach = supply limit,  dead = supply duty k_p band

The rig's `A` and `B` are those of the linear closed loop.  With the parameter `duty` at zero the loop
is open.  The column `name` of `B` is the effect of one additional volt on the rate of the state `row`.

A measured supply is an input.  The closed loop is then computed with the usual supply, and each voltage
is multiplied by the `level`, which is the measured supply divided by the usual supply.

If the firmware limits the speed of the goal, the servo follows a reference, which moves towards the goal
with at most the speed `speed`.  The reference replaces `goal` in the equations above.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import below, signed, size, where
from bayesdrill.rig.models.friction import Named


@dataclass(frozen=True, slots=True, kw_only=True)
class Saturation:
    """The fields name a servo's parameters and inputs (empty if absent), and its entry of `B`."""

    name: str
    row: str
    duty: str
    supply: str
    goal: str
    usual_supply: float = 0.0
    proportional: str = ""
    limit: str = ""
    band: str = ""
    speed: str = ""
    goal_gain: str = ""  # gain of the sensor of the goal, whose recorded speed `moved` limits

    def level(self, inputs: Mapping[str, Any]) -> Any:
        """Return the supply divided by its usual value; None if the supply is a parameter."""
        return inputs[self.supply] * (1.0 / self.usual_supply) if self.usual_supply else None

    def max_voltage(self, p: Named) -> Any:
        """Return the largest voltage at the usual supply, or None without a limit."""
        return (self.usual_supply or p[self.supply]) * p[self.limit] if self.limit else None

    def dead_band(self, p: Named) -> Any:
        """Return the wanted voltage below which the voltage is zero; None without a dead band."""
        if not self.band:
            return None
        dead: Any = (self.usual_supply or p[self.supply]) * p[self.duty] * p[self.band]
        return dead * p[self.proportional] if self.proportional else dead

    def is_linear(self, p: Named, wanted: Any) -> Any:
        """Return whether a `wanted` voltage is neither saturated nor in the dead band."""
        inner, reach, dead = size(wanted), self.max_voltage(p), self.dead_band(p)
        inner = inner if dead is None else inner - dead
        if reach is None:
            return below(-1.0 if dead is None else 0.0, inner)
        if dead is None:
            return below(inner, reach)
        return below(size(inner * 2.0 - reach), reach)  # 0 < inner < reach

    def voltage(self, p: Named, wanted: Any) -> Any:
        """Return the voltage for a `wanted` voltage, at the usual supply."""
        reach, dead, most = self.max_voltage(p), self.dead_band(p), size(wanted)
        if dead is not None:
            most = where(below(most, dead), 0.0, most - dead)
        if reach is not None:
            most = where(below(most, reach), most, reach)
        return signed(most, wanted)

    def moved(self, p: Named, span: Any, reference: Any, goal: Any) -> tuple[Any, Any]:
        """Return the reference after the time `span`, and its mean over `span`, for a constant goal."""
        most, gap = p[self.speed] * span, goal - reference
        most = most / size(p[self.goal_gain]) if self.goal_gain else most
        is_behind = below(most, size(gap))
        fraction = where(is_behind, 1.0, size(gap) / most)  # (time to reach the goal) / span
        step = signed(where(is_behind, most, size(gap)), gap)
        return reference + step, reference + step - step * fraction * 0.5

    def reference(self, p: Mapping[str, float], t: Array, goal: Array | float) -> Array | float:
        """Return the reference for a goal `(T,)` at times `t`; the goal if constant or unlimited."""
        if not self.speed or np.ndim(goal) == 0:
            return goal
        reference = [float(goal[0])]  # type: ignore[index]
        for most, aim in zip(p[self.speed] * np.diff(t), goal[:-1], strict=True):  # type: ignore[index]
            reference.append(reference[-1] + max(-most, min(most, aim - reference[-1])))
        return np.array(reference)

    def wanted(self, linear: Any, p: Named, values: Mapping[str, Any]) -> Any:
        """Return the wanted voltage at `values`: (closed minus open loop) / (rate per volt)."""
        closed, opened = linear(p), linear({**p, self.duty: 0.0})
        total: Any = closed.c.get(self.row, 0.0) - opened.c.get(self.row, 0.0)
        for part in ("A", "B"):
            here, there = getattr(closed, part), getattr(opened, part)
            for row, column in (key for key in here if key[0] == self.row and key[1] in values):
                total = total + (here[row, column] - there[row, column]) * values[column]
        return total / closed.B[self.row, self.name]
