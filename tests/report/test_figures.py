"""Figures as they are rendered: nothing overlaps, values are where they belong, files are whole."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from numpy.typing import NDArray
from PIL import Image
from support.case_tables import for_each
from support.figure_checks import (
    SYMBOLS,
    TABLE,
    clashes,
    corner_panels,
    displayed,
    drawn,
    mode_of,
    posterior,
    prior_of,
    si,
)

from bayesdrill.basics.symbols import PARAMETERS, Symbol
from bayesdrill.inference.priors import Uniform
from bayesdrill.output_files import FORMATS, formats_of
from bayesdrill.report import scales, style
from bayesdrill.report.sections.corner_figure import corner_figure

Array = NDArray[np.float64]

CASES = {
    "1": ((1,), None),
    "2": ((0, 6), None),
    "9": (range(9), None),
    "13": (range(13), None),
    "1 narrow": ((4,), 1e-5),
    "2 narrow": ((0, 12), 1e-5),
    "9 narrow": (range(9), 1e-5),
}


@cache
def corner_case(name: str) -> tuple[Figure, tuple[Symbol, ...], dict[str, float]]:
    chosen, width = CASES[name]
    columns = list(chosen)
    draws = posterior(1500, width)[:, columns]
    symbols = tuple(SYMBOLS[column] for column in columns)
    mode = mode_of(draws, symbols)
    shown = displayed(symbols, TABLE, mode, {s.name: prior_of(s) for s in symbols})
    figure = corner_figure(draws, shown)
    return drawn(figure), symbols, mode


# Overlaps


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "13")) for n in CASES]
)
def test_no_texts_of_a_corner_overlap(name: str) -> None:
    assert list(clashes(corner_case(name)[0])) == []


# Places


def line(panel: Axes, colour: object, dashes: object, *, upright: bool) -> float | None:
    """Where the line of this look crosses the panel."""
    for candidate in panel.get_lines():
        x, y = (np.asarray(data, dtype=float) for data in candidate.get_data())
        along, across = (y, x) if upright else (x, y)
        if (
            candidate.get_color() == colour
            and candidate.get_linestyle() != "None"
            and candidate.is_dashed()
            and len(x) == 2
            and list(along) == [0, 1]
        ):
            return float(across[0])
    return None


def labels_below(figure: Figure, n: int) -> list[str]:
    return [panel.get_xlabel() for panel in figure.axes[-n:]]


def test_nominal_values_and_map_are_at_their_places() -> None:
    def check(name: str) -> None:
        figure, symbols, mode = corner_case(name)
        n = len(symbols)
        labels = labels_below(figure, n)
        panels = corner_panels(figure)
        for i, j in itertools.product(range(n), range(n)):
            if j > i:
                continue
            panel, x, y = panels[i, j], symbols[j].name, symbols[i].name
            upright = line(panel, style.NOMINAL["color"], None, upright=True)
            assert upright is not None
            assert si(labels[j], upright) == pytest.approx(TABLE[x], rel=1e-9)
            if i == j:
                place = line(panel, style.MAP_COLOUR, None, upright=True)
                assert place is not None
                assert si(labels[j], place) == pytest.approx(mode[x], rel=1e-9)
                continue
            level = line(panel, style.NOMINAL["color"], None, upright=False)
            assert level is not None
            assert si(labels[i], level) == pytest.approx(TABLE[y], rel=1e-9)
            (cross,) = (c for c in panel.get_lines() if c.get_marker() == "+")
            assert si(labels[j], cross.get_xdata()[0]) == pytest.approx(mode[x], rel=1e-9)
            assert si(labels[i], cross.get_ydata()[0]) == pytest.approx(mode[y], rel=1e-9)

    for_each({name: (name,) for name in ["1", "2", "9", "9 narrow"]}, check)


def test_contours_of_nearly_perfect_correlation_are_narrow() -> None:
    """They enclose draws, not bins: across the ridge they are as narrow as the draws."""
    figure = corner_case("2")[0]
    panel = corner_panels(figure)[1, 0]
    j_m, k_s = posterior(1500)[:, [0, 6]].T
    x, y = j_m / 1e-4, k_s
    slope, start = np.polyfit(x, y, 1)
    (contours,) = (c for c in panel.collections if not c.filled)
    moved = contours.get_transform() - panel.transData
    vertices = np.concatenate([moved.transform(p.vertices) for p in contours.get_paths()])
    across = vertices[:, 1] - slope * vertices[:, 0] - start
    assert np.abs(across).max() < 4 * np.std(y - slope * x - start)
    assert np.ptp(vertices[:, 0]) > 2 * np.std(x)


def test_a_flat_density_has_no_contour_and_a_box_is_full_to_its_ends() -> None:
    """Mutants killed: islands of noise; bins and smoothing that reach beyond the end of a prior."""
    rng = np.random.default_rng(5)
    pair, n = (SYMBOLS[0], SYMBOLS[6]), 12_000
    low, high = (np.array([TABLE[s.name] for s in pair]) * share for share in (0.5, 1.5))
    priors = {s.name: Uniform(a, b) for s, a, b in zip(pair, low, high, strict=True)}
    for flat in (True, False):
        share = rng.uniform(size=(n, 2)) if flat else rng.beta(4, 4, (n, 2))
        figure = corner_figure(low + (high - low) * share, displayed(pair, TABLE, {}, priors))
        panels = corner_panels(figure)
        lines = [c for c in panels[1, 0].collections if not c.filled and len(c.get_paths()) > 1]
        assert bool(lines) != flat
        (steps,) = (p for p in panels[0, 0].patches if isinstance(p, StepPatch))
        counts, edges, _ = steps.get_data()
        assert counts.sum() == n
        assert si(panels[1, 0].get_xlabel(), edges[0]) >= low[0] * (1 - 1e-9)
        assert si(panels[1, 0].get_xlabel(), edges[-1]) <= high[0] * (1 + 1e-9)
        if flat:
            assert counts[[0, -1]].min() > 0.7 * np.median(counts)


def test_far_nominal_value_is_pointed_at_and_a_missing_one_is_not() -> None:
    draws = posterior(500, 1e-5)[:, [0, 9]] * np.array([1.2, 1.0])
    figure = drawn(corner_figure(draws, displayed((SYMBOLS[0], SYMBOLS[9]), TABLE, {}, {})))
    first, _, last = figure.axes
    assert [c.get_marker() for c in first.get_lines()] == ["<"]
    assert len(last.get_lines()) == 0
    (legend,) = figure.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert "nominal value, off the axis" in texts
    assert not {"nominal value", "prior", "MAP"} & set(texts)


def test_corner_legend_names_contours_and_interval() -> None:
    (legend,) = corner_case("9")[0].legends
    texts = " ".join(text.get_text() for text in legend.get_texts())
    for part in ("39.3 %", "86.5 %", "94 % interval", "prior", "nominal value", "MAP"):
        assert part in texts


# Numbers on axes


@given(
    st.floats(-1e6, 1e6).filter(lambda x: abs(x) > 1e-7),
    st.floats(-9, 1).map(lambda e: 10.0**e),
)
def test_ticks_are_few_distinct_and_true(middle: float, width: float) -> None:
    low, high = middle - 0.5 * width * abs(middle), middle + 0.5 * width * abs(middle)
    scale = scales.scale(low, high)
    places, texts = scale.ticks()
    assert 2 <= len(places) <= 3
    assert len(set(texts)) == len(texts)
    assert max(map(len, texts)) <= 8
    symbol = PARAMETERS["j_m"]
    for place, text in zip(places, texts, strict=True):
        assert float(text.replace("\N{MINUS SIGN}", "-")) == place
        x = si(scale.label(symbol).replace(" - -", " - "), place) if middle > 0 else None
        if x is not None:
            assert low - 1e-12 * abs(low) <= x <= high + 1e-12 * abs(high)
            np.testing.assert_allclose(float(scale(x)), place, atol=1e-4 * (scale.high - scale.low))


def test_labels_have_power_unit_and_origin() -> None:
    j_m, r_m = PARAMETERS["j_m"], PARAMETERS["r_m"]
    x = Symbol("x", "", "x", "", "")

    def label(what: Symbol, power: int, origin: float = 0.0) -> str:
        return scales.Scale(origin, power, 0.0, 1.0).label(what)

    assert label(j_m, -4) == r"$j_m$ [$10^{-4}\,\mathrm{kg\,m^2}$]"
    assert label(r_m, 0) == r"$r_m$ [$\mathrm{\Omega}$]"
    assert label(j_m, -9, 4e-4).startswith(r"$j_m - 4{\cdot}10^{-4}$ [")
    assert label(x, 0, -63.5) == "$x + 63.5$"
    assert label(x, 0) == "$x$"


# Files


def test_files_are_whole_described_and_the_same_each_time(tmp_path: Path) -> None:
    figure = corner_case("2")[0]
    note = {"Title": "a rig", "Creator": "bayesdrill 1", "Seed": "12"}
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        written = style.save(figure, tmp_path / name, "corner", note, formats=FORMATS)
        assert written == [tmp_path / name / f"corner.{kind}" for kind in FORMATS]
        assert sorted((tmp_path / name).iterdir()) == sorted(written)
    for kind in FORMATS:
        one, two = (
            (tmp_path / name / f"corner.{kind}").read_bytes() for name in ("first", "second")
        )
        assert one == two
    svg = (tmp_path / "first" / "corner.svg").read_text()
    assert "<dc:title>a rig</dc:title>" in svg
    assert "Seed: 12" in svg
    assert "<dc:date>" not in svg
    pdf = (tmp_path / "first" / "corner.pdf").read_bytes()
    assert b"(a rig)" in pdf
    assert b"Seed: 12" in pdf
    assert b"CreationDate" not in pdf
    with Image.open(tmp_path / "first" / "corner.png") as image:
        assert image.text["Seed"] == "12"
        assert image.size[0] == pytest.approx(figure.get_figwidth() * 220, abs=1)


def test_only_the_formats_that_are_asked_for_and_as_fine_as_asked(tmp_path: Path) -> None:
    figure = Figure(figsize=(2, 1))
    assert [path.name for path in style.save(figure, tmp_path, "a", {})] == ["a.pdf", "a.png"]
    (only,) = style.save(figure, tmp_path, "b", {}, formats=["png"], dpi=100)
    with Image.open(only) as image:
        assert image.size == (200, 100)


def test_nothing_is_left_where_drawing_fails(tmp_path: Path) -> None:
    figure = Figure(figsize=(2, 2))
    figure.text(0.5, 0.5, r"$\nosuchcommand$")
    with pytest.raises(ValueError, match="nosuchcommand"):
        style.save(figure, tmp_path, "bad", {})
    assert list(tmp_path.iterdir()) == []


def test_a_run_writes_pdf_of_corner_plots_unless_more_is_asked_for() -> None:
    """Mutants killed: PDF of every figure, or of none; `--pdf` that forgets what a config asks for."""
    assert set(formats_of("corner", None, pdf=False)) == {"pdf", "png"}
    assert formats_of("fit", None, pdf=False) == ("png",)
    assert set(formats_of("fit", None, pdf=True)) == {"pdf", "png"}
    assert formats_of("fit", ["svg"], pdf=True) == ("svg", "pdf")
    assert formats_of("corner", ["svg"], pdf=False) == ("svg",)
