"""The figure of the fit: record, model and inputs in the units of the user, and what is left."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from numpy.typing import NDArray
from support.case_tables import for_each
from support.figure_checks import clashes, drawn, si

import bayesdrill as bd
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference import residual_checks
from bayesdrill.report import scales
from bayesdrill.report.sections.fit_figure import fit_figure, record_figure
from bayesdrill.report.sections.fit_words import (
    Course,
    Fit,
    Signal,
    corners,
    every_fit,
    extremes,
    measured,
)
from bayesdrill.report.sections.physics_words import TIME

Array = NDArray[np.float64]
ROOT = Path(__file__).parent.parent.parent

CHANNELS = (
    ("w_1", r"\dot\theta_1", "rad/s", 30.0),
    ("i", r"\dot q", "A", 1.9),
    ("s", r"\theta_1 - \theta_2", "rad", 2e-3),
    ("theta_1", r"\theta_1", "rad", 4e3),
    ("far", r"\dot\theta_2", "rad/s", 1e-5),
    ("w_2", r"\dot\theta_2", "rpm", 1e5),
)
V = Symbol("v", "V", "v", "mV", "supply")


def course(n: int, *, straight: bool) -> Course:
    """A voltage that goes both ways."""
    return Course(label=V, values=8e3 * (-1.0) ** (np.arange(n) // 7), straight=straight)


def fit_of(n_channels: int, n_samples: int) -> Fit:
    rng = np.random.default_rng(7)
    t = 0.1 + np.arange(n_samples) * 5.0 / n_samples
    wave = 1 - np.exp(-t / 0.8) * np.cos(10 * t)
    signals = []
    for name, latex, unit, size in CHANNELS[:n_channels]:
        model, sigma = size * wave + (250.0 if size == 1e-5 else 0.0), 0.03 * size
        signals.append(
            Signal(
                label=Symbol(name, unit, latex, unit, ""),
                y=model + sigma * rng.standard_normal(n_samples),
                model=model,
                predictive=model + sigma * rng.standard_normal((8, n_samples)),
                sigma=sigma,
                dots=measured(model),
                share=0.0213,
            )
        )
    return Fit(t=t, time=TIME, signals=tuple(signals), constant=((V, 8.0),))


@pytest.mark.parametrize(
    ("n_channels", "n_samples"),
    [(1, 20), (3, 700), pytest.param(6, 100_000, marks=pytest.mark.slow)],
)
def test_no_texts_overlap(n_channels: int, n_samples: int) -> None:
    def check(courses: int, width: float) -> None:
        shown = tuple(course(n_samples, straight=False) for _ in range(courses))
        fit = dataclasses.replace(fit_of(n_channels, n_samples), courses=shown)
        figure = drawn(fit_figure(fit, width))
        assert list(clashes(figure)) == []
        assert figure.get_figwidth() == width

    for_each(
        {
            f"{courses} courses in {width} inches": (courses, width)
            for courses in (0, 1, 2)
            for width in (scales.SINGLE, scales.DOUBLE)
        },
        check,
    )


def test_it_shows_samples_model_and_residuals() -> None:
    fit = fit_of(2, 200)
    left, right = fit_figure(fit).axes[2:]
    signal = fit.signals[1]
    dots, solid = left.get_lines()
    shown_y = [si(left.get_ylabel(), u) for u in dots.get_ydata()]
    np.testing.assert_allclose(shown_y, signal.y)
    shown_model = [si(left.get_ylabel(), u) for u in solid.get_ydata()]
    np.testing.assert_allclose(shown_model, signal.model)
    times = [si(left.get_xlabel(), u) for u in dots.get_xdata()]
    np.testing.assert_allclose(times, fit.t)
    (rest,) = (c for c in right.get_lines() if c.get_marker() == "o")
    residuals = [si(right.get_ylabel(), u) for u in rest.get_ydata()]
    np.testing.assert_allclose(residuals, signal.y - signal.model)
    edges = sorted(
        si(right.get_ylabel(), c.get_ydata()[0]) for c in right.get_lines() if c.is_dashed()
    )
    np.testing.assert_allclose(edges, np.array([-1, 1]) * 1.8808 * signal.sigma, rtol=1e-4)


def test_a_record_is_drawn_without_a_model() -> None:
    """Mutants killed: the model instead of the samples; an input in the panel of a channel."""
    one = course(200, straight=False)
    fit = dataclasses.replace(fit_of(2, 200), courses=(one,))
    figure = drawn(record_figure(fit))
    *channels, driven = figure.axes
    for panel, signal in zip(channels, fit.signals, strict=True):
        (dots,) = panel.get_lines()
        shown = [si(panel.get_ylabel(), y) for y in dots.get_ydata()]
        np.testing.assert_allclose(shown, signal.y)
        times = [si(driven.get_xlabel(), t) for t in dots.get_xdata()]
        np.testing.assert_allclose(times, fit.t)
    (line,) = driven.get_lines()
    stairs = {round(si(driven.get_ylabel(), y)) for y in line.get_ydata()}
    assert stairs == {-8000, 8000}
    assert [*clashes(figure)] == []


def test_all_samples_of_a_decimated_channel_are_shown() -> None:
    """Of 30,000 times it has 1,500; mutant killed: dots are chosen among the times of all clocks."""
    fit = fit_of(1, 30_000)
    few = np.where(np.arange(30_000) % 20 == 7, fit.signals[0].y, np.nan)
    signal = dataclasses.replace(fit.signals[0], y=few, dots=measured(few))
    for panel in fit_figure(dataclasses.replace(fit, signals=(signal,))).axes:
        (dots,) = (line for line in panel.get_lines() if line.get_marker() == "o")
        times = [si(panel.get_xlabel(), t) for t in dots.get_xdata()]
        assert times == pytest.approx(fit.t[~np.isnan(few)])


def test_the_band_is_the_quantiles_of_the_predictive() -> None:
    fit = fit_of(1, 50)
    (signal,) = fit.signals
    spread = signal.model + np.linspace(-1, 1, 101)[:, None]
    wide = dataclasses.replace(fit, signals=(dataclasses.replace(signal, predictive=spread),))
    (left, _) = fit_figure(wide).axes
    (band,) = left.collections
    vertices = band.get_paths()[0].vertices
    at = np.isclose(vertices[:, 0], fit.t[20])
    heights = [vertices[at, 1].min() - signal.model[20], vertices[at, 1].max() - signal.model[20]]
    np.testing.assert_allclose(heights, [-0.94, 0.94], atol=1e-9)


def said(figure: Figure) -> list[str]:
    return [text.get_text() for panel in figure.axes for text in panel.texts]


def test_each_channel_says_what_is_left_of_it_and_one_without_spread_nothing() -> None:
    fit = fit_of(2, 200)
    bare = dataclasses.replace(fit.signals[1], share=float("nan"))
    assert said(fit_figure(fit)) == ["unexplained: 2.1 %"] * 2
    assert said(fit_figure(dataclasses.replace(fit, signals=(fit.signals[0], bare)))) == [
        "unexplained: 2.1 %"
    ]


def test_inputs_are_drawn_as_the_model_takes_them() -> None:
    """Mutants killed: stairs that rise before their sample; a line through a held input."""

    def check(straight: bool) -> None:
        n = 100
        one = course(n, straight=straight)
        fit = dataclasses.replace(fit_of(1, n), courses=(one,))
        figure = drawn(fit_figure(fit))
        panel = figure.axes[0]
        assert "mV" in panel.get_ylabel()
        (line,) = panel.get_lines()
        path = line.get_path().vertices  # with the corners that stairs put in
        t, u = (
            np.array([si(label, x) for x in path[:, k]])
            for k, label in ((0, figure.axes[1].get_xlabel() or "$t$ [s]"), (1, panel.get_ylabel()))
        )
        between = fit.t[:-1] + 0.5 * np.diff(fit.t)
        assert sorted(set(np.round(u))) == [-8000, 8000]
        held = np.interp(between, t, u)
        middle = 0.5 * (one.values[1:] + one.values[:-1])
        np.testing.assert_allclose(held, middle if straight else one.values[:-1], atol=1e-6)
        (legend,) = (p.get_legend() for p in [panel])
        (text,) = (text.get_text() for text in legend.get_texts())
        assert ("straight" in text) is straight
        assert ("held" in text) is not straight
        assert any("8" in text.get_text() and "mV" in text.get_text() for text in figure.texts)

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


@pytest.mark.parametrize(("many", "unit", "end"), [(1e4, "ms", 8000.0), (5e3, "s", 8.0)])
def test_times_of_very_many_units_are_in_seconds(
    many: float, unit: str, end: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bayesdrill.config.resolve.assembly.MAX_SHOWN_TIME", many)
    problem = bd.load(ROOT / "configs" / "example_rig.yaml").job.problem
    space, likelihood = problem.posterior.space, problem.posterior.likelihood
    at = space.vector(space.start)
    left = residual_checks.residual_summaries(likelihood, at)
    (fit,) = every_fit(problem, at, left)
    assert fit.time.latex_unit == unit
    assert fit.t[-1] == pytest.approx(end)
