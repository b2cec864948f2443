"""Compute with dual numbers, which carry exact derivatives, and with other kinds of numbers.

These functions and + - * / accept arrays, dual numbers and registers of a compiled kernel.
Classes derived from `Number` implement the functions themselves, and their comparisons return a
`Choice`.  For arrays and plain numbers, NumPy's functions are used.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np


@dataclass(frozen=True, slots=True)
class Dual:
    """A dual number has a value and a derivative (`slope`), which are numbers of any kind."""

    value: Any
    slope: Any

    __array_ufunc__: ClassVar[None] = None  # makes `array * dual` call `Dual.__rmul__`

    def __getitem__(self, index: Any) -> Dual:
        return Dual(self.value[index], self.slope[index])

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
        if not isinstance(power, int) or power < 1:  # registers of a kernel lack these powers
            slope = power * self.value ** (power - 1) * self.slope
            return Dual(self.value**power, slope)
        result = self
        for _ in range(power - 1):
            result = result * self
        return result

    def sqrt(self) -> Dual:
        """Return the square root."""
        return self**0.5

    def exp(self) -> Dual:
        """Return the exponential."""
        value = exp(self.value)
        return Dual(value, value * self.slope)

    def sin(self) -> Dual:
        """Return the sine."""
        return Dual(sin(self.value), sin(self.value + 0.5 * np.pi) * self.slope)

    def log(self) -> Dual:
        """Return the natural logarithm."""
        return Dual(log(self.value), self.slope / self.value)


def dual(number: Any) -> Dual:
    """Return a number as a `Dual`; a number without a slope gets slope zero."""
    return number if isinstance(number, Dual) else Dual(number, 0.0)


def linear_map(function: Callable[..., Any], *numbers: Any) -> Any:
    """Apply a linear function to arrays, or to both the values and the slopes of duals."""
    if not all(isinstance(number, Dual) for number in numbers):
        return function(*numbers)
    values, slopes = zip(*((number.value, number.slope) for number in numbers), strict=True)
    return Dual(function(*values), function(*slopes))


def affine_map(function: Callable[[Any], Any], number: Any) -> Any:
    """Apply an affine function f to an array, or to a dual, with slope f(slope) - f(0)."""
    if not isinstance(number, Dual):
        return function(number)
    still = function(np.zeros_like(number.slope))
    return Dual(function(number.value), function(number.slope) - still)


def elementwise(
    function: Callable[[Any], Any], derivative: Callable[[Any], Any], number: Any
) -> Any:
    """Apply a function to each element of an array, or of a dual, with the given `derivative`."""
    if not isinstance(number, Dual):
        return function(number)
    return Dual(function(number.value), derivative(number.value) * number.slope)


class Number(ABC):
    """Numbers of derived classes implement the functions of this module themselves."""

    __slots__ = ()

    @abstractmethod
    def exp(self) -> Any:
        """Return the exponential."""

    @abstractmethod
    def sin(self) -> Any:
        """Return the sine."""

    @abstractmethod
    def size(self) -> Any:
        """Return the absolute value."""

    @abstractmethod
    def signed(self, like: Any) -> Any:
        """Return the number with the sign of `like`."""

    @abstractmethod
    def below(self, other: Any) -> Choice:
        """Return whether the number is less than `other`."""

    @abstractmethod
    def above(self, other: Any) -> Choice:
        """Return whether the number is greater than `other`."""


class Choice(ABC):
    """A choice is the result of a comparison of two `Number`s."""

    __slots__ = ()

    @abstractmethod
    def chosen(self, yes: Any, no: Any) -> Any:
        """Return `yes` where the comparison is true, and `no` elsewhere."""


def exp(number: Any) -> Any:
    """Return the exponential of a number of any kind."""
    return number.exp() if isinstance(number, Dual | Number) else np.exp(number)


def log(number: Any) -> Any:
    """Return the natural logarithm of an array or a dual."""
    return number.log() if isinstance(number, Dual) else np.log(number)


def sin(number: Any) -> Any:
    """Return the sine of a number of any kind."""
    return number.sin() if isinstance(number, Dual | Number) else np.sin(number)


def below(lower: Any, upper: Any) -> Any:
    """Compare values, not slopes: return the mask `lower < upper`, which `where` accepts."""
    if isinstance(lower, Dual) or isinstance(upper, Dual):
        return below(dual(lower).value, dual(upper).value)
    if isinstance(lower, Number):
        return lower.below(upper)
    return upper.above(lower) if isinstance(upper, Number) else np.less(lower, upper)


def where(mask: Any, yes: Any, no: Any) -> Any:
    """Return `yes` where the mask is true, and `no` elsewhere; slopes are selected likewise."""
    if isinstance(yes, Dual) or isinstance(no, Dual):
        first, second = dual(yes), dual(no)
        return Dual(where(mask, first.value, second.value), where(mask, first.slope, second.slope))
    return mask.chosen(yes, no) if isinstance(mask, Choice) else np.where(mask, yes, no)


def size(number: Any) -> Any:
    """Return the absolute value; its derivative at zero is defined as 1."""
    if isinstance(number, Number):
        return number.size()
    return where(below(number, 0.0), -number, number)


def signed(number: Any, like: Any) -> Any:
    """Give a nonnegative number the sign of `like`."""
    if isinstance(number, Number) and not isinstance(like, Dual):
        return number.signed(like)
    return where(below(like, 0.0), -number, number)
