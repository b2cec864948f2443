"""Dual numbers, which carry exact derivatives along, and the functions that formulas apply to
numbers of any kind.

What formulas want beside + - * /, for numbers of any kind: arrays, duals, registers of a kernel.

A kind of its own is a `Number`, and its masks are `Choice`s; all others are NumPy's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
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
        value = exp(self.value)
        return Dual(value, value * self.slope)

    def log(self) -> Dual:
        return Dual(np.log(self.value), self.slope / self.value)


def dual(number: Any) -> Dual:
    """A plain number has no slope."""
    return number if isinstance(number, Dual) else Dual(number, 0.0)


class Number(ABC):
    """Of a kind that does by itself what is asked here."""

    __slots__ = ()

    @abstractmethod
    def exp(self) -> Any: ...

    @abstractmethod
    def size(self) -> Any: ...

    @abstractmethod
    def signed(self, like: Any) -> Any: ...

    @abstractmethod
    def below(self, other: Any) -> Choice: ...

    @abstractmethod
    def above(self, other: Any) -> Choice: ...


class Choice(ABC):
    """What comparing such numbers gives."""

    __slots__ = ()

    @abstractmethod
    def chosen(self, yes: Any, no: Any) -> Any: ...


def exp(number: Any) -> Any:
    return number.exp() if isinstance(number, Dual | Number) else np.exp(number)


def below(left: Any, right: Any) -> Any:
    """Where `left < right`, by values: for `where`."""
    if isinstance(left, Dual) or isinstance(right, Dual):
        return below(dual(left).value, dual(right).value)
    if isinstance(left, Number):
        return left.below(right)
    return right.above(left) if isinstance(right, Number) else np.less(left, right)


def where(mask: Any, yes: Any, no: Any) -> Any:
    """`yes` or `no`, each with its slope."""
    if isinstance(yes, Dual) or isinstance(no, Dual):
        one, other = dual(yes), dual(no)
        return Dual(
            where(mask, one.value, other.value),
            where(mask, one.slope, other.slope),
        )
    return mask.chosen(yes, no) if isinstance(mask, Choice) else np.where(mask, yes, no)


def size(number: Any) -> Any:
    """Its absolute value; its slope at zero is that from above."""
    if isinstance(number, Number):
        return number.size()
    return where(below(number, 0.0), -number, number)


def signed(number: Any, like: Any) -> Any:
    """What is not negative, with the sign of another."""
    if isinstance(number, Number) and not isinstance(like, Dual):
        return number.signed(like)
    return where(below(like, 0.0), -number, number)
