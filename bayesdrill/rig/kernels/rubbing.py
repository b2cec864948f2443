"""One step of a rig that rubs, written in numbers of any kind: registers, or these with a slope.

    x+ = Phi x + g + Gamma u + Gamma_f f

As long as each friction slips one way or sticks, the rig is a linear one: its `Regime`.  A size that
changes with the speed is taken at the mean of the speeds at both ends.  Where a speed changes its sign,
or what stuck lets go, see `Turning`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from bayesdrill.basics.arithmetic import size
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
)
from bayesdrill.rig.kernels.regime import Regime
from bayesdrill.rig.kernels.rub import Rub, along


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
class Going:
    """A step in which each friction slips on as it did, or sticks on."""

    step: Step
    regime: Regime

    def taken(
        self,
        state: list[Number],
        past: Past,
        drive: Column,
        inputs: Mapping[str, Number],
        ways: Sequence[Lane],
        sizes: Sequence[Number] | None = None,
    ) -> tuple[list[Number], list[Number], Past]:
        """New state, efforts (if the regime shows them) and the past then.

        Sizes that vary are those in the middle: it is looked ahead with sizes that go on as they did.
        Where `sizes` are known, they are these.
        """
        step, x, varying = self.step, len(state), self.step.varying
        rows = self.regime.now()
        columns = [[row.pop(step.first + e, None) for row in rows] for e in varying]
        new = [total(row.pop(x, None), along(row, state, drive)) for row in rows]
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
            every = step.between(state, ahead, inputs)
            sizes = [every[e] for e in varying]
        trends = [one - before for one, before in zip(sizes, past.sizes, strict=True)]
        moved = with_sizes(sizes, range(len(rows)))
        return moved[:x], moved[x:], Past(list(sizes), trends)

    def leaves(self, new: Sequence[Number], ways: Sequence[Lane]) -> Mask:
        """Lanes in which a speed is not what it was, or sticks."""
        return any_of(goes_on(way, new[rub.row]).turned() for way, rub in self._pairs(ways))

    def changes(
        self,
        new: Sequence[Number],
        drive: Column,
        inputs: Mapping[str, Number],
        ways: Sequence[Lane],
    ) -> Mask:
        """Lanes in which a speed changes its sign, or what sticks has more to hold than it can."""
        step = self.step
        sizes, later = step.at_rest(new, inputs), step.later(drive)
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
