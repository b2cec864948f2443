"""Figures of residuals: correlations, frequency responses, predictive checks."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from support.figure_checks import legend_texts, xy
from support.figure_contexts import (
    frequency_response,
    predictive_checks,
    residual_correlations,
)

from bayesdrill.report import scales


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
