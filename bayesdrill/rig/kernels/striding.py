"""From a sample to the next in one stride, where the rig is a linear one all the way.

Steps are as short as friction asks for whose size falls with the speed.  Where every speed is so high
that nothing of that is left, and stays far from zero, a stride takes as many steps at once, and is
exact; what sticks goes by steps, as in one that is long its speed is zero at the ends alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from llvmlite import ir

from bayesdrill.basics.arithmetic import below, size
from bayesdrill.rig.kernels.lanes import LANES, Lane, Mask
from bayesdrill.rig.kernels.numbers import Column, Number, above, goes_on, sticking
from bayesdrill.rig.kernels.regime import Regime
from bayesdrill.rig.kernels.rubbing import Going, Past, Step, any_of

SPENT = 18.0  # exponent: 2e-8 is left of what a friction has more at rest


@dataclass(frozen=True, slots=True)
class Regimes:
    """Of a step and of a stride: both change together."""

    one: Regime
    other: Regime

    def set(self, state: Sequence[Number]) -> None:
        self.one.set(state)
        self.other.set(state)


@dataclass(frozen=True, slots=True)
class Stride:
    """`step` and `regime` of a whole sample."""

    step: Step
    regime: Regime

    def or_else(
        self,
        wanted: ir.Value,
        numbers: tuple[list[Number], Past],
        drive: tuple[Column, Mapping[str, Number]],
        steps: Callable[[], list[Number]],
    ) -> list[Number]:
        """What is carried on: of lanes that slip far from any change a stride, where it is `wanted`; of
        all others `steps`, which are made where there are any.
        """
        kind, (state, past), ways = self.step.kind, numbers, self.regime.ways()
        slips = any_of([*(sticking(way) for way in ways), *self._falling(state)]).turned().value
        free = Mask(kind.b, kind.b.select(wanted, slips, ir.Constant(slips.type, [0] * LANES)))
        stays = [*state, *past.sizes, *past.trends]
        usual = kind.instead(free, stays, lambda: self._taken(state, drive, ways))
        new = usual[: len(state)]
        walks = [free.turned(), *self._falling(new), *self._near(state, new, ways)]
        return kind.rarely(any_of(walks), usual, steps)

    def _taken(
        self,
        state: list[Number],
        drive: tuple[Column, Mapping[str, Number]],
        ways: Sequence[Lane],
    ) -> list[Number]:
        """New state, sizes and trends."""
        step = self.step
        steady = [sliding for sliding, _ in self._spent(state)]
        trends = [step.kind.zero() for _ in steady]
        going, past = Going(step, self.regime), Past(steady, trends)
        new, _, _ = going.taken(state, past, *drive, ways, sizes=steady)
        return [*new, *steady, *trends]

    def _falling(self, state: Sequence[Number]) -> Iterator[Mask]:
        """Sizes that still change with the speed."""
        for _, fallen in self._spent(state):
            yield below(fallen, SPENT)

    def _spent(self, state: Sequence[Number]) -> Iterator[tuple[Number, Number]]:
        """Of sizes that vary, see `friction.Law.spent`."""
        for e in self.step.varying:
            rub = self.step.rubs[e]
            found = rub.law.spent(self.step.parameters, size(state[rub.row]))
            assert found is not None  # `Shape.strides`
            yield found

    def _near(
        self, state: Sequence[Number], new: Sequence[Number], ways: Sequence[Lane]
    ) -> Iterator[Mask]:
        """Speeds that might have been zero on the way: they change by more than is left of them."""
        for rub, way in zip(self.step.rubs, ways, strict=True):
            change = size(new[rub.row] - state[rub.row])
            for end in (state, new):
                yield above(change, size(end[rub.row]))
            yield goes_on(way, new[rub.row]).turned()
