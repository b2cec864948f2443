"""Parse formulas and linear combinations; they are never executed as Python code.

Examples are the formula `pi*G*d**4/(32*L)` and the combination `theta_1 - theta_2`.  Both may
contain numbers, names, `+ - * / **`, `pi`, `sqrt`, `exp` and `log`.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from bayesdrill.basics.errors import did_you_mean, shortened

FUNCTIONS: Mapping[str, Callable[[Any], Any]] = MappingProxyType(
    {"sqrt": np.sqrt, "exp": np.exp, "log": np.log}
)
MAX_TERMS = 1000  # largest number of nodes (numbers, names, operations) in a syntax tree
MAX_DEPTH = 100  # largest depth of a syntax tree; the depth of a sum of n terms is n
RESERVED = frozenset({"pi", *FUNCTIONS})

_OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = MappingProxyType(
    {
        ast.Add: operator.add,
        ast.Sub: operator.sub,
        ast.Mult: operator.mul,
        ast.Div: operator.truediv,
    }
)


@dataclass(frozen=True, slots=True)
class Expression:
    """An expression is a parsed formula; expressions with the same `text` are equal."""

    text: str
    tree: ast.expr = field(repr=False, compare=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the formula's quantities, in the order of `ast.walk`."""
        names = (node.id for node in ast.walk(self.tree) if isinstance(node, ast.Name))
        return tuple(dict.fromkeys(name for name in names if name not in RESERVED))

    def value(self, named: Mapping[str, Any]) -> Any:
        """Evaluate the formula at numbers, arrays of one shape or duals; inf or NaN if undefined."""
        with np.errstate(all="ignore"):
            return _value(self.tree, named)

    @property
    def positive(self) -> bool:
        """Return whether positive values of the names surely give a positive one; False for sums."""
        return _is_positive(self.tree)

    def renamed(self, names: Mapping[str, str]) -> Expression:
        """Return the formula with `names` (old: new) replaced."""
        return self.substituted({old: Expression(x, ast.Name(x)) for old, x in names.items()})

    def substituted(self, others: Mapping[str, Expression]) -> Expression:
        """Replace names by formulas; raises `ValueError` if the resulting formula is too long."""

        class Substitution(ast.NodeTransformer):
            def visit_Name(self, node: ast.Name) -> ast.expr:
                return others[node.id].tree if node.id in others else node

        tree = Substitution().visit(ast.parse(self.text, mode="eval").body)
        _check_size(tree)
        return Expression(ast.unparse(tree), tree)


def expression(text: str, known_names: Iterable[str]) -> Expression:
    """Parse a formula of `known_names`; raises `ValueError` with a message for the user."""
    with _readable(text, "pi*G*d**4/(32*L), with a decimal point and without units"):
        tree = ast.parse(text.strip(), mode="eval").body
        _check_size(tree)
        _check(tree, list(known_names), _short(text))
    return Expression(ast.unparse(tree), tree)


@contextmanager
def _readable(text: str, example: str) -> Iterator[None]:
    """Turn errors of the parser into a `ValueError` that shows an `example`."""
    try:
        yield
    except (SyntaxError, RecursionError, MemoryError, OverflowError):  # too deep or too large
        message = f"{_short(text)} is not a formula; write for example {example}"
        raise ValueError(message) from None


class RelationError(ValueError):
    """The relation of `name` cannot be resolved: it is circular or becomes too long."""

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name


def resolve_relations(relations: Mapping[str, Expression]) -> dict[str, Expression]:
    """Substitute relations into each other until only free names remain; raises `RelationError`."""
    done: dict[str, Expression] = {}

    def resolve(name: str, path: tuple[str, ...]) -> Expression:
        if name in path:
            circle = path[path.index(name) :]
            shown = " -> ".join((*circle, name))
            message = f"depends on itself ({shown}); give one of these a prior or a number"
            raise RelationError(name, message)
        if name not in done:
            inner = [other for other in relations[name].names if other in relations]
            others = {other: resolve(other, (*path, name)) for other in inner}
            try:
                done[name] = relations[name].substituted(others)
            except ValueError as error:
                raise RelationError(name, str(error)) from None
        return done[name]

    return {name: resolve(name, ()) for name in relations}


def _check_size(tree: ast.expr) -> None:
    """Check the size of a tree level by level, since recursion fails for a very deep tree."""
    depth, level, count = 0, [tree], 0
    while level:
        depth, count = depth + 1, count + len(level)
        if depth > MAX_DEPTH or count > MAX_TERMS:
            most = f"more than {MAX_DEPTH} terms or {MAX_TERMS} numbers and names"
            whose = "including those of the formulas that it names"
            raise ValueError(f"this formula has {most}, {whose}; write a shorter one")
        below = (inner for node in level for inner in ast.iter_child_nodes(node))
        level = [inner for inner in below if isinstance(inner, ast.expr)]


def _check(node: ast.expr, known_names: list[str], shown: str) -> None:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            if not math.isfinite(value):
                raise OverflowError
        case ast.Name(id="pi"):
            pass
        case ast.Name(id=name):
            if name not in known_names:
                hint = did_you_mean(name, known_names)
                raise ValueError(f"{_short(name)} is not a known name{hint}")
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            _check(operand, known_names, shown)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div(), right=right):
            _check(left, known_names, shown)
            _check(right, known_names, shown)
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            _check(left, known_names, shown)
            _check(right, [], f"the power {ast.unparse(right)!r}")
        case ast.BinOp(op=ast.BitXor()):
            raise ValueError(f"{shown}: a power is written d**4, not d^4")
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in FUNCTIONS:
            _check(argument, known_names, shown)
        case ast.Call(func=ast.Name(id=name)):
            ways = f"functions are {', '.join(FUNCTIONS)}, of one number each"
            raise ValueError(f"{_short(name)} cannot stand here; {ways}")
        case _:
            use = f"numbers with a decimal point, names, + - * / **, pi, {', '.join(FUNCTIONS)}"
            raise ValueError(f"{_short(ast.unparse(node))} cannot stand in a formula; use {use}")


def _value(node: ast.expr, named: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)
        case ast.Name(id="pi"):
            return np.float64(math.pi)
        case ast.Name(id=name):
            return named[name]
        case ast.UnaryOp(op=op, operand=operand):
            inner = _value(operand, named)
            return -inner if isinstance(op, ast.USub) else inner
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            return _value(left, named) ** _power(right)
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, named), _value(right, named))
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            inner = _value(argument, named)
            # Dual numbers have methods with these names.
            method = getattr(inner, name, None)
            return FUNCTIONS[name](inner) if method is None else method()
    raise AssertionError(ast.dump(node))


def _power(node: ast.expr) -> int | float:
    number = float(_value(node, {}))
    return int(number) if number.is_integer() and abs(number) < 2**31 else number


def _is_positive(node: ast.expr) -> bool:
    """Return whether a formula is a positive number, or a product of powers of names."""
    with suppress(KeyError), np.errstate(all="ignore"):
        return bool(0 < _value(node, {}) < math.inf)
    match node:
        case ast.Name():
            return True
        case ast.BinOp(left=left, op=ast.Pow()):
            return _is_positive(left)
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div(), right=right):
            return _is_positive(left) and _is_positive(right)
        case ast.Call(func=ast.Name(id="sqrt"), args=[argument]):
            return _is_positive(argument)
    return False


def _short(text: str) -> str:
    return repr(shortened(text))


_ONLY_SUMS = "only sums of multiples of states are possible"


def linear_combination(text: str, known_names: Iterable[str]) -> dict[str, float]:
    """Return nonzero weights of `known_names`; raises `ValueError` with a message for the user."""
    names = list(known_names)
    shown = _short(text)
    with _readable(text, "theta_1 - theta_2"):
        weights = _weights(ast.parse(text.strip(), mode="eval").body, names)
    if weights.pop("", 0.0) != 0.0:
        raise ValueError(f"{shown} has a constant term; {_ONLY_SUMS}")
    weights = {name: weight for name, weight in weights.items() if weight != 0.0}
    if not weights:
        raise ValueError(f"{shown} is zero for all states; name one of {', '.join(names)}")
    if not all(map(math.isfinite, weights.values())):
        raise ValueError(f"{shown} has an infinite weight; write a smaller number")
    return weights


def _weights(node: ast.expr, known_names: list[str]) -> dict[str, float]:
    """Return weights by name; the name of the constant term is ''."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return {"": float(value)}
        case ast.Name(id=name):
            if name not in known_names:
                raise ValueError(f"{_short(name)} is not a state{did_you_mean(name, known_names)}")
            return {name: 1.0}
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
            weights = _weights(operand, known_names)
            return _scaled(weights, -1.0) if isinstance(op, ast.USub) else weights
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            total = _weights(left, known_names)
            sign = 1.0 if isinstance(op, ast.Add) else -1.0
            for name, weight in _weights(right, known_names).items():
                total[name] = total.get(name, 0.0) + sign * weight
            return total
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            first, second = _weights(left, known_names), _weights(right, known_names)
            if set(first) == {""}:
                return _scaled(second, first[""])
            if set(second) == {""}:
                return _scaled(first, second[""])
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            divisor = _weights(right, known_names)
            if set(divisor) == {""} and divisor[""] != 0.0:
                return _scaled(_weights(left, known_names), 1.0 / divisor[""])
    raise ValueError(f"{_short(ast.unparse(node))} is not linear; {_ONLY_SUMS}")


def _scaled(weights: dict[str, float], factor: float) -> dict[str, float]:
    return {name: factor * weight for name, weight in weights.items()}
