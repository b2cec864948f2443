"""Figures of one column and of two: as wide as said, readable, and nothing upon anything else."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.case_tables import for_each
from support.figure_checks import (
    SIGMAS,
    SYMBOLS,
    TABLE,
    clashes,
    displayed,
    drawn,
    mode_of,
    posterior,
    prior_of,
    shown,
    si,
)
from support.linear_study import PRIOR_SD, linear_study

from bayesdrill.analysis.calibration import LOG_LIKELIHOOD, Refit, judge_calibration
from bayesdrill.analysis.identifiability.profile import Profile
from bayesdrill.basics.symbols import PARAMETERS, Symbol
from bayesdrill.inference.priors import LogUniform, Prior
from bayesdrill.report import scales
from bayesdrill.report.sections.calibration_figure import calibration_figure
from bayesdrill.report.sections.convergence_figure import trace_figure
from bayesdrill.report.sections.corner_figure import corner_figure
from bayesdrill.report.sections.identify_figure import profile_figure, spectrum_figure
from bayesdrill.report.sections.parameters_figure import (
    CorrelatedPair,
    prior_posterior_figure,
    ridge_figure,
)
from bayesdrill.report.style import warned

LOGS = {"c_m", "sigma_w_1", "sigma_i"}
SIZES = {**TABLE, **{f"sigma_{name}": size for name, size in SIGMAS.items()}}
WIDTHS = (scales.SINGLE, scales.DOUBLE)
QUICK, SLOW = (1, 2, 3, 9), (4, 10, 13)
GROUPS = [
    pytest.param(QUICK, id="quick"),
    pytest.param(SLOW, id="long", marks=pytest.mark.slow),
]
FEWER = [(1, 3, 9), pytest.param((13,), marks=pytest.mark.slow)]
WARNING = "DOES NOT FIT: far more than the noise is left"


def prior(symbol: Symbol) -> Prior:
    plain = prior_of(symbol)
    if symbol.name not in LOGS:
        return plain
    middle = float(plain.quantile(np.array([0.5]))[0])
    return LogUniform(middle / 30, middle * 30)


@cache
def drawn_corner(n: int, inches: float) -> Figure:
    draws, symbols = posterior(1500)[:, :n], SYMBOLS[:n]
    priors = {s.name: prior(s) for s in symbols}
    shown = displayed(symbols, TABLE, mode_of(draws, symbols), priors)
    return drawn(corner_figure(draws, shown, inches))


def letters(figure: Figure) -> list[float]:
    """Points, of all that is to be read; indices are smaller."""
    every = [text for legend in figure.legends for text in legend.get_texts()]
    for panel in (panel for panel in figure.axes if panel.axison):
        every += [panel.xaxis.label, panel.yaxis.label, panel._left_title]
        every += [*panel.get_xticklabels(), *panel.get_yticklabels()]
    return [text.get_fontsize() for text in shown(every)]


@pytest.mark.parametrize("many", GROUPS)
def test_a_corner_is_as_wide_as_said_and_readable(many: tuple[int, ...]) -> None:
    def check(n: int, inches: float) -> None:
        figure = drawn_corner(n, inches)
        assert list(clashes(figure)) == []
        assert figure.get_figwidth() <= inches + 1e-9
        assert figure.get_figheight() < 1.45 * inches
        assert min(letters(figure)) >= 5.0

    for_each({f"{n} in {w} inches": (n, w) for n in many for w in WIDTHS}, check)


def test_each_axis_of_small_panels_says_its_ends() -> None:
    """Mutant killed: ends in the numbers of the log."""
    figure = drawn_corner(9, scales.SINGLE)
    below = [panel.get_xlabel().split("\n") for panel in figure.axes[-9:]]
    assert all(len(lines) == 2 and " to " in lines[1] for lines in below)
    low, high = (float(end) for end in below[1][1].split(" to "))
    draws = posterior(1500)[:, 1]
    power = 10.0 ** round(np.log10(np.median(draws) / np.sqrt(low * high)))
    assert 0 < low * power < np.quantile(draws, 0.01)
    assert np.quantile(draws, 0.99) < high * power < 30 * np.median(draws)


@pytest.mark.parametrize("many", FEWER)
def test_priors_against_posteriors(many: tuple[int, ...]) -> None:
    def check(n: int, inches: float) -> None:
        draws, symbols = posterior(1500)[:, :n], SYMBOLS[:n]
        priors = {s.name: prior(s) for s in symbols}
        mode = mode_of(draws, symbols)
        figure = drawn(
            prior_posterior_figure(draws, displayed(symbols, TABLE, mode, priors), inches)
        )
        assert list(clashes(figure)) == []
        assert figure.get_figwidth() <= inches
        assert figure.get_figheight() < 9.0

    for_each({f"{n} in {w} inches": (n, w) for n in many for w in WIDTHS}, check)


def profile_of(symbol: Symbol) -> Profile:
    """Over a decade, skewed, with its nominal value somewhere on it."""
    values = np.geomspace(0.4, 3.0, 15) * SIZES[symbol.name]
    loss = 3.0 * np.log(values / (0.9 * SIZES[symbol.name])) ** 2
    ends: dict[str, float] = {"best": float(values[6]), "low": float(values[2])}
    return Profile(name=symbol.name, values=values, loss=loss, high=None, shape="one-sided", **ends)


@pytest.mark.parametrize("many", FEWER)
def test_profiles_and_calibrations_are_as_wide_as_said(many: tuple[int, ...]) -> None:
    """Mutant killed: a logarithmic axis on which a value stands at its place on a plain one."""

    def check(n: int, inches: float) -> None:
        symbols = {symbol.name: symbol for symbol in SYMBOLS[:n]}
        found = [profile_of(symbol) for symbol in symbols.values()]
        profiles = drawn(profile_figure(found, symbols, TABLE, LOGS, inches))
        names = [*symbols, LOG_LIKELIHOOD]
        ranks = np.random.default_rng(n).integers(0, 100, (60, n + 1))
        refits = [refit(k, tuple(map(int, row))) for k, row in enumerate(ranks)]
        calibration = drawn(
            calibration_figure(judge_calibration(names, refits, 99), [*symbols.values()], inches)
        )
        for figure in (profiles, calibration):
            assert list(clashes(figure)) == []
            assert figure.get_figwidth() <= inches
            assert figure.get_figheight() < 12.0
            assert min(letters(figure)) >= 5.0
        assert calibration.get_figwidth() == inches
        for panel, symbol in zip(profiles.axes, symbols.values(), strict=True):
            low = panel.get_lines()[1].get_xdata()[2]
            power = si(panel.get_xlabel(), 1.0)
            value = power * 10.0**low if symbol.name in LOGS else si(panel.get_xlabel(), low)
            shown = found[list(symbols).index(symbol.name)]
            assert np.abs(shown.values / value - 1.0).min() < 1e-6

    for_each({f"{n} in {w} inches": (n, w) for n in many for w in WIDTHS}, check)


def refit(index: int, ranks: tuple[int, ...]) -> Refit:
    how: dict[str, Any] = {"r_hat": 1.0, "ess": 500.0, "steps": 800, "reasons": (), "seconds": 0.0}
    return Refit(index=index, truth=(0.0,) * len(ranks), ranks=ranks, **how)


def test_a_spectrum_names_every_bar_at_either_width() -> None:
    def check(inches: float) -> None:
        study = linear_study(np.full(3, PRIOR_SD))
        labels = {name: PARAMETERS[name].latex for name in study.names}
        figure = drawn(spectrum_figure(study, labels, inches))
        assert figure.get_figwidth() == inches
        (panel,) = figure.axes
        texts = [*panel.get_yticklabels(), *panel.texts]
        named = [text for text in texts if "_" in text.get_text()]
        assert len(named) == len(study.information.directions)
        boxes = [text.get_window_extent() for text in named]
        assert all(figure.bbox.contains(*corner) for b in boxes for corner in (b.p0, b.p1))
        heights = [b.y0 for b in boxes]
        assert min(np.abs(np.diff(heights))) > max(b.height for b in boxes)

    for_each({str(inches): (inches,) for inches in WIDTHS}, check)


# What must be said before anything else


def texts(figure: Figure) -> str:
    return " ".join(text.get_text() for text in figure.texts).replace("\n", " ")


def test_a_warning_stands_on_the_page_and_moves_all_else_down() -> None:
    """Mutants killed: a strip beyond the page, which savefig cuts; legends or dots left behind."""
    kinds = ["corner", "trace", "ridge", "plain", "laid out"]

    def check(inches: float, kind: str) -> None:
        draws, some = posterior(1500), SYMBOLS[:3]
        mode = mode_of(draws, SYMBOLS)
        if kind == "corner":
            figure = corner_figure(draws[:, :3], displayed(some, TABLE, mode, {}), inches)
        elif kind == "trace":
            theta = draws[:1200, :3].reshape(3, 50, 8, 3)
            figure = trace_figure(theta, displayed(some, TABLE, mode, {}), 5, inches)
        elif kind == "ridge":
            priors = {s.name: prior_of(s) for s in SYMBOLS}
            shown = displayed(SYMBOLS, TABLE, mode, priors)
            figure = ridge_figure(draws, CorrelatedPair((6, 7), (1, 1)), shown)
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

    for_each({f"{inches} {kind}": (inches, kind) for inches in WIDTHS for kind in kinds}, check)


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
