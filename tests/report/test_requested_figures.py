"""Figures that are drawn when they are asked for: ranks, autocorrelation, predictive check."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import emcee
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pictures import SYMBOLS, clashes, drawn
from together import for_each

from bayesdrill.analysis.calibration import ecdf_band
from bayesdrill.analysis.diagnostics import ranks
from bayesdrill.analysis.prediction import Check
from bayesdrill.record.experiment import Channel
from bayesdrill.report import publish, style
from bayesdrill.report.sections.convergence_figure import autocorrelation_figure, rank_figure
from bayesdrill.report.sections.fit_figure import predictive_figure

Array = NDArray[np.float64]


@cache
def rank_case(n: int, moved: float) -> Figure:
    x = np.random.default_rng(1).standard_normal((5, 400, n))
    x[3, :, 0] += moved
    return drawn(rank_figure(ranks(x, np.random.default_rng(2)), SYMBOLS[:n]))


def chains(rho: float, n: int = 3) -> Array:
    """First-order autoregressive, `(4, 3000, 8, n)`; tau is `(1 + rho) / (1 - rho)`."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((4, 3000, 8, n))
    for step in range(1, 3000):
        x[:, step] = rho * x[:, step - 1] + np.sqrt(1 - rho**2) * x[:, step]
    return x


def check(name: str, pit: Array) -> Check:
    channel = Channel(
        name=name, weights={}, unit="rad/s", latex=r"\dot\theta_1", latex_unit="rad/s"
    )
    return Check(channel=channel, pit=pit, band=ecdf_band(len(pit), 99, 0.005))


def check_case() -> Figure:
    u = np.random.default_rng(4).uniform(size=500)
    return drawn(predictive_figure([check("w_1", u), check("w_2", u**2)]))


def test_no_texts_overlap() -> None:
    def check(n: int) -> None:
        assert list(clashes(rank_case(n, 1.0))) == []
        assert (
            list(clashes(drawn(autocorrelation_figure(chains(0.9, n)[:, :400], SYMBOLS[:n])))) == []
        )
        assert list(clashes(check_case())) == []

    for_each({str(n): (n,) for n in [1, 4, 13]}, check)


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_an_ensemble_that_leaves_the_band_is_drawn_so() -> None:
    assert "leaves the band" not in legend(rank_case(4, 0.0))
    assert "leaves the band" in legend(rank_case(4, 1.0))
    thick = [
        (k, line.get_xydata())
        for k, panel in enumerate(rank_case(4, 1.0).axes)
        for line in panel.get_lines()
        if line.get_linewidth() > 1.5
    ]
    assert {k for k, _ in thick} == {0}
    assert any(
        np.asarray(line)[:, 1].min() < -20 for _, line in thick
    )  # the moved one, in per cent


def test_tau_is_that_of_emcee_and_stands_where_it_is_marked() -> None:
    theta = chains(0.8)
    figure = drawn(autocorrelation_figure(theta, SYMBOLS[:3]))
    found = [float(panel.get_lines()[1].get_xdata()[0]) for panel in figure.axes]
    own = np.mean([emcee.autocorr.integrated_time(chain, quiet=True) for chain in theta], axis=0)
    assert found == pytest.approx(own, rel=0.03)
    assert found == pytest.approx([9.0] * 3, rel=0.1)
    for panel, tau in zip(figure.axes, found, strict=True):
        assert rf"\tau = {tau:.3g}$ steps" in panel.texts[0].get_text()
        assert panel.patches[0].get_width() == pytest.approx(5 * tau, abs=1)  # the window


def test_a_channel_that_is_not_as_predicted_is_named() -> None:
    figure = check_case()
    right = [[text.get_text() for text in panel.texts] for panel in figure.axes[1::2]]
    assert right == [[], ["measured lies below"]]
    areas = [np.sum(p.patches[0].get_data().values) * 0.25 for p in figure.axes[::2]]
    assert areas == pytest.approx([1.0, 1.0])  # all samples are shown


def test_they_are_drawn_on_request_alone(tmp_path: Path) -> None:
    usual = publish.drawn(None)
    assert "corner" in usual
    assert not {"rank", "autocorrelation", "predictive_check"} & {*usual}
    assert publish.drawn(["rank", "corner"]) == ["corner", "rank"]
    for found in style.save(rank_case(1, 0.0), tmp_path, "rank", {}):
        assert found.stat().st_size > 1000
