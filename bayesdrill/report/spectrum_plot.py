"""How well a record determines each principal product of the unknowns: the sloppy spectrum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from bayesdrill.insight.identifiability.study import Study
from bayesdrill.report import style

# Inches.
LEFT, RIGHT, BAR, TOP, BOTTOM = 2.75, 0.25, 0.27, 0.42, 0.48
NARROW_LEFT, NARROW_BAR = 0.12, 0.42  # in one column of a page, where labels stand above their bars
LEAST_EXPONENT = 0.15  # smaller ones are left out of a label
BEYOND = 30.0  # how far the axis reaches past the largest finite sd


def spectrum_figure(study: Study, latex: Mapping[str, str], width: float = style.DOUBLE) -> Figure:
    """A bar for each direction, its length the Cramer-Rao bound on a logarithmic axis."""
    wide = width >= style.DOUBLE
    left, bar = (LEFT, BAR) if wide else (NARROW_LEFT, NARROW_BAR)
    with style.styled(width):
        n = len(study.directions)
        height = BOTTOM + n * bar + TOP
        figure = Figure(figsize=(width, height))
        panel = figure.add_axes(
            (left / width, BOTTOM / height, (width - left - RIGHT) / width, n * bar / height)
        )
        _bars(panel, study, 0.62 * BAR / bar)
        labels = [_label(study.names, d.exponents, latex) for d in study.directions]
        _name(panel, labels, beside=wide)
        panel.set_ylim(n - 0.4, -0.6 if wide else -0.8)
        figure.legend(
            handles=_handles(study),
            loc="upper right",
            bbox_to_anchor=(1 - RIGHT / width, 1.0),
            ncols=3,
            borderaxespad=0.3,
        )
    return figure


def _name(panel: Axes, labels: Sequence[str], *, beside: bool) -> None:
    """The bars: beside the panel, or above each."""
    places = np.arange(len(labels))
    panel.set_yticks(places, labels if beside else [""] * len(labels))
    panel.tick_params(axis="y", length=0)
    for place, label in zip(places, labels if not beside else [], strict=False):
        panel.text(0.01, place - 0.24, label, transform=panel.get_yaxis_transform(), va="bottom")


def _bars(panel: Axes, study: Study, thick: float) -> None:
    sd = 100.0 * np.array([d.sd for d in study.directions])
    finite = np.isfinite(sd)
    prior = 100.0 * float(np.median([known.prior_sd for known in study.parameters]))
    largest = max(sd[finite].max(initial=prior), prior) * BEYOND
    smallest = min(sd[finite].min(initial=prior), prior) / BEYOND
    places = np.arange(len(sd))
    inside = finite & (sd < prior)
    shown = np.where(finite, sd, largest)
    for mask, look in ((inside, KNOWN), (finite & ~inside, UNKNOWN), (~finite, BLIND)):
        panel.barh(places[mask], shown[mask], height=thick, left=smallest, **look)
    panel.axvline(prior, **style.PRIOR_LINE)
    for place, value in zip(places, sd, strict=True):
        if np.isfinite(value):
            panel.annotate(
                _percent(value),
                (smallest + value, place),
                xytext=(3, 0),
                textcoords="offset points",
                va="center",
                fontsize=0.94 * style.letters("legend.fontsize"),
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
            )
    panel.set_xscale("log")
    panel.set_xlim(smallest, largest)
    panel.xaxis.set_major_locator(LogLocator(numticks=8))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(FuncFormatter(lambda x, _: _power_of_ten(x)))
    panel.set_xlabel("relative standard deviation of the product, record alone [%]")


KNOWN: dict[str, Any] = {"facecolor": style.DARK}
UNKNOWN: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.DARK, "linewidth": 0.5}
BLIND: dict[str, Any] = {
    "facecolor": "white",
    "edgecolor": style.MIDDLE,
    "linewidth": 0.5,
    "hatch": "//////",
}


def _handles(study: Study) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [Line2D([], [], label="prior", **style.PRIOR_LINE)]
    sd = np.array([d.sd for d in study.directions])
    if np.isinf(sd).any():
        handles.append(Patch(label="leaves no trace in the record", **BLIND))
    return handles


def _label(names: Sequence[str], exponents: Sequence[float], latex: Mapping[str, str]) -> str:
    """The product in LaTeX, exponents to one decimal, the small ones left out."""
    parts = []
    for name, exponent in zip(names, exponents, strict=True):
        if abs(exponent) >= LEAST_EXPONENT:
            rounded = f"{exponent:.1f}".removesuffix(".0")
            power = "" if rounded == "1" else f"^{{{rounded}}}"
            parts.append(f"{{{latex[name]}}}{power}")
    return "$" + r"\,".join(parts) + "$"


def _percent(value: float) -> str:
    if value > 1000:
        return "> 1000 %"
    return f"{value:.0f} %" if value >= 10 else f"{value:.2g} %"


def _power_of_ten(x: float) -> str:
    exponent = round(np.log10(x))
    return {0: "1", 1: "10", 2: "100"}.get(exponent, f"$10^{{{exponent}}}$")
