"""The corner of what the record can show: products of powers, as deviations from nominal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol, product_latex
from bayesdrill.insight.identifiability.structure import Exponents
from bayesdrill.insight.verdict import Verdict
from bayesdrill.report.corner_plot import corner_figure
from bayesdrill.report.identify_words import product
from bayesdrill.report.widths import DOUBLE

Array = NDArray[np.float64]


def invariants_figure(
    found: Verdict,
    draws: Array,
    mode: Array,
    symbols: Sequence[Symbol],
    width: float = DOUBLE,
) -> Figure:
    """Of SI draws `(N, D)` and the MAP `(D,)`; determined products, or all where none is.

    In per cent, so that a product known to 1e-5 has as readable an axis as one known to a half.
    """
    sure = [q for q in found.products if q.says != "not determined"]
    chosen = sure or list(found.products)
    shown = [_symbol(found.names, quantity.exponents, symbols) for quantity in chosen]
    powers = np.array([quantity.exponents for quantity in chosen], dtype=float)
    table = np.log([quantity.nominal for quantity in chosen])
    m = len(found.names)
    off = 100 * np.expm1(np.log(draws[:, :m]) @ powers.T - table)
    at = 100 * np.expm1(np.log(mode[:m]) @ powers.T - table)
    return corner_figure(
        off,
        shown,
        {symbol.name: 0.0 for symbol in shown},
        {symbol.name: float(x) for symbol, x in zip(shown, at, strict=True)},
        {},
        width,
    )


def _symbol(names: Sequence[str], exponents: Exponents, symbols: Sequence[Symbol]) -> Symbol:
    return Symbol(
        name=product(names, exponents),
        unit="%",
        latex=rf"\Delta\,{product_latex(exponents, symbols)}",
        latex_unit=r"\%\;of\;nominal",
        meaning="deviation from the nominal value",
    )
