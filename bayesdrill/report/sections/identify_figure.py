"""Draw profile likelihoods, and how well a record determines each principal product."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator
from scipy.interpolate import PchipInterpolator

from bayesdrill.analysis.identifiability.profile import THRESHOLD, Profile
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy
from bayesdrill.basics.symbols import Symbol
from bayesdrill.report import scales, style
from bayesdrill.report.pages import build_page, is_first_column, legend_above
from bayesdrill.report.sections.identify_words import percent

LETTER = 0.04  # of a number at an axis, in widths of a panel
HIGHEST = 8.0  # of the loss that is shown
MARGIN = 0.04  # of the width of a panel, so that walls can be seen


def profile_figure(
    profiles: Sequence[Profile],
    symbols: Mapping[str, Symbol],
    nominal: Mapping[str, float],
    logs: Collection[str] = (),
    width: float = scales.DOUBLE,
) -> Figure:
    """Draw the loss of each parameter, and where it passes 95 %; axes in `logs` are logarithmic."""
    with style.styled(width):
        width = width if len(profiles) > 1 else scales.SINGLE
        figure, panels = build_page(len(profiles), 3, 1.75, width)
        sides = set()
        for panel, profile in zip(panels, profiles, strict=True):
            known, log = nominal.get(profile.name), profile.name in logs
            sides.add(_panel(panel, profile, symbols[profile.name], known, log=log))
            side = is_first_column(panel)
            panel.tick_params(labelleft=side)
            panel.set_ylabel("loss of log likelihood" if side else "")
        handles = [Patch(facecolor=style.FAINT, label="within 95 %"), *style.nominal_handles(sides)]
        legend_above(figure, handles)
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
    left = values[0] if profile.low is None else profile.low
    right = values[-1] if profile.high is None else profile.high
    panel.axvspan(float(scale(left)), float(scale(right)), color=style.FAINT, zorder=-2)
    side = style.mark_values(panel, scale, nominal, arrow=False)
    panel.set_xlim(scale.low, scale.high)
    panel.set_ylim(-0.03 * HIGHEST, HIGHEST)
    style.set_ticks(panel.yaxis, np.array([0.0, 2.0, 4.0, 6.0]), ["0", "2", "4", "6"])
    panel.set_xlabel(scale.label(symbol), labelpad=1)
    style.set_numbers(panel.xaxis, scale, 3, clear=0.08, letter=LETTER)
    style.corner_text(panel, profile.shape, "right", fontsize=style.letters("legend.fontsize"))
    return side


def _edge(values: np.ndarray, loss: np.ndarray, end: int) -> float:
    inner = 1 if end == 0 else -2
    if len(values) < 2 or loss[end] <= HIGHEST:
        return float(values[end])
    share = (HIGHEST - loss[inner]) / (loss[end] - loss[inner])
    return float(values[inner] + np.sqrt(max(share, 0.0)) * (values[end] - values[inner]))


BAR, NARROW_BAR = 0.27, 0.42  # inches; in one column of a page labels stand above their bars
LEAST_EXPONENT = 0.15  # smaller ones are left out of a label
BEYOND = 30.0  # how far the axis reaches past the largest finite sd


def spectrum_figure(
    study: IdentifiabilityStudy, latex: Mapping[str, str], width: float = scales.DOUBLE
) -> Figure:
    """Draw a bar for each direction, its length the Cramer-Rao bound on a logarithmic axis."""
    directions = study.information.directions
    wide, n = width >= scales.DOUBLE, len(directions)
    bar = BAR if wide else NARROW_BAR
    labels = [_label(study.names, d.exponents, latex) for d in directions]
    handles: list[Patch | Line2D] = [Line2D([], [], label="prior", **style.PRIOR_LINE)]
    if np.isinf([d.sd for d in directions]).any():
        handles.append(Patch(label="leaves no trace in the record", **BLIND))
    with style.styled(width):
        figure, (panel,) = build_page(1, 1, 0.5 + n * bar, width)
        _bars(panel, study, 0.62 * BAR / bar)
        panel.set_yticks(np.arange(n), labels if wide else [""] * n)
        panel.tick_params(axis="y", length=0)
        panel.set_ylim(n - 0.4, -0.6 if wide else -0.8)
        if not wide:
            across = panel.get_yaxis_transform()
            for position, label in enumerate(labels):
                panel.text(0.01, position - 0.24, label, transform=across, va="bottom")
        legend_above(figure, handles)
    return figure


def _bars(panel: Axes, study: IdentifiabilityStudy, thick: float) -> None:
    bounds = [direction.sd for direction in study.information.directions]
    sd = 100.0 * np.array(bounds)
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
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.6}
    size = 0.94 * style.letters("legend.fontsize")
    text: dict[str, Any] = {"va": "center", "fontsize": size, "bbox": box}
    for position in places[finite]:
        at = (smallest + sd[position], position)
        value = percent(bounds[position])
        panel.annotate(value, at, (3, 0), textcoords="offset points", **text)
    panel.set_xscale("log")
    panel.set_xlim(smallest, largest)
    panel.xaxis.set_major_locator(LogLocator(numticks=8))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(_power_of_ten)
    panel.set_xlabel("relative standard deviation of the product, record alone [%]")


KNOWN: dict[str, Any] = {"facecolor": style.DARK}
UNKNOWN: dict[str, Any] = {"facecolor": style.LIGHT, "edgecolor": style.DARK, "linewidth": 0.5}
BLIND: dict[str, Any] = {**style.HATCHED, "facecolor": "white", "linewidth": 0.5, "hatch": "//////"}


def _label(names: Sequence[str], exponents: Sequence[float], latex: Mapping[str, str]) -> str:
    parts = []
    for name, exponent in zip(names, exponents, strict=True):
        if abs(exponent) >= LEAST_EXPONENT:
            rounded = f"{exponent:.1f}".removesuffix(".0")
            power = "" if rounded == "1" else f"^{{{rounded}}}"
            parts.append(f"{{{latex[name]}}}{power}")
    return "$" + r"\,".join(parts) + "$"


def _power_of_ten(x: float, _: object) -> str:
    exponent = round(np.log10(x))
    return {0: "1", 1: "10", 2: "100"}.get(exponent, f"$10^{{{exponent}}}$")
