"""Figures of several runs: marks stand where the numbers are, and runs differ without colours."""

import numpy as np
import pytest
from support.compared_models import CHANNELS
from support.figure_checks import marked, xy
from support.figure_contexts import compared, models


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
