"""Figures of the verdict as they are rendered: texts apart, lines where they belong."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import for_each
from support.figure_checks import (
    SYMBOLS,
    TABLE,
    clashes,
    displayed,
    drawn,
    mode_of,
    posterior,
    prior_of,
)
from support.linear_study import NAMES, gaussian, verdict

from bayesdrill.analysis.identifiability.structure import ScalingStructure
from bayesdrill.basics.symbols import PARAMETERS, product_latex
from bayesdrill.report.sections.parameters_figure import (
    CorrelatedPair,
    invariants_figure,
    prior_posterior_figure,
    ridge_figure,
    strongest_pair,
)

ALL = SYMBOLS
PRIORS = {symbol.name: prior_of(symbol) for symbol in ALL}


def test_no_texts_of_priors_against_posteriors_overlap() -> None:
    def check(width: float | None, n: int) -> None:
        draws = posterior(1500, width)[:, :n]
        mode = mode_of(draws, ALL[:n])
        figure = drawn(prior_posterior_figure(draws, displayed(ALL[:n], TABLE, mode, PRIORS)))
        assert not list(clashes(figure))

    for_each({f"{width} {n}": (width, n) for width in [None, 1e-5] for n in [1, 9, 13]}, check)


def test_posterior_and_prior_are_densities_on_one_scale() -> None:
    """The prior's line encloses what the posterior's area does: one."""
    draws = posterior(1500)[:, :9]
    figure = prior_posterior_figure(
        draws, displayed(ALL[:9], TABLE, mode_of(draws, ALL[:9]), PRIORS)
    )
    for panel in figure.axes:
        (stairs, *_) = panel.patches
        values, edges, _ = stairs.get_data()  # type: ignore[attr-defined]
        assert np.sum(values * np.diff(edges)) == pytest.approx(1.0)
        x, y = panel.lines[0].get_data()
        assert np.trapezoid(y, x) == pytest.approx(1.0, abs=0.02)


def symmetric(*symmetries: tuple[int, ...]) -> ScalingStructure:
    names = tuple(symbol.name for symbol in ALL[:9])
    return ScalingStructure(names=names, symmetries=symmetries, invariants=(), unexplained=0)


def test_the_ridge_is_the_pair_that_follows_a_symmetry_most_closely() -> None:
    """k_s and j_1 share nearly all of their spread.

    Mutant killed: any strong correlation will do, whatever the exponents.
    """
    draws = posterior(3000)
    assert strongest_pair(draws, symmetric()) is None
    together = symmetric((1, 0, 0, 0, 0, 0, 1, 1, 0), (0, 1, 0, 0, 0, 1, 0, 0, 0))
    assert strongest_pair(draws, together) == CorrelatedPair((6, 7), (1, 1))
    against = symmetric((0, 0, 0, 0, 0, 0, 1, -1, 0))
    assert strongest_pair(draws, against) is None


def test_the_exact_line_passes_through_the_map_with_the_slope_of_the_exponents() -> None:
    draws = posterior(2000)[:, :9]
    mode = mode_of(draws, ALL[:9])
    figure = drawn(
        ridge_figure(draws, CorrelatedPair((6, 7), (1, 2)), displayed(ALL, TABLE, mode, PRIORS))
    )
    assert not list(clashes(figure))
    (panel,) = figure.axes
    x, y = (
        np.asarray(values) / scale
        for values, scale in zip(panel.lines[0].get_data(), (mode["k_s"], mode["j_1"]), strict=True)
    )
    slopes = np.diff(np.log(y)) / np.diff(np.log(x))
    assert slopes == pytest.approx(2.0)


def test_invariants_are_shown_in_per_cent_of_nominal_and_only_what_is_determined() -> None:
    draws = gaussian({**TABLE, "r_m": 1.2 * TABLE["r_m"]}, np.random.default_rng(2))
    symbols = [PARAMETERS[name] for name in NAMES]
    figure = drawn(invariants_figure(verdict(draws), draws, np.median(draws, axis=0), symbols))
    assert not list(clashes(figure))
    labels = [text for axes in figure.axes if (text := axes.get_xlabel())]
    assert len(labels) == 2
    assert all(r"\%\;of\;nominal" in label for label in labels)
    assert any(r"k_s/j_1" in label for label in labels)
    column = next(axes for axes in figure.axes if "r_m" in axes.get_xlabel())
    low, high = column.get_xlim()
    assert low < 100 * (np.median(draws[:, 2]) / TABLE["r_m"] - 1) < high


def test_products_in_latex() -> None:
    symbols = [PARAMETERS[name] for name in ("k_T", "r_m", "k_s")]
    assert product_latex((1, -1, -1), symbols) == r"k_T/(r_m\,k_s)"
    assert product_latex((0, 2, -1), symbols) == r"r_m^{2}/k_s"
    assert product_latex((0, 0, -1), symbols) == r"1/k_s"
