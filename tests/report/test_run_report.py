"""The report of a run: one page that needs nothing beside it, the same list in Markdown and terminal."""

import base64
import dataclasses
import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image
from support import finished_runs
from support.html_pages import Page, page

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.api.run import RunReport
from bayesdrill.basics.findings import Finding
from bayesdrill.report import publish
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import Note, Plain, Table, as_markdown, as_text
from bayesdrill.report.sections.nominal import run_marks
from bayesdrill.report.view import ReportContext


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run with all figures."""
    return finished_runs.run(tmp_path_factory, finished_runs.ALL_FIGURES).folder


@pytest.fixture(scope="module")
def view(saved: Path) -> ReportContext:
    return bd.open(saved)._view


def test_a_run_leaves_a_page_that_needs_nothing_beside_it(saved: Path) -> None:
    html = (saved / "report.html").read_text(encoding="utf-8")
    found = Page(html)
    assert not re.search(
        r"https?:|//[a-z]|url\((?!data:)|@import", re.sub(r'"data:[^"]*"', "", html)
    )
    (policy,) = (m["content"] for m in found.all("meta") if "http-equiv" in m)
    assert policy.startswith("default-src 'none'")
    for what in ("script", "style"):  # the one that is there, and no other
        (own,) = re.findall(f"<{what}>(.*?)</{what}>", html, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()
        assert f"{what}-src 'sha256-{digest}'" in policy
    places = [attributes["id"] for _, attributes in found.found if "id" in attributes]
    assert len(places) == len(set(places))
    links = [a["href"] for a in found.all("a")]
    assert links
    assert {link.removeprefix("#") for link in links} <= set(places)
    pictures = [i for i in found.all("img") if "src" in i]
    drawn = sorted(path.stem for path in (saved / "figures").glob("*.png"))
    assert len(pictures) == len(drawn) >= 4
    inside = [base64.b64decode(i["src"].split(",")[1]) for i in pictures]
    assert sorted(inside) == sorted((saved / f"figures/{stem}.png").read_bytes() for stem in drawn)
    for image, data in zip(pictures, inside, strict=True):
        path = next(p for p in (saved / "figures").glob("*.png") if p.read_bytes() == data)
        with Image.open(path) as opened:
            assert (int(image["width"]), int(image["height"])) == opened.size
        assert len(image["alt"]) > 20


def test_terminal_markdown_and_page_show_the_same_list(saved: Path, view: ReportContext) -> None:
    html = Page((saved / "report.html").read_text(encoding="utf-8"))
    markdown = (saved / "summary.md").read_text(encoding="utf-8")
    flat = re.sub(r"\s+", " ", html.text)
    for section in sections(view):
        for block in section.blocks:
            if isinstance(block, Table):
                shown = next(
                    grid for grid in html.grids if len(grid) == len(block.lines) + 1
                    and [row[-1] for row in grid[1:]] == [line[-1] for line in block.lines]
                )  # fmt: skip
                for line, row in zip(block.lines, shown[1:], strict=True):
                    cells = [row[0], *row[2:]] if block.bars else row
                    assert cells[1:] == [cell.replace("^", "") for cell in line[1:]]
                    assert "| " + " | ".join(line) + " |" in markdown
            if isinstance(block, Plain):
                assert block.text in markdown
                assert block.text in html.text
            if isinstance(block, Note):
                words = re.sub(r"[`*]", "", block.text)
                assert words[:60] in flat


def test_a_nominal_table_is_in_doubt_where_the_model_does_not_fit(view: ReportContext) -> None:
    assert view.analysis.judged is not None
    found = view.analysis.judged.verdict
    products = tuple(dataclasses.replace(one, says="agrees") for one in found.products)
    agreeing = dataclasses.replace(found, products=products, parameters=(), joint=0.0)
    said = {}
    for fits in (True, False):
        verdict = dataclasses.replace(agreeing, fits=fits)
        judged = dataclasses.replace(view.analysis.judged, verdict=verdict)
        mark = run_marks(analysed(view, judged=judged))[-1]
        said[fits] = (mark.text, mark.tone)
    assert said == {
        True: ("agrees with the nominal table (tables_2_3)", "good"),
        False: ("verdict in doubt", "doubt"),
    }


def analysed(view: ReportContext, **said: object) -> ReportContext:
    """As if this were said of it."""
    analysis = dataclasses.replace(view.analysis, **said)  # type: ignore[arg-type]
    return dataclasses.replace(view, analyse=lambda _: analysis)


def test_figures_of_draws_wait_for_no_analysis(view: ReportContext) -> None:
    """They are drawn while it is made."""

    def fail(_: object) -> RunAnalysis:
        raise AssertionError("the analysis is asked for")

    view = dataclasses.replace(view, analyse=fail)
    assert not view.warning
    drawn = [stem for name in output_files.FROM_DRAWS for stem in publish.drawings(name, view)]
    assert drawn == ["corner", "trace", "prior_posterior"]


def unfit(view: ReportContext) -> ReportContext:
    """Return that of a run that converged to what does not fit."""
    return analysed(view, fit=tuple(dataclasses.replace(one, rms=9.0) for one in view.analysis.fit))


def stopped(view: ReportContext) -> ReportContext:
    convergence = dataclasses.replace(
        view.sampled.convergence, reasons=(Finding("nothing sampled", {"why": "too short"}),)
    )
    sampled = dataclasses.replace(view.sampled, convergence=convergence)
    return dataclasses.replace(view, chain=dataclasses.replace(view.chain, sampled=sampled))


@pytest.mark.parametrize(
    ("made", "shown"),
    [
        (unfit, ["does not fit", "converged"]),
        (stopped, ["not converged", "fits: the rest looks like noise"]),
    ],
)
def test_nothing_is_good_about_a_run_that_must_not_be_believed(
    made: Callable[[ReportContext], ReportContext], shown: list[str], view: ReportContext
) -> None:
    assert RunReport(view).reasons == ()
    view = made(view)
    assert [(one.text, one.tone) for one in run_marks(view)] == [
        (shown[0], "bad"),
        (shown[1], "plain"),
    ]
    every, latex_table = sections(view), publish.TABLES["table.tex"](view)
    html = page(*every)
    classes = {c for _, attributes in html.found for c in attributes.get("class", "").split()}
    assert not classes & {"good", "word"}
    terminal = as_text(every)
    for text in (html.text, as_markdown("t", every), "\n".join(terminal), str(latex_table)):
        assert not re.search(r"\bdetermine|\bagrees?\b|the record says", text)
    assert terminal[-1].startswith("verdict: none, because ")
    assert terminal[-2].startswith("DO NOT BELIEVE these numbers")
    assert all(f"  - {reason}" in terminal[-2] for reason in view.reasons)
    assert RunReport(view).reasons == view.reasons


def test_a_rig_without_nominal_values_has_no_columns_of_them(view: ReportContext) -> None:
    rows, derived = (
        tuple(dataclasses.replace(row, nominal=None, deviation=None) for row in every)
        for every in (view.analysis.unknowns, view.analysis.derived)
    )
    problem = dataclasses.replace(view.problem, nominal={}, tolerance={})
    view = dataclasses.replace(view, chain=dataclasses.replace(view.chain, problem=problem))
    view = analysed(view, unknowns=rows, derived=derived, judged=None)
    every, alone = sections(view), MapReport(problem, view.config, view.mode)
    latex_table, machine = (str(publish.TABLES[n](view)) for n in ("table.tex", "summary.csv"))
    shown = (as_markdown("t", every), as_markdown("t", alone.sections), "\n".join(as_text(every)))
    for text in (*shown, page(*every).text, latex_table):
        assert not re.search(r"nominal|dev\. %", text)
    assert "{@{}llrrrl@{}}" in latex_table
    assert {x.count("&") for x in latex_table.splitlines() if x.endswith(r"\\")} == {5}
    assert machine.startswith("name,unit,nominal,map,")
