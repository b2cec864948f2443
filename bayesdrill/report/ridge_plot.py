"""The ridge: two unknowns that an exact symmetry scales together, and the line it draws."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.insight.identifiability.structure import Structure
from bayesdrill.report import style

Array = NDArray[np.float64]

LEFT, BOTTOM, RIGHT, TOP = 0.62, 0.5, 0.14, 0.74  # inches
SIZE = 2.6
POINTS = 3000
REACH, CORNERS = 1e4, 4001  # the line is drawn over this factor, and cut by the axes
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 6.0, "solid_capstyle": "butt"}
DOTS: dict[str, Any] = {**style.DOTS, "markersize": 1.8, "alpha": 0.6, "zorder": 3}
TAIL = 0.001
LEAST = 0.5  # of a pair worth showing


@dataclass(frozen=True, slots=True)
class Pair:
    """Columns of two unknowns and their exponents in one symmetry."""

    columns: tuple[int, int]
    exponents: tuple[int, int]


def strongest_pair(draws: Array, structure: Structure) -> Pair | None:
    """Of draws `(N, D)`, the two unknowns that follow one symmetry most closely.

    None where none do, for want of a symmetry or because priors hold the unknowns in place.
    """
    spread = np.cov(np.log(draws[:, : len(structure.names)]).T)
    best, found = LEAST, None
    for symmetry in structure.symmetries:
        used = [k for k, exponent in enumerate(symmetry) if exponent]
        for i, j in itertools.combinations(used, 2):
            p, q = symmetry[i], symmetry[j]
            # 1 where draws differ along the symmetry alone, 0 where without regard to it.
            along = 2 * p * q * spread[i, j] / (q**2 * spread[i, i] + p**2 * spread[j, j])
            if along > best:
                best, found = float(along), Pair((i, j), (p, q))
    return found


def ridge_figure(
    draws: Array,
    pair: Pair,
    symbols: Sequence[Symbol],
    priors: Mapping[str, Prior],
    nominal: Mapping[str, float],
    mode: Mapping[str, float],
) -> Figure:
    """Of draws `(N, D)` in the units of the symbols; the exact line passes through the MAP."""
    shown = [symbols[k] for k in pair.columns]
    ends = [
        _ends(priors[symbol.name], draws[:, k])
        for symbol, k in zip(shown, pair.columns, strict=True)
    ]
    scales = [
        style.scale(*end, log=flat_in_logs(priors[symbol.name]), margin=0.12)
        for symbol, end in zip(shown, ends, strict=True)
    ]
    with style.styled():
        width, height = LEFT + SIZE + RIGHT, BOTTOM + SIZE + TOP
        figure = Figure(figsize=(width, height))
        panel = figure.add_axes((LEFT / width, BOTTOM / height, SIZE / width, SIZE / height))
        (x0, x1), (y0, y1) = (scale(np.array(end)) for scale, end in zip(scales, ends, strict=True))
        box = Rectangle((x0, y0), x1 - x0, y1 - y0, fill=False, zorder=1, **_box())
        panel.add_patch(box)
        factor = np.geomspace(1 / REACH, REACH, CORNERS)
        line = [
            scale(mode[symbol.name] * factor**power)
            for scale, symbol, power in zip(scales, shown, pair.exponents, strict=True)
        ]
        panel.plot(*line, zorder=2, **BAND)
        kept = style.thin(len(draws), POINTS)
        dots = [scale(draws[kept, k]) for scale, k in zip(scales, pair.columns, strict=True)]
        panel.plot(*dots, **DOTS)
        marked = all(symbol.name in nominal for symbol in shown)
        if marked:
            panel.axvline(float(scales[0](nominal[shown[0].name])), zorder=4, **style.NOMINAL)
            panel.axhline(float(scales[1](nominal[shown[1].name])), zorder=4, **style.NOMINAL)
        at = [float(scale(mode[symbol.name])) for scale, symbol in zip(scales, shown, strict=True)]
        panel.plot([at[0]], [at[1]], zorder=5, **style.CROSS)
        panel.set_xlim(scales[0].low, scales[0].high)
        panel.set_ylim(scales[1].low, scales[1].high)
        style.set_numbers(panel.xaxis, scales[0], 4)
        style.set_numbers(panel.yaxis, scales[1], 4)
        panel.set_xlabel(scales[0].label(shown[0]))
        style.side_label(panel, scales[1].label(shown[1]))
        _legend(figure, marked=marked)
    return figure


def _ends(prior: Prior, x: Array) -> tuple[float, float]:
    low, high = (float(q) for q in prior.quantile(np.array([TAIL, 1 - TAIL])))
    low = prior.low if prior.low > 0 else min(low, float(x.min()))
    high = prior.high if np.isfinite(prior.high) else max(high, float(x.max()))
    return low, high


def _box() -> dict[str, Any]:
    return {"edgecolor": style.MIDDLE, "linewidth": 0.8, "linestyle": style.PRIOR_LINE["linestyle"]}


def _legend(figure: Figure, *, marked: bool) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="exact symmetry: no measured signal changes along it", **BAND),
        Line2D([], [], label="posterior draws", **{**DOTS, "markersize": 3}),
        Patch(fill=False, label="prior", **_box()),
        *(style.nominal_handles({0}) if marked else []),
        Line2D([], [], label="MAP", **style.CROSS),
    ]
    columns = handles[:1], handles[1:]
    first = figure.legend(
        handles=columns[0], loc="upper center", borderaxespad=0.3, handlelength=2.2
    )
    figure.add_artist(first)
    second = figure.legend(
        handles=columns[1],
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.22 / float(figure.get_size_inches()[1])),
        ncols=2,
        borderaxespad=0.3,
        handlelength=2.2,
        columnspacing=1.6,
    )
    figure.add_artist(second)
