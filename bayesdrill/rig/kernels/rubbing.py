"""One step of a rig that rubs, written in numbers of any kind: registers, or these with a slope.

    x+ = Phi x + g + Gamma u + Gamma_f f

While a speed keeps its sign its effort f is the friction's size, against it.  Where the sign changes, f
is the mean over the step: of both signs, each for as long as a straight course of the speed has it, or,
where the speed stays at zero once it is there, what stops it.  A size that changes with the speed is
taken at the mean of the speeds at both ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir

from bayesdrill.basics.arithmetic import below, signed, size, where
from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.gathering import anywhere
from bayesdrill.rig.kernels.lanes import Lane, Mask, fma, vector
from bayesdrill.rig.models.friction import Law

Number = Any  # a Lane, or a Dual of them
Column = Mapping[int, Number]

# In which order efforts are found, each with those before it: they act on each other through the rig.
ORDERS = {0: (), 1: (0,), 2: (0, 1, 0), 3: (0, 1, 2, 0, 1, 2, 0, 1, 2)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rub:
    """`row`: the place of its speed; `holds`: of its angle; `column`: what a unit of it does to
    states in a step, and `over`: minus one over that to its own speed.  `size`: of a law that is steady.
    """

    row: int
    holds: int | None
    column: Column
    over: Number
    law: Law
    size: Number | None


@dataclass(frozen=True, slots=True)
class Kind:
    """Of numbers: registers, or, `dual`, registers with slopes."""

    b: ir.IRBuilder
    dual: bool

    def flat(self, numbers: Sequence[Number]) -> list[ir.Value]:
        """As registers, slopes after values."""
        if not self.dual:
            return [_register(number) for number in numbers]
        duals = [dual(number) for number in numbers]
        return [*(_register(d.value) for d in duals), *(_register(d.slope) for d in duals)]

    def shaped(self, registers: Sequence[ir.Value]) -> list[Number]:
        lanes = [Lane(self.b, value) for value in registers]
        if not self.dual:
            return list(lanes)
        n = len(lanes) // 2
        return [Dual(value, slope) for value, slope in zip(lanes[:n], lanes[n:], strict=True)]


def _register(number: Lane | float) -> ir.Value:
    return number.value if isinstance(number, Lane) else vector(number)


@dataclass(frozen=True, slots=True)
class Taken:
    """The state after a step, its efforts, and the frictions' sizes."""

    state: list[Number]
    efforts: list[Number]
    sizes: list[Number]

    @property
    def every(self) -> list[Number]:
        return [*self.state, *self.efforts, *self.sizes]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """`phi[row]`: what columns of (states, drive) do to a state; `base[row]`: what is constant."""

    phi: Sequence[Column]
    base: Mapping[int, Number]
    rubs: Sequence[Rub]
    parameters: Mapping[str, Number]
    states: tuple[str, ...]
    kind: Kind

    @property
    def steady(self) -> bool:
        """Whether no size ever changes."""
        return all(rub.size is not None for rub in self.rubs)

    def taken(
        self,
        state: list[Number],
        sizes: list[Number],
        drive: Column,
        inputs: Mapping[str, Number],
    ) -> Taken:
        """From `state`, where the last step's `sizes` are known; `inputs` by name, at its middle."""
        free = [
            total(self.base.get(i), [(entry, _of(k, state, drive)) for k, entry in row.items()])
            for i, row in enumerate(self.phi)
        ]
        if not self.rubs:
            return Taken(free, [], [])
        quick = self._slipping(free, state, sizes, inputs)
        b, kind = self.kind.b, self.kind
        keeps = self._all_keep(state, quick.state)
        before, ones = b.block, kind.flat(quick.every)
        with b.if_then(anywhere(b, b.not_(keeps.value)), likely=False):
            slow = self._turning(free, state, inputs)
            # A walker gets what it would get without its neighbours.
            others = kind.flat(
                [
                    where(keeps, one, other)
                    for one, other in zip(quick.every, slow.every, strict=True)
                ]
            )
            inside = b.block
        found = []
        for one, other in zip(ones, others, strict=True):
            found.append(b.phi(one.type))
            found[-1].add_incoming(one, before)
            found[-1].add_incoming(other, inside)
        every, x, e = kind.shaped(found), len(state), len(self.rubs)
        return Taken(every[:x], every[x : x + e], every[x + e :])

    def _all_keep(self, old: list[Number], new: list[Number]) -> Mask:
        first, *rest = (_keeps(old[rub.row], new[rub.row]) for rub in self.rubs)
        for one in rest:
            first = first.both(one)
        return first

    def _slipping(
        self,
        free: list[Number],
        state: list[Number],
        sizes: list[Number],
        inputs: Mapping[str, Number],
    ) -> Taken:
        """Where no speed changes its sign: the speeds ahead are those of the last step's sizes."""
        if not self.steady:
            ahead = self._moved(free, self._against(state, sizes), self._looked_at)
            sizes = self._between(state, ahead, inputs)
        efforts = self._against(state, sizes)
        return Taken(self._moved(free, efforts), efforts, sizes)

    def _turning(
        self, free: list[Number], state: list[Number], inputs: Mapping[str, Number]
    ) -> Taken:
        sizes = self.sizes(state, inputs)
        efforts, slips = self._efforts(free, state, sizes)
        if not self.steady:
            ahead = self._stopped(self._moved(free, efforts), slips)
            sizes = self._between(state, ahead, inputs)
            efforts, slips = self._efforts(free, state, sizes)
        new = self._stopped(self._moved(free, efforts), slips)
        return Taken(self._held(new, state, slips), efforts, sizes)

    def _against(self, state: list[Number], sizes: list[Number]) -> list[Number]:
        return [signed(one, state[rub.row]) for one, rub in zip(sizes, self.rubs, strict=True)]

    def sizes(self, state: list[Number], inputs: Mapping[str, Number]) -> list[Number]:
        """At the speeds of a state."""
        return self._of_laws([size(state[rub.row]) for rub in self.rubs], state, inputs)

    def _between(
        self, state: list[Number], ahead: list[Number], inputs: Mapping[str, Number]
    ) -> list[Number]:
        rates = [(size(state[r.row]) + size(ahead[r.row])) * 0.5 for r in self.rubs]
        looked = self._looked_at
        middle = [
            (one + other) * 0.5 if i in looked else one
            for i, (one, other) in enumerate(zip(state, ahead, strict=True))
        ]
        return self._of_laws(rates, middle, inputs)

    @property
    def _looked_at(self) -> set[int]:
        """Places of the states that laws have to see."""
        names = {name for rub in self.rubs for name in rub.law.seen}
        return {rub.row for rub in self.rubs} | {
            i for i, name in enumerate(self.states) if name in names
        }

    def _of_laws(
        self, rates: list[Number], state: list[Number], inputs: Mapping[str, Number]
    ) -> list[Number]:
        seen = {**dict(zip(self.states, state, strict=True)), **inputs}
        return [
            rub.law.size(self.parameters, rate, seen) if rub.size is None else rub.size
            for rub, rate in zip(self.rubs, rates, strict=True)
        ]

    def _efforts(
        self, free: list[Number], state: list[Number], sizes: list[Number]
    ) -> tuple[list[Number], list[Mask]]:
        """And where they let slip."""
        known: dict[int, Number] = {}
        slips: dict[int, Mask] = {}
        for e in ORDERS[len(self.rubs)]:
            rub = self.rubs[e]
            others = [
                (self.rubs[k].column[rub.row], effort)
                for k, effort in known.items()
                if k != e and rub.row in self.rubs[k].column
            ]
            stop = total(free[rub.row], others) * rub.over
            known[e], slips[e] = _effort(stop, state[rub.row], rub.over, sizes[e])
        return [known[e] for e in range(len(self.rubs))], [slips[e] for e in range(len(self.rubs))]

    def _moved(
        self, free: list[Number], efforts: list[Number], only: set[int] | None = None
    ) -> list[Number]:
        return [
            total(
                one,
                [
                    (rub.column[i], effort)
                    for rub, effort in zip(self.rubs, efforts, strict=True)
                    if i in rub.column and (only is None or i in only)
                ],
            )
            for i, one in enumerate(free)
        ]

    def _stopped(self, new: list[Number], slips: list[Mask]) -> list[Number]:
        new = list(new)
        for rub, moves in zip(self.rubs, slips, strict=True):
            new[rub.row] = where(moves, new[rub.row], 0.0)
        return new

    def _held(self, new: list[Number], old: list[Number], slips: list[Mask]) -> list[Number]:
        """Angles of speeds that were and are zero."""
        for rub, moves in zip(self.rubs, slips, strict=True):
            if rub.holds is not None:
                moved = moves.either(_moving(old[rub.row]))
                new[rub.holds] = where(moved, new[rub.holds], old[rub.holds])
        return new


def _effort(stop: Number, speed: Number, over: Number, most: Number) -> tuple[Number, Mask]:
    """The mean of it over a step from `speed` on, of which `stop` would make zero; and where it slips.

    With signs turned so that the speed is not negative, and in units of the effort: as long as
    stop > most, the speed stays positive.  Else it is zero after a share of the step, and remains so if
    what drives it there, stop - speed, is no more than friction can hold; if not, it goes on backwards.
    """
    back = below(speed, 0.0)
    ahead, rate = where(back, -stop, stop), size(speed) * over
    rest = rate - ahead + most  # what drives it backwards, and what holds it
    share = rate / rest
    passing = most * (share * 2.0 - 1.0)
    keeps, passes = _above(ahead, most), _above(rest, most * 2.0)
    turned = where(keeps, most, where(passes, passing, ahead))
    return where(back, -turned, turned), keeps.either(passes)


def _of(k: int, state: Sequence[Number], drive: Column) -> Number:
    return state[k] if k < len(state) else drive[k]


def _above(one: Number, other: Number) -> Mask:
    """NaN is above all."""
    left, right = dual(one).value, dual(other).value
    return Mask(left.b, left.b.fcmp_unordered(">", left.value, right.value))


def _moving(speed: Number) -> Mask:
    """NaN moves."""
    value = dual(speed).value
    return Mask(value.b, value.b.fcmp_unordered("!=", value.value, vector(0.0)))


def _keeps(old: Number, new: Number) -> Mask:
    """Whether a speed has the sign that it had; what is zero has none."""
    one, other = dual(old).value, dual(new).value
    product = one.b.fmul(one.value, other.value)
    return Mask(one.b, one.b.fcmp_ordered(">", product, vector(0.0)))


def total(start: Number | None, terms: Sequence[tuple[Number, Number]]) -> Number:
    """Sum of products, in two halves: a step takes as long as its longest chain of additions."""
    half = (len(terms) + 1) // 2
    first = start
    for left, right in terms[:half]:
        first = _fused(left, right, first)
    if len(terms) == half:
        return first
    second = None
    for left, right in terms[half:]:
        second = _fused(left, right, second)
    return first + second


def _fused(left: Number, right: Number, sum_: Number | None) -> Number:
    """left * right + sum_; a slope of 0.0 is none."""
    one, other = dual(left), dual(right)
    if not isinstance(left, Dual) and not isinstance(right, Dual) and not isinstance(sum_, Dual):
        return _lane(left, right, sum_)
    before = dual(sum_) if sum_ is not None else None
    value = _lane(one.value, other.value, before.value if before else None)
    slope = before.slope if before else 0.0
    for factor, change in ((one.slope, other.value), (one.value, other.slope)):
        if not _nothing(factor) and not _nothing(change):
            slope = _lane(factor, change, None if _nothing(slope) else slope)
    return Dual(value, slope)


def _nothing(number: Number) -> bool:
    return isinstance(number, float) and number == 0.0


def _lane(left: Lane, right: Lane, sum_: Lane | None) -> Lane:
    b = left.b
    if sum_ is None:
        return Lane(b, b.fmul(left.value, right.value))
    return Lane(b, fma(b, left.value, right.value, sum_.value))
