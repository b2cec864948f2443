"""Dual numbers: arithmetic that carries exact derivatives along."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True, slots=True)
class Dual:
    """A value and its derivative; the numbers may be of any kind that knows arithmetic."""

    value: Any
    slope: Any

    __array_ufunc__: ClassVar[None] = None  # NumPy's numbers leave arithmetic with it to it

    def __add__(self, other: Any) -> Dual:
        right = dual(other)
        return Dual(self.value + right.value, self.slope + right.slope)

    __radd__ = __add__

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.slope)

    def __sub__(self, other: Any) -> Dual:
        return self + -dual(other)

    def __rsub__(self, other: Any) -> Dual:
        return dual(other) - self

    def __mul__(self, other: Any) -> Dual:
        right = dual(other)
        return Dual(self.value * right.value, self.slope * right.value + self.value * right.slope)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Dual:
        right = dual(other)
        quotient = self.value / right.value
        return Dual(quotient, (self.slope - quotient * right.slope) / right.value)

    def __rtruediv__(self, other: Any) -> Dual:
        return dual(other) / self

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


def dual(number: Any) -> Dual:
    """A plain number has no slope."""
    return number if isinstance(number, Dual) else Dual(number, 0.0)
