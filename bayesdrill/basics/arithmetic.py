"""What formulas want beside + - * /, for numbers of any kind: arrays, duals, registers of a kernel.

A kind of its own is a `Number`, and its masks are `Choice`s; all others are NumPy's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from bayesdrill.basics.duals import Dual, dual


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
    if isinstance(number, Dual):
        value = exp(number.value)
        return Dual(value, value * number.slope)
    return number.exp() if isinstance(number, Number) else np.exp(number)


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
