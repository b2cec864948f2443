"""The record against the model: inputs, what was measured, the model at the MAP, and what is left."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.special import ndtri

from bayesdrill.basics.symbols import Symbol
from bayesdrill.insight.diagnostics import HDI_PROBABILITY
from bayesdrill.report import fit_page, residual_words, round_numbers, style
from bayesdrill.report.fit_page import FitPage
from bayesdrill.report.fitted import Course, Fit, Signal
from bayesdrill.report.rubbed import Rub

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DOTS = 3000  # measured samples drawn in a panel
LINE = 2000  # corners of a line

SHARE = f"{100 * HDI_PROBABILITY:.0f} %"
TAILS = (0.5 - HDI_PROBABILITY / 2, 0.5 + HDI_PROBABILITY / 2)
SIGMAS = float(ndtri(TAILS[1]))  # 1.88: half the width of the band of the noise


def fit_figure(fit: Fit, width: float = style.DOUBLE) -> Figure:
    """Inputs above; for each channel its signals, and beside them (below, in one column) residuals."""
    t = fit.t
    time = style.scale(float(t[0]), float(t[-1]), margin=0.01)
    with style.styled(width):
        page = fit_page.build(
            *(len(fit.signals), len(fit.courses), len(fit.rubs)), width, constant=bool(fit.constant)
        )
        for panel, course in zip(page.courses, fit.courses, strict=True):
            _course(panel, course, time, t)
        for signal, (left, right) in zip(fit.signals, page.rows, strict=True):
            drawn = extremes(signal.model, LINE)
            band = _band(signal, drawn)
            _signals(left, signal, time, t, drawn, band)
            _residuals(right, signal, time, t)
        for panel, rub in zip(page.rubs, fit.rubs, strict=True):
            _rub(panel, rub, time, t)
        _times(page, time, fit.time)
        _legends(page, fit, beside=width >= style.DOUBLE)
    return page.figure


def _band(signal: Signal, drawn: Indices) -> Array:
    """Of what draws predict; where there are none, of the noise about the model."""
    if signal.predictive is None:
        return signal.model[drawn] + SIGMAS * signal.sigma * np.array([[-1.0], [1.0]])
    return np.asarray(np.quantile(signal.predictive[:, drawn], TAILS, axis=0))


def _times(page: FitPage, time: style.Scale, label: Symbol) -> None:
    first = page.rows[0][0]
    for panel in page.panels:
        panel.set_xlim(time.low, time.high)
        broad = panel.get_position().width >= first.get_position().width
        style.set_ticks(panel.xaxis, *time.ticks(5 if broad else 4))
        if panel.xaxis.get_tick_params()["labelbottom"]:
            panel.set_xlabel(time.label(label))


def extremes(y: Array, most: int) -> Indices:
    """At most `most` indices, with the least and greatest of each stretch: no peak is lost."""
    n = len(y)
    if n <= most:
        return np.arange(n)
    length = -(-n // ((most - 2) // 2))
    starts = np.arange(0, n, length)
    padded = np.concatenate([y, np.full(len(starts) * length - n, y[-1])]).reshape(-1, length)
    kept = np.stack([starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)])
    return np.unique(np.concatenate([[0, n - 1], np.minimum(kept, n - 1).ravel()]))


def measured(y: Array) -> Indices:
    """At most `DOTS` of the samples of a channel `y (T,)`, which may have few of the record's times."""
    seen = np.flatnonzero(~np.isnan(y))
    return seen[style.thin(len(seen), DOTS)]


def corners(u: Array, most: int) -> Indices:
    """Where stairs through `u` begin, rise and end; of too many, the `extremes`."""
    changes = np.flatnonzero(np.diff(u)) + 1
    found = np.unique(np.concatenate([[0, len(u) - 1], changes]))
    return found if len(found) <= most else extremes(u, most)


DOT: dict[str, Any] = {**style.DOTS, "color": "0.45", "alpha": 0.8, "zorder": 1}
MODEL: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.9}
EDGE: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.6, "linestyle": (0, (4, 2))}
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 0}
STICKS: dict[str, Any] = {
    "facecolor": "none",
    "edgecolor": style.MIDDLE,
    "hatch": "/////",
    "linewidth": 0,
}


def _size(n: int) -> dict[str, float]:
    """Dots that leave something to see of what is behind them."""
    return {"markersize": min(3.0, max(1.0, 40 / math.sqrt(n)))}


def _course(panel: Axes, course: Course, time: style.Scale, t: Array) -> None:
    """As the model takes it between samples."""
    u = course.values
    drawn = (extremes if course.straight else corners)(u, LINE)
    scale = _numbers(panel, course.label, float(u.min()), float(u.max()), 3)
    style_of = "default" if course.straight else "steps-post"
    panel.plot(time(t[drawn]), scale(u[drawn]), drawstyle=style_of, **MODEL)


def _rub(panel: Axes, rub: Rub, time: style.Scale, t: Array) -> None:
    """Held from sample to sample, as it acts; where it sticks the panel is hatched."""
    drawn = extremes(rub.effort, LINE)
    band = rub.effort[None] if rub.band is None else rub.band
    far = max(float(np.abs(band).max()), float(np.abs(rub.effort).max()))
    scale = _numbers(panel, rub.label, -far, far, 3)
    for begin, end in rub.sticks:
        panel.axvspan(float(time(begin)), float(time(end)), zorder=0, **STICKS)
    if rub.band is not None:
        look: dict[str, Any] = {**BAND, "step": "post", "zorder": 1}
        panel.fill_between(time(t[drawn]), *scale(band[:, drawn]), **look)
    panel.plot(time(t[drawn]), scale(rub.effort[drawn]), drawstyle="steps-post", zorder=2, **MODEL)


def _signals(
    panel: Axes, signal: Signal, time: style.Scale, t: Array, drawn: Indices, band: Array
) -> None:
    """`band` `(2, len(drawn))` around the model."""
    y, model = signal.y, signal.model
    low = min(float(np.nanmin(y)), float(model.min()), float(band.min()))
    high = max(float(np.nanmax(y)), float(model.max()), float(band.max()))
    scale = _numbers(panel, signal.label, low, high)
    panel.fill_between(time(t[drawn]), *scale(band), zorder=0, **BAND)
    dots = measured(y)
    panel.plot(time(t[dots]), scale(y[dots]), **(DOT | _size(len(dots))))
    panel.plot(time(t[drawn]), scale(model[drawn]), zorder=2, **MODEL)


def _residuals(panel: Axes, signal: Signal, time: style.Scale, t: Array) -> None:
    """Measured minus MAP, the band of the noise, and how much of the channel this is."""
    rest, sigma = signal.y - signal.model, signal.sigma
    label = Symbol("rest", "", r"\mathrm{residual}", signal.label.latex_unit, "")
    far = max(float(np.nanmax(np.abs(rest))), SIGMAS * sigma)
    scale = _numbers(panel, label, -far, far)
    ends = scale(np.array([-1.0, 1.0]) * SIGMAS * sigma)
    panel.axhspan(*ends, zorder=0, **BAND)
    for end in ends:
        panel.axhline(end, zorder=2, **EDGE)
    dots = measured(rest)
    panel.plot(time(t[dots]), scale(rest[dots]), **(DOT | _size(len(dots))))
    panel.axhline(float(scale(0.0)), zorder=2, **MODEL)
    if not math.isnan(signal.share):
        panel.annotate(
            f"unexplained: {residual_words.percent(signal.share)}",
            (1.0, 0.5),
            (4, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            rotation=90,
            ha="left",
            va="center",
            size=style.letters("legend.fontsize"),
        )


def _numbers(
    panel: Axes, what: style.Labelled, low: float, high: float, most: int = 4
) -> style.Scale:
    scale = style.scale(low, high, margin=0.06)
    panel.set_ylim(scale.low, scale.high)
    style.set_ticks(panel.yaxis, *scale.ticks(most))
    style.side_label(panel, scale.label(what, "\n"))
    return scale


HELD = "input, held from each sample to the next"
STRAIGHT = "input, straight from each sample to the next"
LEFT = "unexplained: rms over spread"


def _legends(page: FitPage, fit: Fit, *, beside: bool) -> None:
    """Above each kind of panel, what is shown in it; what is constant, in a line."""
    dot = Line2D([], [], **{**DOT, "markersize": 3, "rasterized": False})
    line, band = Line2D([], [], **MODEL), Patch(**BAND)
    edged = Patch(facecolor=BAND["color"], edgecolor=style.BLACK, linewidth=0.6, linestyle="--")
    what = "of the noise" if fit.signals[0].predictive is None else "posterior predictive"
    at_map = " at the MAP" if beside else ""
    noise = rf"{SHARE} of the noise ($\pm${SIGMAS:.2f} $\sigma${at_map})"
    signals = {
        f"measured ({fit.label})" if fit.label else "measured": dot,
        "model at the MAP": line,
        f"{SHARE} {what}": band,
    }
    rest = {noise: edged, LEFT: Line2D([], [], linestyle="none")}
    left, right = page.rows[0]
    if beside:
        _legend(left, signals, 3)
        _legend(right, {"measured minus model at the MAP": dot, **rest}, 1)
    else:
        _legend(left, signals | rest, 2, 0.02 - page.left / left.get_position().width)
    if fit.rubs:
        rubs = {"friction at the MAP": line, "it sticks": Patch(**STICKS)}
        known = {} if fit.rubs[0].band is None else {f"{SHARE} posterior": band}
        _legend(page.rubs[0], rubs | known, 3)
    if fit.courses:
        _legend(page.courses[0], {STRAIGHT if fit.courses[0].straight else HELD: line}, 1)
    if fit.constant:
        said = ", ".join(map(_said, *zip(*fit.constant, strict=True)))
        size = style.letters("legend.fontsize")
        page.figure.text(page.left, page.said, f"constant input: {said}", va="top", size=size)


def _said(label: Symbol, value: float) -> str:
    number = round_numbers.latex(float(f"{value:.5g}"))
    unit = rf"\,\mathrm{{{label.latex_unit}}}" if label.latex_unit else ""
    return f"${label.latex} = {number}{unit}$"


def _legend(panel: Axes, entries: dict[str, Any], columns: int, x: float = 0.0) -> None:
    panel.legend(
        list(entries.values()),
        list(entries),
        loc="lower left",
        bbox_to_anchor=(x, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        borderpad=0.2,
        handlelength=1.6,
        handletextpad=0.5,
        columnspacing=1.0,
        labelspacing=0.2,
    )
