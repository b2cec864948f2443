"""Readers are shown results in the units of columns and entries; files for machines say SI."""

import csv
import io
import math
import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser
from support.figure_checks import clashes, drawn, marked, si
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.basics import units
from bayesdrill.basics.symbols import latex_unit
from bayesdrill.inference.display_units import DisplayUnits
from bayesdrill.report import words
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.report.doubts import prior_notes
from bayesdrill.report.publish import TABLES
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_markdown
from bayesdrill.report.sections.convergence import describe_map
from bayesdrill.report.sections.overlay import intervals_figure, overlay_corner_figure
from bayesdrill.report.sections.parameters import HEADERS, mode_rows, of_mode, of_rows
from bayesdrill.report.sections.products import derived_table
from bayesdrill.report.view import ReportContext
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.sampling.mode_search import LocalMaximum
from bayesdrill.tasks import comparison, conclusions, run_entries

T = np.linspace(0.0, 6.0, 121)
FACTORS = {  # of the case in users' units: how many SI each is
    "sigma_theta_1": math.pi / 180,
    "sigma_w_1": math.pi / 30,
    "d": 1e-3,
    "L": 1e-2,
    "wide": 1e-3,
}
UNITS = {"sigma_theta_1": "deg", "sigma_w_1": "rpm", "d": "mm", "L": "cm", "wide": "mm"}
ROUNDED = {"sd": 0.06}  # of two digits, relative; others have four


def case(shown: dict[str, str], factors: dict[str, float]) -> bd.Case:
    """One record and one belief, whatever the units."""

    def over(name: str, *values: float) -> list[float]:
        return [value / factors.get(name, 1.0) for value in values]

    exact = bd.respond(MotorShaft(), NOMINAL, T, {"v": 8.0}, ["theta_1", "w_1"])
    rng, given = np.random.default_rng(3), {}
    for name, sigma, prior in (
        ("theta_1", 0.04, ("log_uniform", "low", 0.002, "high", 0.2, "start", 0.03)),
        ("w_1", 0.3, ("half_normal", "scale", 0.5)),
    ):
        key = f"sigma_{name}"
        entries = dict(zip(prior[1::2], over(key, *map(float, prior[2::2])), strict=True))
        values = (exact[name] + sigma * rng.standard_normal(len(T))) / factors.get(key, 1.0)
        unit = shown.get(key, {"theta_1": "rad", "w_1": "rad/s"}[name])
        given[name] = bd.Channel(values, unit, {"prior": prior[0], **entries})
    (mean, sd), (length,) = over("d", 3e-3, 2e-5), over("L", 2.4)
    d = {"prior": "normal", "mean": mean, "sd": sd, "unit": shown.get("d", "m")}
    return bd.case(
        T,
        channels=given,
        inputs={"v": 8.0},
        parameters=dict.fromkeys(NOMINAL, "nominal")
        | {"k_e": {"prior": "uniform", "low": 0.04, "high": 0.1}, "k_s": "pi*7.9e10*d**4/(32*L)"},
        quantities={"d": d, "L": {"value": length, "unit": shown.get("L", "m")}},
        derived={"wide": {"formula": "2*d", "unit": shown.get("wide", "m")}},
        sampler={"walkers": 16, "r_hat": 1.2, "n_tau": 5, "ess": 100, "max_steps": 1000},
        map={"starts": 1},
        output={"predictive_draws": 10},
    )


@cache
def users() -> bd.Case:
    return case(UNITS, FACTORS)


@cache
def usual() -> bd.Case:
    return case({}, {})


@cache
def views() -> tuple[ReportContext, ReportContext]:
    """Return one chain, seen by a case in users' units and by the same case in SI."""
    run = users().sample()
    own, plain = (
        conclusions.concluded(conclusions.SampledRun(case.job, run.mode, run.sampled))
        for case in (users(), usual())
    )
    return own, plain


def numbers(text: str) -> list[float]:
    return [float(x) for x in re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text)]


# Beliefs


def test_beliefs_in_users_units_are_those_in_si() -> None:
    own, plain = (case.job.problem.posterior.space for case in (users(), usual()))
    assert own.start == pytest.approx(dict(plain.start), rel=1e-9)
    assert own.start["sigma_theta_1"] == pytest.approx(0.03)
    assert own.fixed["L"] == pytest.approx(2.4)


def test_every_prior_of_a_sigma_is_in_the_unit_of_its_column_and_says_so() -> None:
    degree = math.radians(1.0)
    exact = bd.respond(MotorShaft(), NOMINAL, T, {"v": 8.0}, ["theta_1"])["theta_1"]
    record = exact + 0.03 * np.random.default_rng(1).standard_normal(len(T))

    def with_sigma(factor: float, unit: str, sigma: dict[str, Any]) -> bd.Case:
        scaled = {
            key: x if key in ("prior", "sd_log") else x * degree / factor
            for key, x in sigma.items()
        }
        parameters = dict.fromkeys(NOMINAL, "nominal") | {
            "k_e": {"prior": "uniform", "low": 0.04, "high": 0.1}
        }
        channel = bd.Channel(record / factor, unit, scaled)
        return bd.case(T, {"theta_1": channel}, {"v": 8.0}, parameters)

    def check(**prior: Any) -> None:
        degrees = with_sigma(degree, "deg", {**prior, "start": 1.9})
        radians = with_sigma(1.0, "rad", prior)
        name, u = "sigma_theta_1", np.array([0.03, 0.4, 0.96])
        own, plain = (case.job.problem.posterior.space for case in (degrees, radians))
        shown = degrees.job.problem.units.prior(name, own.priors[name])
        assert own.priors[name].quantile(u) == pytest.approx(plain.priors[name].quantile(u))
        assert shown.quantile(u) == pytest.approx(plain.priors[name].quantile(u) / degree)
        assert own.start[name] == pytest.approx(1.9 * degree)
        text = shown.describe()
        entries = {x for key, x in prior.items() if key != "prior"}
        assert entries <= set(numbers(text.replace(" 0 ", " ")))
        assert f"  {name} [deg]: {text}\n" in degrees.preview()

    for prior in (
        {"prior": "log_normal", "median": 2.0, "sd_log": 0.4},
        {"prior": "half_normal", "scale": 2.0},
        {"prior": "normal", "mean": 2.0, "sd": 0.7},
        {"prior": "truncated_normal", "mean": 2.0, "sd": 0.7, "low": 1.5, "high": 3.0},
        {"prior": "uniform", "low": 0.7, "high": 3.0},
        {"prior": "log_uniform", "low": 0.7, "high": 3.0},
    ):
        check(**prior)


# Tables and sentences


def tables(view: ReportContext) -> list[tuple[tuple[str, ...], list[list[str]]]]:
    """Heads and lines of the tables of unknowns, of the mode and of derived quantities."""
    unknowns = of_rows(view.units.rows(view.analysis.unknowns))
    mode = of_mode(view.units.rows(mode_rows(view.problem, view.mode)))
    derived = derived_table(view.units.rows(view.analysis.derived), view.analysis.meanings)
    return [
        (HEADERS, unknowns.lines),
        (("", "unit", "nominal", "MAP", "dev. %"), mode.lines),
        (("", "unit", "nominal", "mean", "sd", "94 % HDI", "dev. %", "meaning"), derived.lines),
    ]


def test_tables_show_results_in_the_unit_of_the_user() -> None:
    with_unit = {"nominal", "MAP", "mean", "sd"}
    for (heads, own), (_, plain) in zip(*map(tables, views()), strict=True):
        for line, line_in_si in zip(own, plain, strict=True):
            name = line[0]
            assert (name, line[1]) == (line_in_si[0], UNITS.get(name, line_in_si[1]))
            for head, cell, in_si in list(zip(heads, line, line_in_si, strict=True))[2:]:
                if head in with_unit or "HDI" in head:
                    expected = [x / FACTORS.get(name, 1.0) for x in numbers(in_si)]
                    assert numbers(cell) == pytest.approx(expected, rel=ROUNDED.get(head, 1e-3))
                else:
                    assert cell == in_si


def test_sentences_have_the_unit_of_the_user_and_parameters_stay_as_they_are() -> None:
    view, _ = views()
    other = LocalMaximum(
        values={**view.mode.values, "sigma_w_1": 2.0, "d": 4e-3}, log_posterior=-9.0
    )
    text = describe_map(replace(view.mode, others=(other,)), view.units)
    assert "sigma_w_1 19.1 rpm" in text
    assert "d 4 mm" in text
    assert "L = 240 cm" in words.opening(view.problem)
    assert "k_T = 0.12," in words.opening(view.problem)
    pressed = [
        replace(view.analysis.unknowns[0], name="sigma_theta_1", pressed_against=math.radians(0.25))
    ]
    assert "against the end 0.25 deg of its prior" in prior_notes(pressed, view.units)[0]
    everything = as_markdown("x", sections(view))
    assert "| sigma_theta_1 | deg |" in everything
    assert "| wide | mm |" in everything


# Several runs


def overlaid(*, users_first: bool) -> ComparisonReport:
    runs = [
        (name, conclusions.SampledRun(case.job, view.mode, view.sampled))
        for name, case, view in zip(("own", "plain"), (users(), usual()), views(), strict=True)
    ]
    runs = runs if users_first else runs[::-1]
    shown = comparison.overlay_units([run.job for _, run in runs])
    layers = [comparison.overlay_layer(name, run, shown) for name, run in runs]
    return ComparisonReport(tuple(layers), shown)


def test_runs_are_shown_in_the_units_of_the_first_and_saved_in_si() -> None:
    """And two runs that differ in units alone are not said to differ."""
    own_first, plain_first = (overlaid(users_first=first) for first in (True, False))
    for report, shown in ((own_first, UNITS), (plain_first, {})):
        assert "in the unit of the first" in report.texts["overlay.md"]
        lines = [line.split(" | ") for line in report.texts["overlay.md"].splitlines()]
        table = {line[0].removeprefix("| "): line for line in lines if len(line) > 4}
        for row in report.rows:
            name, place = row.symbol.name, row.places[0]
            assert table[name][1] == shown.get(name, row.symbol.plain_unit)
            factor = FACTORS[name] if name in shown else 1.0
            for cell in table[name][3:5]:
                assert numbers(cell)[0] == pytest.approx(place.mean / factor, rel=1e-3)
                assert numbers(cell)[1] == pytest.approx(place.sd / factor, rel=5e-2)
        assert "| the noise of" not in report.texts["overlay.md"]
        assert "| sigma_w_1 |" not in report.texts["overlay.md"].split("What differs")[1]
    saved, saved_in_si = (
        {(row["name"], row["run"]): row for row in csv.DictReader(io.StringIO(text))}
        for text in (own_first.texts["overlay.csv"], plain_first.texts["overlay.csv"])
    )
    assert saved == saved_in_si


def test_axes_of_several_runs_have_the_unit_and_the_logs_of_the_first() -> None:
    report = overlaid(users_first=True)
    (row,) = (row for row in report.rows if row.symbol.name == "sigma_theta_1")
    place = row.places[0]
    for draw in (intervals_figure, overlay_corner_figure):
        figure = drawn(draw(report.layers, report.rows, report.units))
        assert list(clashes(figure)) == []
        labels = {p.get_xlabel(): p for p in figure.axes if p.get_xlabel()}
        (label,) = (text for text in labels if "mathrm{deg}" in text)
        assert any(r"mathrm{mm}" in text for text in labels)
        for bar in marked(labels[label], "|")[:1]:
            ends = [si(label, 10.0 ** float(u)) for u in bar.get_xdata()]
            assert ends == pytest.approx(np.degrees([place.low, place.high]))
    assert len(marked(intervals_figure(report.layers, report.rows, report.units).axes[0], "|")) == 2


def test_a_name_that_is_a_length_in_one_run_and_an_angle_in_another_is_in_si() -> None:
    symbols = [replace(s, unit="rad") if s.name == "d" else s for s in usual().job.problem.symbols]
    other = replace(usual().job, problem=replace(usual().job.problem, symbols=tuple(symbols)))
    assert comparison.overlay_units([users().job, usual().job]).factor("d") == 1e-3
    assert comparison.overlay_units([users().job, other]).factor("d") == 1.0


# Files for machines


def test_files_for_machines_are_si_whatever_the_units_of_the_config() -> None:
    own, plain = views()
    for name in ("summary.csv", "derived.csv", "verdict.csv"):
        one, other = (list(csv.DictReader(io.StringIO(TABLES[name](v)))) for v in (own, plain))
        assert one
        for mine, theirs in zip(one, other, strict=True):
            assert mine["unit"] == theirs["unit"] != ""
            assert mine.keys() == theirs.keys()
            for key, text in mine.items():
                if numbers(text) and key not in ("unit", "name", "quantity"):
                    assert float(text) == pytest.approx(float(theirs[key]), rel=1e-6, abs=1e-6)
    expected = {s.name: s.unit for s in own.problem.symbols}
    assert run_entries.entries(own, "")["units"] == expected
    assert expected["sigma_theta_1"] == "rad"


def test_every_variable_of_the_tree_has_a_unit() -> None:
    tree = views()[0].tree
    for name, group in tree.children.items():
        assert group.data_vars or name == "constant_data"
        for key, values in group.data_vars.items():
            assert values.attrs["units"], f"{name}/{key}"
        if "time" in group.coords:
            assert group.coords["time"].attrs["units"] == "s"
    assert tree["constant_data"]["v"].attrs["units"] == "V"
    assert tree["log_likelihood"]["w_1"].coords["time"].attrs["units"] == "s"
    assert tree["posterior"]["sigma_w_1"].attrs["units"] == "rad/s"


# Units


def test_every_unit_is_a_formula_that_fonts_have() -> None:
    """In what LaTeX and matplotlib both read: ASCII, balanced, and parsed."""
    written = (
        "m mm \u00b5m \u03bcm k\u03a9 \u03a9 N\u00b7m m\u00b2 mN\u22c5m % kg*m**2/s m**(-2) 1/s"
    )
    written += " delta_degC ohm N*m*s/rad GPa"
    for name in (*written.split(" "), "kg per second"):
        unit = units.display_unit(name)
        assert unit.name == name
        assert unit.latex.isascii()
        assert unit.latex.count("{") == unit.latex.count("}")
        assert not re.search(r"(?<!\\)[%#&$_]", unit.latex)
        MathTextParser("path").parse(rf"$\mathrm{{{unit.latex}}}$")


def test_a_unit_that_formulas_do_not_have_is_shown_in_si() -> None:
    for name, si_unit in (("\u00c5", "m"), ("\u2113", "m**3")):
        unit = units.display_unit(name)
        assert (unit.name, unit.factor, unit.latex) == (si_unit, 1.0, latex_unit(si_unit))
        with pytest.raises(ValueError, match="letters"):
            latex_unit(name)
        shown = DisplayUnits({"d": unit})
        assert shown.format_value("d", 3e-10) == f"3e-10 {si_unit.replace('**', '^')}"
