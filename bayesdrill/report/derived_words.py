"""Derived quantities for readers: the second table of a summary, and columns of the corner plot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol, plain
from bayesdrill.inference.problem import Problem
from bayesdrill.insight.derived import Derived, Row, at
from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.report.sections import Table
from bayesdrill.report.tables import records_as_csv

Array = NDArray[np.float64]

_HDI = f"{100 * HDI_PROBABILITY:.0f} % HDI"
_HEADERS = ("", "unit", "nominal", "mean", "sd", _HDI, "dev. %", "meaning")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What a corner plot shows: `draws (N, D)`, and nominal and MAP where there are any; SI."""

    draws: Array
    symbols: tuple[Symbol, ...]
    nominal: dict[str, float]
    mode: dict[str, float]


def as_csv(rows: Sequence[Row]) -> str:
    """All digits, SI; `share` of the draws have the quantity, `deviation` is a fraction."""
    return records_as_csv(Row, rows, {})


def table(rows: Sequence[Row], derived: Derived) -> Table:
    """Of what follows, with its meanings."""
    meanings = {symbol.name: symbol.meaning for symbol in derived.symbols}
    lines = []
    for row in rows:
        part = "" if row.share == 1.0 else f"; {100 * (1 - row.share):.2g} % of the draws have none"
        ratio = abs(row.mean) / row.sd if row.sd > 0 else 1.0
        digits = max(4, min(12, 2 + math.ceil(math.log10(max(ratio, 1.0)))))  # down to the sd's
        cells = (
            row.name,
            plain(row.unit),
            "" if row.nominal is None else f"{row.nominal:.4g}",
            f"{row.mean:.{digits}g}",
            f"{row.sd:.2g}",
            f"{row.hdi_low:.{digits}g} to {row.hdi_high:.{digits}g}",
            "" if row.deviation is None else f"{100 * row.deviation:+.2f}",
            meanings[row.name] + part,
        )
        lines.append(cells)
    left = frozenset((_HEADERS[0], _HEADERS[1], _HEADERS[-1]))
    return Table(_HEADERS, tuple(lines), left).filled()


def shown(
    problem: Problem,
    names: Sequence[str] | None,
    draws: Array,
    derived: Derived,
    theta: Array,
) -> Shown:
    """Of the unknowns `draws (E, N, D)` and what is derived, those of `names`; None: all unknowns.

    `theta (1, D)` is the MAP.  Draws without a value, and columns of one value alone, are left out.
    """
    every = np.concatenate([draws, derived.values], axis=-1)
    symbols = (*problem.symbols, *derived.symbols)
    unknown = [symbol.name for symbol in problem.symbols]
    order = [symbol.name for symbol in symbols]
    mode = {name: float(x) for name, x in zip(unknown, theta[0], strict=True)}
    mode |= {name: float(x[0]) for name, x in at(problem, theta).items() if np.isfinite(x[0])}
    wanted = unknown if names is None else [name for name in dict.fromkeys(names) if name in order]
    picked = every.reshape(-1, len(order))[:, [order.index(name) for name in wanted]]
    some = [
        k for k in range(len(wanted)) if len(np.unique(picked[np.isfinite(picked[:, k]), k])) > 1
    ]
    if not some:
        return shown(problem, None, draws, derived, theta)
    picked = picked[:, some]
    nominal = {name: x for name, x in derived.nominal.items() if np.isfinite(x)}
    return Shown(
        draws=picked[np.isfinite(picked).all(axis=1)],
        symbols=tuple(symbols[order.index(wanted[k])] for k in some),
        nominal={**nominal, **problem.nominal},
        mode=mode,
    )
