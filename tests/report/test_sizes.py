"""Figures of one column and of two: as wide as said, readable, and nothing upon anything else."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from pictures import SYMBOLS, TABLE, clashes, drawn, mode_of, posterior, prior_of, shown

from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.priors import LogUniform, Prior
from bayesdrill.report import style
from bayesdrill.report.corner_plot import corner_figure
from bayesdrill.report.prior_posterior_plot import prior_posterior_figure
from bayesdrill.report.ridge_plot import Pair, ridge_figure
from bayesdrill.report.trace_plot import trace_figure
from bayesdrill.report.warning_strip import warned

LOGS = {"c_m", "sigma_w_1", "sigma_i"}
WIDTHS = (style.SINGLE, style.DOUBLE)
MANY = (1, 2, 3, 4, 9, 10, 13)
SLOW = [pytest.param(n, marks=[pytest.mark.slow] * (n in (4, 10, 13))) for n in MANY]
WARNING = "DOES NOT FIT: far more than the noise is left"


def prior(symbol: Symbol) -> Prior:
    plain = prior_of(symbol)
    if symbol.name not in LOGS:
        return plain
    middle = float(plain.quantile(np.array([0.5]))[0])
    return LogUniform(middle / 30, middle * 30)


def drawn_corner(n: int, inches: float) -> Figure:
    draws, symbols = posterior(1500)[:, :n], SYMBOLS[:n]
    priors = {s.name: prior(s) for s in symbols}
    return drawn(corner_figure(draws, symbols, TABLE, mode_of(draws, symbols), priors, inches))


def letters(figure: Figure) -> list[float]:
    """Points, of all that is to be read; indices are smaller."""
    every = [text for legend in figure.legends for text in legend.get_texts()]
    for panel in (panel for panel in figure.axes if panel.axison):
        every += [panel.xaxis.label, panel.yaxis.label, panel._left_title]
        every += [*panel.get_xticklabels(), *panel.get_yticklabels()]
    return [text.get_fontsize() for text in shown(every)]


@pytest.mark.parametrize("inches", WIDTHS)
@pytest.mark.parametrize("n", SLOW)
def test_a_corner_is_as_wide_as_said_and_readable(n: int, inches: float) -> None:
    figure = drawn_corner(n, inches)
    assert list(clashes(figure)) == []
    assert figure.get_figwidth() <= inches + 1e-9
    assert figure.get_figheight() < 1.45 * inches
    assert min(letters(figure)) >= 5.0


def test_each_axis_of_small_panels_says_its_ends() -> None:
    """Mutant killed: ends in the numbers of the log."""
    figure = drawn_corner(9, style.SINGLE)
    below = [panel.get_xlabel().split("\n") for panel in figure.axes[-9:]]
    assert all(len(lines) == 2 and " to " in lines[1] for lines in below)
    low, high = (float(end) for end in below[1][1].split(" to "))
    draws = posterior(1500)[:, 1]
    power = 10.0 ** round(np.log10(np.median(draws) / np.sqrt(low * high)))
    assert 0 < low * power < np.quantile(draws, 0.01)
    assert np.quantile(draws, 0.99) < high * power < 30 * np.median(draws)


@pytest.mark.parametrize("inches", WIDTHS)
@pytest.mark.parametrize("n", [1, 3, 9, 13])
def test_priors_against_posteriors(n: int, inches: float) -> None:
    draws, symbols = posterior(1500)[:, :n], SYMBOLS[:n]
    priors = {s.name: prior(s) for s in symbols}
    mode = mode_of(draws, symbols)
    figure = drawn(prior_posterior_figure(draws, symbols, priors, TABLE, mode, inches))
    assert list(clashes(figure)) == []
    assert figure.get_figwidth() <= inches
    assert figure.get_figheight() < 9.0


# What must be said before anything else


def texts(figure: Figure) -> str:
    return " ".join(text.get_text() for text in figure.texts).replace("\n", " ")


@pytest.mark.parametrize("inches", WIDTHS)
@pytest.mark.parametrize("kind", ["corner", "trace", "ridge", "plain", "laid out"])
def test_a_warning_stands_on_the_page_and_moves_all_else_down(kind: str, inches: float) -> None:
    """Mutants killed: a strip beyond the page, which savefig cuts; legends or dots left behind."""
    draws, some = posterior(1500), SYMBOLS[:3]
    mode = mode_of(draws, SYMBOLS)
    if kind == "corner":
        figure = corner_figure(draws[:, :3], some, TABLE, mode, {}, inches)
    elif kind == "trace":
        theta = draws[:1200, :3].reshape(3, 50, 8, 3)
        figure = trace_figure(theta, some, 5, TABLE, mode, (), inches)
    elif kind == "ridge":
        priors = {s.name: prior_of(s) for s in SYMBOLS}
        figure = ridge_figure(draws, Pair((6, 7), (1, 1)), SYMBOLS, priors, TABLE, mode)
    else:
        layout = "constrained" if kind == "laid out" else None
        figure = Figure(figsize=(inches, 3.0), layout=layout)
        figure.subplots().set_title("of another package")
    before = places(figure)
    height = figure.get_figheight()
    drawn(warned(figure, WARNING))
    assert texts(figure).endswith(WARNING)
    assert list(clashes(figure)) == []
    if kind != "laid out":
        np.testing.assert_allclose(places(figure), before, atol=0.02)
    assert figure.get_figheight() > height + 0.2


def places(figure: Figure) -> np.ndarray:
    """Inches, of panels, legends and dots that stand on the page."""
    drawn(figure)
    boxes = [panel.get_window_extent() for panel in figure.axes]
    boxes += [legend.get_window_extent() for legend in figure.legends]
    boxes += [artist.get_window_extent() for artist in figure.artists]
    return np.array([box.extents for box in boxes]) / figure.dpi


def test_without_a_warning_nothing_changes() -> None:
    figure = Figure(figsize=(3, 2))
    assert warned(figure, "") is figure
    assert figure.get_figheight() == 2
    assert not figure.texts
