"""What is seen of friction and energy: figures, tables, words; and nothing where nothing rubs."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from oracles import NOMINAL
from pictures import clashes, drawn, si
from rubbing import Rig, simulate
from together import for_each

import bayesdrill as bd
from bayesdrill.analysis.energy import AT_START, CONVERTED, STORED, EnergyPart, energy_accounts
from bayesdrill.inference.step_error import StepError
from bayesdrill.output_files import POSTERIOR
from bayesdrill.report import scales, style
from bayesdrill.report.publish import drawings
from bayesdrill.report.run_report import sections
from bayesdrill.report.section import as_markdown
from bayesdrill.report.sections import physics_words, verdict_words
from bayesdrill.report.sections.fit_figure import fit_figure
from bayesdrill.report.sections.physics_figure import energy_figure, friction_figure, stacked_looks
from bayesdrill.report.sections.physics_words import LawShown, energy_names
from bayesdrill.report.view import ReportContext
from bayesdrill.tasks import run_entries

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
            for name in ["fit", "friction", "energy"]
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


# Energy.


def test_shares_of_the_energy_close() -> None:
    """Mutants killed: a part left out, a part counted on both sides."""
    (account,) = view().chain.energy_accounts
    assert sum(account.came.values())[-1] == pytest.approx(account.total[-1])
    went = sum(account.went.values())
    assert np.abs(went - account.total).max() < 2e-3 * account.total[-1]
    shares = {part.name: part.share for part in account.summary.parts}
    assert sum(shares[name] for name in account.came) == pytest.approx(1.0)
    assert sum(shares[name] for name in account.went) == pytest.approx(1.0, abs=2e-3)
    assert {*account.came} == {"v", CONVERTED}
    assert {*account.went} == {"r_m", "c_m", "friction_m", "friction_1", STORED}
    assert all(part.sd is not None and 0 < part.sd < 0.02 for part in account.summary.parts)
    true = simulate(Rig(p={**NOMINAL, "t_f": 0.0, **TRUTH}), T, V).taken
    total = true["supply"][-1] - true["motor"][-1]
    rubs = shares["friction_m"] + shares["friction_1"]
    assert rubs == pytest.approx(true["friction"][-1] / total, abs=0.02)


def test_a_rig_that_runs_down_brings_its_energy() -> None:
    """What is stored at the start has come in; without draws nothing is said of how sure it is."""
    posterior = view().problem.posterior
    one = posterior.likelihood.observations[0]
    moving = dataclasses.replace(
        one.experiment, start={"w_1": 9.0, "w_2": 9.0}, series={"v": np.zeros(len(T))}
    )
    rig = dataclasses.replace(one, response=one.response.of(moving))
    likelihood = dataclasses.replace(posterior.likelihood, observations=(rig,))
    coasting = dataclasses.replace(posterior, likelihood=likelihood)
    (account,) = energy_accounts(coasting, view().chain.best, np.empty((0, len(view().chain.best))))
    # A motor whose terminals are at no voltage brakes, and its k_T over k_e brakes more.
    assert {*account.came} == {AT_START}
    assert account.summary.parts[0].sd is None
    table = physics_words.energy_table(account.summary, view().problem.model)
    assert table.heads == ("", "", "J", "share")
    assert table.lines[0][:2] == ("in", "stored at the start")


def test_the_figure_of_energy_stacks_to_what_came_in() -> None:
    found = figure("energy")
    joules, shares = found.axes
    (total,) = joules.get_lines()
    (account,) = view().chain.energy_accounts
    assert si(joules.get_ylabel(), total.get_ydata()[-1]) == pytest.approx(account.total[-1])
    tops = [band.get_paths()[0].vertices[:, 1].max() for band in joules.collections]
    assert tops == sorted(tops)
    assert max(tops) == pytest.approx(total.get_ydata().max(), rel=3e-3)
    last = shares.collections[-1].get_paths()[0].vertices[:, 1]
    assert last.max() == pytest.approx(100, abs=1)


def test_parts_are_told_apart_in_grey() -> None:
    """By grey, by hatches, or both; no colour is wanted."""
    (one,) = drawings("energy", view()).values()
    account, model = one.arguments[0], view().problem.model
    seen = stacked_looks(account, energy_names(model)).values()
    assert len({(look["facecolor"], look["hatch"]) for look in seen}) == len(seen)
    assert all(0.0 <= float(look["facecolor"]) <= 1.0 for look in seen)
    more = dict.fromkeys(("j_m", "k_e", "k_T", "l_m", "j_1"), account.went["r_m"])
    parts = [EnergyPart(name=name, joules=1.0, share=0.1, sd=None) for name in more]
    many = dataclasses.replace(
        account,
        came={"v": account.total, AT_START: 0 * account.t},
        went={**account.went, **more},
        summary=dataclasses.replace(account.summary, parts=(*account.summary.parts, *parts)),
    )
    one_column = energy_figure(many, scales.SINGLE, model=model, clock=view().clock)
    assert list(clashes(drawn(one_column))) == []


def test_the_report_has_a_table_of_it() -> None:
    text = as_markdown("x", sections(view()))
    assert "## Where the energy goes" in text
    assert "| out | friction at rotor 1 | " in text
    assert "k_T is not k_e" in text
    (data,) = run_entries.energy_data(view().analysis.energy)
    assert list(data["in"]) == ["conversion", "v"] or list(data["in"]) == ["v", "conversion"]
    assert data["out"]["friction_1"]["share"] > 0.1
    assert json.loads(json.dumps(data)) == data


def test_what_does_not_close_is_said() -> None:
    (account,) = view().analysis.energy
    assert "is in neither" not in physics_words.energy_note(
        dataclasses.replace(account, left=1e-4), view().problem.model
    )
    assert "but 1.2 % of it is in neither" in physics_words.energy_note(
        dataclasses.replace(account, left=0.012), view().problem.model
    )


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
    (data,) = run_entries.step_data([few])
    assert data == {"experiment": "slow", "pieces": 1, "over_sigma": {"w_1": 0.45}}


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
    assert drawings("energy", plain) == {}
    assert plain.chain.energy_accounts == plain.analysis.energy == ()
    assert plain.chain.friction_motions == ()
    assert plain.analysis.step_errors == ()
    text = as_markdown("x", sections(plain))
    assert "energy goes" not in text
    assert "steps: " not in text


def test_its_files_are_known(tmp_path: Path) -> None:
    names = ("friction.pdf", "friction_2.png", "energy.svg", "energy_11.pdf")
    assert all(POSTERIOR.is_output(f"figures/{name}") for name in names)
