"""What people are shown is what was found, over the unit of its column or entry; files say SI."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.mathtext import MathTextParser
from support.case_tables import for_each
from support.figure_checks import clashes, drawn, si
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.analysis.calibration import LOG_LIKELIHOOD, Refit, judge_calibration
from bayesdrill.analysis.identifiability.profile import Profile
from bayesdrill.basics import units
from bayesdrill.basics.symbols import latex_unit, unit_product
from bayesdrill.inference.display_units import SI, DisplayUnits
from bayesdrill.report import publish, section, words
from bayesdrill.report.comparison_report import ComparisonReport
from bayesdrill.report.publish import TABLES
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_markdown
from bayesdrill.report.sections import fit_words, physics_words
from bayesdrill.report.sections.comparison_figure import intervals_figure, overlay_corner_figure
from bayesdrill.report.view import ReportContext
from bayesdrill.results.run_folder import Folder
from bayesdrill.rig.models.motor_shaft import MotorShaft
from bayesdrill.sampling.mode_search import LocalMaximum
from bayesdrill.tasks import calibrate, comparison, conclusions, run_entries

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


@dataclass(frozen=True)
class Pair:
    """One chain, seen by a case in users' units and by the same case in SI."""

    own: ReportContext
    plain: ReportContext


@cache
def pair() -> Pair:
    run = users().sample()
    own, plain = (
        conclusions.concluded(conclusions.SampledRun(one.job, run.mode, run.sampled))
        for one in (users(), usual())
    )
    return Pair(own, plain)


def numbers(text: str) -> list[float]:
    return [float(x) for x in re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text)]


# --- beliefs -------------------------------------------------------------------------------------


def test_beliefs_in_users_units_are_those_in_si() -> None:
    """Mutants killed: a `start`, a median or a scale of sigma that is taken for SI."""
    one, other = (each.job.problem.posterior.space for each in (users(), usual()))
    assert one.start == pytest.approx(dict(other.start), rel=1e-9)
    assert one.start["sigma_theta_1"] == pytest.approx(0.03)
    assert one.fixed["L"] == pytest.approx(2.4)


def test_every_prior_of_a_sigma_is_in_the_unit_of_its_column_and_said_so() -> None:
    """Also its start; mutant killed: the words of a prior in SI numbers."""
    cases = [
        {"prior": "log_normal", "median": 2.0, "sd_log": 0.4},
        {"prior": "half_normal", "scale": 2.0},
        {"prior": "normal", "mean": 2.0, "sd": 0.7},
        {"prior": "truncated_normal", "mean": 2.0, "sd": 0.7, "low": 1.5, "high": 3.0},
        {"prior": "uniform", "low": 0.7, "high": 3.0},
        {"prior": "log_uniform", "low": 0.7, "high": 3.0},
    ]

    def check(prior: dict[str, Any]) -> None:
        exact = bd.respond(MotorShaft(), NOMINAL, T, {"v": 8.0}, ["theta_1"])["theta_1"]
        wobble = 0.03 * np.random.default_rng(1).standard_normal(len(T))

        def made(factor: float, unit: str, **begin: float) -> bd.Case:
            scaled = {
                key: x if key in ("prior", "sd_log") else x * math.radians(1.0) / factor
                for key, x in {**prior, **begin}.items()
            }
            channel = bd.Channel((exact + wobble) / factor, unit, scaled)
            parameters = dict.fromkeys(NOMINAL, "nominal") | {
                "k_e": {"prior": "uniform", "low": 0.04, "high": 0.1}
            }
            return bd.case(T, {"theta_1": channel}, {"v": 8.0}, parameters)

        degrees, radians = made(math.radians(1.0), "deg", start=1.9), made(1.0, "rad")
        name = "sigma_theta_1"
        one, other = (each.job.problem.posterior.space for each in (degrees, radians))
        u = np.array([0.03, 0.4, 0.96])
        given = degrees.job.problem.units.prior(name, one.priors[name])
        assert one.priors[name].quantile(u) == pytest.approx(other.priors[name].quantile(u))
        assert given.quantile(u) == pytest.approx(
            other.priors[name].quantile(u) / math.radians(1.0)
        )
        assert one.start[name] == pytest.approx(math.radians(1.9))
        said = given.describe()
        entries = [x for key, x in prior.items() if key != "prior"]
        assert set(entries) <= set(numbers(said.replace(" 0 ", " ")))
        assert f"  {name} [deg]: {said}\n" in degrees.preview()

    for_each({str(prior): (prior,) for prior in cases}, check)


def test_mistakes_of_a_quantity_are_told_in_its_unit(tmp_path: Path) -> None:
    """Mutant killed: the prior is built in SI before it is looked at."""
    wrong = {"prior": "uniform", "low": 80.0, "high": 30.0, "unit": "mm"}
    with pytest.raises(bd.InputError, match="low 80 is not below high 30"):
        bd.case(
            T,
            {"w_1": bd.Channel(T, "rpm", 1.0)},
            {"v": 8.0},
            dict.fromkeys(NOMINAL, "nominal") | {"k_s": "d/L"},
            quantities={"d": wrong, "L": 1.0},
        )


# --- tables and sentences ------------------------------------------------------------------------


def test_tables_show_what_was_found_over_the_unit_of_the_user() -> None:
    """Mutants killed: SI numbers under a user's unit, a unit that is not shown, an sd left in SI."""
    own, plain = pair().own, pair().plain
    for heads, one, other in (
        (
            section.HEADERS,
            *(section.of_rows(v.units.rows(v.analysis.unknowns)).lines for v in (own, plain)),
        ),
        (
            ("", "unit", "nominal", "MAP", "dev. %"),
            *(
                section.of_mode(v.units.rows(section.mode_rows(v.problem, v.mode))).lines
                for v in (own, plain)
            ),
        ),
        (
            ("", "unit", "nominal", "mean", "sd", "94 % HDI", "dev. %", "meaning"),
            *(
                physics_words.derived_table(
                    v.units.rows(v.analysis.derived), v.analysis.meanings
                ).lines
                for v in (own, plain)
            ),
        ),
    ):
        assert [line[0] for line in one] == [line[0] for line in other]
        scaled = {k for k, head in enumerate(heads) if head in ("nominal", "MAP", "mean", "sd")}
        scaled |= {k for k, head in enumerate(heads) if "HDI" in head}
        for mine, theirs in zip(one, other, strict=True):
            factor = FACTORS.get(mine[0], 1.0)
            assert mine[1] == UNITS.get(mine[0], theirs[1])
            for k in range(2, len(heads)):
                if k in scaled:
                    expected = [x / factor for x in numbers(theirs[k])]
                    assert numbers(mine[k]) == pytest.approx(
                        expected, rel=ROUNDED.get(heads[k], 1e-3)
                    )
                else:
                    assert mine[k] == theirs[k]


def test_the_table_for_papers_is_in_these_units() -> None:
    own, plain = pair().own, pair().plain
    texts = [TABLES["table.tex"](view) for view in (own, plain)]
    assert all(text is not None and text.isascii() for text in texts)
    one, other = ([line.split(" & ") for line in str(text).splitlines()[5:-2]] for text in texts)
    for row, mine, theirs in zip(own.analysis.unknowns, one, other, strict=True):
        power, of_si = ([*numbers(cells[1].replace("10^", "")), 0] for cells in (mine, theirs))
        found = 10.0 ** power[0] if "10^" in mine[1] else 1.0
        base = 10.0 ** of_si[0] if "10^" in theirs[1] else 1.0
        if row.name in UNITS:
            assert rf"\mathrm{{{UNITS[row.name]}}}" in mine[1]
        for k in (3, 4):
            expected = [x * base / FACTORS.get(row.name, 1.0) for x in numbers(theirs[k])]
            shown = [x * found for x in numbers(mine[k])]
            assert shown == pytest.approx(expected, rel=5e-2)


def test_sentences_have_the_unit_of_the_user_and_parameters_stay_as_they_are() -> None:
    view = pair().own
    other = LocalMaximum(
        values={**view.mode.values, "sigma_w_1": 2.0, "d": 4e-3}, log_posterior=-9.0
    )
    moved = replace(view.mode, others=(other,))
    said = words.mode(moved, view.units)
    assert "sigma_w_1 19.1 rpm" in said
    assert "d 4 mm" in said
    assert "L = 240 cm" in words.opening(view.problem)
    assert "k_T = 0.12," in words.opening(view.problem)
    pressed = [
        replace(view.analysis.unknowns[0], name="sigma_theta_1", pressed_against=math.radians(0.25))
    ]
    assert "against the end 0.25 deg of its prior" in section.notes(pressed, view.units)[0]
    everything = as_markdown("x", sections(view))
    assert "| sigma_theta_1 | deg |" in everything
    assert "| wide | mm |" in everything


def test_times_are_told_in_the_unit_of_their_column() -> None:
    left = pair().own.analysis.fit[0]
    far = replace(left, farthest=9.0, rms=1.0, time=0.75, limits=replace(left.limits, most=2.0))
    clock = units.display_unit("ms", "s")
    assert "theta_1 9 at 750 ms" in fit_words.residual_sentences([far], clock)


def test_figures_are_of_the_same_draws_in_these_units() -> None:
    """Mutants killed: draws shown in SI, a prior or nominal value left behind."""
    for name in ("trace", "prior_posterior"):
        views = (pair().own, pair().plain)
        one, other = (publish.drawings(name, view)[name].arguments for view in views)
        factors = [FACTORS.get(symbol.name, 1.0) for symbol in other[1].symbols]
        assert one[0] * np.array(factors) == pytest.approx(other[0])
        for mine in one[1].symbols:
            assert mine.latex_unit == UNITS.get(mine.name, mine.latex_unit)
    assert {s.name for s in one[1].symbols} >= {"d", "sigma_w_1"}


# --- several runs --------------------------------------------------------------------------------


def overlaid(first: str, second: str) -> ComparisonReport:
    views = {"own": pair().own, "plain": pair().plain}
    jobs = {"own": users().job, "plain": usual().job}
    shown = comparison.overlay_units([jobs[first], jobs[second]])
    runs = {
        name: conclusions.SampledRun(jobs[name], views[name].mode, views[name].sampled)
        for name in (first, second)
    }
    layers = [comparison.overlay_layer(name, run, shown) for name, run in runs.items()]
    return ComparisonReport(tuple(layers), shown)


def test_runs_are_shown_in_the_units_of_the_first_and_saved_in_si() -> None:
    """Mutants killed: each run in its own unit; the unit of the last; a difference of units alone."""
    mine, theirs = overlaid("own", "plain"), overlaid("plain", "own")
    for report, shown in ((mine, UNITS), (theirs, {})):
        assert "in the unit of the first" in report.texts["overlay.md"]
        lines = [line.split(" | ") for line in report.texts["overlay.md"].splitlines()]
        table = {line[0].removeprefix("| "): line for line in lines if len(line) > 4}
        for row in report.rows:
            name, place = row.symbol.name, row.places[0]
            assert place is not None
            assert table[name][1] == shown.get(name, row.symbol.plain_unit)
            factor = FACTORS[name] if name in shown else 1.0
            for cell in table[name][3:5]:
                assert numbers(cell)[0] == pytest.approx(place.mean / factor, rel=1e-3)
                assert numbers(cell)[1] == pytest.approx(place.sd / factor, rel=5e-2)
        assert "| the noise of" not in report.texts["overlay.md"]
        assert "| sigma_w_1 |" not in report.texts["overlay.md"].split("What differs")[1]
    one, other = (
        {(row["name"], row["run"]): row for row in csv.DictReader(io.StringIO(text))}
        for text in (mine.texts["overlay.csv"], theirs.texts["overlay.csv"])
    )
    assert one == other


def test_axes_of_several_runs_have_the_unit_and_the_logs_of_the_first() -> None:
    """Mutants killed: a plain axis for a log-uniform prior; a bar left in SI."""
    report = overlaid("own", "plain")
    for figure, kind in (
        (intervals_figure(report.layers, report.rows, report.units), "|"),
        (overlay_corner_figure(report.layers, report.rows, report.units), ""),
    ):
        assert list(clashes(drawn(figure))) == []
        labels = {p.get_xlabel(): p for p in figure.axes if p.get_xlabel()}
        (label,) = (text for text in labels if "mathrm{deg}" in text)
        assert any(r"mathrm{mm}" in text for text in labels)
        if kind:
            row = next(r for r in report.rows if r.symbol.name == "sigma_theta_1")
            place = row.places[0]
            assert place is not None
            bar = next(line for line in labels[label].get_lines() if line.get_marker() == kind)
            ends = [si(label, 10.0 ** float(u)) for u in bar.get_xdata()]
            assert ends == pytest.approx(np.degrees([place.low, place.high]))


def test_a_name_of_two_meanings_is_in_si() -> None:
    """Mutant killed: the unit of a length for an angle of the same name."""
    symbols = [replace(s, unit="rad") if s.name == "d" else s for s in usual().job.problem.symbols]
    other = replace(usual().job, problem=replace(usual().job.problem, symbols=tuple(symbols)))
    assert comparison.overlay_units([users().job, usual().job]).factor("d") == 1e-3
    assert comparison.overlay_units([users().job, other]).factor("d") == 1.0


# --- files for machines --------------------------------------------------------------------------


def test_files_for_machines_are_si_whatever_the_units_of_the_config() -> None:
    own, plain = pair().own, pair().plain
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
    """Mutants killed: inputs, densities or times without one."""
    tree = pair().own.tree
    for name, group in tree.children.items():
        assert group.data_vars or name == "constant_data"
        for key, values in group.data_vars.items():
            assert values.attrs["units"], f"{name}/{key}"
        if "time" in group.coords:
            assert group.coords["time"].attrs["units"] == "s"
    assert tree["constant_data"]["v"].attrs["units"] == "V"
    assert tree["log_likelihood"]["w_1"].coords["time"].attrs["units"] == "s"
    assert tree["posterior"]["sigma_w_1"].attrs["units"] == "rad/s"


# --- units ---------------------------------------------------------------------------------------

WRITTEN = {
    "rpm": ("rpm", math.pi / 30),
    "revolution/s": ("revolution/s", 2 * math.pi),
    "deg / ms": ("deg/ms", math.radians(1e3)),
    "\u00b0/s": (r"{{}^{\circ}}/s", math.radians(1.0)),
}


def test_units_of_speeds_are_shown_as_they_are_written() -> None:
    def check(name: str) -> None:
        found = units.display_unit(name, "rad/s")
        assert (found.name, found.latex) == (name, WRITTEN[name][0])
        assert found.factor == pytest.approx(WRITTEN[name][1])

    for_each({str(name): (name,) for name in WRITTEN}, check)


def test_every_unit_is_a_formula_that_fonts_have() -> None:
    """In what LaTeX and matplotlib both read: ASCII, balanced, and parsed."""
    cases = [
        *(
            "m",
            "mm",
            "\u00b5m",
            "\u03bcm",
            "k\u03a9",
            "\u03a9",
            "N\u00b7m",
            "m\u00b2",
            "mN\u22c5m",
            "%",
        ),
        *("kg*m**2/s", "m**(-2)", "1/s", "kg per second", "delta_degC", "ohm", "N*m*s/rad", "GPa"),
    ]

    def check(name: str) -> None:
        found = units.display_unit(name)
        assert found.name == name
        assert found.latex.isascii()
        assert found.latex.count("{") == found.latex.count("}")
        assert not re.search(r"(?<!\\)[%#&$_]", found.latex)
        MathTextParser("path").parse(rf"$\mathrm{{{found.latex}}}$")

    for_each({str(name): (name,) for name in cases}, check)


def test_a_unit_that_formulas_do_not_have_is_shown_in_si() -> None:
    """Mutant killed: its factor with the name of SI."""
    cases = [("\u00c5", "m"), ("\u2113", "m**3")]

    def check(name: str, si_unit: str) -> None:
        found = units.display_unit(name)
        assert (found.name, found.factor, found.latex) == (si_unit, 1.0, latex_unit(si_unit))
        with pytest.raises(ValueError, match="letters"):
            latex_unit(name)
        shown = DisplayUnits({"d": found})
        assert shown.format_value("d", 3e-10) == f"3e-10 {si_unit.replace('**', '^')}"

    for_each({case[0]: case for case in cases}, check)


def test_what_has_no_unit_of_its_own_stays_as_it_is() -> None:
    row = pair().own.analysis.unknowns[0]
    assert row.name == "k_e"
    assert pair().own.units.rows([row]) == (row,)
    assert SI.format_value("k_s", 0.26) == "0.26"
    assert DisplayUnits({"q": units.display_unit("1")}).format_value("q", 0.5) == "0.5"
    assert unit_product(["ohm", "H", "V"], (1, -2, 0)) == "(ohm)*(H)**-2"
    assert unit_product(["ohm", "H"], (0, 1)) == "H"


# --- profiles ------------------------------------------------------------------------------------


def test_a_profile_is_told_and_drawn_in_these_units_as_large_as_the_config_wants(
    tmp_path: Path,
) -> None:
    """Mutants killed: the profile in SI; `output` that the figures of `identify` do not know."""
    line = np.linspace(2.9e-3, 3.1e-3, 9)
    loss = ((line - 3e-3) / 3e-5) ** 2
    known: dict[str, Any] = {"best": 3e-3, "low": 2.94e-3, "high": 3.06e-3, "shape": "bounded"}
    output = users().job.config.output.model_copy(
        update={"formats": ["svg"], "size": "single", "dpi": 90}
    )
    found = replace(
        users().identify(),
        job=users().job.with_settings(output=output),
        profiles=(Profile(name="d", values=line, loss=loss, **known),),
    )
    row = found.text.splitlines()[-1].split()
    assert row[:5] == ["d", "mm", "3", "2.94", "3.06"]
    found.save(tmp_path)
    there = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert there == ["profiles.svg", "spectrum.svg"]
    assert "![profiles](figures/profiles.svg)" in (tmp_path / "identify.md").read_text()
    for name in there:
        text = (tmp_path / "figures" / name).read_text()
        assert float(re.findall(r'width="([\d.]+)pt"', text)[0]) == pytest.approx(3.4 * 72)
    assert "mathrm{mm}" in (tmp_path / "figures" / "profiles.svg").read_text()


def test_a_maximum_is_drawn_in_the_files_that_the_config_wants(tmp_path: Path) -> None:
    output = users().job.config.output.model_copy(update={"formats": ["svg"]})
    job = users().job.with_settings(output=output)
    best = bd.Best(job, pair().own.mode, users().columns)
    best.save(tmp_path / "map")
    assert [p.name for p in (tmp_path / "map" / "figures").iterdir()] == ["fit.svg"]
    told = json.loads((tmp_path / "map" / "run.json").read_text())
    assert "figures/fit.svg" in told["files"]
    assert "figures/fit.svg" in (tmp_path / "map" / "map.md").read_text()


def test_a_calibration_is_drawn_as_large_and_in_the_files_that_the_config_wants(
    tmp_path: Path,
) -> None:
    """Mutants killed: the usual files whatever the config says; files of before that stay."""
    names = [*users().unknowns, LOG_LIKELIHOOD]
    rng = np.random.default_rng(2)
    how: dict[str, Any] = {"r_hat": 1.0, "ess": 500.0, "steps": 800, "reasons": (), "seconds": 0.0}
    refits = [
        Refit(index=k, truth=(0.0,) * 5, ranks=tuple(rng.integers(0, 100, 5).tolist()), **how)
        for k in range(60)
    ]
    verdict = judge_calibration(names, refits, 99)
    for formats, size in ((["png"], "double"), (["svg"], "single")):
        output = users().job.config.output.model_copy(update={"formats": formats, "size": size})
        with Folder(tmp_path, "force", {}, output_files.CALIBRATE) as folder:
            folder.write_run(status="running")
            calibrate._draw(users().job.with_settings(output=output), folder, verdict)
        (file,) = (tmp_path / "figures").iterdir()
        assert file.name == f"calibration.{formats[0]}"
    text = file.read_text()
    assert float(re.findall(r'width="([\d.]+)pt"', text)[0]) == pytest.approx(72 * 3.4)
