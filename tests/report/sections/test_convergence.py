"""Figures of convergence: traces, ranks, autocorrelation."""

import emcee
import numpy as np
import pytest
from support.figure_checks import SYMBOLS, drawn, legend_texts, xy
from support.figure_contexts import chains, ranks

from bayesdrill.report.sections.convergence import autocorrelation_figure


def test_an_ensemble_that_leaves_the_band_of_ranks_is_drawn_so() -> None:
    assert "leaves the band" not in legend_texts(ranks(4, 0.0))
    assert "leaves the band" in legend_texts(ranks(4, 1.0))
    thick = [
        (k, xy(line)[1])
        for k, panel in enumerate(ranks(4, 1.0).axes)
        for line in panel.get_lines()
        if line.get_linewidth() > 1.5
    ]
    assert {k for k, _ in thick} == {0}
    assert any(per_cent.min() < -20 for _, per_cent in thick)  # the moved one


def test_the_autocorrelation_time_is_that_of_emcee_and_stands_where_it_is_marked() -> None:
    theta = chains(0.8)
    figure = drawn(autocorrelation_figure(theta, SYMBOLS[:3]))
    times = [float(panel.get_lines()[1].get_xdata()[0]) for panel in figure.axes]
    own = np.mean([emcee.autocorr.integrated_time(chain, quiet=True) for chain in theta], axis=0)
    assert times == pytest.approx(own, rel=0.03)
    assert times == pytest.approx([9.0] * 3, rel=0.1)
    for panel, tau in zip(figure.axes, times, strict=True):
        assert rf"\tau = {tau:.3g}$ steps" in panel.texts[0].get_text()
        assert panel.patches[0].get_width() == pytest.approx(5 * tau, abs=1)  # the window
