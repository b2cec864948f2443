"""Tables of the paper's studies, of numbers that no study has found: each says what it was given."""

import csv
import io
import math
import re
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from decimal import Decimal
from functools import cache

import numpy as np
import pytest
from support.case_tables import run_cases
from support.scipy_oracles import ORDER

from bayesdrill import output_files
from bayesdrill.analysis.verdict import Quantity, Verdict
from bayesdrill.basics.symbols import PARAMETERS, STATES
from bayesdrill.report.sections.fit import Fit
from studies.paper import printed, reproduction
from studies.paper import study_tables as pages
from studies.paper.findings import NineParameterStudy, PaperFindings
from studies.paper.forward import MatrixReading
from studies.paper.printed import FOLLOWING, PRODUCTS, Row
from studies.paper.searches import Heuristic, SearchEnd, Verification
from studies.paper.study_tables import (
    StudyTable,
    lines_2,
    lines_3,
    products,
    ways,
)

RNG = np.random.default_rng(11)
NAMES = ("k_s", "t_f", "j_m", "l_m", "c_m", "k_T", "j_1", "r_m", "k_e")  # in no one's order
CONTROL_SIGMAS = (0.03, 0.4)
RIGS = "table_3 table_3_digits j_2 r_s both k_T"
CAUSES = f"quantity {RIGS} heuristic posterior hdi94_low hdi94_high alone"
NOISES = "row c_m_percent k_e_percent ratio noise_c_m noise_k_e"
ESTIMATES = (
    *("fminsearch", "scaled", "trapezoid_both", "trapezoid_fit"),
    *("weights_only", "weights_only_trapezoid", "posterior"),
)


def uneven() -> float:
    return float(np.exp(1.5 * RNG.standard_normal()))


def filled[T](kind: type[T], **given: object) -> T:
    """With uneven numbers, none like another, for the fields that are not given."""
    hints = typing.get_type_hints(kind)

    def some(name: str) -> object:
        hint = hints[name]
        if isinstance(hint, types.UnionType):
            return uneven()
        return {float: uneven, int: lambda: int(RNG.integers(20, 900)), bool: lambda: True}[hint]()

    own = {f.name: given[f.name] if f.name in given else some(f.name) for f in fields(kind)}
    return kind(**own)


def row(columns: str, **given: object) -> Row:
    """A line of a table, likewise."""
    return {name: given[name] if name in given else uneven() for name in columns.split()}


# PaperFindings made up


def verification() -> Verification:
    truth = np.array([printed.GUESS[name] for name in ("c_m", "k_e")])
    sizes = ("posterior_sd", "bound", "sd_fminsearch", "sd_scaled")
    values = {
        sigma: {
            "truth": truth,
            **{what: truth * (1 + 0.3 * RNG.standard_normal(2)) for what in ESTIMATES},
            **{what: np.array([uneven(), uneven()]) for what in sizes},
        }
        for sigma in printed.TWO_PARAMETERS
    }
    return Verification(
        names=("c_m", "k_e"), records=37, values=values, estimates={}, converged=True
    )


def quantity(exponents: tuple[int, ...], says: str) -> Quantity:
    return filled(
        Quantity,
        exponents=exponents,
        tolerance=(0.0, 0.0),
        deviation=float(RNG.standard_normal()),
        blind=False,
        says=says,
    )


def unit(name: str) -> tuple[int, ...]:
    return tuple(int(name == other) for other in NAMES)


def nine(name: str, truth: np.ndarray | None) -> NineParameterStudy:
    guess = np.array([printed.GUESS[n] for n in NAMES])
    words = {"k_s": "disagrees", "j_1": "agrees", "r_m": "cannot say"}
    product = tuple(a - 2 * b for a, b in zip(unit("k_s"), unit("j_1"), strict=True))
    quantities = [(q, 10 * uneven()) for q in (*PRODUCTS, *FOLLOWING)]
    quantities[3] = (quantities[3][0], math.inf)
    quantities[4] = (quantities[4][0], 0.0123)
    return NineParameterStudy(
        name=name,
        names=NAMES,
        units=tuple(PARAMETERS[name].plain_unit for name in NAMES),
        given=(),
        heuristic=filled(
            Heuristic,
            guess=guess,
            estimate=guess * [uneven() for _ in NAMES],
            misfits=np.ones(3),
            others=guess * np.exp(RNG.standard_normal((6, 9))),
            others_misfits=np.ones(6),
            stepped=guess * [uneven() for _ in NAMES],
        ),
        fit=Fit(t=np.arange(5.0), time=STATES["w_1"], signals=()),
        truth=truth,
        draws=guess * np.exp(0.3 * RNG.standard_normal((400, 9)) + RNG.standard_normal(9)),
        verdict=Verdict(
            names=NAMES,
            parameters=tuple(quantity(unit(n), word) for n, word in words.items()),
            products=(quantity(unit("k_e"), "agrees"), quantity(product, "disagrees")),
            limit=3.7,
            joint=None,
        ),
        misfits=row(
            "record numbers guess heuristic others stepped map truth low high",
            record=name,
            truth=None if truth is None else uneven(),
            numbers=4004,
            map=0.9731,
            high=1.0371,
        ),
        causes=[row(CAUSES, quantity=q, alone=a) for q, a in quantities],
        converged=True,
    )


def ends() -> tuple[SearchEnd, ...]:
    counts = {"fminsearch": (5, 2, 0, 3), "scaled": (7, 6, 4, 5)}
    return tuple(
        filled(
            SearchEnd,
            way=way,
            reached=k < reached,
            best=k < best,
            settled=k < settled,
            scales=(uneven(), -uneven()),
        )
        for way, (n, reached, best, settled) in counts.items()
        for k in range(n)
    )


@cache
def findings() -> PaperFindings:
    truth = np.array([printed.GUESS[n] for n in NAMES]) * [uneven() for _ in NAMES]
    columns = "name matrix time w_2 w_2_trapezoid w_end error steps"
    t = np.arange(3.0)
    return PaperFindings(
        readings=tuple(
            MatrixReading(row=row(columns, name=n, matrix=f"A as {n}", steps=83), t=t, curve=t)
            for n in "ab"
        ),
        errors=[row("channel largest rms steps", channel=c, steps=71) for c in ("theta_1", "w_1")],
        verification=verification(),
        lengths=[
            row("duration rate c_m_percent k_e_percent repeats", duration=d, rate=r)
            for d, r in ((3.0, 70.0), (11.0, 900.0))
        ],
        implied=[row(NOISES, row=r) for r in ("0.001", "rms")],
        searched="one",
        symmetries=(("j_m", "k_T"), ("r_m", "l_m")),
        ends=ends(),
        control=[
            row("sigma parameter largest_percent records", sigma=s, parameter=p, records=12)
            for s in CONTROL_SIGMAS
            for p in ("c_m", "k_e", "t_f")
        ],
        nines=(nine("one", truth), nine("two", None)),
        tones=[
            row("mode distributed lumped", mode=1),
            row("mode distributed lumped", mode=2, lumped=None),
        ],
    )


@cache
def tables() -> dict[str, StudyTable]:
    made = pages.tables(findings())
    found = {table.stem: table for table in made}
    assert len(found) == len(made)
    return found


# What is in the files


def records(stem: str) -> list[dict[str, str]]:
    heads, *rows = csv.reader(io.StringIO(tables()[stem].csv))
    return [dict(zip(heads, row, strict=True)) for row in rows]


def grids(text: str) -> list[tuple[list[str], list[list[str]]]]:
    """Heads and rows of each table in a text of Markdown."""
    found = []
    for block in text.strip().split("\n\n"):
        heads, bar, *rows = (
            [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]
            for line in block.splitlines()
        )
        assert set(bar) == {"---"}
        assert len(bar) == len(heads)
        found.append((heads, rows))
    return found


def agrees(cell: str, value: str, scale: float = 1.0) -> bool:
    """Whether a cell is a value of the CSV, rounded to the digits that it shows, two at least."""
    try:
        exact = scale * float(value)
    except ValueError:
        return cell == value
    if cell.startswith("> "):
        return exact > float(cell[2:])
    shown = Decimal(cell)
    half = 0.5 * 10.0 ** int(shown.as_tuple().exponent)
    return abs(float(shown) - exact) <= min(half, 0.05 * abs(exact)) * (1 + 1e-9)


# Columns of the CSV behind those of each Markdown table; `~`: two of them in one cell, `+`: with its
# unit behind it, `*`: times a number.
NINE_TABLES: Mapping[str, Sequence[str]] = {
    "table_3": (
        "parameter guess printed printed_percent heuristic heuristic_percent stepped "
        "stepped_percent",
        "parameter truth off_percent stepped_off_percent starts_percent posterior "
        "hdi94_low~hdi94_high verdict",
    ),
    "products": (
        "quantity table_3 table_3_digits j_2 r_s both k_T",
        "quantity heuristic posterior hdi94_low~hdi94_high 100*alone",
    ),
    "verdict": ("product deviation_percent sigmas says",),
}
COLUMNS: Mapping[str, Sequence[str]] = {
    "table_1": ("parameter unit printed nominal says",),
    "inconsistencies": ("what printed+unit implied+unit says",),
    "matrix": ("matrix w_2 w_2_trapezoid w_end steps",),
    "integrator": ("channel largest rms steps",),
    "implied": ("row c_m_percent k_e_percent ratio noise_c_m noise_k_e",),
    "lengths": ("duration rate c_m_percent k_e_percent repeats",),
    "simultaneous": (
        "way searches reached best settled misfit_median misfit_worst scale_1 scale_2 rest",
    ),
    "misfits": ("record numbers guess heuristic others stepped map truth low high",),
    "shaft": ("mode distributed lumped",),
    "table_2": (
        "",  # the paper's layout
        "sigma parameter bound_percent spread_fminsearch_percent spread_scaled_percent "
        "posterior_sd_percent weights_only_percent weights_only_trapezoid_percent "
        "trapezoid_fit_percent trapezoid_both_percent",
    ),
    **{f"{s}_{nine}": columns for s, columns in NINE_TABLES.items() for nine in ("one", "two")},
}
IN_ROWS = [(stem, k) for stem, its in COLUMNS.items() for k, names in enumerate(its) if names]


def check(cell: str, name: str, record: Mapping[str, str]) -> None:
    if "~" in name:
        for part, own in zip(cell.split(" to "), name.split("~"), strict=True):
            assert agrees(part, record[own]), (name, cell, record[own])
    elif "+" in name:
        value, unit_ = name.split("+")
        assert agrees(cell.removesuffix(" " + record[unit_]), record[value]), (name, cell)
    else:
        scale, _, own = name.rpartition("*")
        value = record[own]
        assert agrees(cell, value, float(scale or 1)), (name, cell, value)


@run_cases("stem, k", IN_ROWS)
def test_every_row_is_that_of_the_csv_to_the_digits_shown(stem: str, k: int) -> None:
    heads, rows = grids(tables()[stem].markdown)[k]
    names = COLUMNS[stem][k].split()
    assert len(heads) == len(names)
    for row, record in zip(rows, records(stem), strict=True):
        for cell, name in zip(row, names, strict=True):
            check(cell, name, record)


def test_every_table_has_a_cell_below_each_head_and_a_caption() -> None:
    assert set(tables()) == {*COLUMNS, "control"}
    for stem, table in tables().items():
        for text in (table.title, table.says):
            assert text == " ".join(text.split()), stem
            assert "{" not in text
        assert table.says.endswith(".")
        assert table.markdown.endswith("|\n")
        found = grids(table.markdown)
        assert len(found) == len(COLUMNS.get(stem, [""]))
        for heads, rows in found:
            assert rows
            assert all(len(row) == len(heads) for row in rows), stem
        assert records(stem)
        csv_heads = next(csv.reader(io.StringIO(table.csv)))
        assert len(set(csv_heads)) == len(csv_heads)


def test_every_file_is_one_that_a_later_force_knows() -> None:
    drawn = list(reproduction.drawings(findings()))
    written = {f"{stem}.{end}" for stem in tables() for end in ("csv", "md")}
    assert {*written, "report.md", "report.html", *output_files.figure_files(*drawn)} == set(
        reproduction.files_of(("one", "two")).files
    )


def test_the_layout_of_table_2_is_the_papers() -> None:
    (heads, rows), _ = grids(tables()["table_2"].markdown)
    assert heads[2:] == ["c_m", "dev. %", "k_e", "dev. %"]
    found = {(r["sigma"], r["parameter"]): r for r in records("table_2")}
    sigma = ""
    for k, (first, by, *cells) in enumerate(rows):
        assert by == ("paper", "fminsearch", "scaled")[k % 3]
        assert bool(first) == (by == "paper")
        sigma = first or sigma
        kind = "printed" if by == "paper" else by
        for name, value, percent in zip(("c_m", "k_e"), cells[::2], cells[1::2], strict=True):
            (record,) = (r for (s, p), r in found.items() if (float(s), p) == (float(sigma), name))
            assert value.endswith({"c_m": "e-5", "k_e": "e-4"}[name])
            check(value, kind, record)
            check(percent, f"{kind}_percent", record)
    assert len(rows) == 3 * len(printed.TWO_PARAMETERS)


def test_the_control_has_a_column_for_each_noise() -> None:
    ((heads, rows),) = grids(tables()["control"].markdown)
    assert [float(head.removeprefix("noise ")) for head in heads[1:]] == list(CONTROL_SIGMAS)
    found = {(line["parameter"], line["sigma"]): line for line in findings().control}
    assert len(rows) * len(CONTROL_SIGMAS) == len(found) == len(records("control"))
    for name, *cells in rows:
        for cell, sigma in zip(cells, CONTROL_SIGMAS, strict=True):
            assert agrees(cell, str(found[name, sigma]["largest_percent"]))


# What is in the lines


def test_lines_of_table_2_lead_back_to_what_was_found() -> None:
    found = findings().verification
    cells = [(sigma, name) for sigma in found.values for name in found.names]
    for line, (sigma, name) in zip(lines_2(found), cells, strict=True):
        assert (line["sigma"], line["parameter"], line["records"]) == (sigma, name, 37)
        cell = {what: x[found.names.index(name)] for what, x in found.values[sigma].items()}
        one = cell["truth"] / 100
        for what in ESTIMATES[:-1]:
            off = cell[what] - cell["truth"]
            assert line[f"{what}_percent"] * one == pytest.approx(max(off, -off)), what
        assert line["bound_percent"] * one == pytest.approx(cell["bound"])
        assert line["posterior_sd_percent"] * one == pytest.approx(cell["posterior_sd"])
        assert line["spread_fminsearch_percent"] * one == pytest.approx(cell["sd_fminsearch"])
        assert line["spread_scaled_percent"] * one == pytest.approx(cell["sd_scaled"])
        assert line["efficiency_scaled"] * cell["bound"] == pytest.approx(cell["sd_scaled"])
        for what in ("fminsearch", "scaled", "posterior"):
            assert line[what] == cell[what]
        paper = printed.TWO_PARAMETERS[sigma][name]
        assert (line["printed"], line["printed_percent"]) == (paper.value, paper.deviation)


@run_cases("known", [True, False])
def test_lines_of_table_3_lead_back_to_what_was_found(known: bool) -> None:
    found = findings().nines[0 if known else 1]
    lines = lines_3(found)
    assert [line["parameter"] for line in lines] == list(ORDER)
    for line in lines:
        k = NAMES.index(line["parameter"])
        h = found.heuristic
        assert (line["guess"], line["heuristic"], line["stepped"]) == (
            h.guess[k],
            h.estimate[k],
            h.stepped[k],
        )
        moved = {
            h.estimate[k]: line["heuristic_percent"],
            h.stepped[k]: line["stepped_percent"],
            printed.implied(line["parameter"]): line["printed_percent"],
        }
        for value, percent in moved.items():
            assert line["guess"] * (1 + percent / 100) == pytest.approx(value)
        spread = line["starts_percent"] / 100 * line["guess"]
        own = h.others[:, k]
        assert spread**2 * (len(own) - 1) == pytest.approx(((own - own.mean()) ** 2).sum())
        draws = found.draws[:, k]
        assert np.mean(draws < line["posterior"]) == pytest.approx(0.5)
        inside = (line["hdi94_low"] <= draws) & (draws <= line["hdi94_high"])
        assert np.mean(inside) == pytest.approx(0.94, abs=0.005)
        truths = (
            line["truth"],
            line["true_percent"],
            line["off_percent"],
            line["stepped_off_percent"],
        )
        if found.truth is None:
            assert (*truths, line["holds"]) == (None,) * 5
            continue
        truth, true, off, stepped = truths
        assert truth == found.truth[k]
        assert line["guess"] * (1 + true / 100) == pytest.approx(truth)
        assert truth * (1 + off / 100) == pytest.approx(line["heuristic"])
        assert truth * (1 + stepped / 100) == pytest.approx(line["stepped"])
        assert line["holds"] is bool(line["hdi94_low"] <= truth <= line["hdi94_high"])
    if known:
        assert {line["holds"] for line in lines} == {True, False}
    verdicts = {line["parameter"]: line["verdict"] for line in lines if line["verdict"]}
    assert verdicts == {"k_s": "disagrees", "j_1": "agrees", "r_m": "cannot say"}


def test_a_way_without_a_best_end_has_no_scatter() -> None:
    lines = {line["way"]: line for line in ways(findings())}
    none, some = lines["fminsearch"], lines["scaled"]
    assert (none["searches"], none["reached"], none["best"], none["settled"]) == (5, 2, 0, 3)
    assert (some["searches"], some["reached"], some["best"], some["settled"]) == (7, 6, 4, 5)
    assert (none["scale_1"], none["scale_2"], none["rest"], none["distance"]) == (None,) * 4
    own = [end for end in findings().ends if end.way == "scaled"]
    best = own[:4]
    for k, scale in enumerate((some["scale_1"], some["scale_2"])):
        along = np.array([end.scales[k] for end in best])
        assert 4 * scale**2 == pytest.approx(((along - along.mean()) ** 2).sum())
    assert 4 * some["rest"] ** 2 == pytest.approx(sum(end.rest**2 for end in best))
    assert 4 * some["distance"] ** 2 == pytest.approx(sum(end.distance**2 for end in best))
    misfits = sorted(end.misfit for end in own)
    assert (some["misfit_median"], some["misfit_worst"]) == (misfits[3], misfits[-1])
    one = replace(findings(), ends=tuple(replace(end, scales=end.scales[:1]) for end in own))
    (line,) = ways(one)
    assert (line["scale_1"], line["scale_2"]) == (some["scale_1"], None)
    first, _ = records("simultaneous")
    assert [first[name] for name in ("scale_1", "scale_2", "rest", "distance")] == [""] * 4
    ((_, (row, _)),) = grids(tables()["simultaneous"].markdown)
    assert row[-3:] == ["", "", ""]


def test_the_verdict_names_its_products() -> None:
    found = findings().nines[0]
    lines = products(found)
    assert [line["product"] for line in lines] == ["k_e", "k_s/j_1^2"]
    for line, own in zip(lines, found.verdict.products, strict=True):
        assert line["deviation_percent"] / 100 == pytest.approx(own.deviation)
        assert (line["sigmas"], line["says"]) == (own.tension, own.says)


def test_the_words_name_the_worst_parameter_and_count_those_that_are_held() -> None:
    text = reproduction.in_words(findings())
    table_2 = [line for line in text if line.startswith("Table 2")]
    assert len(table_2) == len(printed.TWO_PARAMETERS)
    for line, values in zip(table_2, findings().verification.values.values(), strict=True):
        shown = re.search(r"known to (\S+) %", line)
        assert shown
        assert agrees(shown[1], str(100 * values["bound"][0] / values["truth"][0]))
    first, second = text[len(table_2) :]
    found = lines_3(findings().nines[0])
    worst = max(found, key=lambda line: abs(line["heuristic"] / line["truth"] - 1))
    shown = re.search(r", (\w+) (\S+) % off", first)
    assert shown
    assert agrees(shown[2].removeprefix("+"), str(100 * (worst["heuristic"] / worst["truth"] - 1)))
    assert shown[1] == worst["parameter"]
    assert f"truth of {sum(line['holds'] for line in found)} of 9" in first
    assert "off" not in second


def test_doubts_are_said_in_words_and_above_the_tables_of_their_record() -> None:
    one, two = findings().nines
    bad = replace(one, misfits={**one.misfits, "map": 2716.846, "high": 1.0443})
    lost = replace(two, converged=False)
    whole = replace(findings(), nines=(bad, lost))
    text = reproduction.in_words(whole)
    (poor,) = [line for line in text if "leaves a misfit of" in line]
    assert poor.startswith("one: ")
    assert "2717 per number, where noise leaves at most 1.04" in poor
    (unsure,) = [line for line in text if "did not converge" in line]
    assert unsure.startswith("two: ")
    for table in pages.tables(whole):
        assert ("2717 per number" in table.says) is table.stem.endswith("_one")
        assert ("did not converge" in table.says) is table.stem.endswith("_two")
    assert not [line for line in reproduction.in_words(findings()) if "Careful" in line]
    assert not [table for table in pages.tables(findings()) if "Careful" in table.says]


def test_an_unknown_of_ones_own_has_a_line_after_the_papers_and_what_is_given_is_named() -> None:
    found = findings().nines[0]
    k = NAMES.index("k_s")
    names = tuple("G" if name == "k_s" else name for name in NAMES)
    own = replace(found, names=names, units=("GPa", *found.units[1:]), given=("k_s = 2*G",))
    assert k == 0
    *_, last = lines_3(own)
    assert (last["parameter"], last["unit"], last["printed"], last["printed_percent"]) == (
        "G",
        "GPa",
        None,
        None,
    )
    assert last["heuristic"] == found.heuristic.estimate[k]
    assert [line["parameter"] for line in lines_3(own)][:-1] == [n for n in ORDER if n != "k_s"]
    (table,) = [
        table
        for table in pages.tables(replace(findings(), nines=(own,)))
        if table.stem == "table_3_one"
    ]
    assert "Not searched: k_s = 2*G." in table.says


def test_without_the_integrator_its_cells_are_empty() -> None:
    found = findings().nines[1]
    nothing = replace(found.heuristic, stepped=None, stepped_misfit=None)
    own = replace(found, heuristic=nothing, misfits={**found.misfits, "stepped": None})
    for line in lines_3(own):
        assert (line["stepped"], line["stepped_percent"], line["stepped_off_percent"]) == (
            None,
        ) * 3
    for table in pages.tables(replace(findings(), nines=(own,))):
        assert "None" not in table.csv + table.markdown
