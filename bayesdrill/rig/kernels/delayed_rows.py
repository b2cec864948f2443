"""Rows of channels that show a rig between its samples, as code.

A channel that is late by d sees x(t - d).  With a whole number m of samples no less than d, that is
the rig a span s = m dt - d after sample n - m: states there through exp(A s), and the inputs of the
steps between.  So a delay changes rows of weights, and adds inputs that are seen at once.  The span
is shares of the steps from there on: of a step that it does not reach, zero.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.lanes import I64, VEC, Builder, Vector, vector
from bayesdrill.rig.kernels.numbers import Matrix, Number, dot
from bayesdrill.rig.kernels.rational_basis import BasisShape, ExponentialEntries


class SpanExponential:
    """The code of exp(M span) - 1 of a walker; `numbers`: the step, then constant inputs."""

    def __init__(
        self, b: Builder, shape: BasisShape, function: ir.Function, numbers: ir.Value
    ) -> None:
        self.step = b.splat(b.load(numbers))
        self.constants = b.gep(numbers, [I64(1)])
        self._b, self._shape, self._function = b, shape, function
        self._span, self._e = b.alloca(VEC), b.alloca(VEC, I64(shape.layout.size**2))

    def over(
        self, share: ir.Value, parameters: ir.Value, e: ir.Value | None = None
    ) -> ExponentialEntries:
        """Store it over a `share` of a step, at `e` or a place of its own; return its entries."""
        e = self._e if e is None else e
        self._b.write(self._b.fmul(share, self.step), self._span, 0)
        self._b.call(self._function, [parameters, self.constants, self._span, e])
        return ExponentialEntries(self._b, self._shape, e)


class DelayedRows:
    """The code of rows over the states at a sample, of what is seen at a later time."""

    def __init__(
        self, b: Builder, shape: BasisShape, through: SpanExponential, parameters: ir.Value
    ) -> None:
        self._shape, self._x, self._series = shape, shape.states, shape.layout.n_series
        self._through, self._parameters = through, parameters
        self._nothing: list[Number] = [Vector(b, vector(0.0))] * self._series
        self._rates = self._of_a_step(b)

    def row(self, states: list[Number], shares: list[Number]) -> tuple[list[Number], Matrix]:
        """Return the row `(X + 1,)`, and weights of inputs `(D + 1, S)` at the samples from there.

        `shares (D,)`: of each step, that are in the span.
        """
        weights = [[*self._nothing] for _ in range(len(shares) + 1)]
        for step, share in reversed([*enumerate(shares)]):
            states, held, rise = self._passed(states, share)
            for s in range(self._series):
                weights[step][s] = weights[step][s] + (held[s] - rise[s])
                weights[step + 1][s] = weights[step + 1][s] + rise[s]
        return states, weights

    def _passed(self, row: list[Number], share: Number) -> tuple[list[Number], ...]:
        """Return a row before a span, and weights of inputs at its begin, and of their increments."""
        x, n, first_order = self._x, self._series, self._shape.layout.first_order
        span, by_share = dual(share).value, dual(share).slope
        e = self._through.over(span.value, self._parameters)
        columns = [
            dot(row[:x], [e(i, column) for i in range(x)], row[column] if column <= x else None)
            for column in range(x + 1 + n * (1 + first_order))
        ]
        states, held, rise = columns[: x + 1], columns[x + 1 : x + 1 + n], columns[x + 1 + n :]
        rise = [number * span for number in rise] if first_order else self._nothing
        if self._shape.tangent:
            values = [dual(number).value for number in states]
            if first_order:
                rise = [
                    a + Dual(0.0, dual(c).value * by_share) for a, c in zip(rise, held, strict=True)
                ]
            states, held = (
                [
                    number + Dual(0.0, self._rate(values, column) * by_share)
                    for column, number in enumerate(part, first)
                ]
                for first, part in ((0, states), (x + 1, held))
            )
        return states, held, rise

    def _rate(self, values: list[Number], column: int) -> Number:
        """Return by how much a row times exp(M span) changes with a share of a step."""
        return sum(values[i] * rate for (i, at), rate in self._rates.items() if at == column)

    def _of_a_step(self, b: Builder) -> dict[tuple[int, int], Number]:
        """Return the entries of M of the rig, times a step, by row and column of the rig."""
        x, layout = self._x, self._shape.layout
        shift, rates = layout.n_states - x, dict[tuple[int, int], Number]()
        for row, column, value in layout.matrix(b, self._parameters, self._through.constants):
            if row < x and (column < x or column >= layout.n_states):
                place = (row, column if column < x else column - shift)
                rates[place] = value * Vector(b, self._through.step) + rates.get(place, 0.0)
        return rates
