"""Draw the paper's studies: printed matrix, two-parameter test, searches, and Table 3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from bayesdrill.basics import PARAMETERS, STATES, Array, own_symbol
from bayesdrill.inference import HDI_PROBABILITY, hdi
from bayesdrill.report import TIME, build_page, legend_above, scales, style
from studies.paper import printed as paper
from studies.paper.forward import MatrixReading
from studies.paper.searches import Heuristic, SearchEnd, Verification

LineStyle = Mapping[str, Any]

NOMINAL_COLOUR = style.NOMINAL["color"]
DASHED, DOTTED, DASH_DOTTED = (0, (4, 2)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5))


def _line(color: str, width: float, dashes: Any = "-", **more: Any) -> LineStyle:
    return {"color": color, "linestyle": dashes, "linewidth": width, **more}


def _mark(color: str, marker: str, size: float, edge: float | None, **more: Any) -> LineStyle:
    looks = {"color": color, "marker": marker, "markersize": size, "markeredgewidth": edge}
    return {**looks, "linestyle": "none", **more}


def _legend(figure: Figure, looks: Mapping[str, LineStyle]) -> None:
    """Put a legend above all panels, by label."""
    legend_above(figure, looks)


MOST_TICKS = 8  # of a logarithmic axis


def set_decades(axis: Axis, low: float, high: float, base: int = 10) -> None:
    """Set a logarithmic axis from `low` to `high`, with powers of the `base` for ticks."""
    name: Any = axis.axis_name  # type: ignore[attr-defined]
    axis.axes.set(**{f"{name}scale": "log", f"{name}lim": (low, high)})
    first, last = (np.log(end) / np.log(base) for end in (low, high))
    exponents = np.arange(np.ceil(first), np.floor(last) + 1)
    exponents = exponents[exponents % -(-len(exponents) // MOST_TICKS) == 0]
    places = float(base) ** exponents
    plain = places.min(initial=1.0) > 0.9e-3 and places.max(initial=1.0) < 1.1e4
    texts = [
        f"{x:g}" if plain else rf"$10^{{{round(k)}}}$"
        for k, x in zip(exponents, places, strict=True)
    ]
    style.set_ticks(axis, places, texts)
    axis.set_minor_locator(NullLocator())


def set_factors(axis: Axis, factors: Array) -> None:
    """Set an axis of factors: at least 0.5 to 2, with powers of 2, or of 10 if it is long."""
    sure = usable(factors)
    low, high = min(0.48, 0.85 * sure.min(initial=1.0)), max(2.1, 1.18 * sure.max(initial=1.0))
    set_decades(axis, low, high, 2 if high / low < 2**MOST_TICKS else 10)


def usable(x: Array) -> Array:
    """Return those values that a logarithmic axis can show."""
    return x[np.isfinite(x) & (x > 0)]


# The printed matrix

ROW = 2.5  # of panels, inches
SHORT = {
    "right": r"corrected: $A_{51}$ over $j_m$, $i_n = 1/i_m$",
    "a_51": r"$A_{51}$ over $j_1$ (printed), $i_n = 1/i_m$",
    "i_n": r"$A_{51}$ over $j_m$, $i_n = i_m$",
    "printed": r"$A_{51}$ over $j_1$ (printed), $i_n = i_m$",
}
CURVES: tuple[LineStyle, ...] = (
    _line(style.BLACK, 1.4),
    _line(NOMINAL_COLOUR, 1.1, DASHED),
    _line(style.MAP_COLOUR, 1.4, DOTTED),
    _line(style.MIDDLE, 1.0, DASH_DOTTED),
)
BAND: LineStyle = {"color": "0.95", "linewidth": 0, "zorder": -2}  # that range, in both panels
BELOW, ABOVE = 0.25, 1.3  # what the near panel shows, over the largest of the right speed


def readings_figure(readings: Sequence[MatrixReading]) -> Figure:
    """Draw speeds of theta_2 over time: all of them, and those near the first, which is right."""
    far = np.concatenate([reading.curve for reading in readings])
    right = float(np.abs(readings[0].curve).max())
    near = (-BELOW * right, ABOVE * right)
    margin = 0.06 * float(far.max() - far.min())
    ranges = ((float(far.min()) - margin, float(far.max()) + margin), near)
    time = scales.scale(0.0, max(reading.row["time"] for reading in readings))
    with style.styled():
        figure, panels = build_page(2, 2, ROW)
        for panel, (low, high) in zip(panels, ranges, strict=True):
            speed = scales.scale(low, high)
            for k, (reading, look) in enumerate(zip(readings, CURVES, strict=False)):
                panel.plot(time(reading.t), speed(reading.curve), zorder=3 - 0.1 * k, **look)
            panel.set_xlim(time.low, time.high)
            panel.set_ylim(speed.low, speed.high)
            style.set_ticks(panel.xaxis, *time.ticks(6, clear=0.0))
            style.set_ticks(panel.yaxis, *speed.ticks(5))
            panel.set_xlabel(time.label(TIME))
            panel.set_ylabel(speed.label(STATES["w_2"]))
        everything = scales.scale(*ranges[0])
        panels[0].axhspan(*(float(everything(x)) for x in near), **BAND)
        panels[1].set_facecolor(BAND["color"])
        looks = {_ending(reading): look for reading, look in zip(readings, CURVES, strict=False)}
        _legend(figure, looks)
    return figure


def _ending(reading: MatrixReading) -> str:
    end = f"{round(reading.row['w_end'], 1) + 0.0:g}".replace("-", "\N{MINUS SIGN}")
    return rf"{SHORT[reading.row['name']]}; settles at {end} rad/s"


# Table 2

BOUND = _line(style.BLACK, 1.0)
FMINSEARCH = _mark(NOMINAL_COLOUR, "o", 6.5, 1.1, markerfacecolor="none")
SCALED = _mark(style.BLACK, "+", 6, 1.0)
PRINTED = _line(style.MAP_COLOUR, 0.9, (0, (1, 1.5)), marker="D", markersize=4)
SINGLES: LineStyle = {**style.DOTS, "color": style.MIDDLE, "markersize": 1.6, "alpha": 0.4}
BIG: LineStyle = {**SINGLES, "markersize": 2.5, "alpha": 0.8, "rasterized": False}
ASIDE = 0.14  # decades, between a sigma and the single estimates of each way
LEAST_SHARE = 0.02  # of the single estimates may be below the panel


def verification_figure(
    v: Verification, printed: Mapping[float, Mapping[str, paper.Estimate]]
) -> Figure:
    """Draw relative errors of each unknown in per cent; `printed` by sigma and name."""
    with style.styled():
        figure, panels = build_page(len(v.names), 2, ROW)
        for k, (panel, name) in enumerate(zip(panels, v.names, strict=True)):
            _errors(panel, v, k, {s: row[name] for s, row in printed.items() if name in row})
            panel.set_xlabel(r"$\sigma_n$ [rad, rad/s]")
            panel.set_ylabel(rf"relative error of ${PARAMETERS[name].latex}$ [%]")
        looks = {
            "Cramér-Rao bound of the sd": BOUND,
            f"sd of {v.records} estimates, fminsearch": FMINSEARCH,
            f"sd of {v.records} estimates, scaled search": SCALED,
            "reported in the paper": PRINTED,
            "single estimates (fminsearch left)": BIG,
        }
        _legend(figure, looks)
    return figure


def _errors(panel: Axes, v: Verification, k: int, printed: Mapping[float, paper.Estimate]) -> None:
    sigmas, each = np.array([*v.values]), v.values.values()

    def percent(what: str) -> Array:
        return np.array([100.0 * abs(values[what][k]) / abs(values["truth"][k]) for values in each])

    shown = np.array([[s, cell.deviation] for s, cell in sorted(printed.items())]).reshape(-1, 2)
    bound, fminsearch, scaled = map(percent, ("bound", "sd_fminsearch", "sd_scaled"))
    errors = [usable(np.concatenate([bound, fminsearch, scaled, shown[:, 1]]))]
    for side, way in ((-1, "fminsearch"), (1, "scaled")):
        for sigma, values in v.values.items():
            truth = values["truth"][k]
            off = 100.0 * np.abs(v.estimates[way][sigma][:, k] - truth) / abs(truth)
            off = off[off > 0]
            panel.plot(np.full(len(off), sigma * 10 ** (side * ASIDE)), off, **SINGLES)
            errors.append(off)
    panel.plot(sigmas, bound, zorder=2, **BOUND)
    panel.plot(sigmas, fminsearch, zorder=3, **FMINSEARCH)
    panel.plot(sigmas, scaled, zorder=4, **SCALED)
    panel.plot(*shown.T, zorder=5, **PRINTED)
    lowest, *singles = errors
    low = min([lowest.min(), *(np.quantile(off, LEAST_SHARE) for off in singles if len(off))])
    high = max(off.max() for off in errors if len(off))
    set_decades(panel.yaxis, low / 1.6, high * 1.6)
    set_decades(panel.xaxis, sigmas.min() / 2.2, sigmas.max() * 2.2)


# Where searches end

FLOOR = _line(style.MIDDLE, 0.9, DASHED, zorder=1)
WAYS: Mapping[str, tuple[str, str, str]] = {  # label, colour, marker
    "fminsearch": ("fminsearch", NOMINAL_COLOUR, "o"),
    "scaled": ("scaled search", style.MAP_COLOUR, "^"),
}
TRUTH = _mark(style.BLACK, "+", 10, 1.2, zorder=5)


def simultaneous_figure(ends: Sequence[SearchEnd], symmetries: Sequence[str]) -> Figure:
    """Draw ends along two symmetries, and misfits against the distance from the truth."""
    shown = symmetries[:2]
    with style.styled():
        figure, panels = build_page(
            2 if shown else 1, 2, ROW, scales.DOUBLE if shown else scales.SINGLE
        )
        if shown:
            _scales(panels[0], ends, shown)
        _misfits(panels[-1], ends)
        looks = {WAYS[way][0]: _end(way, reached=True) for way in _ways(ends)}
        if not all(end.reached for end in ends):
            grey = {"marker": "s", "markeredgecolor": style.DARK}
            looks["open: noise floor not reached"] = {**_end("fminsearch", reached=False), **grey}
        if shown:
            looks["truth"] = {**TRUTH, "markersize": 7}
        _legend(figure, {**looks, "noise floor": FLOOR})
    return figure


def _scales(panel: Axes, ends: Sequence[SearchEnd], symmetries: Sequence[str]) -> None:
    """Factors on logarithmic axes, the truth at 1; of one symmetry a row for each way."""
    factors = np.exp([end.scales[: len(symmetries)] for end in ends]).reshape(len(ends), -1)
    strip = len(symmetries) == 1
    for k, way in enumerate(_ways(ends)):
        selected = [end.way == way for end in ends]
        x = factors[selected, 0]
        y = np.full(len(x), float(k)) if strip else factors[selected, 1]
        _marks(panel, x, y, [end for end in ends if end.way == way])
    panel.plot([1.0], [0.5 * (len(_ways(ends)) - 1) if strip else 1.0], **TRUTH)
    for axis, factor, latex in zip((panel.xaxis, panel.yaxis), factors.T, symmetries, strict=False):
        set_factors(axis, factor)
        axis.set_label_text(f"common factor of ${latex}$")
    panel.axvline(1.0, color=style.LIGHT, linewidth=0.7, zorder=0)
    if strip:
        panel.set_ylim(-0.8, len(_ways(ends)) - 0.2)
        panel.set_yticks([])
    else:
        panel.axhline(1.0, color=style.LIGHT, linewidth=0.7, zorder=0)


def _misfits(panel: Axes, ends: Sequence[SearchEnd]) -> None:
    for way in _ways(ends):
        selected = [end for end in ends if end.way == way]
        x, y = np.array([(end.distance, end.misfit) for end in selected]).T
        _marks(panel, x, y, selected)
    panel.axhline(1.0, **FLOOR)
    finite = [end.distance for end in ends if np.isfinite(end.distance)]
    _from_zero(panel, max([0.1, *finite]), 0.03)
    _misfit_axis(panel, np.array([end.misfit for end in ends]))
    panel.set_xlabel("distance from the truth (rms of logarithms)")


def _marks(panel: Axes, x: Array, y: Array, ends: Sequence[SearchEnd]) -> None:
    """Filled where the noise floor was reached, open where it was not."""
    for reached in (True, False):
        selected = np.array([end.reached is reached for end in ends], dtype=bool)
        if selected.any():
            panel.plot(x[selected], y[selected], **_end(ends[0].way, reached=reached))


def _end(way: str, *, reached: bool) -> LineStyle:
    _, color, marker = WAYS[way]
    face = (color, 0.45) if reached else "none"
    return _mark(color, marker, 4.5, 0.9, zorder=3, markeredgecolor=color, markerfacecolor=face)


def _ways(ends: Sequence[SearchEnd]) -> list[str]:
    return [way for way in WAYS if any(end.way == way for end in ends)]


# The path of the heuristic

ALONE = 0.72 * scales.DOUBLE  # the width of a figure of one panel, inches


def convergence_figure(heuristics: Sequence[tuple[str, Heuristic]]) -> Figure:
    """Draw the misfit per number after each iteration, by name of the record."""
    with style.styled():
        figure, (panel,) = build_page(1, 1, 3.0, ALONE)
        looks = {}
        for k, (name, heuristic) in enumerate(heuristics):
            look, misfits = CURVES[k % len(CURVES)], heuristic.misfits
            panel.step(np.arange(len(misfits)), misfits, where="post", zorder=3, **look)
            panel.plot(len(misfits) - 1, misfits[-1], marker="o", markersize=4, color=look["color"])
            looks[f"record {name}".replace("$", r"\$")] = look
        panel.axhline(1.0, **FLOOR)
        series = [heuristic.misfits for _, heuristic in heuristics]
        _misfit_axis(panel, np.concatenate(series))
        _from_zero(panel, max(len(misfits) for misfits in series) - 1 or 1, 0.02)
        panel.set_xlabel("iteration of the heuristic")
        _legend(figure, {**looks, "noise floor": FLOOR})
    return figure


def _misfit_axis(panel: Axes, misfits: Array) -> None:
    """Shows the noise floor, and nearly a decade above it."""
    sure = usable(misfits)
    low, high = 0.6 * min(1.0, sure.min(initial=1.0)), 1.8 * max(6.0, sure.max(initial=1.0))
    set_decades(panel.yaxis, low, high)
    panel.set_ylabel("misfit per measured number")


def _from_zero(panel: Axes, last: float, before: float) -> None:
    """The horizontal axis: from 0 to `last`, with some room, `before` 0 in shares of `last`."""
    scale = scales.Scale(0.0, 0, -before * last, 1.06 * last)
    panel.set_xlim(scale.low, scale.high)
    style.set_ticks(panel.xaxis, *scale.ticks(8, clear=0.0))


# Table 3

LINE = 0.4  # inches
UP, DOWN = -0.13, 0.22  # rows: the posterior, and below it the heuristic
MIDDLE = (0.25, 0.75)  # quantiles: the thick bar
THIN: LineStyle = {"color": style.DARK, "linewidth": 1.1, "solid_capstyle": "butt"}
THICK: LineStyle = {"color": style.DARK, "linewidth": 4.0, "solid_capstyle": "butt"}
ESTIMATE = _mark(style.MAP_COLOUR, "D", 4.5, None, zorder=4)
OTHERS = _mark(style.MAP_COLOUR, "o", 2.4, 0, alpha=0.4, zorder=3)
GUESS = _line(style.MIDDLE, 0.8, DASHED, zorder=0)
TICK = _mark(NOMINAL_COLOUR, "|", 17, 1.6, zorder=5)
PAPER = _mark(style.BLACK, "x", 5.5, 1.2, zorder=6)


def table_3_figure(
    names: Sequence[str],
    heuristic: Heuristic,
    truth: Array | None,
    draws: Array,
    paper: Array,
) -> Figure:
    """Draw each of `names` over its guess: posterior above, the heuristic's estimates below."""
    n, guess = len(names), heuristic.guess
    printed = np.isfinite(paper)
    differs = truth is None or not np.allclose(paper[printed], truth[printed])
    other = bool(printed.any()) and differs
    ratios, rows, estimate = draws / guess, np.arange(n), heuristic.estimate / guess
    starts = (heuristic.others / guess).reshape(-1, n)
    looks = {
        "posterior, middle half": THICK,
        f"posterior, {100 * HDI_PROBABILITY:.0f} % HDI": THIN,
        "heuristic": ESTIMATE,
        **({"heuristic, other starts": OTHERS} if len(starts) else {}),
        "initial guess": GUESS,
        **({"the paper's estimate": PAPER} if other else {}),
        **({} if truth is None else {"truth": {**TICK, "markersize": 9}}),
    }
    with style.styled():
        figure, (panel,) = build_page(1, 1, 0.6 + n * LINE, ALONE)
        shown = [starts.ravel(), estimate]
        for row in range(n):
            whole = np.exp(hdi(np.log(ratios[:, row])))
            for interval, look in ((whole, THIN), (np.quantile(ratios[:, row], MIDDLE), THICK)):
                panel.plot(interval, [row + UP] * 2, **look)
            shown.append(whole)
            if row:
                panel.axhline(row - 0.5, color=style.FAINT, linewidth=0.6, zorder=-1)
        for start in starts:
            panel.plot(start, rows + DOWN, **OTHERS)
        panel.plot(estimate, rows + DOWN, **ESTIMATE)
        if truth is not None:
            panel.plot(truth / guess, rows + 0.04, **TICK)
            shown.append(truth / guess)
        if other:
            panel.plot(paper / guess, rows + 0.04, **PAPER)
            shown.append((paper / guess)[printed])
        panel.axvline(1.0, **GUESS)
        set_factors(panel.xaxis, np.concatenate(shown))
        panel.set_yticks(rows, [f"${_latex(name)}$" for name in names])
        panel.tick_params(axis="y", length=0)
        panel.set_ylim(n - 0.5, -0.5)
        panel.set_xlabel("value over initial guess")
        _legend(figure, looks)
    return figure


def _latex(name: str) -> str:
    """Of a parameter, or of a noise level."""
    return PARAMETERS[name].latex if name in PARAMETERS else own_symbol(name, "", None, "").latex
