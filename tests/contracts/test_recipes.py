"""What holds of every figure of a run: it is drawn, in one column or two, with words on its axes and in
the units of the user, says what must not be overlooked, and its files are known."""

from __future__ import annotations

import dataclasses
import pickle
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.case_tables import run_cases
from support.figure_checks import clashes, drawn
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill import output_files
from bayesdrill.output_files import POSTERIOR
from bayesdrill.report.publish import FIGURES, drawings
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.view import ReportContext

DRAWN = [
    name for name in FIGURES if name != "rig"
]  # of trains alone: tests/report/test_rig_drawing.py
OWN = [name for name in DRAWN if not name.startswith("toy_")]
T = np.linspace(0.0, 4.0, 161)
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
FAST = {"ensembles": 4, "walkers": 16, "r_hat": 1.1, "n_tau": 5, "ess": 100}


@cache
def run() -> bd.Run:
    """Of a rig that rubs and has one symmetry left, so that every figure has something to show."""
    truth = {**NOMINAL, "t_cm": 0.02}
    exact = bd.respond("motor_shaft", truth, T, {"v": 6.0}, "w_2")["w_2"]
    noise = 0.1 * np.random.default_rng(6).standard_normal(len(T))
    case = bd.case(
        T,
        channels={"w_2": bd.Channel(exact + noise, "rad/s", 0.1)},
        inputs={"v": 6.0},
        parameters={**dict.fromkeys(NOMINAL, "nominal"), "t_cm": 0.02}
        | dict.fromkeys(("r_m", "k_T", "l_m"), BOX),
        sampler=FAST,
        seed=3,
    )
    return case.sample()


ABROAD = """
name: abroad
seed: 5
record:
  file: abroad.csv
  time: {column: t, unit: ms}
  channels:
    twist:
      column: twist
      unit: deg
      measures: theta_1 - theta_2
      sigma: {prior: log_uniform, low: 0.05, high: 50}
    motor: {column: motor, unit: rpm, measures: 8 * w_2, sigma: 5}
inputs:
  v: {column: v, unit: mV, hold: zero}
  t_1: {value: 20, unit: mN*m}
parameters:
  {j_m: nominal, c_m: nominal, k_e: nominal, k_T: nominal, r_m: nominal, l_m: nominal, j_1: nominal,
  t_f: 1.0e-3, t_cm: 0.02, k_s: {prior: uniform, low: 0.1, high: 0.5}}
sampler: {ensembles: 4, walkers: 16, r_hat: 1.1, n_tau: 5, ess: 100}
"""


TORQUE = "missing_torque: {at: rotor_1, size: 0.02, time: 0.5}\n"


@cache
def abroad(*, shaken: bool = False) -> bd.Run:
    """Time in ms, a twist in degrees, a speed in rpm, a voltage in mV that goes both ways.

    `shaken`: without friction, by a load that the config knows the mean of, and a missing torque.
    """
    v = np.where(np.arange(len(T)) // 40 % 2 == 0, 6.0, -6.0)
    rubs = {} if shaken else {"t_cm": 0.02}
    truth = {**NOMINAL, "t_f": 1e-3, "k_s": 0.29, **rubs}
    inputs = {"v": v, "t_1": 0.02 * (1 + shaken * np.sin(3.7 * T))}
    exact = bd.respond("motor_shaft", truth, T, inputs, ["theta_1", "theta_2", "w_2"])
    rng = np.random.default_rng(6)
    twist = np.rad2deg(exact["theta_1"] - exact["theta_2"]) + 2.0 * rng.standard_normal(len(T))
    motor = 8 * exact["w_2"] * 30 / np.pi + 5.0 * rng.standard_normal(len(T))
    table = np.stack([1e3 * T, twist, motor, 1e3 * v], axis=-1)
    with TemporaryDirectory() as place:
        np.savetxt(
            Path(place) / "abroad.csv", table, delimiter=",", header="t,twist,motor,v", comments=""
        )
        text = ABROAD.replace(" t_cm: 0.02,", "") + TORQUE if shaken else ABROAD
        (Path(place) / "abroad.yaml").write_text(text)
        return bd.load(Path(place) / "abroad.yaml").sample()


def showing(name: str, other: bd.Run) -> ReportContext:
    """Of a run that has what a figure shows: a missing torque, a linear rig under a voltage, or what
    another has; `residuals` of a fit that leaves noise are drawn where they are named.
    """
    view = (abroad(shaken=True) if name in ("torque", "frequency_response") else other)._view
    output = view.config.output.model_copy(update={"figures": [name]})
    return dataclasses.replace(view, config=view.config.model_copy(update={"output": output}))


def sized(view: ReportContext, size: str) -> ReportContext:
    output = view.config.output.model_copy(update={"size": size})
    return dataclasses.replace(view, config=view.config.model_copy(update={"output": output}))


def figure_of(name: str, view: ReportContext) -> Figure:
    (drawing,) = drawings(name, view).values()
    other = pickle.loads(pickle.dumps(drawing))  # as a worker gets it
    return drawn(other.drawn())


@cache
def here(name: str, size: str) -> Figure:
    """Of `run`: drawn once, and looked at by several tests."""
    return figure_of(name, sized(showing(name, run()), size))


def labels(figure: Figure) -> str:
    return " ".join(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes)


@run_cases("name", DRAWN)
def test_it_is_drawn_and_says_what_it_shows(name: str) -> None:
    figure = here(name, showing(name, run()).config.output.size)
    assert figure.axes
    assert labels(figure)
    for end in output_files.FORMATS:
        assert POSTERIOR.is_output(f"{output_files.FIGURES}/{name}.{end}")


@run_cases("size", WIDTHS)
@run_cases("name", OWN)
def test_it_is_as_wide_as_the_config_says(name: str, size: str) -> None:
    figure = here(name, size)
    assert list(clashes(figure)) == []
    assert figure.get_figwidth() <= WIDTHS[size]


@run_cases("size", WIDTHS)
@run_cases("name", [name for name in OWN if name != "ridge"])
def test_it_speaks_the_units_of_the_user(name: str, size: str) -> None:
    """Of the record and of its noise; there is no symmetry left, and no ridge."""
    figure = figure_of(name, sized(showing(name, abroad()), size))
    assert list(clashes(figure)) == []
    said = labels(figure)
    assert r"\mathrm{rad}" not in said
    if name in ("corner", "trace", "prior_posterior"):
        assert r"\sigma_{\mathrm{twist}}$" in said
        assert r"\mathrm{deg}" in said
    if name == "frequency_response":
        assert r"\mathrm{rpm/mV}" in said
    if name == "fit":
        for unit in ("deg", "rpm", "ms", "mV"):
            assert rf"\mathrm{{{unit}}}" in said, unit
        (line,) = figure.texts
        assert r"$t_1 = 20\,\mathrm{mN\,m}$" in line.get_text()


def test_numbers_in_the_units_of_the_user_are_those_of_the_record() -> None:
    """Mutants killed: SI under another unit; a factor upside down; a prior left in SI."""
    view = abroad()._view
    (drawing,) = drawings("fit", view).values()
    fit, _ = drawing.arguments
    assert fit.t[-1] == pytest.approx(4000.0)
    twist, motor = fit.signals
    assert np.std(twist.y - twist.model) == pytest.approx(2.0, rel=0.2)
    assert np.std(motor.y - motor.model) == pytest.approx(5.0, rel=0.2)
    assert (twist.sigma, motor.sigma) == pytest.approx((2.0, 5.0), rel=0.2)
    assert np.ptp(twist.predictive - twist.model) > 4
    spread = np.abs(twist.y - twist.model) @ np.abs(twist.y - twist.model)
    matlab = 1 - np.sqrt(spread / np.sum((twist.y - twist.y.mean()) ** 2))  # of `compare`
    assert 1 - twist.share == pytest.approx(matlab, rel=1e-6)
    (course,) = fit.courses
    assert sorted({*course.values}) == [-6000.0, 6000.0]
    shown = view.shown(["sigma_twist"])
    assert np.median(shown.select(view.draws)) == pytest.approx(2.0, rel=0.2)
    prior = shown.priors["sigma_twist"]
    assert (prior.low, prior.high) == pytest.approx((0.05, 50.0))
    assert shown.mode["sigma_twist"] == pytest.approx(twist.sigma)


def test_parameters_are_those_that_the_config_names() -> None:
    view = abroad()._view
    output = view.config.output.model_copy(update={"parameters": ["sigma_twist"]})
    chosen = dataclasses.replace(view, config=view.config.model_copy(update={"output": output}))
    for name in ("corner", "trace", "prior_posterior"):
        (panel,) = figure_of(name, chosen).axes
        assert "twist" in panel.get_xlabel() + panel.get_ylabel()


@run_cases("name", ["corner", "fit", "trace"])
def test_in_a_notebook_it_carries_its_warning(name: str) -> None:
    """Mutant killed: a warning in files alone."""
    good = abroad()
    assert not any("NOT" in text.get_text() for text in good.plot(name).texts)
    sampled = good.sampled
    bad = dataclasses.replace(sampled.convergence, reasons=("too short",))
    figure = drawn(
        dataclasses.replace(good, sampled=dataclasses.replace(sampled, convergence=bad)).plot(name)
    )
    assert any(text.get_text() == "NOT CONVERGED" for text in figure.texts)
    assert list(clashes(figure)) == []
