"""Draw `docs/figures/products`: what the bundled record determines, and what it does not.

    python docs/products.py

The numbers are those of the published run of `configs/nominal_step.yaml`. The PNG carries the digests
of its tables, so that `python docs/results.py --check` finds a figure of other tables.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.report import style

ROOT = Path(__file__).parent.parent
RUN = "nominal_step"
TABLES = ("summary.csv", "verdict.csv")
STEM = "products"
SOURCE = "Source"  # the entry of the PNG that names its tables

WIDTH, HEIGHT = 7.0, 3.0  # inches
TOP, BOTTOM = 0.83, 0.155  # of the panels
END = 72.0  # of the axis, per cent
# An edge keeps the narrowest interval visible.
BAR: Mapping[str, Any] = {"facecolor": "0.7", "edgecolor": style.DARK, "linewidth": 0.6}
PRIOR: Mapping[str, Any] = {"facecolor": style.FAINT, "edgecolor": "none"}
MAP: Mapping[str, Any] = {**style.CROSS, "markersize": 6.5, "markeredgewidth": 1.1}
THICKNESS = 13.0  # of a bar, points


@dataclass(frozen=True)
class Interval:
    """The 94 % interval of a quantity and its MAP, in per cent from the nominal value."""

    name: str
    low: float
    high: float
    map: float
    prior: tuple[float, float] | None = None

    @property
    def label(self) -> str:
        """The product as LaTeX."""
        return f"${self.name.replace(' ', r'\,')}$"

    @property
    def text(self) -> str:
        """The ends of the interval, each with two digits."""
        return f"{_signed(self.low)} to {_signed(self.high)} %"


def _signed(value: float) -> str:
    """Two significant digits, without an exponent."""
    size = abs(value)
    digits = f"{size:.0f}" if size >= 10 else f"{size:.1f}" if size >= 1 else f"{size:.2g}"
    return f"{'\u2212' if value < 0 else '+'}{digits}"


def parameters(folder: Path, config: Path) -> list[Interval]:
    """Return the nine parameters, with the ends of their priors."""
    priors = bd.load(config).job.config.parameters
    intervals = []
    for row in _rows(folder / "summary.csv"):
        prior: Any = priors.get(row["name"])
        ends = (100 * (prior.low - 1), 100 * (prior.high - 1))
        interval = _interval(row["name"], row, float(row["map"]))
        intervals.append(Interval(interval.name, interval.low, interval.high, interval.map, ends))
    return intervals


def products(folder: Path) -> list[Interval]:
    """Return the products of powers that the record determines."""
    at_map = {row["name"]: float(row["map"]) for row in _rows(folder / "summary.csv")}
    return [
        _interval(row["quantity"], row, evaluate(row["quantity"], at_map))
        for row in _rows(folder / "verdict.csv")
        if row["verdict"] != "not determined"
    ]


def evaluate(product: str, values: Mapping[str, float]) -> float:
    """Return `k_T/(r_m k_s)` of these values."""
    over, _, under = product.partition("/")
    result = 1.0
    for names, sign in ((over, 1), (under, -1)):
        for name, power in re.findall(r"(\w+)(?:\^(\d+))?", names):
            if name != "1":
                result *= values[name] ** (sign * int(power or 1))
    return result


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _interval(name: str, row: Mapping[str, str], at_map: float) -> Interval:
    nominal = float(row["nominal"])
    ends = (float(row["hdi94_low"]), float(row["hdi94_high"]), at_map)
    return Interval(name, *(100 * (value / nominal - 1) for value in ends))


def draw(root: Path) -> Figure:
    """Draw parameters at the left and products at the right, on the same axis."""
    folder = root / "results" / "published" / RUN
    with style.styled():
        figure = Figure(figsize=(WIDTH, HEIGHT))
        left, right = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.07, right=0.985, top=TOP, bottom=BOTTOM, wspace=0.3)
        _panel(left, parameters(folder, root / "configs" / f"{RUN}.yaml"), "the nine parameters")
        _panel(right, products(folder), "the products that the record determines")
        _legend(figure)
    return figure


def _panel(panel: Axes, intervals: Sequence[Interval], title: str) -> None:
    unit = len(intervals) * THICKNESS / (72 * HEIGHT * (TOP - BOTTOM))  # a bar, in steps of y
    for y, interval in enumerate(intervals):
        if interval.prior is not None:
            _bar(panel, interval.prior, y, unit, PRIOR, zorder=1)
        _bar(panel, (interval.low, interval.high), y, 0.62 * unit, BAR, zorder=3)
        panel.plot(interval.map, y, **MAP, zorder=5)
        if interval.prior is None:
            end = max(interval.high, interval.map)
            away: Any = {"xytext": (9, 0), "textcoords": "offset points"}
            panel.annotate(interval.text, (end, y), **away, va="center", fontsize=8.0)
    panel.axvline(0.0, **style.NOMINAL, zorder=2)
    panel.set_title(title, pad=5)
    panel.set_xlim(-END, END)
    panel.set_xticks([-50, -25, 0, 25, 50], ["\u221250", "\u221225", "0", "25", "50"])
    panel.set_xlabel("deviation from the nominal value [%]", labelpad=3)
    panel.set_ylim(len(intervals) - 0.4, -0.6)
    panel.set_yticks(range(len(intervals)), [interval.label for interval in intervals])
    panel.tick_params(axis="y", length=0, labelsize=9.5)


def _bar(
    panel: Axes,
    ends: tuple[float, float],
    y: int,
    height: float,
    look: Mapping[str, Any],
    zorder: int,
) -> None:
    width = ends[1] - ends[0]
    panel.barh(y, width, height, left=ends[0], zorder=zorder, **look)


def _legend(figure: Figure) -> None:
    handles = [
        Patch(label="94 % interval of the posterior", **BAR),
        Line2D([], [], label="nominal value", **style.NOMINAL),
        Line2D([], [], label="MAP", **MAP),
        Patch(label="prior, from end to end", **PRIOR),
    ]
    figure.legend(handles=handles, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.0))


def source(root: Path) -> str:
    """Return the digests of the tables that the figure shows."""
    folder = root / "results" / "published" / RUN
    return " ".join(output_files.digest(folder / name) for name in TABLES)


def save(root: Path) -> None:
    """Write the figure as PNG and PDF."""
    metadata = {"Title": "What a record determines", SOURCE: source(root)}
    style.save(draw(root), root / "docs" / "figures", STEM, metadata)


def stale(root: Path) -> Iterator[str]:
    """Say whether the figure shows other tables than those that are published."""
    path = root / "docs" / "figures" / f"{STEM}.png"
    if path.exists() and source(root).encode() not in path.read_bytes():
        yield f"docs/figures/{STEM}.png is not of the published tables"


if __name__ == "__main__":
    save(ROOT)
