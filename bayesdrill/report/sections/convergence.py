"""Report the searches for the MAP and the convergence of the ensembles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.analysis.diagnostics import (
    FALSE_ALARM,
    SHARES,
    RankHistogram,
    independent_draws,
    rank_histograms,
)
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import count_noun
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.display_units import DisplayedUnknowns, DisplayUnits
from bayesdrill.inference.priors import Prior, flat_in_logs
from bayesdrill.report import scales, style
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.pages import build_page, difference_panel, label_outside, legend_above
from bayesdrill.report.section import Note, Picture, Section, build
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart
from bayesdrill.sampling.convergence import BURN_IN_TAUS, SOKAL_WINDOW, autocorrelation
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.mode_search import SAME_POINT, Mode


def maxima(mode: Mode, weights: NDArray[np.float64] | None, units: DisplayUnits) -> str:
    """Describe the maxima and the shares `weights (M,)` of draws near them; empty for one maximum."""
    if not mode.others or weights is None:
        return ""
    names = [
        name
        for name, x in mode.values.items()
        if any(_apart(other.values[name], x) for other in mode.others)
    ][:MOST_NAMED]
    if not names:
        shares = ", ".join(f"{weight:.1%}" for weight in weights)
        return (
            f"{len(weights)} maxima of the posterior, within {SAME_POINT:.0%} of each other in every "
            f"unknown, between which the walkers pass: {shares} of the draws belong to them"
        )
    lines = [f"{len(weights)} maxima of the posterior, between which the walkers pass:"]
    order = np.argsort(-weights, kind="stable")
    for k in order[:MOST_LISTED]:
        values = mode.maxima[k].values
        places = ", ".join(f"{name} {units.format_value(name, values[name])}" for name in names)
        lines.append(f"  {weights[k]:.1%} of the draws belong to the one at {places}")
    if len(more := order[MOST_LISTED:]):
        lines.append(f"  {weights[more].sum():.1%} of the draws belong to the other {len(more)}")
    return "\n".join(lines)


DIAGNOSTICS = (
    "R-hat compares the independent ensembles with each other: it is 1 once they have forgotten their "
    "starts. An autocorrelation time is the number of steps for one independent draw. Effective draws "
    "count the independent ones: the error of a mean is the sd over their square root. Acceptance is "
    "the share of proposed steps that were taken."
)
MOST_NAMED, MOST_LISTED = 4, 6  # largest numbers: unknowns named at a maximum, and maxima


def _apart(value: float, other: float) -> bool:
    return abs(value - other) > SAME_POINT * abs(other)


def describe_map(mode: Mode, units: DisplayUnits) -> str:
    """Describe how the searches for the MAP went."""
    n, same = len(mode.searches), len(mode.highest)
    lines = [
        f"MAP: log posterior {mode.log_posterior:.2f}; {same} of {n} searches reached it within "
        f"{mode.tolerance:.0e}"
    ]
    if mode.wandering:
        lines.append(
            f"     they ended more than {100 * SAME_POINT:g} % apart in {', '.join(mode.wandering)}: "
            "the posterior is flat there"
        )
    elif same == 0:
        lines.append(
            "     only a search from a draw of the prior, or from near another maximum, found it; "
            "increase map.starts or map.evaluations"
        )
    elif same < 2 and n > 1:
        lines.append("     no second search confirms it; increase map.starts or map.evaluations")
    for other in mode.others[:MOST_LISTED]:
        moved = {n: abs(x - other.values[n]) / max(abs(x), 1e-300) for n, x in mode.values.items()}
        names = [name for name, x in other.values.items() if _apart(x, mode.values[name])]
        names = names or [max(moved, key=moved.__getitem__)]
        places = ", ".join(
            f"{name} {units.format_value(name, other.values[name])}" for name in names[:MOST_NAMED]
        )
        lower = mode.log_posterior - other.log_posterior
        height = f"{lower:.3g} lower" if lower > mode.tolerance else "as high"
        lines.append(
            f"     another maximum, {height}: {places}"
            + (", ..." if len(names) > MOST_NAMED else "")
        )
    if unlisted := mode.others[MOST_LISTED:]:
        lowest = mode.log_posterior - unlisted[-1].log_posterior
        lines.append(f"     and {len(unlisted)} more, at most {lowest:.3g} lower")
    lines.append(
        f"     gradient: a Newton step would raise the log posterior by {mode.gain:.1g}"
        + (f"; at the bound of its prior: {', '.join(mode.at_bound)}" if mode.at_bound else "")
    )
    return "\n".join(lines)


def describe_searches(mode: Mode) -> str:
    """Return one line on the searches for the MAP, with doubts about the maximum."""
    n, same = len(mode.searches), len(mode.highest)
    said = f"MAP: {same} of {n} searches reached the {'' if same == 1 else 'same '}maximum"
    if not same:
        said = "MAP: draws from the priors led higher than the searches from the starts"
    if same < 2 and n > 1:
        said += "; no second one confirms it (increase map.starts or map.evaluations)"
    if mode.others:
        said += f"; {len(mode.others)} other maxima were found"
    if mode.at_bound:
        said += f"; at an end of their priors: {', '.join(mode.at_bound)}"
    return said


def describe_sampling(sampled: SamplingResult) -> str:
    """Return one line if the ensembles converged, or else the text of `describe_convergence`."""
    c = sampled.convergence
    if not c.converged:
        return describe_convergence(sampled)
    n_ensembles, _, n_walkers, _ = sampled.theta.shape
    return (
        f"sampling: converged after {c.steps} steps of {n_ensembles} x {n_walkers} walkers (R-hat at "
        f"most {c.r_hat.max():.4f}, at least {c.ess_bulk.min():.0f} effective draws)"
    )


def describe_convergence(sampled: SamplingResult) -> str:
    """Describe whether the ensembles converged, and what is missing if they did not."""
    c = sampled.convergence
    n_ensembles, _, n_walkers, _ = sampled.theta.shape
    rule = f"{BURN_IN_TAUS} autocorrelation times of {c.late_tau:.1f} steps"
    if c.too_short_for_burn_in:
        rule = f"half of the run, too short for {BURN_IN_TAUS} autocorrelation times"
    lines = [
        f"{n_ensembles} ensembles of {n_walkers} walkers, {c.steps} steps, of which the first "
        f"{c.burn_in} are dropped ({rule})",
        f"R-hat at most {c.r_hat.max():.4f}, {c.n_tau:.0f} autocorrelation times of "
        f"{c.tau.max():.0f} steps, at least {c.ess_bulk.min():.0f} effective draws, "
        f"acceptance {sampled.acceptance.mean():.2f}",
    ]
    if sampled.failures:
        refused = count_noun(sampled.failures, "proposal was", "proposals were")
        lines.append(f"{refused} refused, without a finite response")
    if (check := sampled.compression) is not None:
        exact = f" {check.exact} of these draws needed all samples." if check.exact else ""
        lines.append(
            f"The record of {check.samples} samples was compressed into {check.functions} functions. "
            f"For {check.draws} draws the log likelihood differs from the exact one by at most "
            f"{check.difference:.1g}.{exact}"
        )
    if c.converged:
        lines.append("converged: all targets are met")
    else:
        lines.append("NOT CONVERGED, do not use these numbers:")
        lines += [f"  - {reason}" for reason in finding_sentences(c.reasons)]
        if c.enough is not None:
            lines.append(
                f"  only length is missing: about {c.enough} steps should do. Raise sampler.max_steps "
                "to this number in the config, and continue with --resume."
            )
        lines.append(
            f"  {c.slowest} moves slowest. Fewer steps suffice if you hold it, narrow its prior, or add "
            "what `bayesdrill identify` proposes. figures/trace shows the walkers."
        )
    return "\n".join(lines)


STEPS = 300  # largest number of steps that are drawn
QUANTILES = (0.05, 0.5, 0.95)  # quantiles over the walkers that are drawn
EXCURSION = 1.0  # largest extension of an axis for burn-in, in widths of the bands after burn-in
REACH = 0.5  # largest extension of an axis for the nominal value, in widths of the axis
# Grey, line width and dashes of each ensemble; two neighbours are distinguishable in print.
LOOKS: tuple[tuple[str, float, Any], ...] = (
    ("0.0", 0.9, "-"),
    ("0.5", 1.5, "-"),
    ("0.0", 0.9, (0, (5, 2))),
    ("0.35", 1.3, (0, (1, 1.3))),
    ("0.0", 0.9, (0, (6, 1.5, 1, 1.5))),
    ("0.5", 1.5, (0, (5, 2))),
)
THIN = 0.8  # line width in a panel with all ensembles
STRETCHES = 45  # number of segments, in each of which a median is averaged to make dashes visible
MARKS = 4  # numbered marks in a panel, at least one an ensemble; none for over 2 * MARKS ensembles
MARK = style.fix_look(linestyle="none", marker="o", markersize=6.5, markeredgewidth=0.5)
BURN_IN: dict[str, Any] = {**style.HATCHED, "hatch": "////"}
BANDS = 0.24  # opacity of all bands together


def trace_figure(
    theta: Array, displayed: DisplayedUnknowns, burn_in: int, width: float = scales.DOUBLE
) -> Figure:
    """Draw medians and 5 to 95 % bands over the walkers of chains `(E, S, W, D)`, by step."""
    symbols, (n_ensembles, n_steps) = displayed.symbols, theta.shape[:2]
    n, small = len(symbols), width < scales.DOUBLE
    steps = style.thin(n_steps, STEPS)
    bands = np.quantile(theta[:, steps], QUANTILES, axis=2)  # (3, E, steps, D)
    after_burn_in = steps >= min(burn_in, steps[-1])
    known = [displayed.nominal.get(symbol.name) for symbol in symbols]
    vertical = [
        _scale(bands[..., d], after_burn_in, known[d], displayed.priors.get(symbol.name))
        for d, symbol in enumerate(symbols)
    ]
    sides = {s.side(value) for s, value in zip(vertical, known, strict=True) if value is not None}
    with style.styled(width):
        looks = {
            **{f"ensemble {k + 1}, median": ensemble_line(k) for k in range(n_ensembles)},
            "5 % to 95 % of the walkers": style.BAND,
            f"burn-in: {burn_in} steps dropped": BURN_IN,
            **style.nominal_looks(sides, "^"),
            "MAP": style.MAP_LINE,
        }
        columns = 2 if n in (2, 4) else 3
        page_width = width if n > 1 or small else 1.3 * scales.SINGLE
        figure, panels = build_page(n, columns, 1.4, page_width)
        for d, (panel, symbol) in enumerate(zip(panels, symbols, strict=True)):
            if burn_in > 0:
                panel.axvspan(0, burn_in, zorder=0, **BURN_IN)
            _ensembles(panel, steps, vertical[d](bands[..., d]))
            value = displayed.mode.get(symbol.name)
            style.mark_values(panel, vertical[d], known[d], value, vertical=True, zorder=3)
            _step_axis(panel, n_steps)
            style.scale_axis(panel.yaxis, vertical[d], vertical[d].label(symbol, "\n"))
        label_outside(panels, "step", "", share_y=False)
        return legend_above(figure, looks, handlelength=2.8)


def _scale(
    bands: Array, after_burn_in: NDArray[np.bool_], nominal: float | None, prior: Prior | None
) -> scales.Scale:
    """Return an axis for bands `(3, E, steps)` after burn-in, and for burn-in up to `EXCURSION`."""
    log = flat_in_logs(prior)
    to, back = (np.log, np.exp) if log else (np.asarray, np.asarray)
    scaled, after = to(bands), to(bands[..., after_burn_in])
    low, high = float(after.min()), float(after.max())
    width = high - low
    low = max(float(scaled.min()), low - EXCURSION * width)
    high = min(float(scaled.max()), high + EXCURSION * width)
    ends = scales.reaching(float(back(low)), float(back(high)), nominal, REACH, log=log)
    return scales.scale(*ends, log=log, margin=0.06)


def ensemble_line(ensemble: int, width: float | None = None) -> dict[str, Any]:
    """Return the line style of an ensemble, with this `width` or that of the ensemble."""
    colour, line_width, dashes = LOOKS[ensemble % len(LOOKS)]
    return {"color": colour, "linestyle": dashes, "linewidth": width or line_width}


def _thin_looks(n_ensembles: int) -> dict[str, style.Look]:
    return {f"ensemble {k + 1}": ensemble_line(k, THIN) for k in range(n_ensembles)}


def _ensembles(panel: Axes, steps: NDArray[np.intp], bands: Array) -> None:
    """Draw bands `(3, E, steps)`, which are given as positions on the axis."""
    n = bands.shape[1]
    starts = np.unique(np.linspace(0, len(steps), STRETCHES, endpoint=False).astype(np.intp))
    lengths = np.diff(np.append(starts, len(steps)))
    middle = np.add.reduceat(steps, starts) / lengths
    for ensemble, (low, median, high) in enumerate(bands.swapaxes(0, 1)):
        look = ensemble_line(ensemble)
        alpha = BANDS / n
        panel.fill_between(steps, low, high, color=style.BLACK, alpha=alpha, linewidth=0, zorder=1)
        course = np.add.reduceat(median, starts) / lengths
        panel.plot(middle, course, zorder=2, **look)
        if n <= 2 * MARKS:
            _number(panel, ensemble, n, middle, course)


def _number(panel: Axes, ensemble: int, n: int, x: Array, y: Array) -> None:
    each = max(1, MARKS // n)
    places = (np.arange(each) + (ensemble + 0.5) / n) / each * len(x)
    at = np.unique(places.astype(np.intp))
    edge = LOOKS[ensemble % len(LOOKS)][0]
    panel.plot(x[at], y[at], zorder=4, color="white", markeredgecolor=edge, **MARK)
    figure = {**MARK, "marker": f"${ensemble + 1}$", "markersize": 3.6, "markeredgewidth": 0.0}
    panel.plot(x[at], y[at], zorder=5, color=style.BLACK, **figure)


def _step_axis(panel: Axes, n: int, max_count: int = 3) -> None:
    panel.set_xlim(0, max(n - 1, 1))
    panel.locator_params("x", nbins=max_count, integer=True, prune="upper")
    panel.xaxis.set_major_formatter(lambda step, _: f"{step:.0f}")


BEYOND = 2.0  # largest lag that is shown, in lengths of the window over which tau is summed
TAU: dict[str, Any] = {"color": style.BLACK, "linestyle": (0, (4, 2)), "linewidth": 0.8}


def autocorrelation_figure(
    theta: Array, symbols: Sequence[Symbol], width: float = scales.DOUBLE
) -> Figure:
    """Draw autocorrelations of chains `(E, S, W, D)` by ensemble, with tau and window of all."""
    result = autocorrelation(theta)
    lags = min(theta.shape[1], math.ceil(BEYOND * (int(result.window.max()) + 1)) + 1)
    each = [autocorrelation(chain[None]).rho[:lags] for chain in theta]
    low = min(0.0, float(min(rho.min() for rho in each)))
    wide = width >= scales.DOUBLE
    with style.styled(width):
        summed = rf"lags summed up for $\tau$ ({SOKAL_WINDOW:g} $\tau$)"
        looks = {**_thin_looks(len(each)), r"time $\tau$": TAU, summed: style.FAINT_BAND}
        figure, panels = build_page(len(symbols), 3, 1.25, width)
        for d, (panel, symbol) in enumerate(zip(panels, symbols, strict=True)):
            panel.axvspan(0, float(result.window[d]), zorder=0, **style.FAINT_BAND)
            panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
            panel.axvline(float(result.tau[d]), zorder=2, **TAU)
            for k, rho in enumerate(each):
                panel.plot(np.arange(len(rho)), rho[:, d], zorder=3, **ensemble_line(k, THIN))
            _step_axis(panel, lags, 4)
            panel.set_ylim(1.15 * low - 0.06, 1.3)
            style.set_ticks(panel.yaxis, (0.0, 0.5, 1.0), ["0", "0.5", "1"])
            text = rf"${symbol.latex}$: $\tau = {result.tau[d]:.3g}$" + " steps" * wide
            style.corner_text(panel, text, "right")
        label_outside(panels, "lag [steps]", "autocorrelation")
        return legend_above(figure, looks)


def rank_figure(
    ranks: Sequence[RankHistogram], symbols: Sequence[Symbol], width: float = scales.DOUBLE
) -> Figure:
    """Draw the ECDF of the ranks of each ensemble minus the uniform CDF, in per cent."""
    most = 100 * max(max(np.abs(h.deviation).max(), h.half_width.max()) / h.draws for h in ranks)
    places = np.pad(SHARES, 1, constant_values=(0, 1))
    with style.styled(width):
        chance = f"{100 * (1 - FALSE_ALARM):g} % of chance, together"
        looks = {**_thin_looks(len(ranks[0].is_consistent)), chance: style.CHANCE}
        if not all(np.all(histogram.is_consistent) for histogram in ranks):
            looks["leaves the band"] = style.OUTSIDE
        figure, panels = build_page(len(ranks), 3, 1.35, width)
        for panel, histogram, symbol in zip(panels, ranks, symbols, strict=True):
            room = np.pad(100 * histogram.half_width / histogram.draws, 1)
            difference_panel(panel, places, (-room, room), float(most))
            each = zip(histogram.deviation, histogram.is_consistent, strict=True)
            for ensemble, (away, holds) in enumerate(each):
                look = {**ensemble_line(ensemble, THIN), **({} if holds else style.OUTSIDE)}
                line = np.pad(100 * away / histogram.draws, 1)
                panel.plot(places, line, zorder=2 if holds else 3, **look)
            style.corner_text(panel, f"${symbol.latex}$")
        label_outside(panels, "rank, as a share", "ECDF difference [%]")
        return legend_above(figure, looks)


def _draw_trace(run: ReportContext) -> Drawing:
    shown, theta = run.shown(run.config.output.parameters), run.sampled.theta
    given = (shown.select(theta), shown, run.sampled.convergence.burn_in, run.width)
    return Drawing(trace_figure, given, "The walkers of each ensemble, step by step.")


def _draw_rank(run: ReportContext) -> Drawing:
    c = run.sampled.convergence
    draws = independent_draws(run.sampled.theta, c.burn_in, float(c.tau.max()))
    histograms = rank_histograms(draws, seeds.stream(run.config.seed, "rank"))
    says = "Whether the ensembles agree: ranks of the draws of each among those of all."
    return Drawing(rank_figure, (histograms, run.problem.symbols, run.width), says)


def _draw_autocorrelation(run: ReportContext) -> Drawing:
    after_burn_in = run.sampled.theta[:, run.sampled.convergence.burn_in :]
    says = "The memory of the walkers: autocorrelation, its time and its window."
    return Drawing(autocorrelation_figure, (after_burn_in, run.problem.symbols, run.width), says)


def _sections(run: ReportContext, pictures: Sequence[Picture]) -> Iterator[Section]:
    yield build("Maximum of the posterior (MAP)", describe_map(run.mode, run.units), brief=False)
    said = describe_convergence(run.sampled)
    yield build("Convergence", said, Note(DIAGNOSTICS), *pictures, brief=False)


PART = ReportPart(
    sections=_sections,
    figures={"trace": _draw_trace, "rank": _draw_rank, "autocorrelation": _draw_autocorrelation},
)
