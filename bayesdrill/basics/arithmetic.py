"""What formulas want beside + - * /, for numbers of any kind: arrays, dual numbers, registers of a kernel.

A kind of its own brings methods: `exp`, `below`, `chosen`; all others are NumPy's.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesdrill.basics.duals import Dual, dual


def exp(number: Any) -> Any:
    if isinstance(number, Dual):
        value = exp(number.value)
        return Dual(value, value * number.slope)
    return number.exp() if hasattr(number, "exp") else np.exp(number)


def below(left: Any, right: Any) -> Any:
    """Where `left < right`, by values: for `where`."""
    if isinstance(left, Dual) or isinstance(right, Dual):
        return below(dual(left).value, dual(right).value)
    if hasattr(left, "below"):
        return left.below(right)
    return right.above(left) if hasattr(right, "above") else np.less(left, right)


def where(mask: Any, yes: Any, no: Any) -> Any:
    """`yes` or `no`, each with its slope."""
    if isinstance(yes, Dual) or isinstance(no, Dual):
        one, other = dual(yes), dual(no)
        return Dual(
            where(mask, one.value, other.value),
            where(mask, one.slope, other.slope),
        )
    return mask.chosen(yes, no) if hasattr(mask, "chosen") else np.where(mask, yes, no)


def size(number: Any) -> Any:
    """Its absolute value; its slope at zero is that from above."""
    return where(below(number, 0.0), -number, number)


def smaller(left: Any, right: Any) -> Any:
    return where(below(left, right), left, right)


def larger(left: Any, right: Any) -> Any:
    return where(below(left, right), right, left)
