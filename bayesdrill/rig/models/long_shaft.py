"""Define the paper's rig with a shaft of inertia `j_s`, divided into n = `elements` equal pieces.

Each piece is a spring n k_s with the inertia j_s/n, half of it at each end of the piece.  The halves at
the ends of the shaft add to j_1 and, through the gear, to j_m.  Node k is at s = k/n: s is 0 at the
gearbox and 1 at rotor 1.  The angle of the shaft at this node is

    theta_2 + s (theta_1 - theta_2) + phi_k

so phi_k and its rate dphi_k are zero while the twist is uniform, which is assumed at the start.

    phi_k'  = dphi_k
    dphi_k' = (n^2 k_s/j_s)(phi_(k-1) - 2 phi_k + phi_(k+1)) - (1 - s) w_2' - s w_1'
    w_1'    = ... + n k_s phi_(n-1) / (j_1 + j_s/2n)
    w_2'    = ... + i_m^2 n k_s phi_1 / (j_m + i_m^2 j_s/2n)

with the rest of w_1' and w_2' as in `motor_shaft`.  The damping `c_s` acts in parallel with k_s.  This
model shows that the inertia of the paper's shaft, 1.5e-7 kg m^2, makes no difference.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from pydantic import Field

from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.equations import coordinate_inertia
from bayesdrill.rig.models.friction import Friction, Named
from bayesdrill.rig.models.linear import Linear, Model, Offers, ParameterNames
from bayesdrill.rig.models.motor_shaft import OFFERS, PARAMETERS, Gear, MotorShaft, Power

MAX_ELEMENTS = 4
Elements = Annotated[
    int, Field(ge=1, le=MAX_ELEMENTS, description="Equal pieces of which the shaft is made.")
]


def _declared() -> tuple[Symbol, ...]:
    """Return symbols of inner nodes; their unit is 1, not rad, so `Model.angles` leaves them out."""
    what = "of the shaft at an inner node, minus the linear interpolation between its ends"
    nodes = range(1, MAX_ELEMENTS)
    return (
        *(Symbol(f"phi_{k}", "1", rf"\varphi_{k}", "", f"angle {what}") for k in nodes),
        *(Symbol(f"dphi_{k}", "1/s", rf"\dot\varphi_{k}", "1/s", f"speed {what}") for k in nodes),
    )


@dataclass(frozen=True, slots=True)
class LongShaft(Model):
    """The rig has a shaft of `elements` equal pieces; other fields are as in a `MotorShaft`."""

    i_m: Gear = 1 / 8
    elements: Elements = MAX_ELEMENTS
    stribeck: Power = 1
    added: tuple[str, ...] = ()

    name: ClassVar[str] = "long_shaft"
    declares: ClassVar[tuple[Symbol, ...]] = _declared()
    offers: ClassVar[Offers] = OFFERS
    parameters: ClassVar[ParameterNames] = ParameterNames((*PARAMETERS, "j_s"))
    inputs: ClassVar[tuple[str, ...]] = MotorShaft.inputs

    @property
    def inner(self) -> tuple[str, ...]:
        """Return the states of the nodes within the shaft; see `Model.inner`."""
        nodes = range(1, self.elements)
        return (*(f"phi_{k}" for k in nodes), *(f"dphi_{k}" for k in nodes))

    @property
    def states(self) -> tuple[str, ...]:
        """Return the states of a `MotorShaft`, then the inner ones."""
        return (*MotorShaft.states, *self.inner)

    @property
    def frictions(self) -> tuple[Friction, ...]:
        """Return the frictions of a `MotorShaft`."""
        return self._ends.frictions

    def linear(self, p: Named) -> Linear:
        """See `Model.linear`."""
        n = self.elements
        half = p["j_s"] / (2.0 * self.elements)
        shaft = {**p, "j_1": p["j_1"] + half, "j_m": p["j_m"] + self.i_m**2 * half}
        ends = self._ends.linear(shaft)
        a, b, c = dict(ends.A), dict(ends.B), dict(ends.c)
        if n == 1:
            return ends
        springs = [("phi", n * p["k_s"])]
        springs += [("dphi", n * p["c_s"])] if "c_s" in self.added else []
        j_m = coordinate_inertia(self._ends, "w_2", shaft)
        for name, strength in springs:
            a["w_1", f"{name}_{n - 1}"] = strength / shaft["j_1"]
            a["w_2", f"{name}_1"] = self.i_m**2 * strength / j_m
        rows: dict[Any, Any] = {**a, **b, **{(row, None): x for row, x in c.items()}}
        for k in range(1, n):
            a[f"phi_{k}", f"dphi_{k}"] = 1.0
            within = self._within(k, springs, p["j_s"] / n)
            for (row, column), value in rows.items():
                if row in ("w_1", "w_2"):
                    weight = k / n if row == "w_1" else 1.0 - k / n
                    within[column] = within.get(column, 0.0) - weight * value
            for column, value in within.items():
                if column is None:
                    c[f"dphi_{k}"] = value
                else:
                    (a if column in self.states else b)[f"dphi_{k}", column] = value
        return Linear(A=a, B=b, c=c)

    def _within(self, k: int, springs: list[tuple[str, Any]], inertia: Any) -> dict[Any, Any]:
        """Return the entries of dphi_k' that are due to the adjacent pieces, by state."""
        combined: dict[Any, Any] = {}
        for name, strength in springs:
            for node, times in ((k - 1, 1.0), (k, -2.0), (k + 1, 1.0)):
                if 0 < node < self.elements:
                    combined[f"{name}_{node}"] = times * strength / inertia
        return combined

    @property
    def _ends(self) -> MotorShaft:
        return MotorShaft(self.i_m, self.stribeck, self.added)
