"""A step in which a speed changes its sign or what stuck lets go, and long steps where nothing does.

While a speed keeps its sign its effort f is the friction's size, against it.  Where the sign changes, f
is the mean over the step: of both signs, each for as long as a straight course of the speed has it, or,
where the speed stays at zero once it is there, what stops it.

Steps are as short as friction asks for whose size falls with the speed.  Where every speed is so high
that nothing of that is left, and stays far from zero, a stride goes to the next sample at once, and
is exact; what sticks goes by steps, as in one that is long its speed is zero at the ends alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from llvmlite import ir

from bayesdrill.basics.duals import below, signed, size, where
from bayesdrill.rig.kernels.friction import Going, Moment, Past, Regime, Rub, Step, any_of
from bayesdrill.rig.kernels.lanes import F64, I64, LANES, Lane, Loop, Mask
from bayesdrill.rig.kernels.numbers import (
    Column,
    Kind,
    Number,
    above,
    fused,
    goes_on,
    moving,
    sticking,
    total,
)
from bayesdrill.rig.models.friction import SettlingLaw


def step_on(
    going: Going, parts: Parts, now: Moment, turn: Callable[[list[Number]], None]
) -> tuple[list[Number], list[Number], Past]:
    """New state, efforts (where the regime shows them) and the past then.  Where something turns, the
    regime is another from then on: `turn(state)`.
    """
    step, regime, x = going.step, going.regime, len(now.state)
    ways = regime.ways()
    new, efforts, then = going.taken(now, ways)
    usual = [*new, *efforts, *then.sizes, *then.trends]

    def looked() -> list[Number]:
        changes = going.changes(new, now, ways)

        def turned() -> list[Number]:
            others = parts.numbers(now, shows=regime.shows)
            found = [where(changes, *both) for both in zip(others, usual, strict=True)]
            turn(found[:x])
            return found

        return step.kind.instead(changes, usual, turned)

    every = step.kind.instead(going.leaves(new, ways), usual, looked)
    e, v = x + len(efforts), len(step.varying)
    return every[:x], every[x:e], Past(every[e : e + v], every[e + v :])


@dataclass(frozen=True, slots=True)
class Parts:
    """A step in which something turns is made in so many, each of them one `step`: what else happens in
    it, such as a current that follows fast, need not be as straight as a speed.
    """

    count: int
    step: Callable[[], Step]

    def numbers(self, now: Moment, *, shows: bool) -> list[Number]:
        """See `Turning.numbers`; efforts are those in the mean."""
        step = self.step()
        turning, kind = Turning(step), step.kind
        if self.count == 1:
            return turning.numbers(now, shows=shows)
        x, v = len(now.state), len(step.varying)
        e = x + (len(step.rubs) if shows else 0)
        nothing = [kind.zero() for _ in range(e - x)]
        start = kind.flat([*now.state, *nothing, *now.past.sizes, *now.past.trends])
        loop = Loop(kind.b, I64(self.count), start, "parts")
        carried = kind.shaped(loop.carried)
        before = Past(carried[e : e + v], carried[e + v :])
        drive = self._then(step, now.drive, loop.index)
        found = turning.numbers(Moment(carried[:x], before, drive, now.inputs), shows=shows)
        efforts = [
            total + one * (1.0 / self.count)
            for total, one in zip(carried[x:e], found[x:e], strict=True)
        ]
        found = [*found[:x], *efforts, *found[e:]]
        loop.close(kind.flat(found))
        return found

    def _then(self, step: Step, drive: Column, index: ir.Value) -> Column:
        """What drives the part of this number."""
        if not step.slopes:
            return drive
        b = step.kind.b
        since = Lane(b, b.splat(b.sitofp(index, F64))) * step.span
        ahead = {k: drive[k] + drive[slope] * since for k, slope in step.slopes.items()}
        return {**drive, **ahead}


@dataclass(frozen=True, slots=True)
class At:
    """Of a friction at the beginning of a step: what has to be `held`, and its `size` at rest."""

    held: Number
    size: Number


@dataclass(frozen=True, slots=True)
class Turning:
    step: Step

    @property
    def _rubs(self) -> Sequence[Rub]:
        return self.step.rubs

    @property
    def _kind(self) -> Kind:
        return self.step.kind

    @property
    def _order(self) -> list[int]:
        """In which efforts are found, each with the others as known: at first as if nothing turned.

        What stops a current comes first, and once more: it and the motor act on each other strongly.
        """
        every = sorted(range(len(self._rubs)), key=lambda e: self._rubs[e].holds is not None)
        return every * (1 + any(rub.holds is None for rub in self._rubs))

    def numbers(self, now: Moment, *, shows: bool) -> list[Number]:
        """New state, efforts if they are shown, sizes that vary, and trends: none, after a turn."""
        step, state, drive, inputs = self.step, now.state, now.drive, now.inputs
        sizes = [rub.steady for rub in self._rubs]
        for e, one in zip(step.varying, now.past.sizes, strict=True):
            sizes[e] = one
        free, later = step.free(state, drive), step.later(drive)
        held = [rub.held(state, drive) for rub in self._rubs]
        rest = [At(*both) for both in zip(held, step.at_rest(state, inputs), strict=True)]
        efforts, slips = self._efforts(free, state, later, sizes, rest)
        if step.varying:
            ahead = self._stopped(self._moved(free, efforts), slips)
            sizes = step.between(state, ahead, inputs)
            efforts, slips = self._efforts(free, state, later, sizes, rest)
        new = self._held(self._stopped(self._moved(free, efforts), slips), state, slips)
        shown = efforts if shows else []
        varying = [sizes[e] for e in step.varying]
        return [*new, *shown, *varying, *(self._kind.zero() for _ in varying)]

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
            for rub, most, at in zip(self._rubs, sizes, rest, strict=True)
        ]
        slips: dict[int, Mask] = {}
        for e in self._order:
            rub = self._rubs[e]
            others = [
                (self._rubs[k].column[rub.row], effort)
                for k, effort in enumerate(known)
                if k != e and rub.row in self._rubs[k].column
            ]
            stop, speed = total(free[rub.row], others) * rub.over, state[rub.row]
            slipping = self._of_moving(stop, speed, rub.over, sizes[e], rest[e])
            stopped = [stop if k == e else effort for k, effort in enumerate(known)]
            there = self._moved(free, stopped, [k for k in rub.pull if k < len(free)])
            still = self._of_still(stop, rub.held(there, drive), sizes[e], rest[e])
            moves = moving(speed)
            known[e] = where(moves, slipping[0], still[0])
            slips[e] = slipping[1].both(moves).either(still[1].without(moves))
        return known, [slips[e] for e in range(len(self._rubs))]

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
        (turned,) = self._kind.rarely(
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

        (turned,) = self._kind.rarely(slips, [mean], slipping)
        return where(back, -turned, turned), slips

    def _moved(
        self, free: list[Number], efforts: list[Number], only: Sequence[int] | None = None
    ) -> list[Number]:
        """All states, or `only` those right."""
        new = list(free)
        for rub, effort in zip(self._rubs, efforts, strict=True):
            for i in (i for i in rub.column if only is None or i in only):
                new[i] = fused(rub.column[i], effort, new[i])
        return new

    def _stopped(self, new: list[Number], slips: list[Mask]) -> list[Number]:
        new = list(new)
        for rub, moves in zip(self._rubs, slips, strict=True):
            new[rub.row] = where(moves, new[rub.row], 0.0)
        return new

    def _held(self, new: list[Number], old: list[Number], slips: list[Mask]) -> list[Number]:
        """Angles of speeds that were and are zero."""
        for rub, moves in zip(self._rubs, slips, strict=True):
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


SPENT = 18.0  # exponent: 2e-8 is left of what a friction has more at rest


@dataclass(frozen=True, slots=True)
class Stride:
    """`step` and `regime` of a whole sample."""

    step: Step
    regime: Regime

    def or_else(
        self, wanted: ir.Value, now: Moment, steps: Callable[[], list[Number]]
    ) -> list[Number]:
        """What is carried on: of lanes that slip far from any change a stride, where it is `wanted`; of
        all others `steps`, which are made where there are any.
        """
        kind, state, past = self.step.kind, now.state, now.past
        ways = self.regime.ways()
        slips = any_of([*(sticking(way) for way in ways), *self._falling(state)]).turned().value
        free = Mask(kind.b, kind.b.select(wanted, slips, ir.Constant(slips.type, [0] * LANES)))
        stays = [*state, *past.sizes, *past.trends]
        usual = kind.instead(free, stays, lambda: self._taken(now, ways))
        new = usual[: len(state)]
        walks = [free.turned(), *self._falling(new), *self._near(state, new, ways)]
        return kind.rarely(any_of(walks), usual, steps)

    def _taken(self, now: Moment, ways: Sequence[Lane]) -> list[Number]:
        """New state, sizes and trends."""
        step = self.step
        steady = [sliding for sliding, _ in self._spent(now.state)]
        trends = [step.kind.zero() for _ in steady]
        begin = replace(now, past=Past(steady, trends))
        new, _, _ = Going(step, self.regime).taken(begin, ways, sizes=steady)
        return [*new, *steady, *trends]

    def _falling(self, state: Sequence[Number]) -> Iterator[Mask]:
        """Sizes that still change with the speed."""
        for _, fallen in self._spent(state):
            yield below(fallen, SPENT)

    def _spent(self, state: Sequence[Number]) -> Iterator[tuple[Number, Number]]:
        """Of sizes that vary, see `SettlingLaw.spent`."""
        for e in self.step.varying:
            rub = self.step.rubs[e]
            assert isinstance(rub.law, SettlingLaw)  # `Shape.strides`
            yield rub.law.spent(self.step.parameters, size(state[rub.row]))

    def _near(
        self, state: Sequence[Number], new: Sequence[Number], ways: Sequence[Lane]
    ) -> Iterator[Mask]:
        """Speeds that might have been zero on the way: they change by more than is left of them."""
        for rub, way in zip(self.step.rubs, ways, strict=True):
            change = size(new[rub.row] - state[rub.row])
            for end in (state, new):
                yield above(change, size(end[rub.row]))
            yield goes_on(way, new[rub.row]).turned()
