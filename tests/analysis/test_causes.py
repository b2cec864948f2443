"""Candidates that would explain a bad fit: the right one is first, with its size, and mends it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.case_tables import slow_except
from support.command_line import CONFIGS, ROOT
from support.missing_physics import SIGMA, T, record
from support.scipy_oracles import NOMINAL
from support.unexplained_records import amended, causes_of, fits, try_only, write

import bayesdrill as bd
from bayesdrill.analysis.causes import Cause, Causes
from bayesdrill.basics.progress import SILENT
from bayesdrill.report.sections.causes import describe_causes, lacking, wandering
from bayesdrill.rig.models.roles import usual_roles
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import ranking
from bayesdrill.tasks.ranking import WINDOWS, Ranking

CONFIG = (CONFIGS / "unexplained.yaml").read_text(encoding="utf-8")
BOX = "{prior: uniform, low: 0.3, high: 3, relative: true}"


def rig(
    folder: Path,
    lacks: Mapping[str, Any] | None = None,
    *,
    known_noise: bool = True,
    glitch: float = 0.0,
    supply_drifts_to: float = 1.0,
    **added: float,
) -> Path:
    """Write the config of a rig without what it `lacks`, and with parameters that are `added`.

    One sample is off by a `glitch`, in sigmas; the record shows the voltage too large by a factor
    that grows from 1 to `supply_drifts_to`.
    """
    more = {"added": {}, **(lacks or {})}
    seen = record(more.pop("added"), **more)
    entries = "".join(f", {name}: {value}" for name, value in added.items())
    text = CONFIG.replace("BOX", BOX).replace("ADDED", entries)
    for k, sigma in enumerate(SIGMA):
        wide = f"{{prior: log_uniform, low: {sigma / 30}, high: {sigma * 30}}}"
        text = text.replace(f"SIGMA_{k}", str(sigma) if known_noise else wide)
    alpha, w_2 = seen.y.T.copy()
    alpha[150] += glitch * SIGMA[0]
    v = seen.series["v"] * np.linspace(1.0, supply_drifts_to, len(T))
    return write(folder, text, {"t": T, "v": v, "alpha": alpha, "w_2": w_2})


def causes_that_mend(path: Path) -> tuple[Causes, Cause]:
    """Return the causes and the best of them, whose config lines must leave only noise."""
    causes = causes_of(bd.load(path))
    assert fits(amended(path, causes.best.lines))
    return causes, causes.best


def check_words(causes: Causes, first: Cause) -> None:
    text = describe_causes(causes)
    assert f"fit: A is the config with {first.words[0]}" in text
    assert "next: add these lines to the config (A" in text
    assert "That leaves what looks like the noise." in text
    assert f"\n{first.lines}\n" in text
    assert bool(lacking(causes, usual_roles())) == bool(first.lacks)


# Candidates that are refitted by a quick test; all are where none is named.
SOME = ("offset_alpha", "gain_w_2", "ar1")
COASTED = ("free_start", "friction_motor")
# What is wrong, the part that says so, its unknown and the truth.
WRONG: Mapping[str, tuple[Mapping[str, Any], str, str, float]] = {
    "lag": ({"late": 3}, "lag_alpha", "lag_alpha", 0.03),
    "offset": ({"offset": 0.4}, "offset_alpha", "offset_alpha", 0.4),
    "gain": ({"gain": 0.8}, "gain_alpha", "gain_alpha", 0.8),
    "input offset": ({"supply": -0.6}, "offset_v", "offset_v", -0.6),
    "friction": ({"added": {"t_c1": 0.25}}, "friction_rotor_1", "t_c1", 0.25),
    "voltage drop": ({"added": {"v_d": 0.8}}, "voltage_drop", "v_d", 0.8),
    "damping": ({"added": {"c_1": 0.02}}, "damping_rotor_1", "c_1", 0.02),
    "damping of the shaft": ({"added": {"c_s": 5e-3}}, "damping_shaft", "c_s", 5e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("known_noise", [True, False])
@pytest.mark.parametrize("name", WRONG)
def test_the_cause_is_first_with_its_size(name: str, known_noise: bool, tmp_path: Path) -> None:
    """What sensors explain is not blamed on the rig; with noise levels that are known or not."""
    lacks, part, unknown, truth = WRONG[name]
    causes, first = causes_that_mend(rig(tmp_path, lacks, known_noise=known_noise))
    if name == "gain":  # either channel may be off, as the constants of the motor are unknown
        assert first.parts in (("gain_alpha",), ("gain_w_2",))
        return
    assert first.parts == (part,)
    assert first.explains_all
    if causes.ranked[0] is first:
        assert all(len(one.parts) == 1 for one in causes.ranked)  # nothing more is needed
    (new,) = first.new
    assert new.name == unknown
    assert new.value == pytest.approx(truth, abs=max(5 * new.sd, 0.02 * abs(truth)))
    assert new.sd < 0.1 * abs(truth)
    assert first.lacks == ((unknown,) if "added" in lacks else ())
    check_words(causes, first)
    assert first in causes.supported


SEVERAL: Mapping[str, tuple[Mapping[str, Any], set[str], Mapping[str, float]]] = {
    "friction at both ends": (
        {"added": {"t_cm": 0.03, "t_c1": 0.2}}, {"friction_both"}, {"t_cm": 0.03, "t_c1": 0.2}
    ),
    "friction, a late twist and a supply that is off": (
        {"added": {"t_c1": 0.25}, "late": 3, "supply": -0.4},
        {"friction_rotor_1", "lag_alpha", "offset_v"},
        {"t_c1": 0.25, "lag_alpha": 0.03, "offset_v": -0.4},
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SEVERAL)
def test_several_causes_are_all_named(name: str, tmp_path: Path) -> None:
    """Each alone would not do."""
    lacks, parts, truth = SEVERAL[name]
    _, best = causes_that_mend(rig(tmp_path, lacks))
    assert set(best.parts) == parts
    assert best.explains_all
    for new in best.new:
        assert new.value == pytest.approx(truth[new.name], rel=0.1, abs=5 * new.sd)


@pytest.mark.slow
def test_a_rig_with_friction_is_not_said_to_lack_it(tmp_path: Path) -> None:
    rubs = {"t_c1": 0.25, "t_cm": 0.03}
    assert causes_of(bd.load(rig(tmp_path, {"added": rubs}, **rubs))) is None
    causes, best = causes_that_mend(rig(tmp_path, {"added": rubs, "late": 3}, **rubs))
    assert best.parts == ("lag_alpha",)
    sizes = ("friction", "static", "sticking", "direction")  # a gear's load is another law
    assert not any(part.startswith(sizes) for one in causes.ranked for part in one.parts)


def test_combinations_beyond_the_largest_number_of_evaluations_are_named_and_not_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try_only(("offset_alpha", "gain_w_2"), monkeypatch)
    monkeypatch.setattr(ranking, "MOST_EVALUATIONS", 1)
    causes = causes_of(bd.load(rig(tmp_path, {"offset": 0.4, "gain": 0.8, "late": 1})))
    assert all(len(one.parts) == 1 for one in causes.ranked)
    left = ("an offset of alpha with a gain of w_2", "a gain of w_2 with an offset of alpha")
    assert causes.untried in [(words,) for words in left]
    assert "1 combination was not tried" in describe_causes(causes)


@pytest.mark.parametrize("parts", slow_except((SOME,), (SOME, ())), ids=["some", "all"])
def test_no_cause_is_recommended_for_one_bad_sample(
    parts: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try_only(parts, monkeypatch)
    causes = causes_of(bd.load(rig(tmp_path, glitch=7.0)))
    assert causes.best is None
    assert causes.supported == ()
    text = describe_causes(causes)
    assert text.startswith(f"fit: {len(causes.ranked)} candidates were refitted, and none explains")
    assert "add these lines" not in text
    assert len(causes.windows) == WINDOWS
    assert "No unknown changes by more than" in wandering(causes)


def test_a_rig_that_changes_shows_from_window_to_window(tmp_path: Path) -> None:
    """The supply sags, which the record does not show; the model has one number for all times."""
    case = bd.load(rig(tmp_path, supply_drifts_to=1.4))
    mode = case.find_map(quick=True).mode
    job = case.job.with_steps_at(mode)
    with WorkerPool(job.problem.posterior, 1) as pool:
        ranking = Ranking(job, mode.values, pool.submit_function, SILENT)
        windows = ranking._windows()
    values = [one.value for window in windows for one in window if one.name == "k_e"]
    expected = NOMINAL["k_e"] * (1.0 + 0.4 * (np.arange(WINDOWS) + 0.5) / WINDOWS)
    assert values == sorted(values)  # as much voltage for less speed
    assert values == pytest.approx(expected, rel=0.05)
    causes = Causes(given=ranking.base.residuals, ranked=(), windows=windows)
    assert "k_e from " in wandering(causes)


SHAFT = (CONFIGS / "late_shaft.yaml").read_text(encoding="utf-8")


def shaft(folder: Path, late: int) -> Path:
    """Write the config of a shaft on which the torque acts so many samples after it is recorded."""
    t = 0.005 * np.arange(500)
    top = 9.0 + 3.0 * np.sin(18.0 * t) + np.sin(7.0 * t)
    torque = 1.8 + 0.8 * np.sin(18.0 * t + 1.0) + 0.4 * np.sign(np.sin(11.0 * t))
    acting = torque[np.clip(np.arange(500) - late, 0, 499)]
    p, start = {"k_s": 4.1, "j_1": 0.008, "c_s": 0.02}, {"w_1": 9.0, "theta_1": -0.4}
    rig = bd.DrivenShaft(added=("c_s",))
    bit = bd.respond(rig, p, t, {"w_2": top, "t_1": acting}, ["w_1"], initial=start)["w_1"]
    bit = bit + 0.1 * np.random.default_rng(3).standard_normal(500)
    return write(folder, SHAFT, {"t": t, "top": top, "torque": torque, "bit": bit})


@pytest.mark.slow
@pytest.mark.parametrize("late", [-7, 4])
def test_a_torque_that_is_late_is_named(late: int, tmp_path: Path) -> None:
    causes, best = causes_that_mend(shaft(tmp_path, late))
    assert best.parts == ("lag_t_1",)
    (new,) = best.new
    assert new.value == pytest.approx(0.005 * late, abs=2e-3)
    check_words(causes, best)


@pytest.mark.parametrize("parts", slow_except((COASTED,), (COASTED, ())), ids=["some", "all"])
def test_friction_shows_once_a_rig_moves_from_its_start(
    parts: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A motor that coasts, j w' = -c w - T: taken to begin at rest it never moves, and nothing rubs."""
    try_only(parts, monkeypatch)
    t, j_m, c_m, friction, first = 0.01 * np.arange(150), 4e-4, 5e-4, 0.01, 30.0
    w_2 = (first + friction / c_m) * np.exp(-c_m / j_m * t) - friction / c_m
    y = np.maximum(w_2, 0.0) + 0.1 * np.random.default_rng(1).standard_normal(len(t))
    channels, still = {"w_2": bd.Channel(y, "rad/s", 0.1)}, {"t_m": bd.Input(0.0 * t, "N*m")}
    damping = {"prior": "log_normal", "median": 1e-3, "sd_log": 1.0}
    causes = causes_of(bd.case(t, channels, still, {"j_m": j_m, "c_m": damping}, rig="motor"))
    assert {*COASTED} <= {*causes.best.parts}
    assert causes.best.explains_all


@pytest.mark.slow
def test_an_offset_and_dry_friction_of_a_motor_that_turns_one_way_are_not_recommended_together(
    tmp_path: Path,
) -> None:
    """Each of the two explains what both explain for the motor of `docs/one-motor.md`.

    Half of its record is enough.
    """
    head, *rows = (ROOT / "docs/one_motor.csv").read_text().splitlines()
    (tmp_path / "motor.csv").write_text("\n".join([head, *rows[: len(rows) // 2]]))
    columns = ("t=t [s]", "u=u_motor [V]", "y=w_motor [deg/s]")
    bd.init(tmp_path / "motor.csv", output=tmp_path / "motor.yaml", columns=columns)
    causes = causes_of(bd.load(tmp_path / "motor.yaml"))
    explaining = {"offset_w_motor", "offset_u_motor", "friction_motor"}
    assert len(explaining & {*causes.best.parts}) == 1
    (both,) = (c for c in causes.ranked if {*c.parts} == {"offset_w_motor", "offset_u_motor"})
    assert ("alike", {*both.words}) in [(each.kind, {*each.said_of}) for each in both.doubts]


def cause(bayes: float, *parts: str) -> Cause:
    nothing: dict[str, Any] = {"lines": "", "lacks": parts, "new": (), "fit": (), "doubts": ()}
    return Cause(parts=parts, words=parts, gain=bayes + 3.0, bayes=bayes, **nothing)


def best_parts(*ranked: Cause) -> tuple[str, ...]:
    best = Causes(given=(), ranked=ranked).best
    return () if best is None else best.parts


def test_the_best_is_the_simplest_of_those_that_are_about_as_probable() -> None:
    every = (cause(100.0, "a", "b"), cause(96.0, "a"), cause(94.0, "c"), cause(4.0, "d"))
    assert best_parts(*every) == ("a",)
    assert Causes(given=(), ranked=every).supported == every[:3]
    assert best_parts(*every[:1], *every[2:]) == ("a", "b")
    assert best_parts(*every[3:]) == ()


def test_what_absorbs_any_misfit_does_not_hide_a_cause_that_explains_much_of_it() -> None:
    torque, noise = cause(100.0, "missing_torque_motor"), cause(90.0, "ar1")
    both, rubs = cause(100.0, "gain_v", "ar1"), ("friction_motor",)
    assert best_parts(torque, cause(60.0, *rubs)) == rubs
    assert best_parts(torque, cause(40.0, *rubs)) == ("missing_torque_motor",)
    assert best_parts(noise, cause(88.0, "gain_v", "ar1")) == ("ar1",)
    assert best_parts(torque, cause(97.0, "gain_v", "ar1"), noise) == ("gain_v", "ar1")
    assert best_parts(torque, cause(93.0, "gain_v", "ar1"), noise) == ("missing_torque_motor",)
    assert best_parts(both, cause(60.0, *rubs)) == rubs
    assert best_parts(both, cause(40.0, *rubs)) == ("gain_v", "ar1")
