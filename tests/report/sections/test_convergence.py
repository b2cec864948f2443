"""Figures of convergence: traces, ranks, autocorrelation; sentences about maxima and searches."""

import emcee
import numpy as np
import pytest
from support.case_tables import run_cases
from support.figure_checks import SYMBOLS, drawn, legend_texts, xy
from support.figure_contexts import chains, ranks

from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.report.sections.convergence import (
    autocorrelation_figure,
    describe_map,
    describe_searches,
    maxima,
)
from bayesdrill.sampling.mode_search import LocalMaximum, Mode, Search


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


def search(log_posterior: float, k_s: float = 2.0) -> Search:
    return Search(
        start={"k_s": 1.0},
        end={"k_s": k_s},
        log_posterior=log_posterior,
        evaluations=9,
        settled=True,
    )


def mode(*searches: Search, others: int = 0) -> Mode:
    """Return a maximum at 0 whose `others` are each 1 lower than the one before."""
    lower = [LocalMaximum(values={"k_s": 3.0 + k}, log_posterior=-1.0 - k) for k in range(others)]
    return Mode(
        values={"k_s": 2.0}, log_posterior=0.0, slope={}, gain=0.0, at_bound=(), searches=searches,
        others=tuple(lower),
    )  # fmt: skip


@run_cases(
    "found, words, line",
    [
        (mode(search(0.0), search(0.0)), "2 of 2 searches", "reached the same maximum"),
        (mode(search(0.0), search(-9.0)), "no second search confirms it", "no second one confirms"),
        (mode(search(-9.0), search(-9.0)), "only a search from a draw of the prior", "led higher"),
        (mode(search(0.0), search(0.0, 2.1)), "more than 1 % apart in k_s", "2 of 2 searches"),
        (mode(search(0.0), others=8), "and 2 more, at most 8 lower", "8 other maxima were found"),
    ],
)
def test_doubts_about_a_maximum_follow_from_the_ends_of_its_searches(
    found: Mode, words: str, line: str
) -> None:
    assert words in describe_map(found, DisplayUnits({}))
    assert line in describe_searches(found)


def test_the_share_of_draws_at_maxima_that_are_not_listed_is_their_sum() -> None:
    weights = np.array([0.4, 0.2, 0.1, 0.1, 0.07, 0.06, 0.04, 0.03])
    text = maxima(mode(others=7), weights, DisplayUnits({}))
    assert text.endswith("7.0% of the draws belong to the other 2")
