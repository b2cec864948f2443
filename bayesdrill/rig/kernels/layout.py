"""What kernels are specialised for: the structure of one rig in one experiment.

Numbers of an experiment are no part of it: its step, its start, its constant inputs and the weights of
its channels are arguments of kernels, so that experiments of one structure share them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from bayesdrill.basics.duals import Dual
from bayesdrill.rig.kernels.lanes import I64, VEC, Lane, load, splat, vector
from bayesdrill.rig.models.linear import Model

Entries = Callable[[Sequence[Any]], Sequence[tuple[int, int, Any]]]
Pattern = tuple[tuple[bool, ...], ...]
Kinds = tuple[tuple[int, ...], ...]
ANY = 2  # other numbers than 0, 1 and -1


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """`entries(numbers)`: (row, column, value) of the augmented N x N matrix, of the rig's
    `n_parameters` and then of the `n_constants` inputs that are constant.

    Its columns are X states, one constant input, `n_series` sampled inputs and, with a first-order
    hold, their increments; a place may come more than once.  `lead`: whether the start is before the
    first sample.  `channels (K, X)`: weights of states, see `weight_kinds`.
    """

    n_parameters: int
    n_constants: int
    n_states: int
    n_series: int
    first_order: bool
    entries: Entries
    lead: bool = False
    channels: Kinds = ()

    @classmethod
    def of(
        cls, model: Model, series: tuple[str, ...], constant: tuple[str, ...], *, first_order: bool
    ) -> Layout:
        """Of a rig with sampled inputs, and others that are constant and not zero."""
        return cls(
            n_parameters=len(model.parameters),
            n_constants=len(constant),
            n_states=len(model.states),
            n_series=len(series),
            first_order=first_order and bool(series),
            entries=Augmented(model, with_slopes(series, first_order=first_order), constant),
        )

    @property
    def text(self) -> str:
        """See `Structure`."""
        sizes = (self.n_parameters, self.n_states, self.n_series, self.first_order, self.lead)
        return f"{sizes} {self.channels} {formulas(self.n_numbers, self.entries)}"

    @property
    def n_numbers(self) -> int:
        return self.n_parameters + self.n_constants

    @property
    def size(self) -> int:
        return self.n_states + 1 + self.n_series * (2 if self.first_order else 1)

    @property
    def reach(self) -> Pattern:
        """Entries of the exponential that can differ from zero."""
        return reach_of(self._pattern)

    @property
    def idle(self) -> tuple[bool, ...]:
        """Columns of zeros: on that nothing depends, and its own entry of the exponential is one."""
        return tuple(not column for column in self._pattern.any(axis=0))

    @property
    def _pattern(self) -> NDArray[np.bool_]:
        pattern = np.zeros((self.size, self.size), dtype=bool)
        for row, column, _ in self.entries([1.0] * self.n_numbers):
            pattern[row, column] = True
        return pattern

    def matrix(self, b: ir.IRBuilder, parameters: ir.Value, constants: ir.Value) -> Matrix:
        """The entries, each place once, of parameters `(P, LANES)` and constant inputs `(C,)`."""
        lanes = [Lane(b, load(b, parameters, p)) for p in range(self.n_parameters)]
        return self.entries([*lanes, *(number(b, constants, c) for c in range(self.n_constants))])


Matrix = Sequence[tuple[int, int, Lane | float]]


def number(b: ir.IRBuilder, base: ir.Value, index: int) -> Lane:
    """The same of all lanes, from a block of single numbers."""
    return Lane(b, splat(b, b.load(b.gep(base, [I64(index)]))))


def addresses(
    b: ir.IRBuilder, block: ir.Value, group: ir.Value, sizes: Mapping[str, int]
) -> dict[str, ir.Value]:
    """Where the parts of a group begin, which stand one after the other and have so many vectors."""
    found, place = {}, b.gep(block, [b.mul(group, I64(sum(sizes.values())))])
    for name, size in sizes.items():
        found[name], place = place, b.gep(place, [I64(size)])
    return found


def weight_kinds(weights: NDArray[np.float64]) -> Kinds:
    """0, 1 and -1 as they are, as most weights are: nothing is multiplied by them; `ANY` for others."""
    known = np.isin(weights, (-1.0, 0.0, 1.0))
    return tuple(map(tuple, np.where(known, weights, ANY).astype(int).tolist()))


def weights_of(b: ir.IRBuilder, block: ir.Value, kinds: Kinds, k: int) -> dict[int, Lane]:
    """Of channel k, those that are not zero, by state, from a block of all `(K, X)`."""
    return {
        i: number(b, block, k * len(kinds[k]) + i) if kind == ANY else Lane(b, vector(float(kind)))
        for i, kind in enumerate(kinds[k])
        if kind != 0
    }


def reach_of(pattern: NDArray[np.bool_]) -> Pattern:
    """Entries of exp(M) that can differ from zero, for M with the `pattern (N, N)`."""
    reach = pattern | np.eye(len(pattern), dtype=bool)
    for _ in range(len(pattern)):
        reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
    return tuple(tuple(bool(entry) for entry in row) for row in reach)


@dataclass(frozen=True, slots=True)
class Augmented:
    """Entries of the augmented matrix of a rig, see `Layout`.

    `driven`: columns after the constant one, of which `v slope` is by how much `v` rises.  `constant`:
    inputs that are and are not zero.
    """

    model: Model
    driven: tuple[str, ...]
    constant: tuple[str, ...]

    def __call__(self, numbers: Sequence[Any]) -> list[tuple[int, int, Any]]:
        """(row, column, value)."""
        names = self.model.parameters
        linear = self.model.linear(dict(zip(names, numbers[: len(names)], strict=True)))
        constant = dict(zip(self.constant, numbers[len(names) :], strict=True))
        index, x = {name: k for k, name in enumerate(self.model.states)}, len(self.model.states)
        places = {name: x + 1 + k for k, name in enumerate(self.driven)}
        entries = [(index[row], index[column], value) for (row, column), value in linear.A.items()]
        entries += [(index[row], x, value) for row, value in linear.c.items()]
        for (row, name), value in linear.B.items():
            if name in places:
                entries.append((index[row], places[name], value))
            if name in constant:
                entries.append((index[row], x, value * constant[name]))
        rising = [name for name in places if f"{name} slope" in places]
        return entries + [(places[name], places[f"{name} slope"], 1.0) for name in rising]


def with_slopes(series: Sequence[str], *, first_order: bool) -> tuple[str, ...]:
    """Columns of sampled inputs."""
    return (*series, *(f"{name} slope" for name in series)) if first_order else tuple(series)


def present(constant: Mapping[str, float]) -> tuple[str, ...]:
    """Inputs that are constant and not zero: of others the matrix has no entries."""
    return tuple(name for name, value in constant.items() if value != 0.0)


def formulas(count: int, evaluate: Callable[[Sequence[Lane]], Any]) -> str:
    """The code that formulas of `count` numbers become, and what they return of it, as one text.

    Equal formulas have equal texts, wherever they come from.
    """
    kind = ir.FunctionType(ir.VoidType(), [VEC] * count)
    function = ir.Function(ir.Module(), kind, "formulas")
    b = ir.IRBuilder(function.append_basic_block())
    found = evaluate([Lane(b, argument) for argument in function.args])
    return f"{function}{_described(found)}"


def _described(found: Any) -> str:
    """Numbers by their names in the code, containers by what they hold."""
    if isinstance(found, Lane):
        return str(found.value.get_reference())
    if isinstance(found, Dual):
        return f"({_described(found.value)}, {_described(found.slope)})"
    if isinstance(found, Mapping):
        return _described(list(found.items()))
    if isinstance(found, list | tuple):
        return f"[{', '.join(map(_described, found))}]"
    return repr(float(found) if isinstance(found, float) else found)
