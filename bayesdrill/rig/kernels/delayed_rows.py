"""Rows of channels that show a rig between its samples, as code.

A channel that is late by d sees x(t - d).  With a whole number m of samples no less than d, that is
the rig a span s = m dt - d after sample n - m: states there through exp(A s), and the inputs of the
steps between.  So a delay changes rows of weights, and adds inputs that are seen at once.
"""

from __future__ import annotations

from collections.abc import Callable

from llvmlite import ir

from bayesdrill.rig.kernels.jets import Jet, JetArithmetic, Jets, with_slope
from bayesdrill.rig.kernels.lanes import Builder, vector

Entries = Callable[[int, int], Jet]  # of exp(M span) - 1, by row and column of the rig


class DelayedRows:
    """The code of rows over the states at a sample, of what is seen at a later time.

    `rates`: entries of M, by row and column.  `steps`: how many steps a span has at most.
    """

    def __init__(
        self, b: Builder, x: int, series: int, *, first_order: bool, steps: int,
        rates: dict[tuple[int, int], ir.Value],
    ) -> None:  # fmt: skip
        self._b, self._a, self._x, self._series = b, JetArithmetic(b), x, series
        self._first_order, self._steps, self._rates = first_order, steps, rates

    def row(
        self, row: Jets, part: Entries, whole: Entries, share: Jet, count: ir.Value
    ) -> tuple[Jets, list[Jets]]:
        """Return the row `(X + 1,)`, and weights of inputs `(steps + 1, S)` at the samples from there.

        `part`: of the span beyond `count` steps; `share`: that span over a step; `whole`: of a step.
        """
        a, b, zeros = self._a, self._b, [self._a.constant(0.0)] * self._series
        weights = [[*zeros] for _ in range(self._steps + 1)]
        parted = self._through(row, part, share)
        states = row
        for step in range(self._steps - 1, -1, -1):
            here = b.fcmp_ordered("==", count, vector(float(step)))
            beyond = b.fcmp_ordered(">", count, vector(float(step)))
            cases = zip(
                parted, self._through(states, whole, None), (states, zeros, zeros), strict=True
            )
            states, held, rise = (
                [
                    self._select(here, begun, self._select(beyond, passed, still))
                    for begun, passed, still in zip(*case, strict=True)
                ]
                for case in cases
            )
            for s in range(self._series):
                begin = a.add(held[s], a.minus(rise[s]))
                weights[step][s] = a.add(weights[step][s], begin)
                weights[step + 1][s] = a.add(weights[step + 1][s], rise[s])
        return states, weights

    def _through(self, row: Jets, e: Entries, share: Jet | None) -> tuple[Jets, Jets, Jets]:
        """Return a row before a span, and weights of inputs at its begin, and of their increments.

        `share`: the span over a step, None of a whole one.
        """
        a, x, n = self._a, self._x, self._series
        states, offset = row[:x], row[x]

        def passed(column: int, total: Jet | None) -> Jet:
            return a.dot([(states[i], e(i, column)) for i in range(x)], total)

        out = [passed(j, states[j]) for j in range(x)] + [passed(x, offset)]
        held = [passed(x + 1 + s, None) for s in range(n)]
        rise = [a.constant(0.0)] * n
        if self._first_order:
            rise = [passed(x + 1 + n + s, None) for s in range(n)]
            rise = rise if share is None else [a.times(number, (share[0],)) for number in rise]
        if share is not None and len(share) > 1:
            out, held, rise = self._moved(out, held, rise, share[1])
        return out, held, rise

    def _moved(self, out: Jets, held: Jets, rise: Jets, slope: ir.Value) -> tuple[Jets, Jets, Jets]:
        """Add the slopes by the span; `slope`: of its share of a step, and rates are per step."""
        x, a = self._x, self._a
        values = [number[0] for number in out]

        def rate(column: int) -> ir.Value:
            pairs = [
                ((values[i],), (self._rates[i, column],))
                for i in range(x)
                if (i, column) in self._rates
            ]
            return self._b.fmul(a.dot(pairs)[0], slope)

        def add(number: Jet, more: ir.Value) -> Jet:
            return number[0], self._b.fadd(number[1] if len(number) > 1 else vector(0.0), more)

        if self._first_order:
            rise = [
                add(number, self._b.fmul(first[0], slope))
                for number, first in zip(rise, held, strict=True)
            ]
        return (
            [add(number, rate(j)) for j, number in enumerate(out)],
            [add(number, rate(x + 1 + s)) for s, number in enumerate(held)],
            rise,
        )

    def _select(self, mask: ir.Value, first: Jet, second: Jet) -> Jet:
        width = max(len(first), len(second))
        pairs = zip(with_slope(first, width), with_slope(second, width), strict=True)
        return tuple(self._b.select(mask, *pair) for pair in pairs)
