"""The tangent of a rig: a model whose extra states are the derivatives of the rig's own.

    x' = A x + B u + c        x_dot' = A x_dot + A_dot x + B_dot u + c_dot

for a direction in the space of parameters.  Its response is the exact sensitivity of the rig's
response, by the same kernels: no step size, no difference of nearly equal numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.basics.symbols import Symbol
from bayesdrill.rig.models.linear import Around, Linear, Named

DOT = "_dot"


@dataclass(frozen=True, slots=True)
class Tangent(Around):
    """Of `rig`: its parameters and, named with `_dot`, the direction of the derivative."""

    @property
    def name(self) -> str:
        return f"tangent of {self.rig.name}"

    @property
    def declares(self) -> tuple[Symbol, ...]:
        return ()

    @property
    def parameters(self) -> tuple[str, ...]:
        return _with_dots(self.rig.parameters)

    @property
    def states(self) -> tuple[str, ...]:
        return _with_dots(self.rig.states)

    @property
    def frictions(self) -> tuple[()]:
        """None of its own: the columns of the rig's, and their derivatives, stand in its `B`."""
        return ()

    def linear(self, p: Named) -> Linear:
        duals: Any = {name: Dual(p[name], p[name + DOT]) for name in self.rig.parameters}
        rig = self.rig.linear(duals)
        a: dict[tuple[str, str], Any] = {}
        b: dict[tuple[str, str], Any] = {}
        c: dict[str, Any] = {}
        for (row, column), entry in rig.A.items():
            a[row, column] = a[row + DOT, column + DOT] = dual(entry).value
            if isinstance(entry, Dual):
                a[row + DOT, column] = entry.slope
        for (row, name), entry in rig.B.items():
            b[row, name] = dual(entry).value
            if isinstance(entry, Dual):
                b[row + DOT, name] = entry.slope
        for row, entry in rig.c.items():
            c[row] = dual(entry).value
            if isinstance(entry, Dual):
                c[row + DOT] = entry.slope
        return Linear(A=a, B=b, c=c)


def _with_dots(names: tuple[str, ...]) -> tuple[str, ...]:
    return (*names, *(name + DOT for name in names))
