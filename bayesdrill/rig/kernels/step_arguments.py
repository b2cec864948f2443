"""Define the structure and the arguments of kernels for rigs with friction or late inputs.

Walkers (sets of parameters) are advanced in groups, as lanes of vectors, by equal steps from node
to node.  An effort is the torque of a friction, or a voltage drop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from bayesdrill.basics.duals import Dual, where
from bayesdrill.rig.kernels.exponential import (
    AugmentedMatrix,
    Layout,
    Pattern,
    formulas,
    with_slopes,
)
from bayesdrill.rig.kernels.friction import Sizes
from bayesdrill.rig.kernels.lanes import NUMBERS, VECTORS, WHOLE, Builder, Vector, vector
from bayesdrill.rig.kernels.numbers import Number, sum_products
from bayesdrill.rig.kernels.sums import ResidualSums
from bayesdrill.rig.models.friction import DIRECTION, Law, SettlingLaw
from bayesdrill.rig.models.linear import Model

# G groups of walkers, T samples, N steps (`nodes`), K channels, S sampled inputs. A step with an event
# (zero crossing of a speed, beginning of slip) has `turns` parts. `stored` is 1 if signals are stored
# instead of sums.
COUNTS = ("groups", "samples", "nodes", "turns", "stored")
BLOCKS = {
    "numbers": NUMBERS,  # span of a step; usual span between samples; constant inputs
    "own": VECTORS,  # (G, V) numbers of each walker; V is the sum of `walker_vectors`
    "u": NUMBERS,  # (N + 1, S) inputs, or (N + 1, 2 S) with time slopes; rows before and after, too
    "pieces": WHOLE,  # (T,) number of steps to the next sample
    "usual": WHOLE,  # (T,) 1 if `pieces` is the usual number of steps and greater than 1
    "t": NUMBERS,  # (T,) times of samples, in steps from the first node
    "y": NUMBERS,  # (T, K) measured values, NaN if missing
    "begin": WHOLE,  # (K,) index of the first observed sample of each channel
    "trace": VECTORS,  # scratch (N + 1, K, `TRACE_VALUES`), see `time_stepping`
    "out": VECTORS,  # (G, K, n) sums, or (G, T, K) numbers of signals
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SteppedShape:
    """A kernel is specialised for this structure of a stepped rig and record.

    `series` are sampled inputs; those in `delayed_series` have a lag, which depends on the walker.
    `constant` are the non-zero constant inputs. `pattern (K, R)` says which weights of channels may
    differ from zero: those of states, of 1 (the offset) and, with `efforts`, of efforts. The kernel
    computes the sums of a `tally` or, without one, signals. A kernel with the tally `SQUARES` can do
    either. `dual` says that numbers have slopes (derivatives). `read` says that channels have their
    own sampling times. With `efforts`, channels are all states and efforts, in each step.
    """

    model: Model
    series: tuple[str, ...]
    delayed_series: tuple[str, ...]
    constant: tuple[str, ...]
    first_order: bool
    pattern: Pattern
    tally: ResidualSums | None
    dual: bool
    read: bool
    efforts: bool

    @property
    def text(self) -> str:
        """See `compile_kernel`."""
        # The formulas and indices below represent these fields.
        described = ("model", "series", "delayed_series", "constant")
        names = [setting.name for setting in fields(self) if setting.name not in described]
        settings = {name: getattr(self, name) for name in (*names, "long_steps")}
        late = [self.series.index(name) for name in self.delayed_series]
        both = [(c, name in self.series) for c, name in enumerate(self.constant)]
        model = formulas(len(self._named_numbers) * self.numbers, self._formulas)
        return f"{settings} {len(self.series)} {late} {both} {model} {self.layout.text}"

    @property
    def _named_numbers(self) -> tuple[str, ...]:
        """Return the names of the numbers in the formulas of the rig and its frictions."""
        return (*self.model.parameters, *self.constant, *self.model.states, *self.series)

    def _formulas(self, lanes: Sequence[Vector]) -> list[Any]:
        """Return all that the kernel needs from the model, as functions of `_named_numbers`."""
        names = self._named_numbers
        n = len(names)
        numbers: Any = map(Dual, lanes[:n], lanes[n:]) if self.dual else lanes
        named = dict.fromkeys(self.model.inputs, 0.0) | dict(zip(names, numbers, strict=True))
        rates = Rates(lanes[0].b, self, named, {name: named[name] for name in self.constant})
        described: list[Any] = [rates.rows, rates.base]
        named |= self.model.acting(named, {name: named[name] for name in self.model.inputs})
        index = self.model.states.index
        for friction in self.model.frictions:
            law, speed = friction.law, named[friction.against]
            described += [index(friction.against), friction.holds and index(friction.holds)]
            seen = sorted(index(name) for name in law.seen if name in self.model.states)
            described += [law.steady, seen, *self._sizes(lanes[0].b, law, named, speed)]
            if self.long_steps and isinstance(law, SettlingLaw):
                described.append(law.decay_terms(named, speed))
            else:
                described.append(None)
        for gravity in self.model.gravities:
            at = named[gravity.angle]
            described += [index(gravity.angle), index(gravity.speed), gravity.torque(named, at)]
        if (servo := self.model.saturation) is not None:
            duty = self.model.parameters.index(servo.duty)
            # Any numbers will do as arguments: only the formulas are compared, as a text.
            x, y = named[servo.row], named[servo.goal if servo.usual_supply else servo.supply]
            described += [index(servo.row), duty, servo.voltage(named, x)]
            described.append(where(servo.is_linear(named, x), x, 0.0))
            described.append(servo.level(named))
            if servo.speed:
                speed = self.model.parameters.index(servo.speed)
                described += [speed, *servo.moved(named, named[servo.duty], x, y)]
        return described

    def _sizes(self, b: Builder, law: Law, named: Any, speed: Any) -> list[Any]:
        """Return the size of a friction by its law, or the sizes in both directions if they differ."""
        sizes = Sizes.by_law(b, law, named, 0.0 if law.steady else speed, named)
        return [sizes.forward, sizes.backward] if sizes.differ else [sizes.forward]

    @property
    def long_steps(self) -> bool:
        """Return whether long steps are possible: sizes settle, and nothing else needs short steps."""
        special = self.model.gravities or self.model.saturation
        if self.efforts or self.read or self.delayed_series or special:
            return False
        laws = [friction.law for friction in self.model.frictions if not friction.law.steady]
        if any(DIRECTION in friction.law.seen for friction in self.model.frictions):
            return False
        return bool(laws) and all(isinstance(law, SettlingLaw) for law in laws)

    @property
    def columns(self) -> tuple[str, ...]:
        """Return the columns of the sampled inputs in the block `u`, and in a step."""
        return with_slopes(self.series, first_order=self.first_order)

    @property
    def drives(self) -> tuple[str, ...]:
        """Return the columns that drive a step: inputs, then gravity, then a nonlinear servo."""
        servo = self.model.saturation
        gravities = (gravity.name for gravity in self.model.gravities)
        return (*self.columns, *gravities, *((servo.name,) if servo else ()))

    @property
    def driven(self) -> tuple[str, ...]:
        """Return the columns after that of the constant 1: drives, then frictions."""
        return (*self.drives, *(friction.name for friction in self.model.frictions))

    @property
    def numbers(self) -> int:
        """Return how many registers a number takes."""
        return 2 if self.dual else 1

    @property
    def walker_blocks(self) -> dict[str, int]:
        """Return the size of each part of the block `own`, in numbers."""
        k, x, late = len(self.pattern), len(self.model.states), len(self.delayed_series)
        parts = {"parameters": len(self.model.parameters), "x0": x, "rows": k * self.r_count}
        if self.read:
            parts |= {"before": x, "shift": k}
        weights = k * self.tally.weights if self.tally is not None else 0
        parts |= {"weight": weights} if weights else {}
        return parts | ({"share": late, "behind": late} if late else {})

    @property
    def walker_vectors(self) -> dict[str, int]:
        """Return the size of each part of the block `own`, in vectors."""
        return {name: self.numbers * count for name, count in self.walker_blocks.items()}

    @property
    def r_count(self) -> int:
        """Return the number R of entries in a channel's row."""
        return len(self.model.states) + 1 + (len(self.model.frictions) if self.efforts else 0)

    @property
    def layout(self) -> Layout:
        """Return the layout of the rig's augmented matrix."""
        return Layout.from_model(self.model, self.driven, self.constant, first_order=False)


class Rates:
    """Rates are the right side of the rig's equations, x' = A x + c + B u."""

    def __init__(
        self,
        b: Builder,
        shape: SteppedShape,
        parameters: Mapping[str, Number],
        constant: Mapping[str, Number],
    ) -> None:
        self.shape, x = shape, len(shape.model.states)
        self.rows: list[dict[int, Number]] = [{} for _ in range(x)]
        self.base: list[Number] = [Vector(b, vector(0.0))] * x
        numbers = [*(parameters[name] for name in shape.model.parameters), *constant.values()]
        entries = AugmentedMatrix(shape.model, shape.driven, tuple(constant))(numbers)
        for row, column, value in (entry for entry in entries if entry[0] < x):
            if column == x:
                self.base[row] = self.base[row] + value
            else:
                plain = not isinstance(value, Vector | Dual)
                self.rows[row][column] = Vector(b, vector(float(value))) if plain else value

    def evaluate(
        self,
        state: Sequence[Number],
        drive: dict[int, Number],
        efforts: Sequence[Number],
        *,
        later: Number | None = None,
    ) -> list[Number]:
        """Return the rates at the beginning of a step or, if `later` is the step's span, at its end."""
        shape, first = self.shape, len(self.rows) + 1
        values: dict[int, Number] = dict(enumerate(state)) | drive
        values |= {first + len(shape.drives) + e: effort for e, effort in enumerate(efforts)}
        if later is not None and shape.first_order:
            s = len(shape.series)
            values |= {first + k: drive[first + k] + drive[first + s + k] * later for k in range(s)}
        return [
            sum_products(base, [(entry, values[k]) for k, entry in row.items()])
            for row, base in zip(self.rows, self.base, strict=True)
        ]
