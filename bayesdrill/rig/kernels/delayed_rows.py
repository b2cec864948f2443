"""Rows of channels that show a rig between its samples, as code.

A channel that is late by d sees x(t - d).  With a whole number m of samples no less than d, that is
the rig a span s = m dt - d after sample n - m: states there through exp(A s), and the inputs of the
steps between.  So a delay changes rows of weights, and adds inputs that are seen at once.  The span
is shares of the steps from there on: of a step that it does not reach, zero.
"""

from __future__ import annotations

from llvmlite import ir

from bayesdrill.rig.kernels.jets import Jet, JetArithmetic, Jets, Matrix, with_slope
from bayesdrill.rig.kernels.lanes import I64, VEC, Builder, Vector, vector
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
        self._b, self._a, self._shape = b, JetArithmetic(b), shape
        self._x, self._series = shape.states, shape.layout.n_series
        self._through, self._parameters = through, parameters
        self._rates = self._of_a_step()

    def row(self, states: Jets, shares: Jets) -> tuple[Jets, Matrix]:
        """Return the row `(X + 1,)`, and weights of inputs `(D + 1, S)` at the samples from there.

        `shares (D,)`: of each step, that are in the span.
        """
        a = self._a
        weights = [[a.constant(0.0)] * self._series for _ in range(len(shares) + 1)]
        for step, share in reversed([*enumerate(shares)]):
            states, held, rise = self._passed(states, share)
            for s in range(self._series):
                weights[step][s] = a.add(weights[step][s], a.add(held[s], a.minus(rise[s])))
                weights[step + 1][s] = a.add(weights[step + 1][s], rise[s])
        return states, weights

    def _passed(self, row: Jets, share: Jet) -> tuple[Jets, Jets, Jets]:
        """Return a row before a span, and weights of inputs at its begin, and of their increments."""
        a, x, n = self._a, self._x, self._series
        e = self._through.over(share[0], self._parameters)

        def through(column: int) -> Jet:
            total = row[column] if column <= x else None
            return a.dot([(row[i], e(i, column)) for i in range(x)], total)

        states, held = (
            [through(j) for j in part] for part in (range(x + 1), range(x + 1, x + 1 + n))
        )
        rise = [a.constant(0.0)] * n
        if self._shape.layout.first_order:
            rise = [a.times(through(x + 1 + n + s), share[:1]) for s in range(n)]
        if len(share) > 1:
            values, by_share = [number[0] for number in states], share[1]
            if self._shape.layout.first_order:
                rise = [self._moved(*pair, by_share) for pair in zip(rise, held, strict=True)]
            rates = [(self._rate(values, column),) for column in range(x + 1 + n)]
            states = [self._moved(*pair, by_share) for pair in zip(states, rates, strict=False)]
            held = [self._moved(*pair, by_share) for pair in zip(held, rates[x + 1 :], strict=True)]
        return states, held, rise

    def _moved(self, number: Jet, rate: Jet, by_share: ir.Value) -> Jet:
        """Add to the slope of a number that of its share, which has this rate."""
        value, slope = with_slope(number, 2)
        return value, self._b.fma(rate[0], by_share, slope)

    def _rate(self, values: list[ir.Value], column: int) -> ir.Value:
        """Return by how much a row times exp(M span) changes with a share of a step."""
        terms = [(i, column) for i in range(self._x) if (i, column) in self._rates]
        return self._a.dot([((values[i],), (self._rates[i, j],)) for i, j in terms])[0]

    def _of_a_step(self) -> dict[tuple[int, int], ir.Value]:
        """Return the entries of M of the rig, times a step, by row and column of the rig."""
        b, x, layout = self._b, self._x, self._shape.layout
        shift = layout.n_states - x
        rates = dict[tuple[int, int], ir.Value]()
        for row, column, value in layout.matrix(b, self._parameters, self._through.constants):
            if row < x and (column < x or column >= layout.n_states):
                place = (row, column if column < x else column - shift)
                rate = value.value if isinstance(value, Vector) else vector(value)
                rates[place] = b.fma(rate, self._through.step, rates.get(place, vector(0.0)))
        return rates
