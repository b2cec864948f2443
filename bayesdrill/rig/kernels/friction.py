"""Advance a rig with friction by a step in which each friction keeps slipping or sticking.

In such a step the rig is linear (`FrictionMode`), and each new state is a row times known values:

    x_i+ = rows[i] (x, 1, drive, sizes of varying frictions)

An effort is the torque of a friction, or a voltage drop.  Numbers are vectors, and each lane of a
vector is one walker (a set of parameters).

A slipping friction of constant size is part of the constant forcing.  A sticking friction has the
effort that keeps its speed at zero, which is linear in the other states.  So the row of its speed
is zero, and the row of its angle keeps the angle.  The rows of a mode are kept in memory, as they
change rarely.  They follow from the step of the rig with constant efforts f of frictions:

    x+ = Phi x + g + Gamma u + Gamma_f f

A size that changes with the speed is evaluated at the mean of the speeds at both ends of the step.
`ReversalStep` handles events: zero crossings of a speed, and the transition from stick to slip.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any

from llvmlite import ir

from bayesdrill.basics.duals import Dual, below, dual, size, where
from bayesdrill.rig.kernels.lanes import Builder, Mask, Vector, vector
from bayesdrill.rig.kernels.numbers import (
    Column,
    Number,
    Numbers,
    above,
    is_sticking,
    keeps_direction,
    multiply_add,
    slip_direction,
    sum_products,
)
from bayesdrill.rig.models.friction import DIRECTION, Law


@dataclass(frozen=True, slots=True)
class Sizes:
    """A friction has an effort of these sizes in both directions; equal sizes are one object."""

    forward: Number
    backward: Number

    @classmethod
    def by_law(
        cls, b: Builder, law: Law, p: Mapping[str, Number], speed: Any, seen: Mapping[str, Number]
    ) -> Sizes:
        """Evaluate a law in both directions, or once if the direction does not matter."""
        ways = (1.0, -1.0) if DIRECTION in law.seen else (1.0,)
        signs = [Vector(b, vector(way)) for way in ways]
        sizes = [law.size(p, speed, {**seen, DIRECTION: sign}) for sign in signs]
        return cls(sizes[0], sizes[-1])

    @property
    def differ(self) -> bool:
        """Return whether the size depends on the direction."""
        return self.forward is not self.backward

    def along(self, speed: Number, *, back: bool = False) -> Number:
        """Return the size in the direction of a speed or, with `back`, in the opposite one."""
        if not self.differ:
            return self.forward
        both = (self.backward, self.forward)
        return where(below(speed, 0.0), *(reversed(both) if back else both))

    def exceeded(self, effort: Number) -> Mask:
        """Return in which lanes an effort is larger than the size in the effort's direction."""
        return above(size(effort), self.along(effort))


@dataclass(frozen=True, slots=True, kw_only=True)
class StepFriction:
    """The fields describe how one friction acts on the states in a step, and what makes it stick.

    `row` is the index of its speed, and `angle` that of its angle. `column` is the effect of a unit
    effort on the states in a step, and `stop_gain` is -1 / column[row]. The effort that keeps the
    speed constant is `holding_row` times states and drive, plus `holding_base`. `steady` has the
    sizes if they depend only on parameters.
    """

    row: int
    angle: int | None
    column: Column
    stop_gain: Number
    holding_row: Column
    holding_base: Number
    law: Law
    steady: Sizes | None

    def holding_effort(self, state: Sequence[Number], drive: Column) -> Number:
        """Return the effort that keeps the speed constant."""
        return sum_products(self.holding_base, row_terms(self.holding_row, state, drive))


def row_terms(row: Column, state: Sequence[Number], drive: Column) -> list[tuple[Number, Number]]:
    """Return the terms of a row: first those of the drive, which is known before the states."""
    x = len(state)
    known = [(entry, drive[k]) for k, entry in row.items() if k in drive]
    return known + [(entry, state[k]) for k, entry in row.items() if k < x]


Rows = list[dict[int, Number]]


def moved_by(rows: Rows, state: Sequence[Number], drive: Column) -> list[Number]:
    """Return the products of rows with (states, 1, drive)."""
    return [sum_products(row.get(len(state)), row_terms(row, state, drive)) for row in rows]


@dataclass(frozen=True, slots=True)
class FrictionHistory:
    """The history has the varying sizes in the last step, and `trends`, their latest changes."""

    sizes: list[Number]
    trends: list[Number]


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step has the matrix of its transition, and its frictions.

    `rows` times (states, 1, drive, efforts) are the new states; efforts begin at the column
    `first_friction`. `slopes` maps the columns of inputs to those of their time derivatives.
    """

    rows: Rows
    frictions: Sequence[StepFriction]
    parameters: Mapping[str, Number]
    states: tuple[str, ...]
    span: Number
    slopes: Mapping[int, int]
    first_friction: int
    kind: Numbers

    @cached_property
    def varying(self) -> list[int]:
        """Return the indices of frictions whose size depends on more than the parameters."""
        return [e for e, friction in enumerate(self.frictions) if friction.steady is None]

    @cached_property
    def size_states(self) -> list[int]:
        """Return the indices of states on which varying sizes depend."""
        unsteady = [self.frictions[e] for e in self.varying]
        names = {name for friction in unsteady for name in friction.law.seen}
        named = {i for i, name in enumerate(self.states) if name in names}
        return sorted(named | {friction.row for friction in unsteady})

    def sizes(self, state: Sequence[Number], inputs: Mapping[str, Number]) -> list[Sizes]:
        """Return the sizes of all frictions."""
        values = {**dict(zip(self.states, state, strict=True)), **inputs}
        return [
            Sizes.by_law(self.kind.b, f.law, self.parameters, size(state[f.row]), values)
            if f.steady is None
            else f.steady
            for f in self.frictions
        ]

    def rest_sizes(self, state: Sequence[Number], inputs: Mapping[str, Number]) -> list[Sizes]:
        """Return the sizes that frictions would have at rest."""
        still = list(state)
        for friction in self.frictions:
            still[friction.row] = Vector(self.kind.b, vector(0.0))
        return self.sizes(still, inputs)

    def mean_sizes(
        self, state: Sequence[Number], ahead: Sequence[Number], inputs: Mapping[str, Number]
    ) -> list[Sizes]:
        """Return the sizes at the mean of the states at both ends of a step."""
        speeds, middle = {friction.row for friction in self.frictions}, list(state)
        for i in self.size_states:
            here, there = state[i], ahead[i]
            is_speed = i in speeds
            middle[i] = (size(here) + size(there) if is_speed else here + there) * 0.5
        return self.sizes(middle, inputs)

    def drive_after(self, drive: Column, span: Number) -> Column:
        """Return the drive of the rig after a span."""
        later = {k: drive[k] + drive[slope] * span for k, slope in self.slopes.items()}
        return {**drive, **later}

    def frictionless(self, state: Sequence[Number], drive: Column) -> list[Number]:
        """Return the new states that the rig would have without friction."""
        return moved_by(self.rows, state, drive)


@dataclass(frozen=True, slots=True)
class StepStart:
    """A step starts from a state, a history of frictions and a drive.

    `drive` has values at the start, by column. `inputs` has values in mid-step, by name.
    """

    state: list[Number]
    history: FrictionHistory
    drive: Column
    inputs: Mapping[str, Number]


@dataclass(frozen=True, slots=True)
class FrictionMode:
    """In a mode each friction keeps slipping one way or sticking, and the rig is linear.

    `shows` adds a row for the effort of each friction. `block` is memory for directions and rows.
    """

    step: Step
    shows: bool
    block: ir.Value
    slots: dict[tuple[int, int], Number] = field(default_factory=dict)

    # Methods that are called after a speed has changed its sign.

    def set(self, state: Sequence[Number]) -> None:
        """Store the rows for the signs of the speeds in `state`; a speed of zero sticks."""
        step, b = self.step, self.step.kind.b
        first = step.first_friction  # the first column of frictions
        constant = len(step.rows)  # the column of the constant 1
        directions = [slip_direction(state[friction.row]) for friction in step.frictions]
        rows = [dict(row) for row in step.rows]
        if self.shows:
            rows += [{first + e: Vector(b, vector(1.0))} for e in range(len(step.frictions))]
        for e, direction in enumerate(directions):
            self._hold(rows, e, is_sticking(direction))
        for e, (friction, direction) in enumerate(zip(step.frictions, directions, strict=True)):
            b.write(direction.value, self.block, e)
            if friction.steady is not None:
                effort = multiply_add(friction.steady.along(direction), direction, None)
                for row in (row for row in rows if first + e in row):
                    entry = row.pop(first + e)
                    row[constant] = multiply_add(entry, effort, row.get(constant))
        self._store(rows)

    def _hold(self, rows: Rows, e: int, still: Mask) -> None:
        """Give friction e the effort that makes its speed zero, in lanes where it sticks."""
        friction, column = self.step.frictions[e], self.step.first_friction + e
        pivot = dict(rows[friction.row])
        stop = -1.0 / pivot.pop(column)
        for i, row in enumerate(rows):
            if i != friction.row and column in row:
                factor = where(still, row[column] * stop, 0.0)
                for k, entry in pivot.items():
                    row[k] = multiply_add(factor, entry, row.get(k))
        for k in pivot:
            rows[friction.row][k] = where(still, 0.0, rows[friction.row][k])
        if friction.angle is not None:
            angle = rows[friction.angle]
            for k in angle:
                angle[k] = where(still, 1.0 if k == friction.angle else 0.0, angle[k])

    def _store(self, rows: Rows) -> None:
        """Store the rows, at the same addresses in each call."""
        index = len(self.step.frictions)
        for i, row in enumerate(rows):
            for k in sorted(row):
                number = dual(row[k])
                for part in (number.value, number.slope):
                    if isinstance(part, Vector):
                        self.step.kind.b.write(part.value, self.block, index)
                    index += 1
                self.slots[i, k] = row[k]

    # Methods that are called while no speed changes its sign.

    def directions(self) -> list[Vector]:
        """Load the directions: 1 or -1 where a friction slips, 0 where it sticks."""
        b = self.step.kind.b
        return [Vector(b, value) for value in b.read_row(self.block, len(self.step.frictions))]

    def _read_rows(self) -> Rows:
        """Load the rows, which `set` may have changed."""
        b, rows = self.step.kind.b, Rows({} for _ in range(1 + max(i for i, _ in self.slots)))

        def part(number: Vector | float, at: int) -> Vector | float:
            return Vector(b, b.read(self.block, at)) if isinstance(number, Vector) else number

        for n, ((i, k), like) in enumerate(self.slots.items()):
            first, number = len(self.step.frictions) + 2 * n, dual(like)
            value = part(number.value, first)
            known = Dual(value, part(number.slope, first + 1)) if isinstance(like, Dual) else value
            rows[i][k] = known
        return rows

    def advance(
        self, now: StepStart, directions: Sequence[Vector], sizes: Sequence[Number] | None = None
    ) -> list[Number]:
        """Return new state, efforts (if the mode shows them), sizes that vary, and their trends.

        Varying sizes are those in the middle of the step. To compute them, the end of the step is
        predicted with sizes that continue their trends. If `sizes` are given, these are used.
        """
        step, state, past = self.step, now.state, now.history
        rows, varying = self._read_rows(), step.varying
        columns = [[row.get(step.first_friction + e) for row in rows] for e in varying]
        new = moved_by(rows, state, now.drive)
        if not varying:
            return new

        def with_sizes(sizes: Sequence[Number], only: Sequence[int]) -> list[Number]:
            moved = list(new)
            for e, column, magnitude in zip(varying, columns, sizes, strict=True):
                effort = multiply_add(magnitude, directions[e], None)
                for i in (i for i in only if column[i] is not None):
                    moved[i] = multiply_add(column[i], effort, moved[i])
            return moved

        if sizes is None:
            likely = [last + trend for last, trend in zip(past.sizes, past.trends, strict=True)]
            ahead = with_sizes(likely, step.size_states)
            mean_sizes = step.mean_sizes(state, ahead, now.inputs)
            sizes = [mean_sizes[e].along(directions[e]) for e in varying]
        trends = [current - before for current, before in zip(sizes, past.sizes, strict=True)]
        return [*with_sizes(sizes, range(len(rows))), *sizes, *trends]

    def may_change(self, new: Sequence[Number], directions: Sequence[Vector]) -> Mask:
        """Return in which lanes a speed changes its sign, or a friction sticks."""
        return any_of(
            keeps_direction(direction, new[friction.row]).negate()
            for direction, friction in self._pairs(directions)
        )

    def changes(self, new: Sequence[Number], now: StepStart, directions: Sequence[Vector]) -> Mask:
        """Return in which lanes a speed changes its sign, or a stuck friction begins to slip."""
        step = self.step
        sizes, later = step.rest_sizes(new, now.inputs), step.drive_after(now.drive, step.span)
        changed = []
        for (direction, friction), most in zip(self._pairs(directions), sizes, strict=True):
            beyond = most.exceeded(friction.holding_effort(new, later))
            still = is_sticking(direction)
            turned = keeps_direction(direction, new[friction.row]).negate()
            changed.append(beyond.both(still).either(turned.without(still)))
        return any_of(changed)

    def _pairs(self, directions: Sequence[Vector]) -> list[tuple[Vector, StepFriction]]:
        return list(zip(directions, self.step.frictions, strict=True))


def any_of(masks: Iterable[Mask]) -> Mask:
    """Return the logical or of masks."""
    return reduce(Mask.either, masks)
