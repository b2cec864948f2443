"""Advance a rig with a servo, whose loop is open while the servo saturates or is in its dead band.

The wanted voltage at the beginning of a step selects the exact matrix of the closed or the open
loop, for each lane (walker).  The matrix of the closed loop includes the wanted voltage.  If the loop
opens or closes within a step, the matrix lacks a part of the voltage, which varies linearly from
then on.  The mean of this part acts over the whole step, with an error of second order.  If a
measured supply differs from the usual supply, the change of voltage is averaged over both ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from bayesdrill.basics.duals import size, where
from bayesdrill.rig.kernels.friction import Rows, Step, StepFriction, row_terms
from bayesdrill.rig.kernels.lanes import Mask
from bayesdrill.rig.kernels.numbers import Column, Number, sum_products
from bayesdrill.rig.models.servo import Saturation

NO_CHANGE = 1e-300  # volts, added to a divisor that is zero where the voltage is constant


@dataclass(frozen=True, slots=True)
class ServoLoop:
    """The loop of a servo gives its voltage within a step.

    `column` is the index of the voltage among the inputs of a step.  The wanted voltage is `row`
    times states and inputs, plus `base`.
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
        """Return in which lanes the voltage follows the wanted one."""
        mask: Mask = self.law.is_linear(self.parameters, wanted)
        return mask

    def beyond_matrix(self, wanted: Number, closed: Mask, level: Number | None = None) -> Number:
        """Return the voltage that the matrix lacks: without the wanted voltage if the loop is closed."""
        voltage = self.law.voltage(self.parameters, wanted)
        acting = voltage if level is None else voltage * level
        return where(closed, acting - wanted, acting)

    def mean_beyond(self, begin: Number, end: Number, closed: Mask, level: Number | None) -> Number:
        """Return the mean of `beyond_matrix` over a step.

        The wanted voltage goes from `begin` to `end`, and may leave the loop's range on the way.
        """
        first = self.beyond_matrix(begin, closed)
        missing = self.beyond_matrix(end, closed) - first
        fraction = size(missing) / (size(end - begin) + NO_CHANGE)
        mean = first + missing * fraction * 0.5
        if level is None:
            return mean
        volts = [self.law.voltage(self.parameters, wanted) for wanted in (begin, end)]
        return mean + (volts[0] + volts[1]) * (level - 1.0) * 0.5


def merged_step(closed: Mask, first: Step, second: Step) -> Step:
    """Return a step that is `first` in lanes where the loop is closed, and `second` in others."""
    rows = [_merged(closed, *both) for both in zip(first.rows, second.rows, strict=True)]
    pairs = zip(first.frictions, second.frictions, strict=True)
    frictions = [
        _merged_friction(closed, one, other, rows, first.first_friction + e)
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
