"""The right side of a rig's equations, in numbers of any kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from llvmlite import ir

from bayesdrill.basics.duals import Dual
from bayesdrill.rig.kernels.lanes import Lane, vector
from bayesdrill.rig.kernels.numbers import Number, total
from bayesdrill.rig.kernels.pieces import Shape


class Rates:
    """The right side of the rig's equations."""

    def __init__(self, b: ir.IRBuilder, shape: Shape, parameters: Mapping[str, Number]) -> None:
        self.b, self.shape = b, shape
        linear, states = shape.model.linear(parameters), shape.model.states
        constant, driven, x = dict(shape.constant), shape.driven, len(states)
        self.rows: list[dict[int, Number]] = [{} for _ in states]
        self.base: list[Number] = [self._number(0.0) for _ in states]
        for (row, column), value in linear.A.items():
            self.rows[states.index(row)][states.index(column)] = self._number(value)
        for row, value in linear.c.items():
            self.base[states.index(row)] = self.base[states.index(row)] + value
        for (row, name), value in linear.B.items():
            i = states.index(row)
            if name in driven:
                self.rows[i][x + 1 + driven.index(name)] = self._number(value)
            if constant.get(name, 0.0) != 0.0:
                self.base[i] = self.base[i] + value * constant[name]

    def _number(self, value: Number) -> Number:
        plain = not isinstance(value, Lane | Dual)
        return Lane(self.b, vector(float(value))) if plain else value

    def of(
        self,
        state: Sequence[Number],
        drive: dict[int, Number],
        efforts: Sequence[Number],
        *,
        later: Number | None = None,
    ) -> list[Number]:
        """At the beginning of a step, or `later` by its span, at its end."""
        shape, first = self.shape, len(self.rows) + 1
        values: dict[int, Number] = dict(enumerate(state)) | drive
        values |= {first + len(shape.columns) + e: one for e, one in enumerate(efforts)}
        if later is not None and shape.first_order:
            s = len(shape.series)
            values |= {first + k: drive[first + k] + drive[first + s + k] * later for k in range(s)}
        return [
            total(base, [(entry, values[k]) for k, entry in row.items()])
            for row, base in zip(self.rows, self.base, strict=True)
        ]
