"""The zoo in a figure: seconds and effective draws per second of every row, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesdrill.report import scales, style
from benchmarks.zoo.table import Measured

ROW = 0.155  # inches
ABOVE, BELOW, LEFT, GAP, RIGHT = 0.42, 0.5, 1.42, 0.22, 0.12
KINDS = {
    "converged": {"marker": "o", "markerfacecolor": style.BLACK},
    "not to be believed, and said so": {"marker": "s", "markerfacecolor": "white"},
    "failed": {"marker": "X", "markerfacecolor": style.MAP_COLOUR},
}
LIMIT = {"color": style.MIDDLE, "linestyle": (0, (4, 2)), "linewidth": 0.8}
SECONDS = (1, 3, 10, 30, 100)


def figure(every: Sequence[Measured], seconds: float, folder: Path) -> None:
    """`zoo.pdf` and `zoo.png`; `seconds`: the most that a run may take."""
    shown = list(reversed(every))
    height = ROW * len(shown) + ABOVE + BELOW
    with style.styled():
        made = Figure(figsize=(scales.DOUBLE, height))
        width = (scales.DOUBLE - LEFT - GAP - RIGHT) / 2
        panels = [
            made.add_axes(
                (
                    left / scales.DOUBLE,
                    BELOW / height,
                    width / scales.DOUBLE,
                    ROW * len(shown) / height,
                )
            )
            for left in (LEFT, LEFT + width + GAP)
        ]
        _dots(panels[0], [one.numbers("wall_s") for one in shown], shown)
        rates = [one.numbers("ess_per_s") if one.sound else [] for one in shown]
        _dots(panels[1], rates, shown)
        panels[0].axvline(seconds, **LIMIT)
        panels[0].set_xticks(SECONDS, [f"{tick:g}" for tick in SECONDS])
        panels[0].set_xlabel(r"a run from start to end [$\mathrm{s}$]")
        panels[1].set_xlabel(r"effective draws per second [$\mathrm{s^{-1}}$]")
        panels[0].set_yticks(range(len(shown)), [one.name for one in shown])
        panels[1].set_yticks([])
        kinds = {kind(one) for one in every}
        handles = [Line2D([], [], label=name, **_look(name)) for name in KINDS if name in kinds]
        handles.append(Line2D([], [], label="the most that a run may take", **LIMIT))
        made.legend(
            handles=handles, loc="upper right", ncols=len(handles), bbox_to_anchor=(0.995, 1.0)
        )
        style.save(made, folder, "zoo", {"Title": "The zoo"})


def kind(one: Measured) -> str:
    if not one.passed:
        return "failed"
    return "converged" if one.sound else "not to be believed, and said so"


def _look(name: str) -> dict[str, object]:
    return {
        "color": style.BLACK,
        "linestyle": "none",
        "markersize": 3.6,
        "markeredgewidth": 0.6,
        **KINDS[name],
    }


def _dots(panel: Axes, values: Sequence[Sequence[float]], shown: Sequence[Measured]) -> None:
    """Two for each row, and a line between them; nothing where a run has no such number."""
    for place, (row, one) in enumerate(zip(values, shown, strict=True)):
        kept = [value for value in row if value > 0]
        panel.axhline(place, color=style.FAINT, linewidth=0.5, zorder=-2)
        panel.plot(kept, [place] * len(kept), color=style.MIDDLE, linewidth=0.8, zorder=1)
        panel.plot(kept, [place] * len(kept), **_look(kind(one)), clip_on=False)
    panel.set_xscale("log")
    panel.minorticks_off()
    found = [value for row in values for value in row if value > 0] or [1.0]
    panel.set_xlim(0.7 * min(found), 1.4 * max(found))
    panel.set_ylim(-0.7, len(shown) - 0.3)
    panel.tick_params(axis="y", length=0, labelsize=7.0)
    panel.spines[["top", "right"]].set_visible(False)
