"""Axes that show what a prior is flat in: places, densities, ticks; beside plain ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import Rectangle, StepPatch
from support.case_tables import for_each
from support.figure_checks import (
    SYMBOLS,
    TABLE,
    clashes,
    corner_panels,
    displayed,
    drawn,
    mode_of,
    posterior,
    si,
)

from bayesdrill.basics.symbols import PARAMETERS
from bayesdrill.inference.priors import LogUniform, Prior, Uniform, flat_in_logs
from bayesdrill.report import scales
from bayesdrill.report.sections.corner_figure import corner_figure
from bayesdrill.report.sections.parameters_figure import (
    CorrelatedPair,
    prior_posterior_figure,
    ridge_figure,
)

PAIR = (SYMBOLS[0], SYMBOLS[6])  # j_m, flat in its log; k_s, flat itself
LOW, HIGH = 0.02 * TABLE["j_m"], 50 * TABLE["j_m"]
PRIORS: dict[str, Prior] = {
    "j_m": LogUniform(LOW, HIGH),
    "k_s": Uniform(0.5 * TABLE["k_s"], 1.5 * TABLE["k_s"]),
}


def flat(n: int = 20_000) -> np.ndarray:
    """Draws of the priors themselves."""
    u = np.random.default_rng(4).random((n, 2))
    return np.stack([PRIORS[s.name].quantile(u[:, k]) for k, s in enumerate(PAIR)], axis=-1)


def value(label: str, u: float, *, log: bool) -> float:
    return si(label, 10.0**u if log else u)


def test_what_is_flat_in_the_log_is_a_box_in_the_corner_and_the_other_stays_plain() -> None:
    """Mutants killed: a density of the value drawn over its log; a log for every unknown."""
    draws, mode = flat(), {"j_m": 1e-4, "k_s": 0.3}
    panels = corner_panels(corner_figure(draws, displayed(PAIR, TABLE, mode, PRIORS)))
    labels = [panels[1, k].get_xlabel() for k in range(2)]
    for k, (symbol, log) in enumerate(zip(PAIR, (True, False), strict=True)):
        panel = panels[k, k]
        (steps,) = (p for p in panel.patches if isinstance(p, StepPatch))
        counts, edges, _ = steps.get_data()
        assert counts.min() > 0.75 * np.median(counts)
        prior = next(c for c in panel.get_lines() if len(c.get_xdata()) > 100)
        height = np.asarray(prior.get_ydata())
        assert np.ptp(height[height > 0]) < 1e-6 * height.max()
        assert height.max() == pytest.approx(counts.mean(), rel=0.02)
        ends = [value(labels[k], float(edge), log=log) for edge in edges[[0, -1]]]
        assert ends == pytest.approx([PRIORS[symbol.name].low, PRIORS[symbol.name].high], rel=1e-6)
        lines = [c.get_xdata() for c in panel.get_lines() if len(c.get_xdata()) == 2]
        shown = sorted(value(labels[k], float(x[0]), log=log) for x in lines)
        assert shown == pytest.approx(sorted([TABLE[symbol.name], mode[symbol.name]]))


def test_ticks_of_a_logarithmic_axis_are_where_their_texts_say() -> None:
    figure = drawn(corner_figure(flat(), displayed(PAIR, TABLE, {}, PRIORS)))
    panel = corner_panels(figure)[1, 0]
    for text in panel.get_xticklabels():
        told = si(panel.get_xlabel(), float(text.get_text()))
        place = value(panel.get_xlabel(), text.get_position()[0], log=True)
        assert place == pytest.approx(told, rel=1e-6)
    assert len(panel.get_xticklabels()) >= 2
    assert list(clashes(figure)) == []


def test_contours_of_two_logs_are_those_of_the_logs() -> None:
    """A bell in the logs is round there, however many decades it spans."""
    z = np.random.default_rng(2).standard_normal((20_000, 2))
    draws = np.array([TABLE["j_m"], TABLE["k_s"]]) * 10.0 ** (0.5 * z)
    priors: dict[str, Prior] = {s.name: LogUniform(1e-9, 1e3) for s in PAIR}
    panel = corner_panels(corner_figure(draws, displayed(PAIR, {}, {}, priors)))[1, 0]
    (contours,) = (c for c in panel.collections if not c.filled)
    outer = max((path.vertices for path in contours.get_paths()), key=lambda v: np.ptp(v[:, 0]))
    middle = [
        math.log10(si(label, 1.0) / TABLE[s.name])
        for label, s in zip((panel.get_xlabel(), panel.get_ylabel()), PAIR, strict=True)
    ]
    radii = np.hypot(outer[:, 0] + middle[0], outer[:, 1] + middle[1])
    assert radii.min() > 0.85
    assert radii.max() < 1.2


def test_prior_and_posterior_are_densities_of_the_log_on_its_axis() -> None:
    figure = prior_posterior_figure(flat(), displayed(PAIR, TABLE, {}, PRIORS))
    for panel in figure.axes:
        (stairs, *_) = panel.patches
        heights, edges, _ = stairs.get_data()  # type: ignore[attr-defined]
        assert np.sum(heights * np.diff(edges)) == pytest.approx(1.0)
        x, y = panel.lines[0].get_data()
        assert np.trapezoid(y, x) == pytest.approx(1.0, abs=0.02)
        inside = np.asarray(y)[np.asarray(y) > 0]
        assert np.ptp(inside) < 1e-6 * inside.max()
        assert heights.mean() == pytest.approx(inside.max(), rel=0.05)


def test_on_two_logarithmic_axes_a_symmetry_is_a_straight_line() -> None:
    draws = posterior(500)
    mode = mode_of(draws, SYMBOLS)
    priors: dict[str, Prior] = {
        s.name: LogUniform(1e-2 * mode[s.name], 1e2 * mode[s.name]) for s in SYMBOLS
    }
    figure = drawn(
        ridge_figure(draws, CorrelatedPair((6, 7), (1, 2)), displayed(SYMBOLS, TABLE, mode, priors))
    )
    assert list(clashes(figure)) == []
    (panel,) = figure.axes
    x, y = (np.asarray(values, dtype=float) for values in panel.lines[0].get_data())
    np.testing.assert_allclose(np.diff(y) / np.diff(x), 2.0)
    (box,) = (p for p in panel.patches if isinstance(p, Rectangle))
    assert (box.get_width(), box.get_height()) == pytest.approx((4.0, 4.0))


def test_a_plain_axis_of_large_numbers_has_no_small_ticks() -> None:
    """Such as deviations of hundreds of per cent, which are no powers of ten."""

    def check(size: float) -> None:
        assert len(scales.scale(0.8 * size, size).between) == 0
        assert len(scales.scale(0.8 * size, 4 * size, log=True).between) > 3

    for_each({str(size): (size,) for size in [380.0, 3e5]}, check)


@given(st.floats(-8, 4), st.floats(0.001, 6))
def test_logarithmic_ticks_are_few_round_and_inside(start: float, decades: float) -> None:
    low = 10.0**start
    scale = scales.scale(low, low * 10.0**decades, log=True)
    places, texts = scale.ticks(4)
    assert 2 <= len(places) <= 4
    assert len(set(texts)) == len(texts)
    assert (scale.low <= places).all()
    assert (places <= scale.high).all()
    for place, text in zip(places, texts, strict=True):
        if not text.startswith("$"):
            told = si(scale.label(PARAMETERS["r_m"]), float(text))
            assert float(scale.value(place)) == pytest.approx(told, rel=1e-6)


def test_an_axis_too_short_to_be_told_from_a_plain_one_is_plain() -> None:
    assert scales.scale(1.0, 1.01, log=True).log
    assert not scales.scale(1.0, 1.0 + 1e-5, log=True).log


def test_a_prior_in_other_units_is_the_same_prior() -> None:
    def check(prior: Prior) -> None:
        factor = math.pi / 180
        degrees, x = prior.scaled(1 / factor), np.geomspace(0.2, 2.5, 7)
        density = np.exp(degrees.logpdf(x / factor)) / factor
        np.testing.assert_allclose(density, np.exp(prior.logpdf(x)))
        np.testing.assert_allclose(
            degrees.quantile(np.array([0.3])) * factor, prior.quantile(np.array([0.3]))
        )
        ends = (degrees.low * factor, degrees.high * factor)
        assert ends == pytest.approx((prior.low, prior.high))
        assert flat_in_logs(degrees) is flat_in_logs(prior) is isinstance(prior, LogUniform)

    for_each({str(prior): (prior,) for prior in [LogUniform(1e-3, 1e2), Uniform(0.1, 3.0)]}, check)
