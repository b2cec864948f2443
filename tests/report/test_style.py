"""Files of figures, which figures and formats are written, and warnings upon them."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image
from support.figure_contexts import corner

from bayesdrill.output_files import FORMATS, formats_of
from bayesdrill.report import style

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
