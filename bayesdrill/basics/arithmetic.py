"""What formulas want beside + - * /, for numbers of any kind: arrays, duals, registers of a kernel.

A kind of its own brings methods: `exp`, `size`, `signed`, `below`, `above`, and
`chosen` of its masks; all others are NumPy's.
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
    if hasattr(number, "size") and not isinstance(number, np.ndarray | np.generic):
        return number.size()
    return where(below(number, 0.0), -number, number)


def signed(number: Any, like: Any) -> Any:
    """What is not negative, with the sign of another."""
    if hasattr(number, "signed") and not isinstance(like, Dual):
        return number.signed(like)
    return where(below(like, 0.0), -number, number)
