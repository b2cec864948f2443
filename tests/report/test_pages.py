"""The report for eyes: one page that needs nothing beside it, with every cell and sentence on it."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import re
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from support.case_tables import for_each
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.analysis.diagnostics import ParameterRow
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.api.run import RunReport
from bayesdrill.basics.symbols import PARAMETERS, Symbol
from bayesdrill.inference.priors import LogUniform, Uniform
from bayesdrill.report import publish, render, run_report, style
from bayesdrill.report.map_report import MapReport
from bayesdrill.report.render import as_html
from bayesdrill.report.run_report import interval_bar, sections
from bayesdrill.report.scales import Typesetter, printed
from bayesdrill.report.section import (
    Badge,
    Badges,
    IntervalBar,
    Note,
    Picture,
    Plain,
    Section,
    Sentences,
    Table,
    as_markdown,
    as_text,
)
from bayesdrill.report.view import ReportContext

ALONE = frozenset(("meta", "img", "rect", "line", "br"))  # elements without an end

T = np.linspace(0.0, 4.0, 161)


@cache
def run() -> bd.Run:
    """Of a rig whose record says nothing of `c_m`, and whose voltage constant is not the table's."""
    truth = {**NOMINAL, "k_e": 0.055}
    exact = bd.respond("motor_shaft", truth, T, {"v": 6.0}, "w_2")["w_2"]
    noise = 0.1 * np.random.default_rng(6).standard_normal(len(T))
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    case = bd.case(
        T,
        channels={"w_2": bd.Channel(exact + noise, "rad/s", 0.1)},
        inputs={"v": 6.0},
        parameters=dict.fromkeys(NOMINAL, "nominal") | dict.fromkeys(("k_e", "c_m"), box),
        sampler={"ensembles": 4, "walkers": 16, "r_hat": 1.1, "n_tau": 5, "ess": 100},
        seed=3,
    )
    return case.sample()


class Page(HTMLParser):
    """Elements in their order; raises where they do not nest."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict[str, str]]] = []
        self.grids: list[list[list[str]]] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in ALONE:
            self.open.append(tag)
        if tag == "table":
            self.grids.append([])
        if tag == "tr":
            self.grids[-1].append([])
        if tag in ("td", "th"):
            self.grids[-1][-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if {"td", "th"} & set(self.open):
            self.grids[-1][-1][-1] += data.strip("\n")
        if not {"style", "script"} & set(self.open):
            self.text += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.found if name == tag]


def page(*said: Section, figures: Path = Path(), symbols: tuple[Symbol, ...] = ()) -> Page:
    return Page(as_html("a title", "a kind", said, figures, symbols))


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run().save(tmp_path_factory.mktemp("pages") / "mine")


def test_a_run_leaves_a_page_that_needs_nothing_beside_it(saved: Path) -> None:
    """Mutants killed: a picture by its path, a font or a script from elsewhere, two places of a name."""
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


def test_what_matters_most_comes_first_and_ends_a_terminal(saved: Path) -> None:
    html = (saved / "report.html").read_text(encoding="utf-8")
    titles = re.findall(r"<h2>(.*?)</h2>", html)
    first = ["Verdict", "Fit", "Parameters", "Against the nominal table", "Figures"]
    assert titles[: len(first)] == first
    assert titles[-2:] == ["Provenance", "How to cite"]
    said = run().judge().text
    assert said.splitlines()[-1].startswith(("verdict:", "Not determined"))
    assert said.index("the record says") < said.index("fit: ") < said.index("verdict: ")


def test_terminal_markdown_and_page_show_the_same_list(saved: Path) -> None:
    """Mutant killed: a table made anew for one of the three, with cells of its own."""
    html = Page((saved / "report.html").read_text(encoding="utf-8"))
    markdown = (saved / "summary.md").read_text(encoding="utf-8")
    view = run()._view
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


def test_the_marks_say_what_the_verdict_says() -> None:
    view = run()._view
    blocks = [block for section in sections(view) for block in section.blocks]
    (shown,) = (block for block in blocks if isinstance(block, Badges))
    assert {mark.text: mark.tone for mark in shown.items} == {
        "converged": "good",
        "fits: the rest looks like noise": "good",
        "disagrees with tables_2_3": "doubt",
    }
    html = page(*sections(stopped()))
    assert "not converged" in html.text
    assert "disagrees with" not in html.text


def test_a_table_is_in_doubt_where_the_fit_is_no_noise() -> None:
    """Mutant killed: a table that agrees, by a model that the fit speaks against."""
    view = run()._view
    assert view.analysis.judged is not None
    found = view.analysis.judged.verdict
    products = tuple(dataclasses.replace(one, says="agrees") for one in found.products)
    agreeing = dataclasses.replace(found, products=products, parameters=(), joint=0.0)
    said = {}
    for fits in (True, False):
        verdict = dataclasses.replace(agreeing, fits=fits)
        judged = dataclasses.replace(view.analysis.judged, verdict=verdict)
        mark = run_report.run_marks(analysed(view, judged=judged))[-1]
        said[fits] = (mark.text, mark.tone)
    assert said == {True: ("agrees with tables_2_3", "good"), False: ("verdict in doubt", "doubt")}


def analysed(view: ReportContext, **said: object) -> ReportContext:
    """As if this were said of it."""
    analysis = dataclasses.replace(view.analysis, **said)  # type: ignore[arg-type]
    return dataclasses.replace(view, analyse=lambda _: analysis)


def test_figures_of_draws_wait_for_no_analysis() -> None:
    """They are drawn while it is made.  Mutant killed: the corner asks for the products of a verdict."""

    def fail(_: object) -> RunAnalysis:
        raise AssertionError("the analysis is asked for")

    view = dataclasses.replace(run()._view, analyse=fail)
    assert not view.warning
    drawn = [stem for name in output_files.OF_DRAWS for stem in publish.drawings(name, view)]
    assert drawn == ["corner", "trace", "prior_posterior"]


def unfit() -> ReportContext:
    """Of a run that converged to what does not fit."""
    view = run()._view
    return analysed(view, fit=tuple(dataclasses.replace(one, rms=9.0) for one in view.analysis.fit))


def stopped() -> ReportContext:
    view = run()._view
    convergence = dataclasses.replace(view.sampled.convergence, reasons=("too short",))
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
    made: Callable[[], ReportContext], shown: list[str]
) -> None:
    """Mutants killed: a green `converged` beside `does not fit`; what the draws *determine*; reasons of
    the fit alone, or of the sampler.
    """
    view = made()
    assert [(one.text, one.tone) for one in run_report.run_marks(view)] == [
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
    assert run().judge().reasons == ()


def test_a_rig_without_nominal_values_has_no_columns_of_them() -> None:
    """Mutants killed: columns that are empty in every line, on each way to a reader."""
    view = run()._view
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


def test_texts_of_users_stay_texts() -> None:
    """Mutant killed: no escaping, by which a name of a column would be read as HTML."""
    evil = '<script>alert("x")</script> & `<b>`'
    table = Table(("", evil), ((evil, evil),), frozenset())
    said = Section(
        evil,
        (
            Sentences(evil),
            Note(evil),
            Plain(evil, folded=evil),
            table,
            Badges((Badge(evil, "bad"),)),
        ),
    )
    html = page(said)
    assert len(html.all("script")) == 1
    assert not html.all("b")
    assert html.text.count('alert("x")') >= 8


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


def test_no_field_makes_an_element(tmp_path: Path) -> None:
    """Law: whatever stands in the fields of a page, it has the same elements, with the same attributes.

    Mutants killed: the index of a symbol's `latex:` taken as HTML; names of unknowns (`lt`, `amp`)
    looked for in what is escaped already.
    """
    evil = """'"><svg onload=owned=1><script>owned=1</script> & ${7*7} {{ 7*7 }} -->"""
    found, usual = (Page(written(text, tmp_path)[0]) for text in (evil, "said"))

    def elements(html: Page) -> list[tuple[str, list[str]]]:
        return [(tag, sorted(attributes)) for tag, attributes in html.found]

    assert elements(found) == elements(usual)
    assert found.text.count("owned=1") == 2 * (usual.text.count("said"))
    assert "&" not in found.text.replace(" & ", "")


def test_markdown_of_users_stays_text(tmp_path_factory: pytest.TempPathFactory) -> None:
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


def test_a_terminal_is_told_nothing_that_it_obeys(tmp_path: Path) -> None:
    table = Table(("", "a\x1b[2J"), (("\x9b31m", "[red]b"),), frozenset())
    said = [Section("", (table, Sentences("x\x1b]0;owned\x07\u202ey")))]
    assert as_text(said) == ("       a [2J\n 31m  [red]b", "x ]0;owned  y")
    assert as_markdown("t", said).replace("\n", "").isprintable()


def test_names_are_printed_with_their_index_and_kept_in_code() -> None:
    own = (
        Symbol("sigma_w_2", "rad/s", r"\sigma_{\dot\theta_2}", "rad/s", "noise"),
        Symbol("sigma_twist", "rad", r"\sigma_{\mathrm{twist}}", "rad", "noise"),
    )
    typeset = Typesetter(printed(own)).prose
    assert str(typeset("k_T/(r_m k_s)")) == (
        "<var>k<sub>T</sub></var>/(<var>r<sub>m</sub></var> <var>k<sub>s</sub></var>)"
    )
    assert str(typeset("theta_1 in kg m^2")) == "<var>&theta;<sub>1</sub></var> in kg m<sup>2</sup>"
    assert "<sub>&theta;&#775;<sub>2</sub></sub>" in str(typeset("sigma_w_2"))
    assert str(typeset("sigma_twist")) == "<var>&sigma;<sub>twist</sub></var>"
    for name in ("k_s_over_j_1", "tables_2_3", "mean_k_s", "k_s.csv", "k_s2"):
        assert "<var>" not in str(typeset(name)), name
    assert str(typeset("`k_s` is *weak*, **k_s**")) == (
        "<code>k_s</code> is <em>weak</em>, <strong><var>k<sub>s</sub></var></strong>"
    )
    assert str(typeset("5 * k_s * 2")).count("em>") == 0
    assert all(PARAMETERS[name].name in printed() for name in PARAMETERS)


def test_a_picture_without_its_file_is_left_out(tmp_path: Path) -> None:
    assert not page(Section("s", (Picture("none", "nothing"),)), figures=tmp_path).all("figure")


def test_a_page_shows_the_format_that_it_can(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Mutants killed: a page without figures where there is no PNG; a PDF as a picture."""

    def check(formats: tuple[str, ...]) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        style.save(Figure(figsize=(3.4, 1.7)), tmp_path, "fit", {}, formats=formats)
        one = Picture("fit", "a fit", output_files.shown_path(formats))
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

    for_each(
        {
            str(formats): (formats,)
            for formats in [("pdf", "png"), ("svg",), ("pdf", "svg"), ("pdf",)]
        },
        check,
    )


def test_sentences_that_go_on_are_bullets_below() -> None:
    text = "fit: first\n  - more\n  and more\nsecond"
    html = page(Section("Fit", (Sentences(text),)))
    assert len(html.all("li")) == 1 + 4  # of the contents, and ...
    assert "First" in html.text
    assert as_markdown("t", [Section("", (Sentences(text),))]).endswith(
        "- fit: first\n  - more\n  - and more\n- second\n"
    )
    sections = [Section("", (Sentences("page's first"),)), Section("", (Sentences("last"),))]
    assert as_text(sections) == ("last", "page's first")


ROW = ParameterRow(
    name="k_s", unit="N*m/rad", nominal=0.26, map=0.31, mean=0.3, sd=0.0123, hdi_low=0.28,
    hdi_high=0.32, deviation=0.15, r_hat=1.0, ess_bulk=1.0, ess_tail=1.0, shrinkage=0.5,
    word="weak", pressed_against=None,
)  # fmt: skip


def test_bars_stand_on_the_range_of_the_prior_in_logs_where_it_has_decades() -> None:
    plain = interval_bar(ROW, Uniform(0.2, 0.4))
    assert plain.low == pytest.approx((0.28 - 0.2) / 0.2, abs=2e-3)
    assert plain.nominal == pytest.approx((0.26 - 0.2) / 0.2, abs=2e-3)
    logs = interval_bar(ROW, LogUniform(0.01, 10.0))
    assert logs.high == pytest.approx(np.log(32) / np.log(1000), abs=2e-3)
    far = dataclasses.replace(ROW, nominal=2.0)
    wide = interval_bar(far, Uniform(0.2, 0.4))
    assert wide == IntervalBar(wide.low, wide.high, 1.0, wide.best)
    assert max(wide.low, wide.high, wide.best) < 0.1


def test_the_latex_table_has_the_numbers_to_two_digits_of_the_sd() -> None:
    """Mutants killed: a power of ten lost, one column in the place of another."""
    cases = [(1.0, 0.0123), (1e-4, 0.00123), (3e5, 0.1), (1.0, 2.5e-6), (-2e-7, 0.02)]

    def check(scale: float, sd: float) -> None:
        names = ("nominal", "map", "mean", "hdi_low", "hdi_high")
        values = {name: getattr(ROW, name) * scale for name in names} | {"sd": sd * abs(scale)}
        if scale < 0:
            values["hdi_low"], values["hdi_high"] = values["hdi_high"], values["hdi_low"]
        text = render.latex_table([dataclasses.replace(ROW, **values)], [PARAMETERS["k_s"]])
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


def test_provenance_names_seed_versions_record_and_digests(saved: Path) -> None:
    said = as_markdown("t", [run_report.provenance_section(run()._view, saved)])
    for word in ("| seed | 3 |", "numpy 2", "161 samples", "`chain.h5` ", "sampler:"):
        assert word in said, word
