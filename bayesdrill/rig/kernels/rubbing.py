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
from functools import cached_property

from bayesdrill.basics.arithmetic import below, signed, size, where
from bayesdrill.basics.duals import Dual
from bayesdrill.rig.kernels.lanes import Lane, Mask, vector
from bayesdrill.rig.kernels.numbers import (
    Column,
    Kind,
    Number,
    above,
    fused,
    keeps_sign,
    moving,
    total,
)
from bayesdrill.rig.models.friction import Law


@dataclass(frozen=True, slots=True, kw_only=True)
class Rub:
    """`row`: the place of its speed; `holds`: of its angle; `column`: what a unit of it does to
    states in a step, and `over`: minus one over that to its own speed.  `pull`, `pull_base`: what it
    has to hold, of states and drive.  `size`: of a law that is steady.
    """

    row: int
    holds: int | None
    column: Column
    over: Number
    pull: Column
    pull_base: Number
    law: Law
    size: Number | None

    def held(self, state: Sequence[Number], drive: Column) -> Number:
        """What it takes to keep the speed as it is."""
        terms = [(entry, _of(k, state, drive)) for k, entry in self.pull.items()]
        return total(self.pull_base, terms)


@dataclass(frozen=True, slots=True)
class At:
    """Of a friction at the beginning of a step: what has to be `held`, and its `size` at rest."""

    held: Number
    size: Number


@dataclass(frozen=True, slots=True)
class Past:
    """Of the last step: sizes of frictions, and how much these changed."""

    sizes: list[Number]
    trends: list[Number]


@dataclass(frozen=True, kw_only=True)
class Step:
    """`phi[row]`: what columns of (states, drive) do to a state; `base[row]`: what is constant;
    `slopes`: columns of inputs, and those of their slopes.
    """

    phi: Sequence[Column]
    base: Mapping[int, Number]
    rubs: Sequence[Rub]
    parameters: Mapping[str, Number]
    states: tuple[str, ...]
    span: Number
    slopes: Mapping[int, int]
    kind: Kind

    @property
    def steady(self) -> bool:
        """Whether no size ever changes."""
        return all(rub.size is not None for rub in self.rubs)

    @cached_property
    def looked_at(self) -> list[int]:
        """Places of states that sizes change with."""
        unsteady = [rub for rub in self.rubs if rub.size is None]
        names = {name for rub in unsteady for name in rub.law.seen}
        named = {i for i, name in enumerate(self.states) if name in names}
        return sorted(named | {rub.row for rub in unsteady})

    @property
    def _order(self) -> list[int]:
        """In which efforts are found, each with the others as known: at first as if nothing turned.

        What stops a current comes first, and once more: it and the motor act on each other strongly.
        """
        every = sorted(range(len(self.rubs)), key=lambda e: self.rubs[e].holds is not None)
        return every * (1 + any(rub.holds is None for rub in self.rubs))

    def begun(self, state: list[Number], inputs: Mapping[str, Number]) -> Past:
        nothing = [Lane(self.kind.b, vector(0.0)) for _ in self.rubs]
        return Past(self.sizes(state, inputs), nothing)

    def taken(
        self, state: list[Number], past: Past, drive: Column, inputs: Mapping[str, Number]
    ) -> tuple[list[Number], list[Number], Past]:
        """New state, efforts, and what is past then; `inputs` by name, in the middle of the step."""
        free = [
            total(self.base.get(i), [(entry, _of(k, state, drive)) for k, entry in row.items()])
            for i, row in enumerate(self.phi)
        ]
        if not self.rubs:
            return free, [], past
        quick = self._slipping(free, state, past, inputs)
        keeps = self._all_keep(state, quick)
        every = self.kind.rarely(
            keeps.turned(), quick, lambda: self._turning(free, state, past, drive, inputs)
        )
        x, e = len(state), len(self.rubs)
        new, efforts = every[:x], every[x : x + e]
        if self.steady:
            return new, efforts, past
        return new, efforts, Past(every[x + e : x + 2 * e], every[x + 2 * e :])

    def _all_keep(self, old: list[Number], new: list[Number]) -> Mask:
        first, *rest = (keeps_sign(old[rub.row], new[rub.row]) for rub in self.rubs)
        for one in rest:
            first = first.both(one)
        return first

    def _slipping(
        self, free: list[Number], state: list[Number], past: Past, inputs: Mapping[str, Number]
    ) -> list[Number]:
        """Where no speed changes its sign: it is looked ahead with sizes that go on as they did."""
        if self.steady:
            efforts = self._against(state, past.sizes)
            return [*self._moved(free, efforts), *efforts]
        likely = [one + trend for one, trend in zip(past.sizes, past.trends, strict=True)]
        ahead = self._moved(free, self._against(state, likely), self.looked_at)
        sizes = self._between(state, ahead, inputs)
        efforts = self._against(state, sizes)
        trends = [one - before for one, before in zip(sizes, past.sizes, strict=True)]
        return [*self._moved(free, efforts), *efforts, *sizes, *trends]

    def _turning(
        self,
        free: list[Number],
        state: list[Number],
        past: Past,
        drive: Column,
        inputs: Mapping[str, Number],
    ) -> list[Number]:
        sizes, rest = past.sizes, self._at_rest(state, drive, inputs)
        later = self._later(drive)
        efforts, slips = self._efforts(free, state, later, sizes, rest)
        if not self.steady:
            ahead = self._stopped(self._moved(free, efforts), slips)
            sizes = self._between(state, ahead, inputs)
            efforts, slips = self._efforts(free, state, later, sizes, rest)
        new = self._held(self._stopped(self._moved(free, efforts), slips), state, slips)
        return [*new, *efforts] if self.steady else [*new, *efforts, *sizes, *self._no_trends]

    @property
    def _no_trends(self) -> list[Number]:
        """What turns does not go on as it did."""
        zero = Lane(self.kind.b, vector(0.0))
        return [Dual(zero, zero) if self.kind.dual else zero for _ in self.rubs]

    def _later(self, drive: Column) -> Column:
        """At the end of the step."""
        ends = {k: drive[k] + drive[slope] * self.span for k, slope in self.slopes.items()}
        return {**drive, **ends}

    def _at_rest(
        self, state: list[Number], drive: Column, inputs: Mapping[str, Number]
    ) -> list[At]:
        still = list(state)
        for rub in self.rubs:
            still[rub.row] = Lane(self.kind.b, vector(0.0))
        held = [rub.held(state, drive) for rub in self.rubs]
        return [At(one, most) for one, most in zip(held, self.sizes(still, inputs), strict=True)]

    def _against(self, state: list[Number], sizes: list[Number]) -> list[Number]:
        return [signed(one, state[rub.row]) for one, rub in zip(sizes, self.rubs, strict=True)]

    def _between(
        self, state: list[Number], ahead: list[Number], inputs: Mapping[str, Number]
    ) -> list[Number]:
        speeds, middle = {rub.row for rub in self.rubs}, list(state)
        for i in self.looked_at:
            here, there = state[i], ahead[i]
            turned = i in speeds
            middle[i] = (size(here) + size(there) if turned else here + there) * 0.5
        return self.sizes(middle, inputs)

    def sizes(self, state: list[Number], inputs: Mapping[str, Number]) -> list[Number]:
        seen = {**dict(zip(self.states, state, strict=True)), **inputs}
        return [
            rub.law.size(self.parameters, size(state[rub.row]), seen)
            if rub.size is None
            else rub.size
            for rub in self.rubs
        ]

    def _efforts(
        self,
        free: list[Number],
        state: list[Number],
        drive: Column,
        sizes: list[Number],
        rest: list[At],
    ) -> tuple[list[Number], list[Mask]]:
        """And where they let slip; `drive` at the end of the step."""
        known = [
            where(moving(state[rub.row]), signed(most, state[rub.row]), at.held)
            for rub, most, at in zip(self.rubs, sizes, rest, strict=True)
        ]
        slips: dict[int, Mask] = {}
        for e in self._order:
            rub = self.rubs[e]
            others = [
                (self.rubs[k].column[rub.row], effort)
                for k, effort in enumerate(known)
                if k != e and rub.row in self.rubs[k].column
            ]
            stop, speed = total(free[rub.row], others) * rub.over, state[rub.row]
            slipping = self._of_moving(stop, speed, rub.over, sizes[e], rest[e])
            stopped = [stop if k == e else effort for k, effort in enumerate(known)]
            there = self._moved(free, stopped, [k for k in rub.pull if k < len(free)])
            still = self._of_still(stop, rub.held(there, drive), sizes[e], rest[e])
            moves = moving(speed)
            known[e] = where(moves, slipping[0], still[0])
            slips[e] = slipping[1].both(moves).either(still[1].without(moves))
        return known, [slips[e] for e in range(len(self.rubs))]

    def _of_moving(
        self, stop: Number, speed: Number, over: Number, most: Number, rest: At
    ) -> tuple[Number, Mask]:
        """The mean of it over a step from `speed` on, of which `stop` would make zero; where it slips.

        With signs turned so that the speed is not negative, and in units of the effort: as long as
        stop > most, the speed stays positive.  Else it is zero after a share of the step, and remains
        so if what drives it there, stop - speed, is no more than friction can hold; if not, it goes on
        backwards.
        """
        back = below(speed, 0.0)
        ahead, rate = where(back, -stop, stop), size(speed) * over
        against = rate - ahead + most  # what drives it backwards, and what brakes it
        keeps, passes = above(ahead, most), above(against, most + rest.size)
        turned = where(keeps, most, ahead)
        (turned,) = self.kind.rarely(
            passes.without(keeps), [turned], lambda: [most * (rate / against * 2.0 - 1.0)]
        )
        return where(back, -turned, turned), keeps.either(passes)

    def _of_still(self, stop: Number, later: Number, most: Number, rest: At) -> tuple[Number, Mask]:
        """From rest: what has to be held goes from `rest.held` to `later`, in the mean `stop`.

        Once it is more than friction at rest can hold, the speed slips under `most`.
        """
        back = below(stop, 0.0)
        mean, first, last = (where(back, -one, one) for one in (stop, rest.held, later))
        slips = above(last, rest.size).either(above(mean, rest.size))

        def slipping() -> list[Number]:
            # Straight from the first to the middle, and on to the last.
            middle = (mean * 6.0 - first - last) * 0.25
            halves = [_beyond(*ends, rest.size) for ends in ((first, middle), (middle, last))]
            share = (halves[0][0] + halves[1][0]) * 0.5
            driving = (halves[0][1] + halves[1][1]) * 0.5
            bent = mean - (first + middle * 2.0 + last) * 0.25
            return [mean - driving - share * (rest.size - most + bent)]

        (turned,) = self.kind.rarely(slips, [mean], slipping)
        return where(back, -turned, turned), slips

    def _moved(
        self, free: list[Number], efforts: list[Number], only: Sequence[int] | None = None
    ) -> list[Number]:
        """All states, or `only` those right."""
        new = list(free)
        for rub, effort in zip(self.rubs, efforts, strict=True):
            for i in (i for i in rub.column if only is None or i in only):
                new[i] = fused(rub.column[i], effort, new[i])
        return new

    def _stopped(self, new: list[Number], slips: list[Mask]) -> list[Number]:
        new = list(new)
        for rub, moves in zip(self.rubs, slips, strict=True):
            new[rub.row] = where(moves, new[rub.row], 0.0)
        return new

    def _held(self, new: list[Number], old: list[Number], slips: list[Mask]) -> list[Number]:
        """Angles of speeds that were and are zero."""
        for rub, moves in zip(self.rubs, slips, strict=True):
            if rub.holds is not None:
                moved = moves.either(moving(old[rub.row]))
                new[rub.holds] = where(moved, new[rub.holds], old[rub.holds])
        return new


def _beyond(first: Number, last: Number, limit: Number) -> tuple[Number, Number]:
    """For what share of a straight way it is beyond a limit, and by how much in the mean."""
    begins, ends, rises = above(first, limit), above(last, limit), above(last, first)
    far, near = where(rises, last, first), where(rises, first, last)
    crosses = begins.either(ends).without(begins.both(ends))
    share = where(crosses, (far - limit) / (far - near), where(begins, 1.0, 0.0))
    over = where(begins.both(ends), (first + last) * 0.5 - limit, share * (far - limit) * 0.5)
    return share, over


def _of(k: int, state: Sequence[Number], drive: Column) -> Number:
    return state[k] if k < len(state) else drive[k]
