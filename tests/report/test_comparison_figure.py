"""The figure of a comparison as it is rendered: nothing overlaps, and marks stand where numbers are."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.case_tables import for_each
from support.compared_models import CHANNELS, model
from support.figure_checks import clashes, drawn, marked, xy

from bayesdrill.analysis.comparison import RunSummary, overlay_rows
from bayesdrill.inference.display_units import SI
from bayesdrill.report.sections.comparison_figure import comparison_figure


def models(n: int, unknowns: int, wide: float) -> list[RunSummary]:
    """The last is the most probable, and by far."""
    return [
        model(
            f"{'a_long_name_of_a_model_' * (k % 2)}{k}",
            -wide * (n - 1 - k) / n,
            rig=str(k),
            unknowns=unknowns - (k == 0 and unknowns > 1),
            rms=1.0 + 0.5 * (n - 1 - k) ** 2,
            correlation=0.2 * (n - 1 - k) % 1.0,
            moved=0.5 * k,
        )
        for k in range(n)
    ]


def figure(given: list[RunSummary]) -> Figure:
    return drawn(comparison_figure(given, overlay_rows([one.layer for one in given]), SI))


def test_no_texts_overlap() -> None:
    def check(n: int, unknowns: int, wide: float) -> None:
        assert list(clashes(figure(models(n, unknowns, wide)))) == []

    for_each(
        {str(case): case for case in [(2, 1, 0.5), (2, 3, 40.0), (8, 9, 3e5), (24, 5, 2e7)]}, check
    )


def test_of_many_models_those_unknowns_are_shown_that_most_have() -> None:
    given = [model(str(k), -float(k), unknowns=3 if k < 2 else 2) for k in range(8)]
    assert len(figure(given).axes) == 3 + 2
    assert len(figure(given[:3]).axes) == 3 + 3


def test_marks_stand_where_the_numbers_are() -> None:
    """Mutant killed: models in the order given, beside names in that of their odds."""
    given = models(4, 3, 60.0)
    page = figure(given)
    odds, left = page.axes[0], page.axes[1]
    names = [text.get_text() for text in odds.get_yticklabels()]
    assert names == [one.name for one in reversed(given)]
    places = dict(zip(names, odds.get_yticks(), strict=True))
    best = given[-1].log_z
    for line in marked(odds, "o"):
        ((x, y),) = xy(line).T
        one = next(one for one in given if places[one.name] == y)
        assert x == pytest.approx(best - one.log_z)
    whole = [line for line in left.get_lines() if line.get_marker() in ("o", "s", "^", "D")]
    assert len(whole) == len(given) * len(CHANNELS)
    hollow = {xy(line)[1, 0] for line in whole if line.get_markerfacecolor() == "white"}
    assert hollow == {places[one.name] for one in given if not one.like_noise}
    assert len({round(y) for y in hollow}) == 3
    assert np.ptp([xy(line)[1, 0] for line in whole]) == 3


def test_names_that_differ_at_their_ends_are_told_apart() -> None:
    ends = ["first", "second", "third"]
    given = [model(f"{'all_that_rubs-' * 4}{end}", -9.0 * k) for k, end in enumerate(ends)]
    page = figure(given)
    names = [text.get_text() for text in page.axes[0].get_yticklabels()]
    assert {name.rpartition("-")[2] for name in names} == set(ends)
    assert max(map(len, names)) < len(given[0].name)
    assert list(clashes(page)) == []


def test_channels_of_several_experiments_say_which_they_are_of() -> None:
    given = [
        model(name, -3.0 * k, experiments=("up", "down the hill")) for k, name in enumerate("ab")
    ]
    page = figure(given)
    words = [text.get_text() for text in page.legends[0].get_texts()]
    channels = [word for word in words if " in " in word]
    assert len(channels) == len(set(channels)) == 2 * len(CHANNELS)
    assert {word.partition(" in ")[2] for word in channels} == {"up", "down the hill"}
    assert list(clashes(page)) == []
