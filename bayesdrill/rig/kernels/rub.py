"""Frictions in a step of a rig, in numbers of any kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from bayesdrill.basics.arithmetic import size
from bayesdrill.rig.kernels.numbers import Column, Number, total
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
