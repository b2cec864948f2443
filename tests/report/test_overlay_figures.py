"""Runs laid over each other as they are rendered: told apart in grey, nothing overlapping."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from support.case_tables import for_each
from support.figure_checks import clashes, drawn, posterior

import bayesdrill as bd
from bayesdrill.analysis.comparison import PosteriorSummary, overlay_rows
from bayesdrill.inference.display_units import SI
from bayesdrill.report import style
from bayesdrill.report.comparison_report import OVERLAID
from bayesdrill.report.section import as_markdown, as_text
from bayesdrill.report.sections import comparison_words
from bayesdrill.report.sections.comparison_figure import (
    RUN_STYLES,
    intervals_figure,
    overlay_corner_figure,
)

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
PROBLEM = bd.load(CONFIG).job.problem


def layers(n_runs: int, unknowns: int) -> list[PosteriorSummary]:
    """The runs lie beside each other, each narrower; the last has not the last unknown."""
    found = []
    for k in range(n_runs):
        x = posterior(1500)[:, :unknowns]
        sd = x.std(axis=0)
        moved = x.mean(axis=0) + (x - x.mean(axis=0)) / (1 + 0.5 * k) + 0.8 * k * sd
        found.append(
            PosteriorSummary(
                name=f"run_with_a_name_{k}",
                mark=str(k),
                problem=dataclasses.replace(PROBLEM, symbols=PROBLEM.symbols[:unknowns]),
                draws=moved,
                settings={"seed": str(k)},
                warning="NOT CONVERGED" if k == 1 else "",
                reasons=("the ensembles disagree",) if k == 1 else (),
            )
        )
    if unknowns > 1:
        last = found[-1]
        less = dataclasses.replace(PROBLEM, symbols=PROBLEM.symbols[: unknowns - 1])
        found[-1] = dataclasses.replace(last, problem=less, draws=last.draws[:, :-1])
    return found


@cache
def corner(n_runs: int, unknowns: int) -> Figure:
    given = layers(n_runs, unknowns)
    return drawn(overlay_corner_figure(given, overlay_rows(given), SI))


@cache
def intervals(n_runs: int, unknowns: int) -> Figure:
    given = layers(n_runs, unknowns)
    return drawn(intervals_figure(given, overlay_rows(given), SI))


def test_no_texts_overlap() -> None:
    def check(n_runs: int, unknowns: int) -> None:
        assert list(clashes(corner(n_runs, unknowns))) == []
        assert list(clashes(intervals(n_runs, unknowns))) == []

    for_each({str(case): case for case in [(2, 1), (2, 2), (6, 3), (3, 9)]}, check)


def test_no_legend_lies_on_a_panel() -> None:
    for n_runs, unknowns in ((2, 1), (2, 2), (6, 3), (3, 9)):
        for figure in (corner(n_runs, unknowns), intervals(n_runs, unknowns)):
            legend = figure.legends[0].get_window_extent()
            panels = [panel for panel in figure.axes if panel.axison]
            assert not any(panel.get_window_extent().overlaps(legend) for panel in panels)


def test_runs_are_told_apart_without_colours() -> None:
    """By grey and width where lines are whole, by dashes else; none has those of a nominal value."""
    assert len(RUN_STYLES) == OVERLAID.most
    grey = {look: np.dot(to_rgb(look.color), (0.299, 0.587, 0.114)) for look in RUN_STYLES}
    whole = sorted(grey[look] for look in RUN_STYLES if look.linestyle == "-")
    assert min(np.diff(whole)) > 0.1
    dashes = [look.linestyle for look in RUN_STYLES if look.linestyle != "-"]
    assert len({*dashes, style.NOMINAL["linestyle"]}) == len(dashes) + 1
    assert len({look.marker for look in RUN_STYLES}) == len(RUN_STYLES)


def test_intervals_stand_where_the_numbers_are_and_gaps_where_none_is() -> None:
    given = layers(3, 4)
    found = overlay_rows(given)
    figure = drawn(intervals_figure(given, found, SI))
    for row, panel in zip(found, figure.axes, strict=True):
        bars = [line for line in panel.get_lines() if line.get_marker() == "|"]
        there = [place for place in row.places if place is not None]
        assert len(bars) == len(there)
        x = np.array([bar.get_xdata() for bar in bars], dtype=float)
        widths = np.array([place.high - place.low for place in there])
        assert np.diff(x)[:, 0] / np.diff(x)[0, 0] == pytest.approx(widths / widths[0])
    assert len(there) == 2  # the last unknown


def test_a_run_that_did_not_converge_says_so_in_legend_and_words() -> None:
    for figure in (corner(2, 2), intervals(2, 2)):
        texts = [text.get_text() for text in figure.legends[0].get_texts()]
        assert texts[:2] == ["run_with_a_name_0", "run_with_a_name_1 (NOT CONVERGED)"]
    given = layers(2, 3)
    sections = comparison_words.comparison_sections(given, (), overlay_rows(given), SI)
    for text in ("\n".join(as_text(sections)), as_markdown("overlay", sections)):
        assert "run_with_a_name_1: NOT CONVERGED" in text
        assert "the ensembles disagree" in text
        assert "0.94 sd apart" in text
        assert "not the same: seed" in text
