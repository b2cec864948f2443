"""One step of a rig with friction: which way each friction slips or that it sticks, and the linear
rig in between.

    x_i+ = rows[i] (x, 1, drive, sizes of frictions that vary)

What a steady friction does is part of what is constant; what sticks takes what it has to, which is
linear in the rest, so that its own row is zero and its angle's row keeps the angle.  All of it stands
in memory, as it changes rarely.

    x+ = Phi x + g + Gamma u + Gamma_f f

As long as each friction slips one way or sticks, the rig is a linear one: its `Regime`.  A size that
changes with the speed is taken at the mean of the speeds at both ends.  Where a speed changes its sign,
or what stuck lets go, see `Turning`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from llvmlite import ir

from bayesdrill.basics.duals import Dual, dual, size, where
from bayesdrill.rig.kernels.lanes import Lane, Mask, vector
from bayesdrill.rig.kernels.numbers import (
    Column,
    Kind,
    Number,
    above,
    fused,
    goes_on,
    sticking,
    total,
    way_of,
)
from bayesdrill.rig.models.friction import Law


@dataclass(frozen=True, slots=True, kw_only=True)
class Rub:
    """`row`: the place of its speed; `holds`: of its angle; `column`: what a unit of it does to
    states in a step, and `over`: minus one over that to its own speed.  `pull`, `pull_base`: what it
    has to hold, of states and drive.  `steady`: its size, of a law that is steady.
    """

    row: int
    holds: int | None
    column: Column
    over: Number
    pull: Column
    pull_base: Number
    law: Law
    steady: Number | None

    def held(self, state: Sequence[Number], drive: Column) -> Number:
        """What it takes to keep the speed as it is."""
        return total(self.pull_base, along(self.pull, state, drive))

    def size(
        self, parameters: Mapping[str, Number], speed: Number, seen: Mapping[str, Number]
    ) -> Number:
        return self.law.size(parameters, size(speed), seen) if self.steady is None else self.steady


def along(row: Column, state: Sequence[Number], drive: Column) -> list[tuple[Number, Number]]:
    """Terms of a row over states and drive, what is known first at first."""
    x = len(state)
    known = [(entry, drive[k]) for k, entry in row.items() if k >= x]
    return known + [(entry, state[k]) for k, entry in row.items() if k < x]


Rows = list[dict[int, Number]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Regime:
    """`rows`: of states over columns (states, one, drive, frictions from `first` on); `shows`: with
    a row for the effort of each friction.  `block`: room in memory for `size` registers.
    """

    kind: Kind
    rows: Rows
    rubs: Sequence[Rub]
    first: int
    shows: bool
    block: ir.Value
    slots: dict[tuple[int, int], Number] = field(default_factory=dict)

    @staticmethod
    def size(states: int, columns: int, frictions: int) -> int:
        """Registers, slopes among them."""
        return frictions + 2 * (states + frictions) * (columns + frictions)

    @property
    def one(self) -> int:
        return len(self.rows)

    # Where speeds have changed their signs.

    def set(self, state: Sequence[Number]) -> None:
        """As speeds are: what has none sticks."""
        b, ways = self.kind.b, [way_of(state[rub.row]) for rub in self.rubs]
        rows = [dict(row) for row in self.rows]
        if self.shows:
            rows += [{self.first + e: Lane(b, vector(1.0))} for e in range(len(self.rubs))]
        for e, way in enumerate(ways):
            self._hold(rows, e, sticking(way))
        for e, (rub, way) in enumerate(zip(self.rubs, ways, strict=True)):
            b.write(way.value, self.block, e)
            if rub.steady is not None:
                effort = fused(rub.steady, way, None)
                for row in rows:
                    entry = row.pop(self.first + e, None)
                    if entry is not None:
                        row[self.one] = fused(entry, effort, row.get(self.one))
        self._keep(rows)

    def _hold(self, rows: Rows, e: int, still: Mask) -> None:
        """Where friction e sticks: it takes what makes its speed zero."""
        rub, column = self.rubs[e], self.first + e
        pivot = dict(rows[rub.row])
        stop = -1.0 / pivot.pop(column)
        for i, row in enumerate(rows):
            if i != rub.row and column in row:
                share = where(still, row[column] * stop, 0.0)
                for k, entry in pivot.items():
                    row[k] = fused(share, entry, row.get(k))
        for k in pivot:
            rows[rub.row][k] = where(still, 0.0, rows[rub.row][k])
        if rub.holds is not None:
            held = rows[rub.holds]
            for k in held:
                held[k] = where(still, 1.0 if k == rub.holds else 0.0, held[k])

    def _keep(self, rows: Rows) -> None:
        """In the same places each time."""
        place = len(self.rubs)
        for i, row in enumerate(rows):
            for k in sorted(row):
                number = dual(row[k])
                for part in (number.value, number.slope):
                    if isinstance(part, Lane):
                        self.kind.b.write(part.value, self.block, place)
                    place += 1
                self.slots[i, k] = row[k]

    # As long as they do not.

    def ways(self) -> list[Lane]:
        """1 or -1 as it slips, 0 as it sticks."""
        return [Lane(self.kind.b, self.kind.b.read(self.block, e)) for e in range(len(self.rubs))]

    def now(self) -> Rows:
        """Read again: it may have changed."""
        place = len(self.rubs)
        found: Rows = [{} for _ in range(1 + max(i for i, _ in self.slots))]
        for (i, k), like in self.slots.items():
            found[i][k] = self._read(like, place)
            place += 2
        return found

    def _read(self, like: Number, place: int) -> Number:
        b = self.kind.b

        def part(number: Lane | float, at: int) -> Lane | float:
            return Lane(b, b.read(self.block, at)) if isinstance(number, Lane) else number

        if not isinstance(like, Dual):
            return part(like, place)
        return Dual(part(like.value, place), part(like.slope, place + 1))


@dataclass(frozen=True, slots=True)
class Past:
    """Of the last step: sizes of frictions that vary, and how much these changed."""

    sizes: list[Number]
    trends: list[Number]


@dataclass(frozen=True, kw_only=True)
class Step:
    """`phi[row]`: what columns of (states, drive) do to a state; `base[row]`: what is constant;
    `slopes`: columns of inputs, and those of their slopes; `first`: column of the first friction.
    """

    phi: Sequence[Column]
    base: Mapping[int, Number]
    rubs: Sequence[Rub]
    parameters: Mapping[str, Number]
    states: tuple[str, ...]
    span: Number
    slopes: Mapping[int, int]
    first: int
    kind: Kind

    @cached_property
    def varying(self) -> list[int]:
        """Frictions whose size is not that of the parameters alone."""
        return [e for e, rub in enumerate(self.rubs) if rub.steady is None]

    @cached_property
    def looked_at(self) -> list[int]:
        """Places of states that sizes change with."""
        unsteady = [self.rubs[e] for e in self.varying]
        names = {name for rub in unsteady for name in rub.law.seen}
        named = {i for i, name in enumerate(self.states) if name in names}
        return sorted(named | {rub.row for rub in unsteady})

    def rows(self) -> list[dict[int, Number]]:
        """Of states over all columns."""
        rows = [dict(row) for row in self.phi]
        for i, base in self.base.items():
            rows[i][len(self.phi)] = base
        for e, rub in enumerate(self.rubs):
            for i, entry in rub.column.items():
                rows[i][self.first + e] = entry
        return rows

    def sizes(self, state: Sequence[Number], inputs: Mapping[str, Number]) -> list[Number]:
        seen = {**dict(zip(self.states, state, strict=True)), **inputs}
        return [rub.size(self.parameters, state[rub.row], seen) for rub in self.rubs]

    def at_rest(self, state: Sequence[Number], inputs: Mapping[str, Number]) -> list[Number]:
        """Sizes, if nothing moved."""
        still = list(state)
        for rub in self.rubs:
            still[rub.row] = Lane(self.kind.b, vector(0.0))
        return self.sizes(still, inputs)

    def between(
        self, state: Sequence[Number], ahead: Sequence[Number], inputs: Mapping[str, Number]
    ) -> list[Number]:
        """Sizes in the mean of both ends of a step."""
        speeds, middle = {rub.row for rub in self.rubs}, list(state)
        for i in self.looked_at:
            here, there = state[i], ahead[i]
            turned = i in speeds
            middle[i] = (size(here) + size(there) if turned else here + there) * 0.5
        return self.sizes(middle, inputs)

    def later(self, drive: Column) -> Column:
        """At the end of the step."""
        ends = {k: drive[k] + drive[slope] * self.span for k, slope in self.slopes.items()}
        return {**drive, **ends}

    def free(self, state: Sequence[Number], drive: Column) -> list[Number]:
        """New states, if nothing rubbed."""
        return [total(self.base.get(i), along(row, state, drive)) for i, row in enumerate(self.phi)]


@dataclass(frozen=True, slots=True)
class Moment:
    """The beginning of a step: the state, the past, and what drives it, by column and, in its middle, by
    name.
    """

    state: list[Number]
    past: Past
    drive: Column
    inputs: Mapping[str, Number]


@dataclass(frozen=True, slots=True)
class Going:
    """A step in which each friction slips on as it did, or sticks on."""

    step: Step
    regime: Regime

    def taken(
        self, now: Moment, ways: Sequence[Lane], sizes: Sequence[Number] | None = None
    ) -> tuple[list[Number], list[Number], Past]:
        """New state, efforts (if the regime shows them) and the past then.

        Sizes that vary are those in the middle: it is looked ahead with sizes that go on as they did.
        Where `sizes` are known, they are these.
        """
        step, state, past = self.step, now.state, now.past
        x, varying = len(state), step.varying
        rows = self.regime.now()
        columns = [[row.pop(step.first + e, None) for row in rows] for e in varying]
        new = [total(row.pop(x, None), along(row, state, now.drive)) for row in rows]
        if not varying:
            return new[:x], new[x:], past

        def with_sizes(sizes: Sequence[Number], only: Sequence[int]) -> list[Number]:
            moved = list(new)
            for e, column, one in zip(varying, columns, sizes, strict=True):
                effort = fused(one, ways[e], None)
                for i in (i for i in only if column[i] is not None):
                    moved[i] = fused(column[i], effort, moved[i])
            return moved

        if sizes is None:
            likely = [one + trend for one, trend in zip(past.sizes, past.trends, strict=True)]
            ahead = with_sizes(likely, step.looked_at)
            every = step.between(state, ahead, now.inputs)
            sizes = [every[e] for e in varying]
        trends = [one - before for one, before in zip(sizes, past.sizes, strict=True)]
        moved = with_sizes(sizes, range(len(rows)))
        return moved[:x], moved[x:], Past(list(sizes), trends)

    def leaves(self, new: Sequence[Number], ways: Sequence[Lane]) -> Mask:
        """Lanes in which a speed is not what it was, or sticks."""
        return any_of(goes_on(way, new[rub.row]).turned() for way, rub in self._pairs(ways))

    def changes(self, new: Sequence[Number], now: Moment, ways: Sequence[Lane]) -> Mask:
        """Lanes in which a speed changes its sign, or what sticks has more to hold than it can."""
        step = self.step
        sizes, later = step.at_rest(new, now.inputs), step.later(now.drive)
        found = []
        for (way, rub), most in zip(self._pairs(ways), sizes, strict=True):
            beyond = above(size(rub.held(new, later)), most)
            still = sticking(way)
            turned = goes_on(way, new[rub.row]).turned()
            found.append(beyond.both(still).either(turned.without(still)))
        return any_of(found)

    def _pairs(self, ways: Sequence[Lane]) -> list[tuple[Lane, Rub]]:
        return list(zip(ways, self.step.rubs, strict=True))


def any_of(masks: Iterable[Mask]) -> Mask:
    first, *rest = masks
    for one in rest:
        first = first.either(one)
    return first
