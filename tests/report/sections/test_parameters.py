"""Figures of parameters: densities on one scale, ridges along symmetries, products in per cent."""

import numpy as np
import pytest
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, mode_of, posterior
from support.figure_contexts import prior_posterior, ridge

from bayesdrill.analysis.identifiability.structure import ScalingStructure
from bayesdrill.report.sections.parameters import CorrelatedPair, strongest_pair


def test_prior_and_posterior_are_densities_on_one_scale() -> None:
    """The prior's line encloses what the posterior's area does, one: also over a logarithmic axis."""

    def check(logs: frozenset[str]) -> None:
        for panel in prior_posterior(9, logs=logs).axes:
            (stairs, *_) = panel.patches
            heights, edges, _ = stairs.get_data()  # type: ignore[attr-defined]
            assert np.sum(heights * np.diff(edges)) == pytest.approx(1.0)
            x, y = panel.lines[0].get_data()
            assert np.trapezoid(y, x) == pytest.approx(1.0, abs=0.02)
            inside = np.asarray(y)[np.asarray(y) > 0]
            assert np.ptp(inside) < 1e-6 * inside.max()  # uniform, or log-uniform

    every = frozenset(symbol.name for symbol in SYMBOLS)
    for_each({"plain": (frozenset(),), "logarithmic": (every,)}, check)


def symmetric(*symmetries: tuple[int, ...]) -> ScalingStructure:
    names = tuple(symbol.name for symbol in SYMBOLS[:9])
    return ScalingStructure(names=names, symmetries=symmetries, invariants=(), unexplained=0)


def test_the_ridge_is_the_pair_that_follows_a_symmetry_most_closely() -> None:
    """k_s and j_1 share nearly all of their spread; a strong correlation alone makes no ridge."""
    draws = posterior(3000)
    assert strongest_pair(draws, symmetric()) is None
    both = symmetric((1, 0, 0, 0, 0, 0, 1, 1, 0), (0, 1, 0, 0, 0, 1, 0, 0, 0))
    assert strongest_pair(draws, both) == CorrelatedPair((6, 7), (1, 1))
    against = symmetric((0, 0, 0, 0, 0, 0, 1, -1, 0))
    assert strongest_pair(draws, against) is None


def test_the_exact_line_passes_through_the_map_with_the_slope_of_the_exponents() -> None:
    (panel,) = ridge().axes
    mode = mode_of(posterior(2000), SYMBOLS)
    x, y = (
        np.asarray(values) / mode[name]
        for values, name in zip(panel.lines[0].get_data(), ("k_s", "j_1"), strict=True)
    )
    assert np.diff(np.log(y)) / np.diff(np.log(x)) == pytest.approx(2.0)
