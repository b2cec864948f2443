"""Describe limits of quantities of a rig, such as a current, a twist, or the heat of a run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.duals import Dual, linear_map
from bayesdrill.basics.errors import Issue
from bayesdrill.basics.formulas import Expression, expression
from bayesdrill.record.experiment import raise_if_any

_INTEGRAL = re.compile(r"\s*integral\s*\((.*)\)\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class RigLimit:
    """A limit keeps a formula of states, inputs and parameters between `low` and `high`, in SI.

    With `integral`, the limit holds for the integral of the formula from the start to any time.
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
        """Return the limited quantity `(W, T, 1)`, with derivatives for dual states and inputs.

        The trapezoidal rule gives integrals; inputs are constant in each sampling `interval` [s].
        """
        if not self.integral:
            return self.formula.value({**constant, **states, **driven})
        held = {**constant, **{name: each[:, :-1] for name, each in driven.items()}}
        first, last = (
            self.formula.value(held | {name: each[:, part] for name, each in states.items()})
            for part in (slice(-1), slice(1, None))
        )

        def integrated(power: Array) -> Array:
            return np.insert(0.5 * interval * np.cumsum(power, axis=1), 0, 0.0, axis=1)

        return linear_map(integrated, first + last)

    def quadratic_form(
        self,
        states: Mapping[str, Array],
        driven: Mapping[str, Array],
        constant: Mapping[str, Any],
        interval: float,
    ) -> Array:
        """Return Q `(R, R)`: x' Q x is the integral over all samples if signals are `(T, R) @ x`.

        The first element of x is one.
        """
        names = [name for name in (*states, *driven) if name in self.formula.names]
        power, totals = self._power(names, constant), []
        for part in (slice(-1), slice(1, None)):
            rows = [states[n][part] if n in states else driven[n][:-1] for n in names]
            ones = np.zeros_like(rows[0])
            ones[:, 0] = 1.0
            signals = np.stack([ones, *rows])
            weighted = np.tensordot(power, signals, 1).reshape(-1, ones.shape[1])
            totals.append(weighted.T @ signals.reshape(-1, ones.shape[1]))
        return np.asarray(0.5 * interval * sum(totals))

    def _power(self, names: Sequence[str], constant: Mapping[str, Any]) -> Array:
        """Return the symmetric matrix P of the formula, which is y' P y with y = (1, *names)."""
        n = len(names)
        points, units = np.vstack([np.zeros(n), np.eye(n)]), np.eye(n)
        duals = {name: Dual(points[:, [k]], units[k]) for k, name in enumerate(names)}
        values = self.formula.value({**constant, **duals})
        value, slopes = values.value.reshape(-1), values.slope.reshape(-1, n)
        out = np.empty((n + 1, n + 1))
        out[0, 0], out[0, 1:], out[1:, 0] = value[0], 0.5 * slopes[0], 0.5 * slopes[0]
        out[1:, 1:] = 0.5 * (slopes[1:] - slopes[0])
        return out

    def is_quadratic(self, names: Sequence[str]) -> bool:
        """Return whether the formula is a polynomial of at most degree two in `names`."""
        x = np.append(1.0, 1.3 + np.arange(len(names)))
        values = {name: np.float64(1.7) for name in self.formula.names}
        exact = self.formula.value(values | dict(zip(names, x[1:], strict=True)))
        return bool(np.isclose(x @ self._power(names, values) @ x, exact, rtol=1e-9))


def excess(limited: Array, limits: Sequence[RigLimit]) -> Array:
    """Return excesses of quantities `(..., L)`: positive above `high`, negative below `low`."""
    low = np.array([limit.low for limit in limits])
    high = np.array([limit.high for limit in limits])
    return np.asarray(np.maximum(limited - high, 0.0) + np.minimum(limited - low, 0.0))


def parse_limits(
    texts: Sequence[str], states: Sequence[str], inputs: Sequence[str], parameters: Iterable[str]
) -> tuple[RigLimit, ...]:
    """Return limits such as `w_2=0:` or `integral(v*i)=:50`; raises `InputError`.

    A formula must contain one of the `states`, and may contain `inputs` and `parameters`.
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
            formula = expression(inner[1] if inner else name, [*states, *inputs, *parameters])
            if not {*states} & {*formula.names}:
                raise ValueError(f"name at least one of the states {', '.join(states)}")
            limit = RigLimit(
                text=name.strip(), formula=formula, integral=bool(inner), low=low, high=high
            )
            moving = [each for each in formula.names if each in (*states, *inputs)]
            if inner and not limit.is_quadratic(moving):
                raise ValueError("integrate only a power, of degree two in states and inputs")
            limits.append(limit)
        except ValueError as error:
            shown = str(error)
            if shown.startswith("could not convert"):
                shown = f"an end is not a number; write for example {name}=0:20"
            issues.append(Issue("--limit", f"'{text}': {shown}"))
    raise_if_any(issues)
    return tuple(limits)
