"""Figures of the fit: record, model, inputs and residuals in units of users; predictive checks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from support.case_tables import for_each
from support.figure_checks import drawn, legend_texts, si, xy
from support.figure_contexts import (
    course,
    fit_of,
    frequency_response,
    predictive_checks,
    residual_correlations,
)

from bayesdrill.report import scales
from bayesdrill.report.sections.fit_figure import fit_figure, record_figure
from bayesdrill.report.sections.fit_words import Fit, measured


def read(label: str, values: object) -> list[float]:
    return [si(label, u) for u in np.asarray(values)]


def dots(panel: Axes) -> tuple[list[float], list[float]]:
    """Times and values of the samples, by the labels of the axes."""
    (line,) = (line for line in panel.get_lines() if line.get_marker() == "o")
    t, y = xy(line)
    return read(panel.get_xlabel() or "$t$ [s]", t), read(panel.get_ylabel(), y)


def test_a_fit_shows_samples_model_and_residuals() -> None:
    fit = fit_of(2, 200)
    signal = fit.signals[1]
    left, right = fit_figure(fit).axes[2:]
    times, samples = dots(left)
    np.testing.assert_allclose(times, fit.t)
    np.testing.assert_allclose(samples, signal.y)
    model = read(left.get_ylabel(), left.get_lines()[1].get_ydata())
    np.testing.assert_allclose(model, signal.model)
    np.testing.assert_allclose(dots(right)[1], signal.y - signal.model)
    edges = [c.get_ydata()[0] for c in right.get_lines() if c.is_dashed()]
    band = np.array([-1, 1]) * 1.8808 * signal.sigma
    np.testing.assert_allclose(sorted(read(right.get_ylabel(), edges)), band, rtol=1e-4)


def test_a_record_is_drawn_without_a_model_and_its_inputs_in_a_panel_of_their_own() -> None:
    fit = fit_of(2, 200, courses=1)
    *channels, driven = drawn(record_figure(fit)).axes
    for panel, signal in zip(channels, fit.signals, strict=True):
        assert len(panel.get_lines()) == 1
        np.testing.assert_allclose(dots(panel)[1], signal.y)
        np.testing.assert_allclose(dots(panel)[0], fit.t)
    (line,) = driven.get_lines()
    assert {*np.round(read(driven.get_ylabel(), line.get_ydata()))} == {-8000, 8000}


def test_all_samples_of_a_channel_with_a_slow_clock_are_shown() -> None:
    """It has 1,500 of 30,000 times; they are not thinned with those of the other clocks."""
    fit = fit_of(1, 30_000)
    few = np.where(np.arange(30_000) % 20 == 7, fit.signals[0].y, np.nan)
    signal = dataclasses.replace(fit.signals[0], y=few, dots=measured(few))
    for panel in fit_figure(dataclasses.replace(fit, signals=(signal,))).axes:
        assert dots(panel)[0] == pytest.approx(fit.t[~np.isnan(few)])


def test_the_band_is_the_quantiles_of_the_predictive() -> None:
    fit = fit_of(1, 50)
    (signal,) = fit.signals
    spread = signal.model + np.linspace(-1, 1, 101)[:, None]
    wide = dataclasses.replace(fit, signals=(dataclasses.replace(signal, predictive=spread),))
    (band,) = fit_figure(wide).axes[0].collections
    vertices = band.get_paths()[0].vertices
    heights = vertices[np.isclose(vertices[:, 0], fit.t[20]), 1] - signal.model[20]
    assert (heights.min(), heights.max()) == pytest.approx((-0.94, 0.94))


def test_each_channel_says_what_is_unexplained_and_a_constant_channel_nothing() -> None:
    def texts(fit: Fit) -> list[str]:
        return [text.get_text() for panel in fit_figure(fit).axes for text in panel.texts]

    fit = fit_of(2, 200)
    constant = dataclasses.replace(fit.signals[1], share=float("nan"))
    assert texts(fit) == ["unexplained: 2.1 %"] * 2
    assert texts(dataclasses.replace(fit, signals=(fit.signals[0], constant))) == [
        "unexplained: 2.1 %"
    ]


def test_inputs_are_drawn_held_or_straight_as_the_model_takes_them() -> None:
    def check(straight: bool) -> None:
        voltage = course(100, straight=straight)
        fit = dataclasses.replace(fit_of(1, 100), courses=(voltage,))
        figure = drawn(fit_figure(fit))
        panel = figure.axes[0]
        assert "mV" in panel.get_ylabel()
        (line,) = panel.get_lines()
        t, u = line.get_path().vertices.T  # with the corners that stairs put in
        t = read(figure.axes[1].get_xlabel() or "$t$ [s]", t)
        u = read(panel.get_ylabel(), u)
        assert {*np.round(u)} == {-8000, 8000}
        between = np.interp(fit.t[:-1] + 0.5 * np.diff(fit.t), t, u)
        middle = 0.5 * (voltage.values[1:] + voltage.values[:-1])
        np.testing.assert_allclose(between, middle if straight else voltage.values[:-1], atol=1e-6)
        (text,) = (text.get_text() for text in panel.get_legend().get_texts())
        assert ("straight" in text, "held" in text) == (straight, not straight)
        assert any("8" in text.get_text() and "mV" in text.get_text() for text in figure.texts)

    for_each({str(straight): (straight,) for straight in [True, False]}, check)


def test_a_correlation_of_residuals_outside_of_its_band_is_drawn_so() -> None:
    figure = residual_correlations(2, scales.DOUBLE)
    thick = {
        k: [tuple(segment[1]) for segment in lines.get_segments()]
        for k, panel in enumerate(figure.axes)
        for lines in panel.collections
        if isinstance(lines, LineCollection) and lines.get_linewidth()[0] > 1.5
    }
    outside = {k: ends for k, ends in thick.items() if ends}
    assert outside == {1: [(23.0, -0.4)], 4: [(23.0, -0.4)]}
    assert legend_texts(figure) == ["99 % of chance, each lag", "inside", "outside"]


def test_a_frequency_response_is_shown_in_its_units_and_where_it_is_measured() -> None:
    magnitude, phase = frequency_response(1).axes
    assert "rad/s/V" in magnitude.get_ylabel()
    (x, modelled), (_, measured_phase) = (xy(line) for line in phase.get_lines())
    assert 10 ** x[0] == pytest.approx(0.5)
    assert modelled[9] == pytest.approx(-45.0, abs=0.5)  # at 5 Hz
    assert measured_phase == pytest.approx(modelled[:20] - 30.0, abs=1e-6)


def test_a_channel_that_is_not_as_predicted_is_named() -> None:
    figure = predictive_checks()
    remarks = [[text.get_text() for text in panel.texts] for panel in figure.axes[1::2]]
    assert remarks == [[], ["measured lies below"]]
    areas = [np.sum(p.patches[0].get_data().values) * 0.25 for p in figure.axes[::2]]
    assert areas == pytest.approx([1.0, 1.0])  # all samples are shown
