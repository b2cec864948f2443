"""Figures that are drawn when they are asked for: ranks, autocorrelation, predictive check."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import emcee
import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, clashes, drawn

from bayesdrill.analysis.calibration import ecdf_band
from bayesdrill.analysis.diagnostics import rank_histograms
from bayesdrill.analysis.prediction import FrequencyResponse, PredictionCheck
from bayesdrill.basics.symbols import INPUTS
from bayesdrill.basics.units import Unit
from bayesdrill.inference.residual_checks import ResidualCorrelation
from bayesdrill.record.experiment import Channel
from bayesdrill.report import publish, style
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections.convergence_figure import autocorrelation_figure, rank_figure
from bayesdrill.report.sections.fit_figure import (
    frequency_figure,
    predictive_figure,
    residuals_figure,
)

Array = NDArray[np.float64]


@cache
def rank_case(n: int, moved: float) -> Figure:
    x = np.random.default_rng(1).standard_normal((5, 400, n))
    x[3, :, 0] += moved
    return drawn(rank_figure(rank_histograms(x, np.random.default_rng(2)), SYMBOLS[:n]))


def chains(rho: float, n: int = 3) -> Array:
    """First-order autoregressive, `(4, 3000, 8, n)`; tau is `(1 + rho) / (1 - rho)`."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((4, 3000, 8, n))
    for step in range(1, 3000):
        x[:, step] = rho * x[:, step - 1] + np.sqrt(1 - rho**2) * x[:, step]
    return x


def check(name: str, pit: Array) -> PredictionCheck:
    channel = Channel(
        name=name, weights={}, unit="rad/s", latex=r"\dot\theta_1", latex_unit="rad/s"
    )
    return PredictionCheck(channel=channel, pit=pit, band=ecdf_band(len(pit), 99, 0.005))


def check_case() -> Figure:
    u = np.random.default_rng(4).uniform(size=500)
    return drawn(predictive_figure([check("w_1", u), check("w_2", u**2)]))


def channel(name: str = "w_1") -> Channel:
    return Channel(name=name, weights={}, unit="rad/s", latex=r"\dot\theta_1", latex_unit="rad/s")


def correlations_case(width: str, n: int = 2) -> Figure:
    """Of n channels with themselves, and with two inputs; at one lag of one outside."""
    found = []
    for k in range(n):
        for given in ("", "v", "t_1"):
            lags = np.arange(-25 if given else 1, 26)
            values = 0.05 * np.random.default_rng(k).uniform(-1, 1, len(lags))
            values[-3] = -0.4 if given == "v" else values[-3]
            common = {"channel": channel(f"w_{k}"), "step": 0.01}
            sds = np.full(len(lags), 0.03)
            found.append(
                ResidualCorrelation(input=given, lags=lags, values=values, sds=sds, **common)
            )
    return drawn(residuals_figure(found, WIDTHS[width], latex={}))


def response_case(width: str, n: int = 2) -> Figure:
    """A lag; measured where the frequency is at most 10 Hz, 30 degrees and a tenth off."""
    f = np.linspace(0.5, 50, 100)
    model = 20.0 / (1.0 + 1j * f / 5.0)
    measured = np.where(f <= 10, 1.1 * model * np.exp(-1j * np.pi / 6), np.nan)
    one = FrequencyResponse(
        channel=channel(),
        input=INPUTS["v"],
        unit=Unit("V", 1.0, "V"),
        frequencies=f,
        modelled=model,
        measured=measured,
        error=np.full(100, 0.05),
    )
    return drawn(frequency_figure([one] * n, WIDTHS[width]))


def test_no_texts_overlap_in_figures_of_what_is_left() -> None:
    def check(width: str, n: int) -> None:
        assert list(clashes(correlations_case(width, n))) == []
        assert list(clashes(response_case(width, n))) == []

    for_each({f"{w}, {n}": (w, n) for w in WIDTHS for n in (1, 4)}, check)


def test_a_correlation_outside_of_its_band_is_drawn_so() -> None:
    """Mutants killed: inside and outside exchanged; a band of one sd."""
    figure = correlations_case("double")
    thick = {
        k: [segment[1] for segment in lines.get_segments()]
        for k, panel in enumerate(figure.axes)
        for lines in panel.collections
        if isinstance(lines, LineCollection) and lines.get_linewidth()[0] > 1.5
    }
    assert {k: [tuple(end) for end in ends] for k, ends in thick.items() if len(ends)} == {
        1: [(23.0, -0.4)],
        4: [(23.0, -0.4)],
    }
    assert legend(figure) == ["99 % of chance, each lag", "inside", "outside"]


def test_a_response_is_shown_in_its_units_and_where_it_is_measured() -> None:
    figure = response_case("double", 1)
    magnitude, phase = figure.axes
    assert "rad/s/V" in magnitude.get_ylabel()
    model, points = phase.get_lines()
    x, y = model.get_data()
    assert np.asarray(y)[9] == pytest.approx(-45.0, abs=0.5)  # at 5 Hz
    there, measured = (np.asarray(values) for values in points.get_data())
    assert len(there) == 20
    assert measured == pytest.approx(np.asarray(y)[:20] - 30.0, abs=1e-6)
    assert 10 ** np.asarray(x)[0] == pytest.approx(0.5)


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
    usual = publish.wanted_figures(None)
    assert "corner" in usual
    assert not {"rank", "autocorrelation", "predictive_check", "frequency_response"} & {*usual}
    assert publish.wanted_figures(["rank", "corner"]) == ["corner", "rank"]
    for found in style.save(rank_case(1, 0.0), tmp_path, "rank", {}):
        assert found.stat().st_size > 1000
