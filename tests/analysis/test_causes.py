"""What would explain what a fit leaves: the right candidate is first, with its size, and mends it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from support.case_tables import for_each
from support.missing_physics import SIGMA, T, record
from support.scipy_oracles import NOMINAL
from support.unexplained_records import amended, causes_of, fits, write

import bayesdrill as bd
from bayesdrill.analysis.causes import Cause, Causes
from bayesdrill.analysis.refits import refit_candidate
from bayesdrill.basics.progress import SILENT
from bayesdrill.report.sections import causes_words
from bayesdrill.rig.models.roles import usual_roles
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks.ranking import WINDOWS, Ranking

CONFIG = """\
name: rig
seed: 4
record:
  file: record.csv
  time: {column: t, unit: s}
  channels:
    alpha: {column: alpha, unit: rad, measures: theta_1 - theta_2, sigma: SIGMA_0}
    w_2: {column: w_2, unit: rad/s, sigma: SIGMA_1}
inputs: {v: {column: v, unit: V}}
model: {name: motor_shaft}
nominal: tables_2_3
parameters: {j_m: BOX, c_m: BOX, k_e: BOX, k_s: BOX, j_1: BOX, k_T: nominal, r_m: nominal,
  l_m: nominal, t_f: 1.0e-3}
"""
BOX = "{prior: uniform, low: 0.3, high: 3, relative: true}"


def rig(
    folder: Path,
    lacks: Mapping[str, Any],
    *,
    known: bool = True,
    glitch: float = 0.0,
    supply_drifts_to: float = 1.0,
    **added: float,
) -> Path:
    """The config of a rig without what it `lacks`; `known`: the noise; `added`: parameters that it is
    said to have; `glitch`: in sigmas, of one sample; `supply_drifts_to`: by what the record shows the
    voltage too large at the end; at the beginning it is right.
    """
    more = {"added": {}, **lacks}
    seen = record(more.pop("added"), **more)
    text = CONFIG.replace("BOX", BOX)
    for k, sigma in enumerate(SIGMA):
        wide = f"{{prior: log_uniform, low: {sigma / 30}, high: {sigma * 30}}}"
        text = text.replace(f"SIGMA_{k}", str(sigma) if known else wide)
    said = "".join(f", {name}: {value}" for name, value in added.items())
    alpha, w_2 = seen.y.T.copy()
    alpha[150] += glitch * SIGMA[0]
    v = seen.series["v"] * np.linspace(1.0, supply_drifts_to, len(T))
    columns = {"t": T, "v": v, "alpha": alpha, "w_2": w_2}
    return write(folder, text.replace("t_f: 1.0e-3", f"t_f: 1.0e-3{said}"), columns)


def named(path: Path) -> Causes:
    found = causes_of(bd.load(path))
    assert found is not None
    assert found.best is not None
    assert fits(amended(path, found.best.lines))
    return found


# What it is, the part that says so, its unknown, and whether the rig lacks it.
LACKS: Mapping[str, tuple[Mapping[str, Any], str, str]] = {
    "lag": ({"late": 3}, "lag_alpha", "lag_alpha"),
    "offset": ({"offset": 0.4}, "offset_alpha", "offset_alpha"),
    "gain": ({"gain": 0.8}, "gain_alpha", "gain_alpha"),
    "input offset": ({"supply": -0.6}, "offset_v", "offset_v"),
    "friction": ({"added": {"t_c1": 0.25}}, "friction_rotor_1", "t_c1"),
    "voltage drop": ({"added": {"v_d": 0.8}}, "voltage_drop", "v_d"),
    "damping": ({"added": {"c_1": 0.02}}, "damping_rotor_1", "c_1"),
    "damping of the shaft": ({"added": {"c_s": 5e-3}}, "damping_shaft", "c_s"),
}
TRUTH = {
    "lag_alpha": 0.03,
    "offset_alpha": 0.4,
    "gain_alpha": 0.8,
    "offset_v": -0.6,
    **{name: size for lacks, *_ in LACKS.values() for name, size in lacks.get("added", {}).items()},
}
FEW = (("friction", False),)
REST = tuple((name, known) for name in LACKS for known in (True, False) if (name, known) not in FEW)
GROUPS = [
    pytest.param(FEW, id="quick"),
    pytest.param(REST, id="long", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("cases", GROUPS)
def test_what_is_wrong_is_first_with_its_size(
    cases: tuple[tuple[str, bool], ...], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """And what sensors explain is not blamed on the rig; config lines that say so leave only noise.

    Mutants killed: a lag that is sought from one side only, lines that say something else, a candidate
    that is not refitted.
    """

    def check(name: str, known: bool) -> None:
        lacks, part, unknown = LACKS[name]
        found = named(rig(tmp_path_factory.mktemp("rig"), lacks, known=known))
        first = found.best
        if (
            name == "gain"
        ):  # of two channels either is out of scale, as the motor's constants are free
            assert first.parts in (("gain_alpha",), ("gain_w_2",))
            return
        assert first.parts == (part,)
        assert first.explains_all
        if found.ranked[0] is first:
            assert all(len(one.parts) == 1 for one in found.ranked)  # it needs nothing beside it
        (new,) = first.new
        assert new.name == unknown
        truth = TRUTH[unknown]
        assert new.value == pytest.approx(truth, abs=max(5 * new.sd, 0.02 * abs(truth)))
        assert new.sd < 0.1 * abs(truth)
        assert found.best.lacks == ((unknown,) if "added" in lacks else ())
        assert bool(causes_words.lacking(found, usual_roles())) == ("added" in lacks)
        said = causes_words.explained(found)
        assert f"fit: A is the config with {first.words[0]}" in said
        assert "next: add these lines to the config (A" in said
        assert "That leaves what looks like the noise." in said
        assert f"\n{first.lines}\n" in said
        assert (part,) in [one.parts for one in found.good]

    for_each({str(case): case for case in cases}, check)


@pytest.mark.slow
def test_two_and_more_at_once_are_all_named(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Friction at both ends; and friction, a twist that is late and a supply that is off: each alone
    would not do.
    """
    cases = {
        "friction": ({"added": {"t_cm": 0.03, "t_c1": 0.2}}, {"friction_both"}),
        "three": (
            {"added": {"t_c1": 0.25}, "late": 3, "supply": -0.4},
            {"friction_rotor_1", "lag_alpha", "offset_v"},
        ),
    }
    sizes = {"t_cm": 0.03, "t_c1": 0.2, "lag_alpha": 0.03, "offset_v": -0.4}

    def check(lacks: Mapping[str, Any], parts: set[str]) -> None:
        best = named(rig(tmp_path_factory.mktemp("rig"), lacks)).best
        assert set(best.parts) == parts
        assert best.explains_all
        for new in best.new:
            truth = {**sizes, **lacks["added"]}[new.name]
            assert new.value == pytest.approx(truth, rel=0.1, abs=5 * new.sd)

    for_each(cases, check)


@pytest.mark.slow
def test_a_rig_that_has_it_is_not_said_to_lack_it(tmp_path: Path) -> None:
    rubs = {"t_c1": 0.25, "t_cm": 0.03}
    assert causes_of(bd.load(rig(tmp_path, {"added": rubs}, **rubs))) is None
    found = named(rig(tmp_path, {"added": rubs, "late": 3}, **rubs))
    assert found.best.parts == ("lag_alpha",)
    assert not any("friction" in part for one in found.ranked for part in one.parts)


def test_where_nothing_explains_nothing_is_said_to(tmp_path: Path) -> None:
    """One sample that is far off is no matter of sensors, rig or noise."""
    found = causes_of(bd.load(rig(tmp_path, {}, glitch=7.0)))
    assert found is not None
    assert found.best is None
    assert not any(one.explains_all for one in found.good)
    assert found.good == ()
    said = causes_words.explained(found)
    assert said.startswith(f"fit: {len(found.ranked)} candidates were refitted, and none explains")
    assert "add these lines" not in said
    assert len(found.windows) == WINDOWS
    assert "No unknown changes by more than" in causes_words.wandering(found)


def test_a_rig_that_changes_shows_from_window_to_window(tmp_path: Path) -> None:
    """A supply that sags while the record does not show it; the model has one number for all times.

    Mutants killed: windows that all are the first; an sd of all windows for that of each.
    """
    case = bd.load(rig(tmp_path, {}, supply_drifts_to=1.4))
    mode = case.find_map(quick=True).mode
    job = case.job.with_steps_at(mode)
    given = refit_candidate(job.problem.posterior, mode.values, -np.inf)
    assert given is not None
    with WorkerPool(job.problem.posterior, 1) as pool:
        windows = Ranking(job, mode.values, given, pool.submit_function, SILENT)._windows()
    k_e = [value for window in windows for value in window if value.name == "k_e"]
    values = [value.value for value in k_e]
    assert len(values) == WINDOWS
    assert values == sorted(values)  # as much voltage for less speed
    expected = NOMINAL["k_e"] * (1.0 + 0.4 * (np.arange(WINDOWS) + 0.5) / WINDOWS)
    np.testing.assert_allclose(values, expected, rtol=0.05)
    found = Causes(given=given.fit, ranked=(), windows=windows)
    assert "k_e from " in causes_words.wandering(found)


# A torque that is late, of a shaft whose upper end is turned.

SHAFT = """\
name: shaft
seed: 4
record:
  file: record.csv
  time: {column: t, unit: s}
  channels: {w_1: {column: bit, unit: rad/s, sigma: 0.1}}
inputs:
  w_2: {column: top, unit: rad/s}
  t_1: {column: torque, unit: N*m}
initial: {w_1: 9.0, theta_1: -0.4}
model: {name: driven_shaft}
parameters:
  k_s: {prior: log_normal, median: 4.1, sd_log: 0.5}
  j_1: {prior: log_normal, median: 0.008, sd_log: 0.5}
  c_s: {prior: log_normal, median: 0.02, sd_log: 0.5}
"""
STEP, N = 0.005, 500
TIMES = STEP * np.arange(N)
TOP = 9.0 + 3.0 * np.sin(18.0 * TIMES) + np.sin(7.0 * TIMES)
TORQUE = 1.8 + 0.8 * np.sin(18.0 * TIMES + 1.0) + 0.4 * np.sign(np.sin(11.0 * TIMES))


def moved(late: float) -> np.ndarray:
    """The bit's speed by small steps, where the torque acts `late` after its record shows it."""
    fine = 20
    h, x, found = STEP / fine, np.array([0.4, 9.0]), []
    for k in range(N):
        found.append(x[1])
        for part in range(fine):
            s = TIMES[k] + (part + 0.5) * h
            torque = TORQUE[np.clip(int(np.floor((s - late) / STEP)), 0, N - 1)]

            def rate(x: np.ndarray, top: float = TOP[k], torque: float = torque) -> np.ndarray:
                push = 4.1 * x[0] + 0.02 * (top - x[1]) - torque
                return np.array([top - x[1], push / 0.008])

            x = x + h * rate(x + 0.5 * h * rate(x))
    return np.array(found)


def shaft(folder: Path, late: float) -> Path:
    noisy = moved(late) + 0.1 * np.random.default_rng(3).standard_normal(N)
    return write(folder, SHAFT, {"t": TIMES, "top": TOP, "torque": TORQUE, "bit": noisy})


LATE = [pytest.param(-0.035, id="early"), pytest.param(0.02, id="late", marks=pytest.mark.slow)]


@pytest.mark.parametrize("late", LATE)
def test_a_torque_that_is_late_is_named(late: float, tmp_path: Path) -> None:
    """Mutants killed: the lag of a channel for that of an input, its sign turned."""
    found = named(shaft(tmp_path, late))
    assert found.best.parts == ("lag_t_1",)
    (new,) = found.best.new
    assert new.value == pytest.approx(late, abs=2e-3)


def test_inputs_that_are_in_time_leave_nothing_to_explain(tmp_path: Path) -> None:
    path = shaft(tmp_path, 0.0)
    assert causes_of(bd.load(path)) is None
    assert causes_words.explained(None) == ""


def test_friction_shows_once_a_rig_moves_from_its_start() -> None:
    """A beam that was let go: taken to begin at rest it never moves, and nothing can rub.

    Mutant killed: candidates for a rig that does not move.
    """
    t = 0.01 * np.arange(300)
    truth = {"k_s": 0.8, "j_1": 1.4e-3, "t_c1": 0.01}
    shown = bd.respond(
        bd.DrivenShaft(added=("t_c1",)),
        truth,
        t,
        {"w_2": 0.0, "t_1": 0.0},
        ["theta_1"],
        initial={"theta_1": 0.5},
    )
    noisy = shown["theta_1"] + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    case = bd.case(
        t,
        channels={"theta_1": bd.Channel(noisy, "rad", 1e-3)},
        inputs={"w_2": 0.0, "t_1": 0.0},
        rig="driven_shaft",
        parameters={"k_s": {"prior": "log_normal", "median": 1.0, "sd_log": 1.0}, "j_1": 1.4e-3},
    )
    found = causes_of(case)
    assert found is not None
    assert {"free_start", "friction_rotor_1"} <= {*found.best.parts}
    assert found.best.explains_all


def test_an_offset_and_dry_friction_of_a_motor_that_turns_one_way_are_not_recommended_together(
    tmp_path: Path,
) -> None:
    """The motor of `docs/one-motor.md`: each of the two explains what both explain.

    Mutant killed: parts that stand for each other, which are trusted together.
    """
    columns = ("t=t [s]", "u=u_motor [V]", "y=w_motor [deg/s]")
    record = Path(__file__).parents[2] / "docs/one_motor.csv"
    bd.init(record, output=tmp_path / "motor.yaml", columns=columns)
    found = causes_of(bd.load(tmp_path / "motor.yaml"))
    assert found is not None
    assert found.best is not None
    assert found.best.parts in {("offset_w_motor",), ("offset_u_motor",), ("friction_motor",)}


def test_the_best_is_the_simplest_of_those_that_are_about_as_probable() -> None:
    """And what absorbs any misfit does not hide a cause that explains much of it."""

    def cause(bayes: float, *parts: str) -> Cause:
        said: dict[str, Any] = {"lines": "", "lacks": parts, "new": (), "fit": (), "doubts": ()}
        return Cause(parts=parts, words=parts, gain=bayes + 3.0, bayes=bayes, **said)

    every = (cause(100.0, "a", "b"), cause(96.0, "a"), cause(94.0, "c"), cause(4.0, "d"))
    assert Causes(given=(), ranked=every).best is every[1]
    assert Causes(given=(), ranked=every).good == every[:3]
    assert Causes(given=(), ranked=every[:1] + every[2:]).best is every[0]
    assert Causes(given=(), ranked=every[3:]).best is None

    def best(*ranked: Cause) -> tuple[str, ...]:
        return Causes(given=(), ranked=ranked).best.parts

    torque, noise = cause(100.0, "missing_torque_motor"), cause(90.0, "ar1")
    assert best(torque, cause(60.0, "friction_motor")) == ("friction_motor",)
    assert best(torque, cause(40.0, "friction_motor")) == ("missing_torque_motor",)
    assert best(noise, cause(88.0, "gain_v", "ar1")) == ("ar1",)
    assert best(torque, cause(97.0, "gain_v", "ar1"), noise) == ("gain_v", "ar1")
    assert best(torque, cause(93.0, "gain_v", "ar1"), noise) == ("missing_torque_motor",)
    both, rubs = cause(100.0, "gain_v", "ar1"), ("friction_motor",)
    assert best(both, cause(60.0, *rubs)) == rubs
    assert best(both, cause(40.0, *rubs)) == ("gain_v", "ar1")


# The evidence of a candidate.


def test_the_evidence_of_a_straight_model_is_exact() -> None:
    """Offsets of channels and of the supply act along straight lines: their evidence is that of a
    Gaussian, of which the covariance is written down.

    Mutants killed: the prior left out or counted twice, its curvature or a factor of 2 pi forgotten.
    """
    n, rng = 120, np.random.default_rng(2)
    t = T[:n]
    v = 5.0 * np.sign(np.sin(5.0 * t + 0.4))
    rest = dict.fromkeys(NOMINAL, 0.0) | NOMINAL | {"t_f": 0.0}
    sds = {"offset_theta_2": 2e-3, "offset_w_1": 0.01, "offset_v": 0.01}  # as sure as the record
    wanted = ["theta_2", "w_1"]

    def seen(volts: np.ndarray) -> np.ndarray:
        shown = bd.respond("motor_shaft", rest, t, {"v": volts}, wanted)
        return np.concatenate([shown[name] for name in wanted])

    noise = np.repeat([0.02, 0.1], n)
    clean = seen(v)
    y = seen(v + 0.01) + noise * rng.standard_normal(2 * n)
    each = np.repeat(np.eye(2), n, axis=0)
    rows = np.column_stack([each, seen(v + 1.0) - clean]) * [*sds.values()]
    exact = multivariate_normal(clean, np.diag(noise**2) + rows @ rows.T).logpdf(y)

    def off(name: str) -> dict[str, Any]:
        return {"prior": "normal", "mean": 0.0, "sd": sds[f"offset_{name}"]}

    case = bd.case(
        t,
        channels={
            "theta_2": bd.Channel(y[:n], "rad", 0.02, offset=off("theta_2")),
            "w_1": bd.Channel(y[n:], "rad/s", 0.1, offset=off("w_1")),
        },
        inputs={"v": bd.Input(v, "V", offset=off("v"))},
        parameters=rest,
    )
    posterior = case.job.problem.posterior
    assert {*posterior.space.free} == {*sds}
    top = refit_candidate(posterior, {}, -np.inf)
    assert top is not None
    assert top.log_z == pytest.approx(exact, abs=0.01)
    assert not top.at_ends
    assert not top.several


def test_a_maximum_at_the_end_of_a_prior_is_said_to_be(tmp_path: Path) -> None:
    path = rig(tmp_path, {})
    narrow = (
        "parameters: {k_s: {prior: uniform, low: 0.078, high: 0.182, start: 0.17, relative: false}}"
    )
    for case, at_end in ((bd.load(path), False), (amended(path, narrow), True)):
        posterior = case.job.problem.posterior
        top = refit_candidate(posterior, posterior.space.start, -np.inf)
        assert top is not None
        assert ("k_s" in top.at_ends) == at_end
