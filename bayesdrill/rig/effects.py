"""What a rig may do without: efforts that it lacks, and the rig with some of them.

An effort acts where one of the rig's own does, so that no equation is written twice: at rotor 1 as the
load `t_1`, at the motor as its friction `t_f`, in the motor's circuit as the voltage `v`, and on the shaft
at both of its ends as its stiffness does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.linear import Linear, Model, Named

Array = NDArray[np.float64]

Place = Literal["motor", "rotor 1", "shaft", "circuit"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """An effort `parameter` times a sum of states, or times its sign where it is `dry`, against it.

    `parameter`: of rigs that have it; `states`: names of the sum, the second one taken off the first;
    `geared`: the sum is that of the motor, 1/i_m of it; `said`: in words.
    """

    parameter: str
    place: Place
    states: tuple[str, ...]
    dry: bool
    said: str
    unit: str

    def motion(self, states: Mapping[str, Array]) -> Array:
        """What it goes against, `(T,)`."""
        first, *rest = (states[name] for name in self.states)
        return np.asarray(first - rest[0] if rest else first)

    def shape(self, states: Mapping[str, Array]) -> Array:
        """The effort of a parameter that is one, `(T,)`."""
        moved = self.motion(states)
        return np.asarray(np.sign(moved)) if self.dry else moved


EFFECTS = (
    Effect(
        parameter="t_cm",
        place="motor",
        states=("w_2",),
        dry=True,
        said="dry friction at the motor",
        unit="N m",
    ),
    Effect(
        parameter="t_c1",
        place="rotor 1",
        states=("w_1",),
        dry=True,
        said="dry friction at rotor 1",
        unit="N m",
    ),
    Effect(
        parameter="c_1",
        place="rotor 1",
        states=("w_1",),
        dry=False,
        said="viscous damping at rotor 1",
        unit="N m s/rad",
    ),
    Effect(
        parameter="c_s",
        place="shaft",
        states=("w_1", "w_2"),
        dry=False,
        said="damping of the shaft",
        unit="N m s/rad",
    ),
    Effect(
        parameter="v_d",
        place="circuit",
        states=("i",),
        dry=True,
        said="a voltage drop of driver and brushes",
        unit="V",
    ),
)


def entries(rig: Model, place: Place, p: Named) -> dict[str, Any]:
    """What an effort of one does to the rates of states at the parameters `p`.

    Raises `KeyError` for a rig that has nothing at such a place.
    """
    linear = rig.linear(p)
    if place == "circuit":
        return {"i": -1.0 * linear.B["i", "v"]}
    if place == "motor":
        with_it, without = (rig.linear({**p, "t_f": torque}).c["w_2"] for torque in (1.0, 0.0))
        return {"w_2": with_it - without}
    load = linear.B["w_1", "t_1"]
    if place == "rotor 1":
        return {"w_1": load}
    return {"w_1": load, "w_2": load * (linear.A["w_2", "theta_1"] / linear.A["w_1", "theta_1"])}


@dataclass(frozen=True, slots=True)
class Lacking:
    """`rig` with `effects`, each with a parameter more, of the name that `named` gives it.

    What is dry goes by inputs, the signs of a motion that is known from elsewhere; so all is linear.
    """

    rig: Model
    effects: tuple[Effect, ...]
    named: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.rig.name

    @property
    def declares(self) -> tuple[Symbol, ...]:
        return self.rig.declares

    @property
    def parameters(self) -> tuple[str, ...]:
        return (*self.rig.parameters, *self.named)

    @property
    def states(self) -> tuple[str, ...]:
        return self.rig.states

    @property
    def inputs(self) -> tuple[str, ...]:
        dry = [name for one, name in zip(self.effects, self.named, strict=True) if one.dry]
        return (*self.rig.inputs, *dry)

    def linear(self, p: Named) -> Linear:
        found = self.rig.linear(p)
        a, b = dict(found.A), dict(found.B)
        for effect, name in zip(self.effects, self.named, strict=True):
            for row, entry in entries(self.rig, effect.place, p).items():
                if effect.dry:
                    b[row, name] = entry * p[name]
                    continue
                for state, sign in zip(effect.states, (1.0, -1.0), strict=False):
                    a[row, state] = a.get((row, state), 0.0) + sign * entry * p[name]
        return Linear(A=a, B=b, c=found.c)
