"""Files of figures, which figures and formats are written, and warnings upon them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from support.case_tables import for_each
from support.figure_checks import SYMBOLS, TABLE, clashes, displayed, drawn, mode_of, posterior
from support.figure_contexts import corner

from bayesdrill.output_files import FORMATS, formats_of
from bayesdrill.report import publish, scales, style
from bayesdrill.report.sections.corner import corner_figure
from bayesdrill.report.style import warned

WARNING = "DOES NOT FIT: the residuals are far larger than the noise"


# Files


def test_files_are_described_and_the_same_each_time(tmp_path: Path) -> None:
    figure = corner((0, 6))
    note = {"Title": "a rig", "Creator": "bayesdrill 1", "Seed": "12"}
    contents = []
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        written = style.save(figure, folder, "corner", note, formats=FORMATS)
        assert written == [folder / f"corner.{kind}" for kind in FORMATS]
        assert sorted(folder.iterdir()) == sorted(written)
        contents.append({kind: (folder / f"corner.{kind}").read_bytes() for kind in FORMATS})
    first, second = contents
    assert first == second
    for kind, there, date in (
        ("svg", (b"<dc:title>a rig</dc:title>", b"Seed: 12"), b"<dc:date>"),
        ("pdf", (b"(a rig)", b"Seed: 12"), b"CreationDate"),
    ):
        assert all(entry in first[kind] for entry in there)
        assert date not in first[kind]
    with Image.open(tmp_path / "first" / "corner.png") as image:
        assert image.text["Seed"] == "12"
        assert image.size[0] == pytest.approx(figure.get_figwidth() * 220, abs=1)


def test_no_file_is_left_where_drawing_fails(tmp_path: Path) -> None:
    figure = Figure(figsize=(2, 2))
    figure.text(0.5, 0.5, r"$\nosuchcommand$")
    with pytest.raises(ValueError, match="nosuchcommand"):
        style.save(figure, tmp_path, "bad", {})
    assert list(tmp_path.iterdir()) == []


def test_a_run_writes_pdf_of_corner_plots_unless_more_is_asked_for() -> None:
    assert set(formats_of("corner", None, pdf=False)) == {"pdf", "png"}
    assert formats_of("fit", None, pdf=False) == ("png",)
    assert set(formats_of("fit", None, pdf=True)) == {"pdf", "png"}
    assert formats_of("fit", ["svg"], pdf=True) == ("svg", "pdf")
    assert formats_of("corner", ["svg"], pdf=False) == ("svg",)


def test_diagnostic_figures_are_drawn_on_request_alone() -> None:
    usual = publish.wanted_figures(None)
    assert "corner" in usual
    assert not {"rank", "autocorrelation", "predictive_check", "frequency_response"} & {*usual}
    assert publish.wanted_figures(["rank", "corner"]) == ["corner", "rank"]


# Warnings


def figure_of_another_package(inches: float, layout: str | None) -> Figure:
    figure = Figure(figsize=(inches, 3.0), layout=layout)
    figure.subplots().set_title("of another package")
    return figure


def some_corner(inches: float) -> Figure:
    draws, symbols = posterior(1500)[:, :3], SYMBOLS[:3]
    return corner_figure(draws, displayed(symbols, TABLE, mode_of(draws, symbols), {}), inches)


KINDS: dict[str, Callable[[float], Figure]] = {
    "corner": some_corner,
    "plain": lambda inches: figure_of_another_package(inches, None),
    "laid out": lambda inches: figure_of_another_package(inches, "constrained"),
}


def places(figure: Figure) -> np.ndarray:
    """Inches, of panels, legends and dots that stand on the page."""
    drawn(figure)
    boxes = [a.get_window_extent() for a in (*figure.axes, *figure.legends, *figure.artists)]
    return np.array([box.extents for box in boxes]) / figure.dpi


def test_a_warning_stands_on_the_page_and_all_else_keeps_its_place_below() -> None:
    def check(inches: float, kind: str) -> None:
        figure = KINDS[kind](inches)
        before, height = places(figure), figure.get_figheight()
        drawn(warned(figure, WARNING))
        texts = " ".join(text.get_text() for text in figure.texts).replace("\n", " ")
        assert texts.endswith(WARNING)
        assert list(clashes(figure)) == []
        if kind != "laid out":
            np.testing.assert_allclose(places(figure), before, atol=0.02)
        assert figure.get_figheight() > height + 0.2

    widths = (scales.SINGLE, scales.DOUBLE)
    for_each({f"{inches} {kind}": (inches, kind) for inches in widths for kind in KINDS}, check)


def test_without_a_warning_nothing_changes() -> None:
    figure = Figure(figsize=(3, 2))
    assert warned(figure, "") is figure
    assert figure.get_figheight() == 2
    assert not figure.texts
