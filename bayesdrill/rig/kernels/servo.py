"""A step of a rig with a servo, whose loop is closed or, where it saturates or is dead, open.

In each lane a step has the matrix of the closed loop or that of the open one, as the wanted voltage at
its beginning says; either is exact.  The passage from one to the other is not located in time: in a step
with it the voltage at the end differs from the one that the matrix has, by a part that grows from zero
along a straight line.  Its mean acts over the whole step, which leaves an error of second order.  So
does a measured supply, whose difference from the usual one acts by the mean of begin and end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bayesdrill.basics.duals import size, where
from bayesdrill.rig.kernels.friction import Rows, Step, StepFriction, row_terms
from bayesdrill.rig.kernels.lanes import Mask
from bayesdrill.rig.kernels.numbers import Column, Number, sum_products
from bayesdrill.rig.models.servo import Saturation

NO_CHANGE = 1e-300  # volts, so that nothing is divided by zero where no voltage changes


@dataclass(frozen=True, slots=True)
class ServoLoop:
    """The servo of a step.

    `column`: of its voltage among what drives.  `row`, `base`: what voltage is wanted, of states and
    drive.
    """

    law: Saturation
    column: int
    row: Column
    base: Number
    parameters: Mapping[str, Number]

    def wanted(self, state: Sequence[Number], drive: Column) -> Number:
        """Return the voltage that the linear closed loop would have."""
        return sum_products(self.base, row_terms(self.row, state, drive))

    def is_closed(self, wanted: Number) -> Mask:
        """Tell where the voltage follows the wanted one."""
        mask: Mask = self.law.is_linear(self.parameters, wanted)
        return mask

    def beyond_matrix(self, wanted: Number, closed: Mask, level: Number | None = None) -> Number:
        """Return the voltage less the one that the matrix of the loop has."""
        voltage = self.law.voltage(self.parameters, wanted)
        acting = voltage if level is None else voltage * level
        return where(closed, acting - wanted, acting)

    def mean_beyond(self, begin: Number, end: Number, closed: Mask, level: Number | None) -> Number:
        """Return the mean over a step of what the voltage is beyond the matrix.

        The wanted voltage goes from `begin` to `end`, and leaves the range in which it began on the way.
        """
        first = self.beyond_matrix(begin, closed)
        missing = self.beyond_matrix(end, closed) - first
        share = size(missing) / (size(end - begin) + NO_CHANGE)
        mean = first + missing * share * 0.5
        if level is None:
            return mean
        volts = [self.law.voltage(self.parameters, wanted) for wanted in (begin, end)]
        return mean + (volts[0] + volts[1]) * (level - 1.0) * 0.5


def merged_step(closed: Mask, first: Step, second: Step) -> Step:
    """Return the step that is the first where the loop is closed, and else the second."""
    rows = [_merged(closed, *both) for both in zip(first.rows, second.rows, strict=True)]
    pairs = zip(first.frictions, second.frictions, strict=True)
    frictions = [
        _merged_friction(closed, one, other, rows, first.first + e)
        for e, (one, other) in enumerate(pairs)
    ]
    return replace(first, rows=rows, frictions=frictions)


def _merged(closed: Mask, first: Column, second: Column) -> dict[int, Number]:
    return {k: where(closed, entry, second[k]) for k, entry in first.items()}


def _merged_friction(
    closed: Mask, first: StepFriction, second: StepFriction, rows: Rows, column: int
) -> StepFriction:
    return replace(
        first,
        column={i: row[column] for i, row in enumerate(rows) if column in row},
        stop_gain=where(closed, first.stop_gain, second.stop_gain),
        holding_row=_merged(closed, first.holding_row, second.holding_row),
        holding_base=where(closed, first.holding_base, second.holding_base),
    )
