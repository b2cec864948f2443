"""Rungs of a ladder: each a config that is valid, and that differs in what its name says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from support import command_line
from support.case_tables import for_each

from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.selection import config_edits
from bayesdrill.selection.candidates import MOST_PARTS, CandidateModel, CandidateModels

TORQUES = {"missing_torque_motor", "missing_torque_rotor_1"}
PHYSICS = {
    "friction_motor": ("t_cm",),
    "friction_rotor_1": ("t_c1",),
    "friction_both": ("t_cm", "t_c1"),
    "voltage_drop": ("v_d",),
    "drag_motor": ("d_m",),
    "drag_rotor_1": ("d_1",),
    "damping_rotor_1": ("c_1",),
    "damping_shaft": ("c_s",),
    "load_friction_motor": ("eta",),
    "inertia_rotor_1": ("j_0", "k_0", "c_0"),
}
ALL = {"unknown_noise", "ar1", *PHYSICS, *TORQUES}
CHANNELS = ("theta_1", "w_1")
SENSED = ("lag", "gain", "offset")
UNKNOWN_SENSED = (*(f"{kind}_{name}" for name in CHANNELS for kind in SENSED), "t_0")
MOST_SENSED = (*UNKNOWN_SENSED, "sign_theta_1", "sign_w_1", "free_start")

NOT_OF_MODEL = ("output", "simulation", "sampler")


def ladder(tmp_path: Path, *changes: tuple[str, str]) -> CandidateModels:
    return CandidateModels.from_job(
        prepare(command_line.small_config(tmp_path, ("walkers: 8", "walkers: 24"), *changes)), {}
    )


def by_name(every: list[CandidateModel]) -> dict[str, CandidateModel]:
    return {one.name: one for one in every}


def singles(made: CandidateModels) -> list[CandidateModel]:
    """What names a cause, and what absorbs any misfit."""
    return [*made.singles(), *made.singles(absorbing=True)]


def test_each_is_valid_and_has_what_it_says(tmp_path: Path) -> None:
    """Mutants killed: one channel of all; a thing that stays in the next rung; a gear that stays."""
    made = ladder(tmp_path)
    geared = made.with_numbers(gear=2.0).rungs([("gear",)])
    found = by_name([*singles(made), *geared])
    assert set(found) == {*ALL, *MOST_SENSED, "gear"}
    for name, one in found.items():
        problem = one.job().problem
        physics = {*PHYSICS.get(name, ())}
        noise = {n for n in problem.names if n.startswith(("sigma", "rho"))}
        sensed = {name} & {*UNKNOWN_SENSED}
        assert {"k_e", "j_1"} | physics | sensed <= set(problem.names), name
        if name not in TORQUES and name != "free_start":
            assert set(problem.names) == {"k_e", "j_1"} | physics | noise | sensed, name
        sizes = {f"sigma_{c}" for c in ("theta_1", "w_1")}
        memories = {f"rho_{c}" for c in ("theta_1", "w_1")}
        wanted = {"unknown_noise": sizes, "ar1": sizes | memories}
        assert noise == wanted.get(name, set()), name
    start = found["free_start"].job().problem.names
    assert {"theta_1_0", "w_1_0", "theta_2_0", "w_2_0", "i_0"} <= set(start)
    assert found["gear"].job().problem.model.i_m == 2.0 * made.job.problem.model.i_m
    assert geared[0].lines == "model: {i_m: 0.25}"
    assert found["sign_w_1"].lines == "record:\n  channels:\n    w_1: {gain: -1.0}"


def test_the_lines_of_a_rung_make_it_of_the_config(tmp_path: Path) -> None:
    """Pasted into the config as given, they are the rung.  Mutant killed: only what is new is said."""
    made = ladder(tmp_path)
    read = YAML(typ="safe").load

    def merge(data: dict[str, Any], more: dict[str, Any]) -> dict[str, Any]:
        inside = (
            k for k, x in more.items() if isinstance(x, dict) and isinstance(data.get(k), dict)
        )
        both = {k: merge(data[k], more[k]) for k in inside}
        return {**data, **more, **both}

    for one in singles(made):
        given = read(made.job.source.text)
        pasted = merge(given, read(one.lines))
        assert {k: v for k, v in pasted.items() if k not in NOT_OF_MODEL} == {
            k: v for k, v in read(one.source.text).items() if k not in NOT_OF_MODEL
        }, one.name


def test_sensors_of_several_experiments_are_the_same(tmp_path: Path) -> None:
    """But for offsets of channels.  Mutants killed: a lag of its own in each; what an experiment says of
    a sensor is said again.
    """
    text = (
        "experiments:\n"
        "  one: {}\n"
        "  two: {record: {channels: {w_1: {column: w_1, unit: rad/s, sigma: 0.1, lag: 0.01}}}}\n"
        "inputs:"
    )
    found = by_name(singles(ladder(tmp_path, ("inputs:", text))))
    assert "gain_w_1" in found["gain_w_1"].job().problem.names
    offsets = found["offset_theta_1"].job().problem.names
    assert {"offset_theta_1_one", "offset_theta_1_two"} <= set(offsets)
    late = found["lag_w_1"].job().problem
    assert [name for name in late.names if name.startswith("lag")] == ["lag_w_1_one"]


def test_what_a_config_has_already_is_not_tried(tmp_path: Path) -> None:
    free = "sigma: {prior: log_uniform, low: 0.01, high: 1}"
    made = ladder(
        tmp_path,
        ("t_f: nominal", "t_f: nominal\n  t_cm: {prior: uniform, low: 0, high: 0.1}"),
        ("theta_1, unit: rad, sigma: 0.05", f"theta_1, unit: rad, {free}"),
        ("w_1, unit: rad/s, sigma: 0.05", f"w_1, unit: rad/s, noise: ar1, {free}"),
    )
    found = by_name(singles(made))
    assert not {"friction_motor", "friction_both", "unknown_noise"} & set(found)
    assert {"friction_rotor_1", "ar1"} <= set(found)
    assert "rho_theta_1" in found["ar1"].job().problem.names


def test_channels_of_experiments_are_changed_too(tmp_path: Path) -> None:
    text = (
        "experiments:\n"
        "  one: {}\n"
        "  two: {record: {channels: {w_1: {column: w_1, unit: rad/s, sigma: 0.1}}}}\n"
        "inputs:"
    )
    found = by_name(singles(ladder(tmp_path, ("inputs:", text))))
    names = found["unknown_noise"].job().problem.names
    assert {"sigma_w_1_one", "sigma_w_1_two", "sigma_theta_1"} <= set(names)
    names = found["ar1"].job().problem.names
    assert {"rho_w_1_one", "rho_w_1_two", "rho_theta_1"} <= set(names)
    names = found["missing_torque_rotor_1"].job().problem.names
    assert {"s_d", "tau_d"} <= set(names)


def test_windows_leave_what_is_held_out_as_it_is(tmp_path: Path) -> None:
    """Kills: experiments that are told by their place, so that one held out stops the ranking."""
    text = "experiments:\n  away: {held_out: true}\n  one: {}\ninputs:"
    first, second = ladder(tmp_path, ("inputs:", text)).windows(2)
    for half in (first, second):
        assert half.source.data["experiments"]["away"] == {"held_out": True}
    ends = [half.source.data["experiments"]["one"]["record"]["window"] for half in (first, second)]
    assert ends[0][1] == ends[1][0] > ends[0][0]


def test_a_memory_goes_with_the_size_of_its_noise(tmp_path: Path) -> None:
    """Mutant killed: a memory of its own in each experiment, of noise that they share."""
    free = "sigma: {prior: log_uniform, low: 0.01, high: 1}"
    changes = (
        ("inputs:", "experiments: {one: {}, two: {}}\nshared: [sigma_w_1]\ninputs:"),
        ("theta_1, unit: rad, sigma: 0.05", f"theta_1, unit: rad, {free}"),
        ("w_1, unit: rad/s, sigma: 0.05", f"w_1, unit: rad/s, {free}"),
    )
    names = by_name(singles(ladder(tmp_path, *changes)))["ar1"].job().problem.names
    assert {"rho_w_1", "rho_theta_1_one", "rho_theta_1_two"} <= set(names)


def test_where_a_rig_has_turned_to_makes_no_prior_wider(tmp_path: Path) -> None:
    """Mutant killed: springs as strong as both their angles."""
    here = ladder(tmp_path / "here").sizes
    start = ("inputs:", "initial: {theta_1: 1000, theta_2: 1000}\ninputs:")
    assert ladder(tmp_path / "far", start).sizes == pytest.approx(here, rel=1e-6)


def test_beside_others_what_can_go_with_them(tmp_path: Path) -> None:
    """Mutants killed: friction at rest that nothing slides with; a second friction, noise or torque."""
    made = ladder(tmp_path)
    every = [one.name for one in singles(made)]
    found = [one.name for one in made.beyond(("friction_rotor_1", "ar1"), every)]
    smooth = ("damping_rotor_1", "damping_shaft", "inertia_rotor_1", *MOST_SENSED)
    rubbing = ("voltage_drop", "drag_motor", "drag_rotor_1", "load_friction_motor")
    beside = {*smooth, *rubbing, "static_rotor_1"}
    assert {*found} == {f"friction_rotor_1-ar1-{part}" for part in beside}
    rests = by_name(made.beyond(("friction_both",), ()))
    assert set(rests) == {"friction_both-static_motor", "friction_both-static_rotor_1"}
    problem = rests["friction_both-static_rotor_1"].job().problem
    assert {"t_cm", "t_c1", "t_s1", "w_s1"} <= set(problem.names)
    torque = [one.name for one in made.beyond(("missing_torque_motor",), every)]
    assert {*torque} == {f"missing_torque_motor-{part}" for part in ("unknown_noise", *smooth)}
    without = [one.name for one in made.without_each(("friction_both", "static_motor", "ar1"))]
    assert without == ["friction_both-ar1", "friction_both-static_motor"]
    assert made.beyond(tuple(f"x{k}" for k in range(MOST_PARTS)), every) == []


def test_what_is_recommended_is_a_config_from_anywhere(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Mutant killed: a record that is looked for beside the new config."""

    def check(name: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        output = ("output: {predictive_draws: 10, figures: []}", "output: {figures: [corner]}")
        made = ladder(tmp_path / "here", output)
        one = by_name([*made.rungs([()]), *singles(made)])[name]
        far = tmp_path / "far" / "away"
        far.mkdir(parents=True)
        path = far / "recommended.yaml"
        given = one.source.data, made.job.source, far
        path.write_text(config_edits.as_file(*given, ["first", "second"], "mine"))
        assert path.read_text().startswith("# first\n# second\nname: mine\n")
        case = loading.load(path)
        assert list(case.config.output.figures) == ["corner"]
        again = prepare(path).problem
        assert again.names == one.job().problem.names
        assert (again.experiment.y == one.job().problem.experiment.y).all()
        assert YAML(typ="safe").load(case.source.text)["record"]["file"] == "../../here/small.csv"

    for_each({name: (name,) for name in ["as_given", "ar1", "damping_shaft"]}, check)
