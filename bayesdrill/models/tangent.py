"""The tangent of a rig: a model whose extra states are the derivatives of the rig's own.

    x' = A x + B u + c        x_dot' = A x_dot + A_dot x + B_dot u + c_dot

for a direction in the space of parameters.  Its response is the exact sensitivity of the rig's
response, by the same kernels: no step size, no difference of nearly equal numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bayesdrill.models.linear import Linear, Model, Named

DOT = "_dot"


@dataclass(frozen=True, slots=True)
class Dual:
    """A value and its derivative; the numbers may be of any kind that knows arithmetic."""

    value: Any
    slope: Any

    __array_ufunc__: ClassVar[None] = None  # NumPy's numbers leave arithmetic with it to it

    def __add__(self, other: Any) -> Dual:
        right = _dual(other)
        return Dual(self.value + right.value, self.slope + right.slope)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> Dual:
        return self + -_dual(other)

    def __rsub__(self, other: Any) -> Dual:
        return _dual(other) - self

    def __mul__(self, other: Any) -> Dual:
        right = _dual(other)
        return Dual(self.value * right.value, self.slope * right.value + self.value * right.slope)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Dual:
        right = _dual(other)
        quotient = self.value / right.value
        return Dual(quotient, (self.slope - quotient * right.slope) / right.value)

    def __rtruediv__(self, other: Any) -> Dual:
        return _dual(other) / self

    def __pow__(self, power: float) -> Dual:
        if not isinstance(power, int) or power < 1:  # of numbers only
            slope = power * self.value ** (power - 1) * self.slope
            return Dual(self.value**power, slope)
        result = self
        for _ in range(power - 1):
            result = result * self
        return result

    def sqrt(self) -> Dual:
        return self**0.5

    def exp(self) -> Dual:
        value = np.exp(self.value)
        return Dual(value, value * self.slope)

    def log(self) -> Dual:
        return Dual(np.log(self.value), self.slope / self.value)


def _dual(number: Any) -> Dual:
    return number if isinstance(number, Dual) else Dual(number, 0.0)


@dataclass(frozen=True, slots=True)
class Tangent:
    """Of `rig`: its parameters and, named with `_dot`, the direction of the derivative."""

    rig: Model

    @property
    def name(self) -> str:
        return f"tangent of {self.rig.name}"

    @property
    def parameters(self) -> tuple[str, ...]:
        return _with_dots(self.rig.parameters)

    @property
    def states(self) -> tuple[str, ...]:
        return _with_dots(self.rig.states)

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.rig.inputs

    def linear(self, p: Named) -> Linear:
        duals: Any = {name: Dual(p[name], p[name + DOT]) for name in self.rig.parameters}
        rig = self.rig.linear(duals)
        a: dict[tuple[str, str], Any] = {}
        b: dict[tuple[str, str], Any] = {}
        c: dict[str, Any] = {}
        for (row, column), entry in rig.A.items():
            a[row, column] = a[row + DOT, column + DOT] = _dual(entry).value
            if isinstance(entry, Dual):
                a[row + DOT, column] = entry.slope
        for (row, name), entry in rig.B.items():
            b[row, name] = _dual(entry).value
            if isinstance(entry, Dual):
                b[row + DOT, name] = entry.slope
        for row, entry in rig.c.items():
            c[row] = _dual(entry).value
            if isinstance(entry, Dual):
                c[row + DOT] = entry.slope
        return Linear(A=a, B=b, c=c)


def _with_dots(names: tuple[str, ...]) -> tuple[str, ...]:
    return (*names, *(name + DOT for name in names))
