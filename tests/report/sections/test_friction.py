"""Figures and words of friction, over time and over speed; nothing of it where nothing rubs."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.figure_checks import drawn, si
from support.friction_oracle import Rig, simulate
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.inference.step_error import StepError
from bayesdrill.report import style
from bayesdrill.report.doubts import step_sentences, steps_wanted
from bayesdrill.report.publish import drawings
from bayesdrill.report.run_report import sections
from bayesdrill.report.scales import DOUBLE
from bayesdrill.report.section import as_markdown
from bayesdrill.report.view import ReportContext

T = 0.04 * np.arange(250)
V = np.where((T // 2.52) % 2 == 0, 1.0, -1.0) * np.where(T < 5.04, 5.0, 2.5)
TRUTH = {"t_cm": 0.03, "t_c1": 0.2, "t_s1": 0.35, "w_s1": 0.8}
TABLE = {**NOMINAL, **TRUTH}  # a right table needs no explanation by other physics
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
SAMPLER = {"ensembles": 4, "walkers": 8, "r_hat": 1.1, "ess": 100, "n_tau": 5}


@cache
def case() -> bd.Case:
    """Of a rig that rubs at both ends and sticks now and then; its record is the oracle's."""
    moved = simulate(Rig(p={**NOMINAL, "t_f": 0.0, **TRUTH}), T, V)
    noise = np.random.default_rng(4).standard_normal((3, len(T)))
    twist = moved.of("theta_1") - moved.of("theta_2")
    known = {**dict.fromkeys(NOMINAL, "nominal"), "t_f": 0.0, "t_s1": "nominal", "w_s1": "nominal"}
    return bd.case(
        T,
        channels={
            "twist": bd.Channel(twist + 0.02 * noise[0], "rad", 0.02, measures="theta_1 - theta_2"),
            "w_2": bd.Channel(moved.of("w_2") + 0.1 * noise[1], "rad/s", 0.1),
            "w_1": bd.Channel(moved.of("w_1") + 0.1 * noise[2], "rad/s", 0.1),
        },
        inputs={"v": bd.Input(V, "V")},
        nominal=TABLE,
        parameters=known | dict.fromkeys(("k_s", "t_cm", "t_c1"), BOX),
        sampler=SAMPLER,
        map={"starts": 1},
        seed=3,
    )


@cache
def view() -> ReportContext:
    return case().sample(processes=1)._view


def figure(name: str, width: float = DOUBLE) -> Figure:
    (drawing,) = drawings(name, view()).values()
    return drawn(drawing.figure(drawing.arguments[0], width))


def test_the_fit_shows_frictions_with_their_bands_and_where_they_stick() -> None:
    frictions, panels = view().chain.friction_motions[0], figure("fit").axes
    for friction, symbol in zip(frictions, ("T_m", "T_1"), strict=True):
        (panel,) = (p for p in panels if symbol in p.get_ylabel())
        (line,) = panel.get_lines()
        shown = [si(panel.get_ylabel(), u) for u in line.get_ydata()]
        np.testing.assert_allclose(shown, friction.effort, atol=1e-12)
        assert line.get_drawstyle() == "steps-post"
        hatched = [p for p in panel.patches if p.get_hatch()]
        for patch, (begin, end) in zip(hatched, friction.intervals, strict=True):
            assert patch.get_x() == pytest.approx(begin)
            assert patch.get_x() + patch.get_width() == pytest.approx(end)
        (band,) = panel.collections
        edges = band.get_paths()[0].vertices[:, 1]
        low, high = np.quantile(friction.efforts, [0.03, 0.97], axis=0)
        top, foot = (si(panel.get_ylabel(), y) for y in (edges.max(), edges.min()))
        assert (foot, top) == pytest.approx((low.min(), high.max()))
    motor, rotor = frictions
    true = simulate(Rig(p={**NOMINAL, "t_f": 0.0, **TRUTH}), T, V)
    assert rotor.sticks.mean() == pytest.approx(true.stuck[:, 1].mean(), abs=0.03)
    assert rotor.intervals[0][0] == 0.0
    assert len(rotor.intervals) > 1
    assert motor.reversals == 3


def test_a_law_is_drawn_at_the_speeds_of_the_motor_with_map_and_nominal_values() -> None:
    motor, rotor = figure("friction").axes
    best = view().mode.values
    frictions = view().chain.friction_motions[0]
    for panel, friction, name, gear in (
        (motor, frictions[0], "t_cm", 8),
        (rotor, frictions[1], "t_c1", 1),
    ):
        lines = {line.get_color(): line for line in panel.get_lines() if len(line.get_xdata()) > 9}
        for colour, size in ((style.NOMINAL["color"], TABLE[name]), (style.BLACK, best[name])):
            x, y = lines[colour].get_data()
            ends = [si(panel.get_ylabel(), u) for u in (y[0], y[-1])]
            assert ends == pytest.approx([-size, size], rel=1e-3)
            reach = si(panel.get_xlabel(), x[-1])
            assert reach == pytest.approx(1.05 * gear * np.abs(friction.speed).max())
    x, y = rotor.get_lines()[1].get_data()
    just_above = si(rotor.get_ylabel(), y[np.argmax(x > 0)])
    assert just_above == pytest.approx(TRUTH["t_s1"], rel=1e-2)


def test_numbers_of_steps_are_said_to_be_enough_or_too_few() -> None:
    fine = StepError(label="", channels=("w_1", "alpha"), pieces=2, errors=(0.03, 0.004))
    assert step_sentences([fine]) == (
        "steps: 2 steps to a sample; 16 times as many would move samples by at most 0.03 of the noise "
        "(w_1 0.03, alpha 0.004). That is harmless."
    )
    both = [fine, dataclasses.replace(fine, label="b", errors=(0.01, 0.04))]
    assert "a sample in b, the worst of 2 experiments; " in step_sentences(both)
    few = StepError(label="slow", channels=("w_1",), pieces=1, errors=(0.45,))
    sentences = step_sentences([few])
    assert sentences.startswith("steps: TOO FEW: one step to a sample in slow; ")
    assert sentences.endswith("Say `model: {pieces: 8}`.")
    assert steps_wanted(dataclasses.replace(few, pieces=3, errors=(0.11,))) == 6
    assert step_sentences(()) == ""
    assert "steps: " in as_markdown("x", sections(view()))
    assert "steps: " in str(case().find_map(processes=1))
