"""Compare residuals with noise: correlations, predictions, and frequency responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any

import numpy as np

from bayesdrill.analysis.prediction import (
    FALSE_ALARM,
    FrequencyResponse,
    PredictionCheck,
    frequency_responses,
    prediction_checks,
)
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.residual_checks import (
    BAND_PROBABILITY,
    ResidualCorrelation,
    correlations,
    like_noise,
)
from bayesdrill.report import scales, style, words
from bayesdrill.report.pages import build_page, departures, label_outside, legend_above, ranks_panel
from bayesdrill.report.section import build
from bayesdrill.report.style import Axes, Figure
from bayesdrill.report.view import Drawing, ReportContext, ReportPart, for_each_experiment
from bayesdrill.rig.models.linear import Model

FARTHEST = 4.5  # largest deviation that is shown, in sds; the outermost bins count larger ones, too
BINS = 36


def predictive_figure(checks: Sequence[PredictionCheck], width: float = scales.DOUBLE) -> Figure:
    """Draw, for each channel, the standardised errors of the prediction and their PIT."""
    away = [100 * departures(check.band, check.ranks) for check in checks]
    most = max(float(np.abs(each).max()) for each in away)
    wide = width >= scales.DOUBLE
    with style.styled(width):
        chance = f"{100 * (1 - FALSE_ALARM):g} % of chance, together"
        looks = {"record": style.FILLED, "as predicted": style.NOMINAL, chance: style.CHANCE}
        if any(check.is_consistent for check in checks):
            looks["record, in the band"] = style.BLACK_LINE
        if not all(check.is_consistent for check in checks):
            looks["record, leaves the band"] = style.OUTSIDE
        figure, panels = build_page(2 * len(checks), 2, 1.55, width)
        for k, check in enumerate(checks):
            left, right = panels[2 * k : 2 * k + 2]
            _densities(left, check)
            ranks_panel(right, check.band, away[k], most, check.says)
            right.set_ylabel("ECDF difference [%]")
        label_outside(panels, "", "", share_y=False)
        panels[-2].set_xlabel("measured less predicted" + ", in sds of the prediction" * wide)
        panels[-1].set_xlabel("share of the prediction below (PIT)" if wide else "PIT")
        return legend_above(figure, looks)


def _densities(panel: Axes, check: PredictionCheck) -> None:
    from scipy.special import ndtri
    from scipy.stats import norm

    edges = np.linspace(-FARTHEST, FARTHEST, BINS + 1)
    tail = norm.cdf(-FARTHEST)
    heights, _ = np.histogram(ndtri(np.clip(check.pit, tail, 1 - tail)), edges, density=True)
    panel.stairs(heights, edges, fill=True, zorder=1, **style.FILLED)
    places = np.linspace(-FARTHEST, FARTHEST, 401)
    panel.plot(places, norm.pdf(places), zorder=3, **style.NOMINAL)
    panel.set_xlim(-FARTHEST, FARTHEST)
    panel.set_ylim(0, 1.25 * max(0.4, float(heights.max())))
    style.set_ticks(panel.xaxis, (-4.0, -2.0, 0.0, 2.0, 4.0), ["\u22124", "\u22122", "0", "2", "4"])
    style.set_ticks(panel.yaxis, ())
    panel.set_ylabel("density")
    style.corner_text(panel, f"${check.channel.latex}$")


POINT = style.fix_look(
    color=style.DARK, marker="o", markersize=2.4, markeredgewidth=0, linestyle="none"
)
STEM: dict[str, Any] = {"color": style.DARK, "linewidth": 1.1}


def residuals_figure(
    correlations: Sequence[ResidualCorrelation],
    width: float = scales.DOUBLE,
    *,
    latex: Mapping[str, str],
) -> Figure:
    """Draw correlations of residuals with themselves and with inputs; `latex` names the inputs."""
    beside = [c for c in correlations if c.channel == correlations[0].channel]
    high = 1.1 * max(float(np.maximum(c.values, c.band).max()) for c in correlations)
    low = 1.1 * min(float(np.minimum(c.values, -c.band).min()) for c in correlations)
    with style.styled(width):
        chance = f"{100 * BAND_PROBABILITY:g} % of chance, each lag"
        looks = {chance: style.CHANCE, "inside": STEM}
        if any((np.abs(c.values) > c.band).any() for c in correlations):
            looks["outside"] = style.OUTSIDE
        columns = len(beside)
        figure, panels = build_page(len(correlations), columns, 1.35, width, narrow=columns)
        for panel, c in zip(panels, correlations, strict=True):
            panel.fill_between(c.lags, -c.band, c.band, zorder=0, **style.CHANCE)
            panel.axhline(0.0, color=style.MIDDLE, linewidth=0.5, zorder=1)
            for inside, look in ((True, STEM), (False, dict(style.OUTSIDE))):
                shown = (np.abs(c.values) <= c.band) == inside
                panel.vlines(c.lags[shown], 0.0, c.values[shown], zorder=2, **look)
            panel.set_ylim(low, high + 0.3 * (high - low))  # room for the name
            style.set_ticks(panel.yaxis, *scales.Scale(0.0, 0, low, high).ticks(4))
            panel.locator_params("x", nbins=4, integer=True, prune="both")
            panel.set_xlim(c.lags[0] - 1, c.lags[-1] + 1)
            style.corner_text(panel, f"${c.channel.latex}$")
            driver = latex.get(c.input, c.input)
            other = f"with ${driver}$" if driver else "with itself"
            style.corner_text(panel, other, "right", fontsize=style.letters("legend.fontsize"))
        label_outside(panels, "lag [samples]", "correlation")
        return legend_above(figure, looks)


RESIDUALS = "Whether residuals are white, and whether they follow an input at positive lags."


def _draw_residuals(run: ReportContext) -> tuple[Drawing, ...] | None:
    asked = "residuals" in (run.config.output.figures or ())
    if like_noise(run.analysis.fit) and not asked:
        return None
    results = correlations(run.problem.posterior.likelihood, run.chain.best)
    return residual_drawings(results, run.width, run.problem.model)


def residual_drawings(
    correlations: Sequence[ResidualCorrelation], width: float, rig: Model
) -> tuple[Drawing, ...]:
    """Return a drawing of the correlations of each experiment."""
    latex = {name: rig.symbols[name].latex for name in rig.inputs}
    each = groupby(correlations, lambda correlation: correlation.experiment)
    shown = ((label, tuple(group)) for label, group in each)
    return for_each_experiment(partial(residuals_figure, latex=latex), shown, width, RESIDUALS)


def frequency_figure(
    responses: Sequence[FrequencyResponse], width: float = scales.DOUBLE
) -> Figure:
    """Draw magnitude and phase of the frequency response, by channel and input."""
    with style.styled(width):
        measured = r"measured, where the input excites ($\pm$2 sd)"
        figure, panels = build_page(2 * len(responses), 2, 1.5, width)
        for k, panel in enumerate(panels):
            _bode(panel, responses[k // 2], phase=bool(k % 2))
        label_outside(panels, "frequency [Hz]", "", share_y=False)
        return legend_above(figure, {"model at the MAP": style.BLACK_LINE, measured: POINT})


def _bode(panel: Axes, response: FrequencyResponse, *, phase: bool) -> None:
    there, shown = np.isfinite(response.measured), response.channel.display_unit
    model, measured = (
        np.abs(values) * response.unit.factor / shown.factor
        for values in (response.modelled, response.measured)
    )
    error = measured * response.error
    if phase:
        model = np.degrees(np.unwrap(np.angle(response.modelled)))
        measured = model + np.degrees(np.angle(response.measured / response.modelled))
        error = np.degrees(response.error)
    magnitudes = np.concatenate([model, measured[there]])
    x = scales.scale(response.frequencies[0], response.frequencies[-1], log=True, margin=0.03)
    y = scales.scale(float(magnitudes.min()), float(magnitudes.max()), log=not phase, margin=0.2)
    ends = y(np.stack([measured - 2 * error, measured + 2 * error])[:, there])
    panel.plot(x(response.frequencies), y(model), zorder=1, **style.BLACK_LINE)
    places = x(response.frequencies[there])
    panel.vlines(places, *ends, color=POINT["color"], linewidth=0.6, zorder=2)
    panel.plot(places, y(measured[there]), zorder=3, **POINT)
    unit = f"{shown.latex}/{response.unit.latex}"
    what, unit = (r"\arg\, G", r"^\circ") if phase else ("|G|", unit)
    style.scale_axis(panel.xaxis, x, "", 5)
    style.scale_axis(panel.yaxis, y, y.label(Symbol("", "", what, unit, "")), 4)
    style.corner_text(panel, rf"${response.input.latex} \to {response.channel.latex}$", "right")


def _draw_frequency_response(run: ReportContext) -> tuple[Drawing, ...]:
    responses = frequency_responses(run.problem.posterior, run.chain.best)
    each = groupby(responses, lambda response: response.label)
    shown = ((label, tuple(group)) for label, group in each)
    says = "Frequency responses: measured where the input excites the rig, and of the model."
    return for_each_experiment(frequency_figure, shown, run.width, says)


def _draw_predictive_check(run: ReportContext) -> Drawing:
    draws = run.sampled.draws
    each = words.predictive_draws(run.problem, run.config)
    columns = np.unique(np.linspace(0, draws.shape[1] - 1, max(1, each)).astype(int))
    theta = draws[:, columns].reshape(-1, draws.shape[-1])
    results = prediction_checks(run.problem.posterior.likelihood, theta)
    says = "Whether the record is as the posterior predicts it, channel by channel."
    return Drawing(predictive_figure, (results, run.width), says=says)


PART = ReportPart(
    sections=lambda _, pictures: [build("Residuals", *pictures, brief=False)],
    figures={
        "residuals": _draw_residuals,
        "predictive_check": _draw_predictive_check,
        "frequency_response": _draw_frequency_response,
    },
)
