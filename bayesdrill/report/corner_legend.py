"""What lines, shades and numbers of a corner plot are, and where it is said."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.report import style
from bayesdrill.report.contours import INNER, LEVELS, OUTER
from bayesdrill.report.corner_page import CornerPage

Handles = list[Line2D | Patch]


def handles(
    *, sides: Collection[int], prior: bool, mode: bool, joint: bool, differences: bool
) -> tuple[Handles, Handles]:
    """Lines, then shades and notes.

    `sides`: where nominal values are; `joint`: of more than one unknown; `differences`: some axes
    count from an origin.
    """
    credible = f"{100 * HDI_PROBABILITY:.0f} %"
    lines: Handles = [
        Line2D([], [], color=style.BLACK, linewidth=0.8, label="posterior"),
        Patch(color=style.FAINT, label=f"narrowest {credible} interval"),
    ]
    if prior:
        lines.append(Line2D([], [], label="prior", **style.PRIOR_LINE))
    lines += style.nominal_handles(sides)
    if mode:
        both = {**style.CROSS, "linestyle": style.MAP_LINE["linestyle"]}
        lines.append(Line2D([], [], label="MAP", **both))
    shades: Handles = []
    notes = [f"titles: median and {credible} interval, as on the axes"]
    if joint:
        for grey, level, sds in zip((INNER, OUTER), LEVELS, (1, 2), strict=True):
            text = rf"{100 * level:.1f} % of the draws (${sds}\sigma$ in two dimensions)"
            shades.append(Patch(facecolor=grey, edgecolor="black", linewidth=0.7, label=text))
        notes.append("no contour where the density is flat")
    if differences:
        notes.append(r"$\delta$: the difference that the axis shows")
    return lines, shades + [Line2D([], [], linestyle="none", label=note) for note in notes]


def legend(figure: Figure, first: Handles, second: Handles, page: CornerPage) -> None:
    """In the empty upper right or beside a single panel; where there is no room, above."""
    width, height = page.width, page.height
    edge = 0.5 * min(page.right, 0.2) / width
    shared: dict[str, Any] = {
        "fontsize": page.legend_letters,
        "borderaxespad": 0.0,
        "handlelength": 2.2,
    }
    high = 1 - 0.07 / height
    if page.above:
        spread = {**shared, "labelspacing": 0.35}
        at = (0.05 / width, high), (1.0, high)
        figure.legend(handles=first, loc="upper left", bbox_to_anchor=at[0], **spread)
        figure.legend(handles=second, loc="upper right", bbox_to_anchor=at[1], **spread)
        return
    at_corner = (1 - edge, high)
    figure.legend(handles=[*first, *second], loc="upper right", bbox_to_anchor=at_corner, **shared)
