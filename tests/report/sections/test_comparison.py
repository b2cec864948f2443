"""Figures of several runs: marks stand where the numbers are, and runs differ without colours."""

from dataclasses import replace

import numpy as np
import pytest
from support.compared_models import CHANNELS, model
from support.figure_checks import marked, si, xy
from support.figure_contexts import compared, models

from bayesdrill.analysis.comparison import overlay_rows
from bayesdrill.analysis.prediction import HeldOutScore, LooScore
from bayesdrill.inference.display_units import SI
from bayesdrill.report.findings import Finding
from bayesdrill.report.sections.comparison import predicted
from bayesdrill.report.sections.overlay import farthest, intervals_figure, overlay_table


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


def test_rows_of_three_runs_name_the_pair_that_is_farthest_apart_and_nominal_values_that_differ() -> (
    None
):
    layers = [
        model(name, 0.0, moved=moved).layer
        for name, moved in zip("abc", (0.0, 9.0, 1.0), strict=True)
    ]
    row, *_ = overlay_rows(layers)
    row = replace(row, nominal=(row.nominal[0], 1.02 * row.nominal[0], None))
    cells = overlay_table(layers, [row]).lines[0]
    assert cells[2] == "differs"
    assert cells[-1] == f"{row.distance:.2f} (a, b)"
    (said,) = farthest(layers, [row])
    assert said.endswith(f"a and b are {row.distance:.2g} sd apart")
    assert [*farthest(layers, [replace(row, distance=None)])] == [
        "no unknown is shared by two of the runs"
    ]
    (panel,) = intervals_figure(layers, [row], SI).axes
    marks = {x[0]: y for x, y in map(xy, panel.get_lines()) if len(x) == 2 and x[0] == x[1]}
    places = [si(panel.get_xlabel(), x) for x in marks]
    assert places == pytest.approx([value for value in row.nominal if value])
    assert [y.tolist() for y in marks.values()] == [[1.5, 2.5], [0.5, 1.5]]


def test_scores_that_cannot_be_trusted_have_a_sentence_with_the_reason() -> None:
    loo = LooScore(elpd=1.0, terms=np.zeros(9), unreliable=0.25)
    held = [HeldOutScore(score=score, samples=9, terms=np.zeros(9)) for score in (1.0, 2.0)]
    bad, good = (
        replace(model(name, 0.0), loo=loo, held_out=score)
        for name, score in zip(("bad", "good"), held, strict=True)
    )
    refused = replace(good, loo=Finding("noise with memory"))
    assert [*predicted([bad, replace(good, loo=replace(loo, unreliable=0.0))])] == [
        "held out: 9 samples, which good predicts best",
        "LOO of bad: 25% of its terms depend on a few draws",
    ]
    text = [*predicted([refused])][-1]
    assert text.startswith("LOO refused for good: its noise is correlated")
