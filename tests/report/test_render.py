"""Sections as HTML, Markdown, LaTeX and text: whatever users write stays text."""

import dataclasses
import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from support.case_tables import for_each
from support.html_pages import Page, page

from bayesdrill import output_files
from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.basics.symbols import PARAMETERS, Symbol
from bayesdrill.report import style
from bayesdrill.report.render import as_html
from bayesdrill.report.section import (
    Badge,
    Badges,
    Note,
    Picture,
    Plain,
    Section,
    Sentences,
    Table,
    as_markdown,
    as_text,
)
from bayesdrill.report.sections.parameters import latex_table


def written(text: str, folder: Path) -> tuple[str, str]:
    """A page of HTML and one of Markdown, with `text` in every field that shows one."""
    style.save(Figure(figsize=(3.4, 1.7)), folder, "fit", {}, formats=("png",))
    own = (Symbol("q", "1", f"x_{{{text}}}", "", text), Symbol("lt", "1", r"\lambda", "", ""))
    table = Table(
        ("", text, "verdict"), ((text, text, text), ("q", "lt", "k_s^2")), frozenset((text,))
    )
    blocks = (
        *(
            Sentences(f"{text}\n  - {text}"),
            Note(text),
            Plain(text),
            Plain(text, folded=text),
            table,
        ),
        *(Badges((Badge(text, "bad"),)), Picture("fit", text)),
    )
    said = (Section("the first", blocks), Section(text, (Note("q, lt"),)))
    return as_html(text, text, said, folder, own), as_markdown(text, said)


def test_text_of_users_never_becomes_an_element_of_the_page(tmp_path: Path) -> None:
    """Whatever its fields hold, a page has the same elements with the same attributes."""
    evil = """'"><svg onload=owned=1><script>owned=1</script> & ${7*7} {{ 7*7 }} -->"""
    found, usual = (Page(written(text, tmp_path)[0]) for text in (evil, "said"))

    def elements(html: Page) -> list[tuple[str, list[str]]]:
        return [(tag, sorted(attributes)) for tag, attributes in html.found]

    assert elements(found) == elements(usual)
    assert found.text.count("owned=1") == 2 * (usual.text.count("said"))
    assert "&" not in found.text.replace(" & ", "")


def test_text_of_users_never_becomes_markup_in_markdown(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Nothing begins an element, a column or a line, whatever code and backslashes stand before it."""

    def check(before: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        text = written(f"{before}<svg onload=owned=1>` | ```\n<!-- R-hat <= 1 < 2", tmp_path)[1]
        shown = re.sub(r"^(`{4,})text\n.*?\n\1$", "", text, flags=re.DOTALL | re.MULTILINE)
        assert shown.count("````") == 0
        assert not re.search(r"<[A-Za-z/!?]", shown)
        assert "R-hat <= 1 < 2" in shown
        rows = [line for line in shown.splitlines() if line.startswith("| ")]
        assert [len(re.findall(r"(?<!\\)\|", row)) for row in rows] == [4] * 4

    for_each({before: (before,) for before in ["", "`", "``", "\\\\", "\\\\`", "`a``b` "]}, check)


def test_control_characters_of_users_do_not_reach_a_terminal(tmp_path: Path) -> None:
    table = Table(("", "a\x1b[2J"), (("\x9b31m", "[red]b"),), frozenset())
    said = [Section("", (table, Sentences("x\x1b]0;owned\x07\u202ey")))]
    assert as_text(said) == ("       a [2J\n 31m  [red]b", "x ]0;owned  y")
    assert as_markdown("t", said).replace("\n", "").isprintable()


def test_a_picture_without_its_file_is_left_out(tmp_path: Path) -> None:
    assert not page(Section("s", (Picture("none", "nothing"),)), figures=tmp_path).all("figure")


def test_a_page_embeds_png_or_svg_and_markdown_links_pdf(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:

    def check(formats: tuple[str, ...]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        style.save(Figure(figsize=(3.4, 1.7)), tmp_path, "fit", {}, formats=formats)
        one = Picture("fit", "a fit", output_files.preferred_format(formats))
        (text,) = as_markdown("t", [Section("", (one,))]).splitlines()[-1:]
        html = page(Section("s", (one,)), figures=tmp_path)
        if formats == ("pdf",):
            assert text == "[a fit](figures/fit.pdf)"
            assert not html.all("figure")
            return
        kind = "png" if "png" in formats else "svg"
        assert text == f"![a fit](figures/fit.{kind})"
        image, _ = html.all("img")  # and the one that is enlarged
        assert image["src"].startswith(f"data:image/{kind}")
        assert int(image["width"]) == pytest.approx(2 * int(image["height"]), abs=2)
        assert html.all("figure")[0]["class"] == "tenths-5"  # 3.4 of 7 inches

    for_each(
        {
            str(formats): (formats,)
            for formats in [("pdf", "png"), ("svg",), ("pdf", "svg"), ("pdf",)]
        },
        check,
    )


ROW = ParameterRow(
    name="k_s", unit="N*m/rad", nominal=0.26, map=0.31, mean=0.3, sd=0.0123, hdi_low=0.28,
    hdi_high=0.32, deviation=0.15, r_hat=1.0, ess_bulk=1.0, ess_tail=1.0, shrinkage=0.5,
    word="weak", pressed_against=None,
)  # fmt: skip


def test_the_latex_table_has_the_numbers_to_two_digits_of_the_sd() -> None:
    cases = [(1.0, 0.0123), (1e-4, 0.00123), (3e5, 0.1), (1.0, 2.5e-6), (-2e-7, 0.02)]

    def check(scale: float, sd: float) -> None:
        names = ("nominal", "map", "mean", "hdi_low", "hdi_high")
        values = {name: getattr(ROW, name) * scale for name in names} | {"sd": sd * abs(scale)}
        if scale < 0:
            values["hdi_low"], values["hdi_high"] = values["hdi_high"], values["hdi_low"]
        text = latex_table([dataclasses.replace(ROW, **values)], [PARAMETERS["k_s"]])
        (line,) = (line for line in text.splitlines() if line.startswith("$k_s$"))
        power = re.search(r"10\^\{(-?\d+)\}", line)
        ten = 10.0 ** int(power[1]) if power else 1.0
        found = [
            float(x) for x in re.findall(r"(?<=[{ ])-?\d+(?:\.\d+)?(?=[} ])", line.split("&", 2)[2])
        ]
        shown = dict(
            zip(("nominal", "map", "mean", "sd", "hdi_low", "hdi_high"), found, strict=True)
        )
        for name, value in shown.items():
            assert value * ten == pytest.approx(values[name], abs=0.0501 * values["sd"]), name
        assert r"\mathrm{N\,m/rad}" in line
        assert line.endswith(r"& weak \\")
        assert text.count("\n") == 8

    for_each({str(case): case for case in cases}, check)
