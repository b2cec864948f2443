"""How the runs of an overlay look: each with a grey, a line and a marker of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.lines import Line2D

from bayesdrill.insight.overlay import Layer
from bayesdrill.report.overlay_words import elided, warned

LONGEST = 48  # letters of a name in a legend


@dataclass(frozen=True, slots=True)
class Look:
    """Colours that print as different greys."""

    color: str
    linestyle: Any
    marker: str
    linewidth: float = 1.0

    @property
    def line(self) -> dict[str, Any]:
        return {"color": self.color, "linestyle": self.linestyle, "linewidth": self.linewidth}

    @property
    def contour(self) -> dict[str, Any]:
        own = {"colors": self.color, "linestyles": [self.linestyle]}
        return {**own, "linewidths": 0.9 * self.linewidth}


# Thin and thick, dark and light in turn; none has the dashes of a nominal value.
LOOKS = (
    Look("0.0", "-", "o", 0.9),
    Look("#e0832b", "-", "s", 1.7),
    Look("#1d6b58", (0, (6, 1, 1, 1)), "^", 1.1),
    Look("#7b4fb0", (0, (1, 1)), "D", 1.5),
    Look("0.72", "-", "v", 2.2),
    Look("#6b3d1e", (0, (10, 2)), "P"),
)


def handles(layers: Sequence[Layer], *, marked: bool) -> list[Line2D]:
    """For a legend: the name of each run, with its warning."""
    return [
        Line2D([], [], label=legend_name(layer), marker=look.marker if marked else "", **look.line)
        for layer, look in zip(layers, LOOKS, strict=False)
    ]


def legend_name(layer: Layer) -> str:
    return elided(warned(layer), LONGEST).replace("$", r"\$")
