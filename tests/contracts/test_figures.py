"""Every figure of a run is drawn in each width, with words on its axes and in the units of the user.

Nothing overlaps, warnings are on it, and its files are known.
"""

import dataclasses
import pickle
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from support.case_tables import run_cases
from support.command_line import CONFIGS
from support.figure_checks import clashes, drawn
from support.friction_oracle import Rig, simulate
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.basics.findings import Finding
from bayesdrill.config.schema.records import OutputSpec
from bayesdrill.output_files import POSTERIOR
from bayesdrill.report.publish import FIGURES, drawings
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.view import ReportContext

# The drawing of a rig is of trains alone: tests/report/test_rig_drawing.py.
DRAWN = [name for name in FIGURES if name != "rig"]
OWN = [name for name in DRAWN if not name.startswith("toy_")]
T = np.linspace(0.0, 4.0, 161)
CONFIG = (CONFIGS / "other_units.yaml").read_text(encoding="utf-8")
BOX = "{prior: uniform, low: 0.5, high: 1.5, relative: true}"
TORQUE = "missing_torque: {at: rotor_1, size: 0.02, time: 0.5}\n"


@cache
def run(*, missing_torque: bool) -> bd.Run:
    """Sample with time in ms, a twist in degrees, a speed in rpm, a voltage in mV that goes both ways.

    The rig rubs and has one symmetry left, so that every figure has something to show.
    `missing_torque`: without either, by a load of which the config says only that it is missing.
    """
    v = np.where(np.arange(len(T)) // 40 % 2 == 0, 6.0, -6.0)
    truth = Rig(p={**NOMINAL, "t_f": 1e-3, "t_cm": 0.0 if missing_torque else 0.02})
    load = 0.02 * np.sin(3.7 * T) if missing_torque else 0.02
    theta_1, theta_2, _, w_2, _ = simulate(truth, T, v, t_1=load).states.T
    rng = np.random.default_rng(6)
    twist = np.rad2deg(theta_1 - theta_2) + 2.0 * rng.standard_normal(len(T))
    motor = 8 * w_2 * 30 / np.pi + 5.0 * rng.standard_normal(len(T))
    table = np.stack([1e3 * T, twist, motor, 1e3 * v], axis=-1)
    text = CONFIG.replace("BOX", BOX)
    if missing_torque:
        text = CONFIG.replace(" t_cm: 0.02,", "").replace("BOX", "nominal") + TORQUE
        text = text.replace("{value: 20", "{value: 0").replace("k_s: nominal", f"k_s: {BOX}")
    with TemporaryDirectory() as folder:
        record, config = Path(folder) / "other_units.csv", Path(folder) / "other_units.yaml"
        np.savetxt(record, table, delimiter=",", header="t,twist,motor,v", comments="")
        config.write_text(text)
        return bd.load(config).sample()


def with_output(view: ReportContext, **entries: object) -> ReportContext:
    output = view.config.output.model_copy(update=entries)
    config = view.config.model_copy(update={"output": output})
    return dataclasses.replace(view, config=config, analyse=lambda _: view.analysis)


@cache
def view_of(size: str, *, missing_torque: bool) -> ReportContext:
    """Return the view of a run in a size, which has every figure drawn."""
    return with_output(run(missing_torque=missing_torque)._view, figures=DRAWN, size=size)


def figure_of(name: str, view: ReportContext) -> Figure:
    (drawing,) = drawings(name, view).values()
    return drawn(pickle.loads(pickle.dumps(drawing)).drawn())  # as a worker gets it


@cache
def figure_of_run(name: str, size: str) -> Figure:
    torque = name in ("torque", "frequency_response")
    return figure_of(name, view_of(size, missing_torque=torque))


def labels(figure: Figure) -> str:
    return " ".join(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes)


@run_cases("name", DRAWN)
def test_it_is_drawn_and_has_words_on_its_axes(name: str) -> None:
    figure = figure_of_run(name, OutputSpec().size)
    assert figure.axes
    assert labels(figure)
    for end in output_files.FORMATS:
        assert POSTERIOR.is_output(f"{output_files.FIGURES}/{name}.{end}")


@run_cases("size", WIDTHS)
@run_cases("name", OWN)
def test_it_is_as_wide_as_the_config_says_and_nothing_overlaps(name: str, size: str) -> None:
    figure = figure_of_run(name, size)
    assert list(clashes(figure)) == []
    assert figure.get_figwidth() <= WIDTHS[size]


@run_cases("size", WIDTHS)
@run_cases("name", OWN)
def test_it_has_the_units_of_the_user(name: str, size: str) -> None:
    """Those of the record and of its noise."""
    figure = figure_of_run(name, size)
    text = labels(figure)
    assert r"\mathrm{rad}" not in text
    if name in ("corner", "trace", "prior_posterior"):
        assert r"\sigma_{\mathrm{twist}}$" in text
        assert r"\mathrm{deg}" in text
    if name == "frequency_response":
        assert r"\mathrm{rpm/mV}" in text
    if name == "fit":
        for unit in ("deg", "rpm", "ms", "mV"):
            assert rf"\mathrm{{{unit}}}" in text, unit
        shown = [each.get_text() for each in figure.findobj(Text)]
        assert any(r"$t_1 = 20\,\mathrm{mN\,m}$" in each for each in shown)


def test_numbers_in_the_units_of_the_user_are_those_of_the_record() -> None:
    """Data, noise, inputs, draws and priors are all converted."""
    view = run(missing_torque=False)._view
    (drawing,) = drawings("fit", view).values()
    fit, _ = drawing.arguments
    assert fit.t[-1] == pytest.approx(4000.0)
    twist, motor = fit.signals
    assert np.std(twist.y - twist.model) == pytest.approx(2.0, rel=0.2)
    assert np.std(motor.y - motor.model) == pytest.approx(5.0, rel=0.2)
    assert (twist.sigma, motor.sigma) == pytest.approx((2.0, 5.0), rel=0.2)
    assert np.ptp(twist.predictive - twist.model) > 4
    matlab = 1 - np.linalg.norm(twist.y - twist.model) / np.linalg.norm(twist.y - twist.y.mean())
    assert 1 - twist.unexplained == pytest.approx(matlab, rel=1e-6)  # of `compare`
    (course,) = fit.courses
    assert sorted({*course.values}) == [-6000.0, 6000.0]
    shown = view.shown(["sigma_twist"])
    assert np.median(shown.select(view.draws)) == pytest.approx(2.0, rel=0.2)
    prior = shown.priors["sigma_twist"]
    assert (prior.low, prior.high) == pytest.approx((0.05, 50.0))
    assert shown.mode["sigma_twist"] == pytest.approx(twist.sigma)


@run_cases("name", ["corner", "trace", "prior_posterior"])
def test_its_parameters_are_those_that_the_config_names(name: str) -> None:
    view = with_output(run(missing_torque=False)._view, parameters=["sigma_twist"])
    (panel,) = figure_of(name, view).axes
    assert "twist" in panel.get_xlabel() + panel.get_ylabel()


@run_cases("name", ["corner", "fit", "trace"])
def test_in_a_notebook_it_carries_its_warning(name: str) -> None:
    good = run(missing_torque=False)
    assert not any("NOT" in text.get_text() for text in good.plot(name).texts)
    bad = dataclasses.replace(
        good.sampled.convergence, reasons=(Finding("nothing sampled", {"why": "too short"}),)
    )
    unconverged = dataclasses.replace(good.sampled, convergence=bad)
    figure = drawn(dataclasses.replace(good, sampled=unconverged).plot(name))
    assert any(text.get_text() == "NOT CONVERGED" for text in figure.texts)
    assert list(clashes(figure)) == []
