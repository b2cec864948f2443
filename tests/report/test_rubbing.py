"""What is seen of friction: figures, words; and nothing where nothing rubs."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from support.case_tables import for_each
from support.figure_checks import clashes, drawn, si
from support.friction_oracle import Rig, simulate
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.inference.step_error import StepError
from bayesdrill.output_files import POSTERIOR
from bayesdrill.report import scales, style
from bayesdrill.report.publish import drawings
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_markdown
from bayesdrill.report.sections import verdict_words
from bayesdrill.report.sections.fit_figure import fit_figure
from bayesdrill.report.sections.physics_figure import friction_figure
from bayesdrill.report.sections.physics_words import LawShown
from bayesdrill.report.view import ReportContext

T = 0.04 * np.arange(250)
V = np.where((T // 2.52) % 2 == 0, 1.0, -1.0) * np.where(T < 5.04, 5.0, 2.5)
TRUTH = {"t_cm": 0.03, "t_c1": 0.2, "t_s1": 0.35, "w_s1": 0.8}
TABLE = {**NOMINAL, "t_cm": 0.033, "t_c1": 0.18, "t_s1": 0.35, "w_s1": 0.8}


@cache
def case() -> bd.Case:
    """Of a rig that rubs at both ends and sticks now and then; its record is the oracle's."""
    moved = simulate(Rig(p={**NOMINAL, "t_f": 0.0, **TRUTH}), T, V)
    noise = np.random.default_rng(4).standard_normal((3, len(T)))
    twist = moved.of("theta_1") - moved.of("theta_2")
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    held = {**dict.fromkeys(NOMINAL, "nominal"), "t_f": 0.0, "t_s1": "nominal", "w_s1": "nominal"}
    return bd.case(
        T,
        channels={
            "twist": bd.Channel(twist + 0.02 * noise[0], "rad", 0.02, measures="theta_1 - theta_2"),
            "w_2": bd.Channel(moved.of("w_2") + 0.1 * noise[1], "rad/s", 0.1),
            "w_1": bd.Channel(moved.of("w_1") + 0.1 * noise[2], "rad/s", 0.1),
        },
        inputs={"v": bd.Input(V, "V")},
        nominal=TABLE,
        parameters=held | dict.fromkeys(("k_s", "t_cm", "t_c1"), box),
        sampler={"ensembles": 4, "walkers": 16, "ess": 100, "n_tau": 10},
        seed=3,
    )


@cache
def view() -> ReportContext:
    return case().sample(processes=1)._view


def figure(name: str, width: float = scales.DOUBLE) -> Figure:
    (one,) = drawings(name, view()).values()
    return drawn(one.figure(one.arguments[0], width))


def test_no_texts_overlap() -> None:
    def check(width: float, name: str) -> None:
        found = figure(name, width)
        assert list(clashes(found)) == []
        assert found.get_figwidth() == width

    for_each(
        {
            f"{width} {name}": (width, name)
            for width in [scales.SINGLE, scales.DOUBLE]
            for name in ["fit", "friction"]
        },
        check,
    )


# Over time.


def panel_of(found: Figure, what: str) -> Axes:
    (panel,) = (p for p in found.axes if what in p.get_ylabel())
    return panel


def test_the_fit_shows_frictions_with_their_bands_and_where_they_stick() -> None:
    """Mutants killed: efforts of another friction, times of sticking by samples."""
    found = figure("fit")
    moved = view().chain.friction_motions[0]
    for rub, what in zip(moved, ("T_m", "T_1"), strict=True):
        panel = panel_of(found, what)
        (line,) = panel.get_lines()
        shown = [si(panel.get_ylabel(), u) for u in line.get_ydata()]
        np.testing.assert_allclose(shown, rub.effort, atol=1e-12)
        assert line.get_drawstyle() == "steps-post"
        hatched = [p for p in panel.patches if p.get_hatch()]
        assert len(hatched) == len(rub.intervals)
        for patch, (begin, end) in zip(hatched, rub.intervals, strict=True):
            assert patch.get_x() == pytest.approx(begin)
            assert patch.get_x() + patch.get_width() == pytest.approx(end)
        (band,) = panel.collections
        edges = band.get_paths()[0].vertices[:, 1]
        low, high = np.quantile(rub.efforts, [0.03, 0.97], axis=0)
        top, foot = (si(panel.get_ylabel(), y) for y in (edges.max(), edges.min()))
        assert (foot, top) == pytest.approx((low.min(), high.max()))
    rotor = moved[1]
    true = simulate(Rig(p={**NOMINAL, "t_f": 0.0, **TRUTH}), T, V)
    assert rotor.stuck == pytest.approx(true.stuck[:, 1].mean(), abs=0.03)
    assert rotor.intervals[0][0] == 0.0
    assert len(rotor.intervals) > 1
    assert moved[0].reversals == 3


def test_a_fit_without_frictions_has_no_panels_of_them() -> None:
    (one,) = drawings("fit", view()).values()
    fit = one.arguments[0]
    none = fit_figure(dataclasses.replace(fit, rubs=()))
    assert len(none.axes) == len(fit_figure(fit).axes) - 2


# Over speed.


def test_a_law_is_drawn_at_the_speeds_of_the_motor_with_map_and_nominal_values() -> None:
    """Mutants killed: speeds of the shaft, nominal values of the MAP."""
    motor, rotor = figure("friction").axes
    best = view().mode.values
    for panel, rub, name in (
        (motor, view().chain.friction_motions[0][0], "t_cm"),
        (rotor, view().chain.friction_motions[0][1], "t_c1"),
    ):
        lines = {line.get_color(): line for line in panel.get_lines() if len(line.get_xdata()) > 9}
        for colour, size in ((style.NOMINAL["color"], TABLE[name]), (style.BLACK, best[name])):
            x, y = lines[colour].get_data()
            far = si(panel.get_ylabel(), y[-1])
            assert far == pytest.approx(size, rel=1e-3)
            assert si(panel.get_ylabel(), y[0]) == pytest.approx(-size, rel=1e-3)
            reach = si(panel.get_xlabel(), x[-1])
            gear = 8 if name == "t_cm" else 1
            assert reach == pytest.approx(1.05 * gear * np.abs(rub.speed).max())
    x, y = rotor.get_lines()[1].get_data()
    just_above = si(rotor.get_ylabel(), y[np.argmax(x > 0)])
    assert just_above == pytest.approx(TRUTH["t_s1"], rel=1e-2)


def test_the_speeds_of_the_record_stand_below() -> None:
    panel = figure("friction").axes[1]
    (steps,) = (p for p in panel.patches if isinstance(p, StepPatch))
    heights, edges, low = steps.get_data()
    counts, _ = np.histogram(
        view().chain.friction_motions[0][1].speed, [si(panel.get_xlabel(), e) for e in edges]
    )
    np.testing.assert_allclose((heights - low) / (heights - low).max(), counts / counts.max())


def test_a_law_without_nominal_values_is_a_line_with_its_band() -> None:
    (one,) = drawings("friction", view()).values()
    law: LawShown = one.arguments[0][0]
    found = drawn(friction_figure([dataclasses.replace(law, nominal=None)]))
    assert list(clashes(found)) == []
    (legend,) = found.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["MAP", "94 % posterior", "speeds of the record"]
    assert len(found.axes[0].get_lines()) == 2


# Steps.


def test_steps_that_are_enough_and_steps_that_are_not() -> None:
    fine = StepError(label="", channels=("w_1", "alpha"), pieces=2, errors=(0.03, 0.004))
    said = verdict_words.step_sentences([fine])
    assert said == (
        "steps: 2 steps to a sample; 16 times as many would move samples by at most 0.03 of the noise "
        "(w_1 0.03, alpha 0.004). That does no harm."
    )
    few = StepError(label="slow", channels=("w_1",), pieces=1, errors=(0.45,))
    said = verdict_words.step_sentences([few])
    assert said.startswith("steps: TOO FEW: one step to a sample in slow; ")
    assert said.endswith("Say `model: {pieces: 8}`.")
    assert verdict_words.steps_wanted(dataclasses.replace(few, pieces=3, errors=(0.11,))) == 6
    assert verdict_words.step_sentences(()) == ""


def test_a_run_and_a_maximum_say_of_their_steps() -> None:
    assert "steps: " in as_markdown("x", sections(view()))
    assert "steps: " in str(case().find_map(processes=1))


# Nothing of it where nothing rubs.


def test_a_rig_that_does_not_rub_has_none_of_it() -> None:
    box = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
    exact = bd.respond("motor_shaft", NOMINAL, T, {"v": 6.0}, "w_2")["w_2"]
    noise = 0.1 * np.random.default_rng(6).standard_normal(len(T))
    case = bd.case(
        T,
        channels={"w_2": bd.Channel(exact + noise, "rad/s", 0.1)},
        inputs={"v": 6.0},
        parameters=dict.fromkeys(NOMINAL, "nominal") | {"k_e": box},
        sampler={"ensembles": 4, "walkers": 16, "ess": 100, "n_tau": 10},
        seed=3,
    )
    plain = case.sample(processes=1)._view
    assert drawings("friction", plain) == {}
    assert plain.chain.friction_motions == ()
    assert plain.analysis.step_errors == ()
    text = as_markdown("x", sections(plain))
    assert "steps: " not in text


def test_its_files_are_known(tmp_path: Path) -> None:
    names = ("friction.pdf", "friction_2.png", "energy.svg", "energy_11.pdf")
    assert all(POSTERIOR.is_output(f"figures/{name}") for name in names)
