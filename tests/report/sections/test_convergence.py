"""Tests of the sentence about several maxima, and of figures of traces, ranks and autocorrelation."""

import emcee
import numpy as np
import pytest
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, drawn, legend_texts, xy
from support.figure_contexts import chains, ranks

from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.report.sections.convergence import autocorrelation_figure, maxima
from bayesdrill.sampling.mode_search import LocalMaximum, Mode


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


def test_maxima_are_named_by_their_places_or_said_to_be_close() -> None:
    cases = [(2.5, "the one at k_s 2.5"), (2.001, "within 1% of each other in every unknown")]

    def check(elsewhere: float, said: str) -> None:
        other = LocalMaximum(values={"k_s": elsewhere, "j_1": 3.0}, log_posterior=-1.0)
        found = Mode(
            values={"k_s": 2.0, "j_1": 3.0}, log_posterior=0.0, slope={}, gain=0.0, at_bound=(),
            searches=(), others=(other,),
        )  # fmt: skip
        text = maxima(found, np.array([0.75, 0.25]), DisplayUnits({}))
        assert said in text
        assert "75.0%" in text
        assert "25.0%" in text
        assert "  \n" not in text

    for_each({str(case): case for case in cases}, check)
