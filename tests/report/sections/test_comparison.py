"""Figures of several runs: marks stand where the numbers are, and runs differ without colours."""

import numpy as np
import pytest
from support.compared_models import CHANNELS
from support.figure_checks import legend_texts, marked, xy
from support.figure_contexts import (
    compared,
    layers,
    models,
    overlaid_corner,
    overlaid_intervals,
)

from bayesdrill.analysis.comparison import overlay_rows
from bayesdrill.inference.display_units import SI
from bayesdrill.report.section import as_markdown, as_text
from bayesdrill.report.sections.comparison import comparison_sections


def test_marks_of_models_stand_where_the_numbers_are() -> None:
    """In the order of their odds, beside their names."""
    summaries = models(4, 3, 60.0)
    odds, residuals = compared(summaries).axes[:2]
    names = [text.get_text() for text in odds.get_yticklabels()]
    assert names == [summary.name for summary in reversed(summaries)]
    places = dict(zip(names, odds.get_yticks(), strict=True))
    for mark in marked(odds, "o"):
        ((x, y),) = xy(mark).T
        (summary,) = (summary for summary in summaries if places[summary.name] == y)
        assert x == pytest.approx(summaries[-1].log_z - summary.log_z)
    channels = [mark for marker in "os^D" for mark in marked(residuals, marker)]
    assert len(channels) == len(summaries) * len(CHANNELS)
    hollow = {xy(mark)[1, 0] for mark in channels if mark.get_markerfacecolor() == "white"}
    assert hollow == {places[summary.name] for summary in summaries if not summary.like_noise}
    assert len({round(y) for y in hollow}) == 3
    assert np.ptp([xy(mark)[1, 0] for mark in channels]) == 3


def test_intervals_of_overlaid_runs_stand_where_the_numbers_are_and_gaps_where_none_is() -> None:
    rows = overlay_rows(layers(3, 4))
    for row, panel in zip(rows, overlaid_intervals(3, 4).axes, strict=True):
        bars = marked(panel, "|")
        places = [place for place in row.places if place is not None]
        assert len(bars) == len(places)
        lengths = np.array([np.diff(xy(bar)[0])[0] for bar in bars])
        widths = np.array([place.high - place.low for place in places])
        assert lengths / lengths[0] == pytest.approx(widths / widths[0])
    assert len(places) == 2  # the last unknown


def test_a_run_that_did_not_converge_says_so_in_legend_and_words() -> None:
    for figure in (overlaid_corner(2, 2), overlaid_intervals(2, 2)):
        assert legend_texts(figure)[:2] == [
            "run_with_a_name_0",
            "run_with_a_name_1 (NOT CONVERGED)",
        ]
    summaries = layers(2, 3)
    sections = comparison_sections(summaries, (), overlay_rows(summaries), SI)
    for text in ("\n".join(as_text(sections)), as_markdown("overlay", sections)):
        assert "run_with_a_name_1: NOT CONVERGED" in text
        assert "the ensembles disagree" in text
        assert "0.94 sd apart" in text
        assert "not the same: seed" in text
