"""The record against the model: what was measured, the model at the MAP, and what is left."""

from __future__ import annotations

import dataclasses
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
from bayesdrill.record.experiment import Channel, Experiment
from bayesdrill.report import style

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DOTS = 3000  # measured samples drawn in a panel
LINE = 2000  # corners of a line

SHARE = f"{100 * HDI_PROBABILITY:.0f} %"
TAILS = (0.5 - HDI_PROBABILITY / 2, 0.5 + HDI_PROBABILITY / 2)
SIGMAS = float(ndtri(TAILS[1]))  # 1.88: half the width of the band of the noise

TIME = Symbol("t", "s", "t", "s", "time")

# Inches.
ROW, LEFT, RIGHT, BOTTOM, GAP_X, GAP_Y, TOP = 1.45, 0.84, 0.12, 0.42, 0.9, 0.12, 0.48
FIT_SHARE = 0.6  # of the width, for the signals; the rest is for the residuals


def fit_figure(
    experiment: Experiment, mode_signals: Array, predictive: Array | None, mode_sigma: Array
) -> Figure:
    """A row for each channel, all SI: signals beside residuals.

    mode_signals : (T, K) at the MAP; predictive : (N, T, K) with noise, None where there are no draws;
    mode_sigma : (K,).
    """
    t = experiment.t
    margin = 0.01 * float(t[-1] - t[0])
    time = style.scale(float(t[0]) - margin, float(t[-1]) + margin)
    with style.styled():
        figure, rows = _page(len(experiment.channels))
        for k, (channel, (left, right)) in enumerate(zip(experiment.channels, rows, strict=True)):
            y, model = experiment.y[:, k], mode_signals[:, k]
            drawn = extremes(model, LINE)
            if predictive is None:
                band = model[drawn] + SIGMAS * mode_sigma[k] * np.array([[-1.0], [1.0]])
            else:
                band = np.quantile(predictive[:, drawn, k], TAILS, axis=0)
            _signals(left, channel, time, (t, y, model), drawn, band)
            _residuals(right, channel, time, t, y - model, float(mode_sigma[k]))
            for panel in (left, right):
                panel.set_xlim(time.low, time.high)
                most = 5 if panel is left else 4
                style.set_ticks(panel.xaxis, *style.ticks(time.low, time.high, most))
        for panel in rows[-1]:
            panel.set_xlabel(time.label(TIME))
        _legends(rows[0], "posterior predictive" if predictive is not None else "of the noise")
    return figure


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


def _page(n: int) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """Two panels a channel, times at the foot only, room for the legends above."""
    width, height = style.DOUBLE, BOTTOM + n * ROW + (n - 1) * GAP_Y + TOP
    figure = Figure(figsize=(width, height))
    free = width - LEFT - RIGHT - GAP_X
    rows = []
    for k in range(n):
        y = height - TOP - ROW - k * (ROW + GAP_Y)
        left = figure.add_axes((LEFT / width, y / height, FIT_SHARE * free / width, ROW / height))
        x = LEFT + FIT_SHARE * free + GAP_X
        share = (1 - FIT_SHARE) * free / width
        right = figure.add_axes((x / width, y / height, share, ROW / height))
        for panel in (left, right):
            panel.tick_params(labelbottom=k == n - 1)
        rows.append((left, right))
    return figure, rows


DOT: dict[str, Any] = {**style.DOTS, "color": "0.45", "alpha": 0.8, "zorder": 1}
MODEL: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.9}
EDGE: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.6, "linestyle": (0, (4, 2))}
BAND: dict[str, Any] = {"color": style.LIGHT, "linewidth": 0}


def _size(n: int) -> dict[str, float]:
    """Dots that leave something to see of what is behind them."""
    return {"markersize": min(3.0, max(1.0, 40 / math.sqrt(n)))}


def _signals(
    panel: Axes,
    channel: Channel,
    time: style.Scale,
    columns: tuple[Array, Array, Array],
    drawn: Indices,
    band: Array,
) -> None:
    """Times, measured and modelled `(T,)`; `band` `(2, len(drawn))` around the model."""
    t, y, model = columns
    low = min(float(y.min()), float(model.min()), float(band.min()))
    high = max(float(y.max()), float(model.max()), float(band.max()))
    scale = _numbers(panel, channel, low, high)
    panel.fill_between(time(t[drawn]), *scale(band), zorder=0, **BAND)
    dots = style.thin(len(t), DOTS)
    panel.plot(time(t[dots]), scale(y[dots]), **(DOT | _size(len(dots))))
    panel.plot(time(t[drawn]), scale(model[drawn]), zorder=2, **MODEL)


def _residuals(
    panel: Axes, channel: Channel, time: style.Scale, t: Array, rest: Array, sigma: float
) -> None:
    """Measured minus MAP `(T,)`, and the band of the noise."""
    residual = dataclasses.replace(channel, latex=rf"\mathrm{{residual\ of}}\ {channel.latex}")
    far = max(float(np.abs(rest).max()), SIGMAS * sigma)
    scale = _numbers(panel, residual, -far, far)
    ends = scale(np.array([-1.0, 1.0]) * SIGMAS * sigma)
    panel.axhspan(*ends, zorder=0, **BAND)
    for end in ends:
        panel.axhline(end, zorder=2, **EDGE)
    dots = style.thin(len(t), DOTS)
    panel.plot(time(t[dots]), scale(rest[dots]), **(DOT | _size(len(dots))))
    panel.axhline(float(scale(0.0)), zorder=2, **MODEL)


def _numbers(panel: Axes, what: style.Labelled, low: float, high: float) -> style.Scale:
    margin = 0.06 * (high - low)
    scale = style.scale(low - margin, high + margin)
    panel.set_ylim(scale.low, scale.high)
    style.set_ticks(panel.yaxis, *style.ticks(scale.low, scale.high, 4))
    style.side_label(panel, scale.label(what, "\n"))
    return scale


def _legends(panels: tuple[Axes, Axes], what: str) -> None:
    """Above each column, what is shown in it; `what` the band of the signals is."""
    dot = Line2D([], [], **{**DOT, "markersize": 3, "rasterized": False})
    line, band = Line2D([], [], **MODEL), Patch(**BAND)
    edged = Patch(facecolor=BAND["color"], edgecolor=style.BLACK, linewidth=0.6, linestyle="--")
    left = {"measured": dot, "model at the MAP": line, f"{SHARE} {what}": band}
    noise = rf"{SHARE} of the noise ($\pm${SIGMAS:.2f} $\sigma$ at the MAP)"
    right = {"measured minus model at the MAP": dot, noise: edged}
    for panel, entries, columns in zip(panels, (left, right), (3, 1), strict=True):
        panel.legend(
            list(entries.values()),
            list(entries),
            loc="lower left",
            bbox_to_anchor=(0.0, 1.02),
            ncols=columns,
            borderaxespad=0.0,
            borderpad=0.2,
            handlelength=1.6,
            handletextpad=0.5,
            columnspacing=1.0,
            labelspacing=0.2,
        )
