"""Linear combinations written as text, such as `theta_1 - theta_2` or `8 * w_2`."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable

from bayesdrill.basics.errors import did_you_mean


def linear_combination(text: str, known: Iterable[str]) -> dict[str, float]:
    """Weights of the `known` names; raises `ValueError` with a message for the user."""
    names = list(known)
    shown = _short(text)
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        weights = _weights(tree, names)
    except (SyntaxError, RecursionError, MemoryError, OverflowError):  # too deep, or too large
        raise ValueError(f"{shown} is not a formula; write for example theta_1 - theta_2") from None
    if weights.pop("", 0.0) != 0.0:
        raise ValueError(
            f"{shown} has a constant term; only sums of multiples of states are possible"
        )
    weights = {name: weight for name, weight in weights.items() if weight != 0.0}
    if not weights:
        raise ValueError(f"{shown} is zero whatever the states are; name one of {', '.join(names)}")
    if not all(map(math.isfinite, weights.values())):
        raise ValueError(f"{shown} has an infinite weight; write a smaller number")
    return weights


def _weights(node: ast.expr, known: list[str]) -> dict[str, float]:
    """Weights by name; the name '' holds the constant."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return {"": float(value)}
        case ast.Name(id=name):
            if name not in known:
                raise ValueError(f"{_short(name)} is not a state{did_you_mean(name, known)}")
            return {name: 1.0}
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _scaled(_weights(operand, known), -1.0)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _weights(operand, known)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            total = _weights(left, known)
            sign = 1.0 if isinstance(op, ast.Add) else -1.0
            for name, weight in _weights(right, known).items():
                total[name] = total.get(name, 0.0) + sign * weight
            return total
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            first, second = _weights(left, known), _weights(right, known)
            if set(first) == {""}:
                return _scaled(second, first[""])
            if set(second) == {""}:
                return _scaled(first, second[""])
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            divisor = _weights(right, known)
            if set(divisor) == {""} and divisor[""] != 0.0:
                return _scaled(_weights(left, known), 1.0 / divisor[""])
    raise ValueError(
        f"{_short(ast.unparse(node))} is not linear; only sums of multiples of states are possible"
    )


def _scaled(weights: dict[str, float], factor: float) -> dict[str, float]:
    return {name: factor * weight for name, weight in weights.items()}


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
