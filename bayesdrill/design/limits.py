"""Describe the limits of a rig, on quantities such as a current, a twist, or heat over the run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import linear_map
from bayesdrill.basics.errors import Issue
from bayesdrill.basics.formulas import Expression, expression
from bayesdrill.record.experiment import raise_if_any

_INTEGRAL = re.compile(r"\s*integral\s*\((.*)\)\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class RigLimit:
    """A limit keeps a formula of states, inputs and parameters between `low` and `high`, SI.

    With `integral`, the integral of the formula from the start to each time is kept there.
    """

    text: str
    formula: Expression
    integral: bool = False
    low: float = -math.inf
    high: float = math.inf

    def describe(self) -> str:
        """Return the limit as an inequality."""
        lower = f"{self.low:g} <= " if self.low > -math.inf else ""
        upper = f" <= {self.high:g}" if self.high < math.inf else ""
        return f"{lower}{self.text}{upper}"

    def course(
        self,
        states: Mapping[str, Any],
        driven: Mapping[str, Any],
        constant: Mapping[str, Any],
        interval: float,
    ) -> Any:
        """Return the limited quantity `(W, T, 1)`, with slopes if states and inputs have them.

        The trapezoidal rule integrates over the sampling intervals [s], in which inputs are held.
        """
        if not self.integral:
            return self.formula.value({**states, **driven, **constant})
        held = {name: each[:, :-1] for name, each in driven.items()} | {**constant}
        first, last = (
            self.formula.value({name: each[:, part] for name, each in states.items()} | held)
            for part in (slice(-1), slice(1, None))
        )

        def integrated(power: Array) -> Array:
            return np.insert(0.5 * interval * np.cumsum(power, axis=1), 0, 0.0, axis=1)

        return linear_map(integrated, first + last)


def excess(limited: Array, limits: Sequence[RigLimit]) -> Array:
    """Return by how much quantities `(..., L)` are beyond their ends; negative below the lower one."""
    low = np.array([limit.low for limit in limits])
    high = np.array([limit.high for limit in limits])
    return np.asarray(np.maximum(limited - high, 0.0) + np.minimum(limited - low, 0.0))


def parse_limits(
    texts: Sequence[str], states: Sequence[str], others: Iterable[str]
) -> tuple[RigLimit, ...]:
    """Return limits such as `w_2=0:` or `integral(v*i)=:50`; raises `InputError`.

    A formula has names of `states`, and may have `others`, of inputs and parameters.
    """
    limits, issues = [], []
    for text in texts:
        name, _, ends = text.partition("=")
        first, colon, last = ends.partition(":")
        try:
            low, high = float(first or -math.inf), float(last or math.inf)
            if not colon or not low < high or not (math.isfinite(low) or math.isfinite(high)):
                raise ValueError(f"give two ends, the lower first, such as {name or 'SUM'}=0:20")
            inner = _INTEGRAL.fullmatch(name)
            formula = expression(inner[1] if inner else name, [*states, *others])
            if not {*states} & {*formula.names}:
                raise ValueError(f"name at least one of the states {', '.join(states)}")
            limit = RigLimit(
                text=name.strip(), formula=formula, integral=bool(inner), low=low, high=high
            )
            limits.append(limit)
        except ValueError as error:
            shown = str(error)
            if shown.startswith("could not convert"):
                shown = f"an end is not a number; write for example {name}=0:20"
            issues.append(Issue("--limit", f"'{text}': {shown}"))
    raise_if_any(issues)
    return tuple(limits)
