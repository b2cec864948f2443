"""Where the energy goes: what came in and what became of it, over time, in joules and as shares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayesdrill.basics.symbols import Symbol
from bayesdrill.report import style
from bayesdrill.report.energy_words import Balance, Stacked
from bayesdrill.report.fit_plot import extremes

Array = NDArray[np.float64]

JOULES = Symbol("E", "J", "E", "J", "energy so far")
SHARE = Symbol("share", "%", r"\mathrm{share}", r"\%", "of what came in")
POINTS = 800  # of an edge
FIRST = 0.02  # of all that comes in: before it shares mean nothing
LEFT, RIGHT, GAP, BOTTOM, LINE, ROW = 0.84, 0.12, 0.16, 0.42, 0.17, 1.5  # inches
NARROW_ROW, NARROW_LEFT = 1.2, 0.7  # of a figure in one column

# Greys by kinds, and hatches within them: no colour is wanted.
LOOKS: Mapping[str, tuple[str, str]] = {
    "electrical": (style.FAINT, ""),
    "viscous": (style.LIGHT, ""),
    "friction": (style.MIDDLE, ""),
    "other": ("1.0", ""),
    "stored": ("1.0", "......"),
}
HATCHES = ("", "\\\\\\\\", "////", "xxxx")


def energy_figure(found: Balance, width: float = style.DOUBLE) -> Figure:
    """Above in joules, below as shares of what came in until then."""
    broad = width >= style.DOUBLE
    row, side, columns = (ROW, LEFT, 4) if broad else (NARROW_ROW, NARROW_LEFT, 2)
    lines = math.ceil((len(found.parts) + 1) / columns)
    top = 0.1 + LINE * lines
    height = top + 2 * row + GAP + BOTTOM
    with style.styled(width):
        figure = Figure(figsize=(width, height))
        inside = (width - side - RIGHT) / width
        panels = [
            figure.add_axes(
                (side / width, (BOTTOM + k * (row + GAP)) / height, inside, row / height)
            )
            for k in (1, 0)
        ]
        drawn = extremes(found.total, POINTS)
        time = style.scale(float(found.t[0]), float(found.t[-1]))
        handles = _joules(panels[0], found, drawn, time)
        _shares(panels[1], found, drawn, time)
        for panel in panels:
            panel.set_xlim(time.low, time.high)
            style.set_ticks(panel.xaxis, *time.ticks(5))
        panels[0].tick_params(labelbottom=False)
        panels[1].set_xlabel(time.label(found.time))
        figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(side / width if broad else 0.02, 1.0),
            ncols=columns,
            borderaxespad=0.3,
            borderpad=0.0,
            columnspacing=1.2,
            labelspacing=0.25,
            handlelength=1.8,
        )
    return figure


def _joules(panel: Axes, found: Balance, drawn: NDArray[np.intp], time: style.Scale) -> list[Any]:
    edges = np.cumsum([np.zeros(len(drawn)), *(p.joules[drawn] for p in found.parts)], axis=0)
    low, high = min(0.0, float(edges.min())), max(float(edges.max()), float(found.total.max()))
    scale = style.scale(low, high or 1.0, margin=0.03)
    panel.set_ylim(scale.low if low < 0 else 0.0, scale.high)
    handles = _stack(panel, found, time(found.t[drawn]), scale(edges))
    (line,) = panel.plot(
        time(found.t[drawn]), scale(found.total[drawn]), color=style.BLACK, linewidth=1.0
    )
    line.set_label(f"came in: {found.sources}")
    style.set_ticks(panel.yaxis, *scale.ticks(4))
    style.side_label(panel, scale.label(JOULES, "\n"))
    return [line, *handles]


def _shares(panel: Axes, found: Balance, drawn: NDArray[np.intp], time: style.Scale) -> None:
    kept = drawn[found.total[drawn] > FIRST * float(found.total.max())]
    if not len(kept):
        return
    parts = [100.0 * p.joules[kept] / found.total[kept] for p in found.parts]
    edges = np.cumsum([np.zeros(len(kept)), *parts], axis=0)
    _stack(panel, found, time(found.t[kept]), edges)
    panel.set_ylim(0, 100)
    style.set_ticks(panel.yaxis, np.arange(0, 101, 25.0), ["0", "25", "50", "75", "100"])
    style.side_label(panel, f"${SHARE.latex}$\n[$\\mathrm{{{SHARE.latex_unit}}}$]")


def _stack(panel: Axes, found: Balance, t: Array, edges: Array) -> list[Patch]:
    """Each between two of `edges (P + 1, N)`."""
    handles = []
    for part, look, low, high in zip(
        found.parts, looks(found.parts), edges[:-1], edges[1:], strict=True
    ):
        panel.fill_between(t, low, high, **look)
        handles.append(Patch(label=part.name, **look))
    return handles


def looks(parts: Sequence[Stacked]) -> list[dict[str, Any]]:
    """Those of one kind differ in their hatches."""
    seen: dict[str, int] = {}
    found = []
    for part in parts:
        k = seen[part.kind] = seen.get(part.kind, -1) + 1
        face, hatch = LOOKS[part.kind]
        found.append(
            {
                "facecolor": face,
                "edgecolor": style.BLACK,
                "hatch": hatch or HATCHES[k % len(HATCHES)],
                "linewidth": 0.4,
            }
        )
    return found
