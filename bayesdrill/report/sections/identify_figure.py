"""Profile likelihoods, and how well a record determines each principal product of the unknowns."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from scipy.interpolate import PchipInterpolator

from bayesdrill.analysis.identifiability.profile import THRESHOLD, Profile
from bayesdrill.analysis.identifiability.study import Study
from bayesdrill.basics.symbols import Symbol
from bayesdrill.report import scales, style
from bayesdrill.report.pages import Page

PAGE = Page(left=0.5, gap_x=0.18, gap_y=0.62, top=0.34, bottom=0.5)
LEGEND = 3  # entries
LETTER, ROOMY = 0.062, 1.6  # inches: of a letter, and of a panel that has room for four ticks
HIGHEST = 8.0  # of the loss that is shown
MARGIN = 0.04  # of the width of a panel, so that walls can be seen


def profile_figure(
    profiles: Sequence[Profile],
    symbols: Mapping[str, Symbol],
    nominal: Mapping[str, float],
    logs: Collection[str] = (),
    width: float = scales.DOUBLE,
) -> Figure:
    """A panel for each parameter: the loss against its value, in the units of the symbols, and where it
    passes 95 %; the axes of the parameters in `logs` are logarithmic.
    """
    alone = len(profiles) == 1
    with style.styled(width):
        page = PAGE.fitting(width, LEGEND) if not alone else replace(PAGE, width=scales.SINGLE)
        figure, panels = page.build(len(profiles))
        sides = set()
        for k, (panel, profile) in enumerate(zip(panels, profiles, strict=True)):
            known, log = nominal.get(profile.name), profile.name in logs
            sides.add(_panel(panel, profile, symbols[profile.name], known, log=log))
            panel.tick_params(labelleft=k % page.columns == 0)
            if k % page.columns == 0:
                panel.set_ylabel(
                    "loss of log likelihood", fontsize=style.letters("legend.fontsize")
                )
        figure.legend(
            handles=_profile_handles(sides),
            loc="upper center",
            ncols=4 if width >= scales.DOUBLE else 2,
            borderaxespad=0.3,
            labelspacing=0.3,
        )
    return figure


def _panel(
    panel: Axes, profile: Profile, symbol: Symbol, nominal: float | None, *, log: bool
) -> int:
    """The side on which the nominal value is off the axis: -1, 0 or 1."""
    near = profile.loss <= HIGHEST
    first, last = (int(k) for k in np.flatnonzero(near)[[0, -1]])
    shown = slice(max(first - 1, 0), min(last + 2, len(near)))
    values, loss = profile.values[shown], profile.loss[shown]
    scale = scales.scale(_edge(values, loss, 0), _edge(values, loss, -1), log=log, margin=MARGIN)
    fine = np.geomspace(values[0], values[-1], 400)
    line = PchipInterpolator(np.log(values), loss)(np.log(fine))
    panel.plot(scale(fine), line, color=style.BLACK)
    panel.plot(scale(values), loss, color=style.BLACK, marker="o", markersize=2, linestyle="none")
    panel.axhline(THRESHOLD, color=style.MIDDLE, linewidth=0.7, linestyle=(0, (1, 1)))
    left = profile.low if profile.low is not None else float(values[0])
    right = profile.high if profile.high is not None else float(values[-1])
    panel.axvspan(float(scale(left)), float(scale(right)), color=style.FAINT, zorder=-2)
    side = scale.side(nominal) if nominal is not None else 0
    if nominal is not None and side == 0:
        panel.axvline(float(scale(nominal)), **style.NOMINAL)
    panel.set_xlim(scale.low, scale.high)
    panel.set_ylim(-0.03 * HIGHEST, HIGHEST)
    style.set_ticks(panel.yaxis, np.array([0.0, 2.0, 4.0, 6.0]), ["0", "2", "4", "6"])
    panel.set_xlabel(scale.label(symbol), labelpad=1)
    inches = panel.get_window_extent().width / panel.figure.dpi
    most = 4 if inches > ROOMY else 3
    style.set_numbers(panel.xaxis, scale, most, clear=0.08, letter=LETTER / inches)
    where: dict[str, Any] = {"transform": panel.transAxes, "ha": "right", "va": "top"}
    panel.text(0.97, 0.93, profile.shape, fontsize=style.letters("legend.fontsize"), **where)
    return side


def _edge(values: np.ndarray, loss: np.ndarray, end: int) -> float:
    """Where the curve leaves the panel, or its end."""
    inner = 1 if end == 0 else -2
    if len(values) < 2 or loss[end] <= HIGHEST:
        return float(values[end])
    share = (HIGHEST - loss[inner]) / (loss[end] - loss[inner])
    return float(values[inner] + np.sqrt(max(share, 0.0)) * (values[end] - values[inner]))


def _profile_handles(sides: set[int]) -> list[Line2D | Patch]:
    return [
        Patch(facecolor=style.FAINT, label="within 95 %"),
        *style.nominal_handles(sides),
    ]


# Inches.
LEFT, RIGHT, BAR, TOP, BOTTOM = 2.75, 0.25, 0.27, 0.42, 0.48
NARROW_LEFT, NARROW_BAR = 0.12, 0.42  # in one column of a page, where labels stand above their bars
LEAST_EXPONENT = 0.15  # smaller ones are left out of a label
BEYOND = 30.0  # how far the axis reaches past the largest finite sd


def spectrum_figure(study: Study, latex: Mapping[str, str], width: float = scales.DOUBLE) -> Figure:
    """A bar for each direction, its length the Cramer-Rao bound on a logarithmic axis."""
    wide = width >= scales.DOUBLE
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
            handles=_spectrum_handles(study),
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


def _spectrum_handles(study: Study) -> list[Patch | Line2D]:
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
