"""Of each friction, which way it slips or that it sticks; and the rig that is linear as long as that
does not change.

    x_i+ = rows[i] (x, 1, drive, sizes of frictions that vary)

What a steady friction does is part of what is constant; what sticks takes what it has to, which is
linear in the rest, so that its own row is zero and its angle's row keeps the angle.  All of it stands
in memory, as it changes rarely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from llvmlite import ir

from bayesdrill.basics.arithmetic import where
from bayesdrill.basics.duals import Dual, dual
from bayesdrill.rig.kernels.lanes import Lane, Mask, load, store, vector
from bayesdrill.rig.kernels.numbers import Kind, Number, fused, sticking, way_of
from bayesdrill.rig.kernels.rub import Rub

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
            store(b, way.value, self.block, e)
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
                        store(self.kind.b, part.value, self.block, place)
                    place += 1
                self.slots[i, k] = row[k]

    # As long as they do not.

    def ways(self) -> list[Lane]:
        """1 or -1 as it slips, 0 as it sticks."""
        return [Lane(self.kind.b, load(self.kind.b, self.block, e)) for e in range(len(self.rubs))]

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
            return Lane(b, load(b, self.block, at)) if isinstance(number, Lane) else number

        if not isinstance(like, Dual):
            return part(like, place)
        return Dual(part(like.value, place), part(like.slope, place + 1))
