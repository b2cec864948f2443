"""The figure of a fit: record, model, inputs and residuals in units of users; long records."""

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from support.case_tables import for_each
from support.figure_checks import drawn, legend_texts, si, xy
from support.figure_contexts import course, fit_of

from bayesdrill.report.sections.fit import Fit, corners, extremes, fit_figure


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


def test_each_channel_says_what_is_unexplained_and_a_constant_channel_nothing() -> None:
    def texts(fit: Fit) -> list[str]:
        return [text.get_text() for panel in fit_figure(fit).axes for text in panel.texts]

    fit = fit_of(2, 200)
    constant = dataclasses.replace(fit.signals[1], unexplained=float("nan"))
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
        legend = legend_texts(figure)
        (text,) = (text for text in legend if "inputs, " in text)
        assert ("straight" in text, "held" in text) == (straight, not straight)
        assert any("8" in text and "mV" in text for text in legend)

    for_each({str(straight): (straight,) for straight in [True, False]}, check)


@given(st.integers(3, 5000), st.integers(10, 300))
def test_extremes_keep_ends_and_peaks(n: int, most: int) -> None:
    y = np.random.default_rng(n).standard_normal(n)
    kept = extremes(y, most)
    assert len(kept) <= most
    assert len(np.unique(kept)) == len(kept)
    assert {0, n - 1, int(y.argmin()), int(y.argmax())} <= set(kept.tolist())


@given(st.integers(2, 3000), st.integers(1, 40))
def test_corners_of_stairs_are_where_they_rise(n: int, length: int) -> None:
    u = (np.arange(n) // length % 3).astype(float)
    kept = corners(u, 500)
    assert len(kept) <= 500
    if len(kept) < 500 and n // length < 400:
        at = np.searchsorted(kept, np.arange(n), side="right") - 1
        np.testing.assert_array_equal(u[kept[at]], u)
