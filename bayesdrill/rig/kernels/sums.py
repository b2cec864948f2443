"""Compute for each channel the sums over residuals, such as squares, that noise densities need."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.rig.kernels.lanes import INT_VEC, VEC, Builder, Values, Vector, vector


@dataclass(frozen=True, slots=True)
class Record:
    """A record has the addresses of its samples `y (T, K)` and of `begin (K,)`.

    Missing samples are NaN. `begin` has the index of the first measured sample of each channel.
    All walkers (sets of parameters) have the same samples, so that branches can skip missing ones.
    """

    b: Builder
    y: ir.Value
    begin: ir.Value
    channels: int

    def measured(self, sample: ir.Value, k: int) -> ir.Value:
        """Load the measured value of channel k at a sample, as a single number."""
        return self.b.single(self.y, self.b.add(self.b.mul(sample, self.channels), k))

    def residual(self, sample: ir.Value, k: int, value: ir.Value) -> ir.Value:
        """Return the measured value of channel k minus the computed `value` of each walker."""
        return self.b.fsub(self.b.splat(self.measured(sample, k)), value)

    def if_observed(
        self, sample: ir.Value, k: int, default: Values, other: Callable[[], Values]
    ) -> Values:
        """Return the result of `other` if channel k was measured at a sample, else `default`."""
        y = self.measured(sample, k)
        return self.b.replace_if(self.b.fcmp_ordered("ord", y, y), default, other, likely=True)

    def unless_first(self, sample: ir.Value, k: int, later: Values, first: Values) -> Values:
        """Return `later`, or `first` at the first sample of channel k."""
        begins = self.b.icmp_signed("==", sample, self.b.single(self.begin, k))
        return self.b.replace_if(begins, later, lambda: first, likely=False)


@dataclass(frozen=True, slots=True)
class Sample:
    """A sample of channel `k` of a record has a `residual`, and the `weights` of the channel."""

    record: Record
    index: ir.Value
    k: int
    residual: ir.Value
    weights: Values


@dataclass(frozen=True, slots=True)
class ResidualSums:
    """The sums are those of squares of residuals; classes for other sums derive from this class.

    `weights` is the number of weights of a walker for each channel. `start` has the initial values
    of a channel's registers, which are carried from sample to sample. Instances of different
    classes are never equal, so that none is mistaken for `SQUARES`.
    """

    start: tuple[float, ...] = (0.0,)
    weights: int = 0

    @property
    def count(self) -> int:
        """Return how many registers a channel has."""
        return len(self.start)

    def initial(self, channels: int = 1) -> Values:
        """Return the registers before the first sample, channel after channel."""
        return [vector(value) for value in self.start] * channels

    def add_if_observed(self, b: Builder, totals: Values, sample: Sample) -> Values:
        """Return the registers of all channels with one more sample, if it was measured."""
        first, last = sample.k * self.count, (sample.k + 1) * self.count
        before = totals[first:last]
        new = sample.record.if_observed(
            sample.index, sample.k, before, lambda: self.add(b, before, sample)
        )
        return [*totals[:first], *new, *totals[last:]]

    def add(self, b: Builder, totals: Values, sample: Sample) -> Values:
        """Return the registers `totals` of a channel with one more sample of the channel."""
        return [b.fma(sample.residual, sample.residual, totals[0])]


@dataclass(frozen=True, slots=True)
class _Neighbours(ResidualSums):
    """The sums are those of squared residuals and increments, then the last and first residual."""

    start: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def add(self, b: Builder, totals: Values, sample: Sample) -> Values:
        squares, steps, last, first = totals
        residual, begin = sample.residual, [vector(0.0), sample.residual]
        later = [b.fsub(residual, last), first]
        step, first = sample.record.unless_first(sample.index, sample.k, later, begin)
        return [b.fma(residual, residual, squares), b.fma(step, step, steps), residual, first]


_FRACTION = (1 << 52) - 1  # mask of the 52 bits of a double's fraction
_ONE = 1023 << 52  # the bits of the double 1.0


@dataclass(frozen=True, slots=True)
class _Logs(ResidualSums):
    """The sums are the sum of squares, and the product of the factors 1 + weight * residual^2.

    The product is stored as a number from 1 to 2 and an integer exponent of two, which cannot
    overflow. So only one logarithm is taken, of the whole product.
    """

    start: tuple[float, ...] = (0.0, 1.0, 0.0)
    weights: int = 1

    def add(self, b: Builder, totals: Values, sample: Sample) -> Values:
        squares, product, powers = totals
        square = b.fmul(sample.residual, sample.residual)
        factor = b.fma(sample.weights[0], square, vector(1.0))
        return [b.fadd(squares, square), *_times(b, product, powers, factor)]


def _times(b: Builder, product: ir.Value, powers: ir.Value, factor: ir.Value) -> Values:
    """Return a product and its exponent of two, see `_Logs`, multiplied by a factor."""
    bits = b.bitcast(b.fmul(product, factor), INT_VEC)
    power = b.sub(b.lshr(bits, 52), 1023)
    fraction = b.or_(b.and_(bits, _FRACTION), _ONE)
    whole = b.add(b.bitcast(powers, INT_VEC), power)
    return [b.bitcast(fraction, VEC), b.bitcast(whole, VEC)]


MAX_INSIDE_SDS = -8.5  # (|residual| - width / 2) / sd below which the probability is 1 - 1e-17
_TURN = 3.0
# Polynomial in (x - _TURN) / (x + _TURN) for (1 + 2 x) erfcx(x) / 2, x >= 0, with an error of 1e-10
# (Shepherd and Laframboise 1981).
_TAIL = (
    0.626504029134865,
    -0.06781055221817794,
    -0.023781147143580275,
    0.06482254768566878,
    -0.059636832964930137,
    0.034154359726710146,
    -0.011885243345947868,
    0.0012630128247643313,
    0.0009442732342668533,
    -0.00038565099561746285,
    -5.238290620130925e-05,
    5.6594558198715556e-05,
    2.1616152328836802e-06,
    -5.519855373374109e-06,
    -6.585111502014721e-08,
)


def _tail(b: Builder, far: ir.Value) -> ir.Value:
    """Return P(z > far) / exp(-far^2 / 2) for a standard normal z, if `far` is not negative."""
    x = b.fmul(far, vector(math.sqrt(0.5)))
    wide, twice = b.fadd(x, vector(_TURN)), b.fma(x, vector(2.0), vector(1.0))
    over = b.fdiv(vector(1.0), b.fmul(wide, twice))
    position = b.fmul(b.fmul(b.fsub(x, vector(_TURN)), twice), over)
    return b.fmul(b.polynomial(_TAIL, position), b.fmul(wide, over))


@dataclass(frozen=True, slots=True)
class _Intervals(ResidualSums):
    """The sums are the sum of squares, and the product of probabilities of intervals around residuals.

    The product is stored as in `_Logs`. Each interval is residual +- width / 2. If zero is outside
    an interval, the interval's probability is divided by exp(-x^2 / 2) at the nearer end x; these
    factors' logs are added up too. The weights are 1 / sd, and width / (2 sd) >= 0.2.
    """

    start: tuple[float, ...] = (0.0, 1.0, 0.0, 0.0)
    weights: int = 2

    def add(self, b: Builder, totals: Values, sample: Sample) -> Values:
        over, half = sample.weights
        middle = b.fmul(b.absolute(sample.residual), over)
        near = b.fsub(middle, half)
        squares, *others = totals
        squares = b.fma(sample.residual, sample.residual, squares)

        def moved() -> Values:
            return self._moved(b, others, near, middle, half)

        # Where zero is far inside the interval, the probability is one and changes no product.
        far = b.anywhere(b.fcmp_unordered(">", near, vector(MAX_INSIDE_SDS)))
        return [squares, *b.replace_if(far, others, moved)]

    def _moved(
        self, b: Builder, totals: Values, near: ir.Value, middle: ir.Value, half: ir.Value
    ) -> Values:
        product, powers, logs = totals
        zero, minus = vector(0.0), vector(-0.5)
        far = b.fadd(middle, half)
        beyond = b.fcmp_ordered(">", near, zero)
        log = b.fmul(b.fmul(near, near), minus)
        here = _tail(b, Vector(b, near).size().value)
        there = b.fmul(_tail(b, far), b.exp(b.fmul(b.fmul(middle, half), vector(-2.0))))
        outside = b.fmul(b.exp(log), b.fadd(here, there))
        mass = b.select(beyond, b.fsub(here, there), b.fsub(vector(1.0), outside))
        return [*_times(b, product, powers, mass), b.fadd(logs, b.select(beyond, log, zero))]


SQUARES = ResidualSums()
NEIGHBOURS = _Neighbours()
LOGS = _Logs()
INTERVALS = _Intervals()
