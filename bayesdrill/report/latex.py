"""The summary as a table for a paper: LaTeX with booktabs and siunitx."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

from bayesdrill.basics.symbols import Symbol
from bayesdrill.insight.diagnostics import HDI_PROBABILITY, Row
from bayesdrill.report.scales import unit_of

_HEADS = (
    *("", "unit", "nominal", "MAP", "mean (sd)"),
    rf"{100 * HDI_PROBABILITY:.0f}\,\% HDI",
    "the record says",
)
_USUAL = range(-1, 3)  # powers of ten that are written out

_BEYOND = re.compile(r"[^\x00-\x7f]+")  # ASCII; in names, and in LaTeX outside of formulas alone


def table(rows: Sequence[Row], symbols: Sequence[Symbol]) -> str:
    """A `tabular` for a table of one's own, with the places of two digits of each sd."""
    named = {symbol.name: symbol for symbol in symbols}
    return "\n".join(_around(_line(row, named[row.name]) for row in rows)) + "\n"


def _around(lines: Iterator[str]) -> Iterator[str]:
    yield r"% needs \usepackage{booktabs,siunitx}"
    yield r"\begin{tabular}{@{}llrrrrl@{}}"
    yield r"\toprule"
    yield " & ".join(_HEADS) + r" \\"
    yield r"\midrule"
    yield from lines
    yield r"\bottomrule"
    yield r"\end{tabular}"


def _line(row: Row, symbol: Symbol) -> str:
    power = _exponent(max(abs(row.hdi_low), abs(row.hdi_high)))
    power = 0 if power in _USUAL else power
    sd = row.sd / 10.0**power
    places = max(0, 1 - _exponent(sd)) if sd > 0 else 3

    def number(x: float) -> str:
        return f"{x / 10.0**power:.{places}f}"

    cells = (
        f"${_BEYOND.sub(lambda beyond: rf'\text{{{beyond[0]}}}', symbol.latex)}$",
        unit_of(power, symbol.latex_unit),
        "--" if row.nominal is None else rf"\num{{{number(row.nominal)}}}",
        rf"\num{{{number(row.map)}}}",
        rf"\num{{{number(row.mean)} \pm {number(row.sd)}}}",
        rf"\numrange{{{number(row.hdi_low)}}}{{{number(row.hdi_high)}}}",
        row.word,
    )
    return " & ".join(cells) + r" \\"


def _exponent(x: float) -> int:
    return math.floor(math.log10(x)) if x > 0 else 0
