"""The summary as a table for a paper: LaTeX with booktabs and siunitx."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from itertools import compress

from bayesdrill.basics.symbols import Symbol
from bayesdrill.insight.diagnostics import HDI_PROBABILITY, Row
from bayesdrill.report.scales import unit_of

_HEADS = (
    *("", "unit", "nominal", "MAP", "mean (sd)"),
    rf"{100 * HDI_PROBABILITY:.0f}\,\% HDI",
    "the record says",
)
_NOMINAL = _HEADS.index("nominal")
_USUAL = range(-1, 3)  # powers of ten that are written out

_BEYOND = re.compile(r"[^\x00-\x7f]+")  # ASCII; in names, and in LaTeX outside of formulas alone


def table(rows: Sequence[Row], symbols: Sequence[Symbol], *, believed: bool = True) -> str:
    """A `tabular` for a table of one's own, with the places of two digits of each sd.

    Without what the record says, where that must not be `believed`.
    """
    named = {symbol.name: symbol for symbol in symbols}
    shown = [True] * len(_HEADS)
    shown[_NOMINAL] = any(row.nominal is not None for row in rows)
    shown[-1] = believed
    every = (_HEADS, *(_cells(row, named[row.name]) for row in rows))
    lines = [" & ".join(compress(line, shown)) + r" \\" for line in every]
    return "\n".join(_around("".join(compress("llrrrrl", shown)), lines)) + "\n"


def _around(columns: str, lines: Sequence[str]) -> Iterator[str]:
    yield r"% needs \usepackage{booktabs,siunitx}"
    yield rf"\begin{{tabular}}{{@{{}}{columns}@{{}}}}"
    yield r"\toprule"
    yield lines[0]
    yield r"\midrule"
    yield from lines[1:]
    yield r"\bottomrule"
    yield r"\end{tabular}"


def _cells(row: Row, symbol: Symbol) -> tuple[str, ...]:
    power = _exponent(max(abs(row.hdi_low), abs(row.hdi_high)))
    power = 0 if power in _USUAL else power
    sd = row.sd / 10.0**power
    places = max(0, 1 - _exponent(sd)) if sd > 0 else 3

    def number(x: float) -> str:
        return f"{x / 10.0**power:.{places}f}"

    return (
        f"${_BEYOND.sub(lambda beyond: rf'\text{{{beyond[0]}}}', symbol.latex)}$",
        unit_of(power, symbol.latex_unit),
        "--" if row.nominal is None else rf"\num{{{number(row.nominal)}}}",
        rf"\num{{{number(row.map)}}}",
        rf"\num{{{number(row.mean)} \pm {number(row.sd)}}}",
        rf"\numrange{{{number(row.hdi_low)}}}{{{number(row.hdi_high)}}}",
        row.word,
    )


def _exponent(x: float) -> int:
    return math.floor(math.log10(x)) if x > 0 else 0
