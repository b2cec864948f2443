"""Rungs of a ladder: each a config that is valid, and that differs in what its name says."""

from __future__ import annotations

from pathlib import Path

import pytest
import systems
from ruamel.yaml import YAML
from together import for_each

from bayesdrill import selection
from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.config.schema.config import Config
from bayesdrill.rig.models.linear import USUAL
from bayesdrill.selection import Ladder, Rung

TORQUES = set(selection.TORQUES) if selection.MISSING in Config.model_fields else set()
ALL = {"as_given", "unknown_noise", "ar1", *selection.PHYSICS, *TORQUES}


def ladder(tmp_path: Path, *changes: tuple[str, str]) -> Ladder:
    return Ladder.of(prepare(systems.small(tmp_path, ("walkers: 8", "walkers: 24"), *changes)))


def by_name(every: list[Rung]) -> dict[str, Rung]:
    return {one.name: one for one in every}


def test_each_is_valid_and_has_what_it_says(tmp_path: Path) -> None:
    """Mutants killed: one channel of all; a thing that stays in the next rung."""
    found = by_name(ladder(tmp_path).first())
    assert set(found) == ALL
    assert next(iter(found)) == "as_given"
    for name, one in found.items():
        problem = one.job().problem
        physics = {USUAL[role] for role in selection.PHYSICS.get(name, ())}
        noise = {n for n in problem.names if n.startswith(("sigma", "rho"))}
        assert {"k_e", "j_1"} | physics <= set(problem.names), name
        if name not in TORQUES:
            assert set(problem.names) == {"k_e", "j_1"} | physics | noise, name
        sizes = {f"sigma_{c}" for c in ("theta_1", "w_1")}
        memories = {f"rho_{c}" for c in ("theta_1", "w_1")}
        wanted = {"unknown_noise": sizes, "ar1": sizes | memories}
        assert noise == wanted.get(name, set()), name


def test_what_a_config_has_already_is_not_tried(tmp_path: Path) -> None:
    free = "sigma: {prior: log_uniform, low: 0.01, high: 1}"
    found = by_name(
        ladder(
            tmp_path,
            ("t_f: nominal", "t_f: nominal\n  t_cm: {prior: uniform, low: 0, high: 0.1}"),
            ("theta_1, unit: rad, sigma: 0.05", f"theta_1, unit: rad, {free}"),
            ("w_1, unit: rad/s, sigma: 0.05", f"w_1, unit: rad/s, noise: ar1, {free}"),
        ).first()
    )
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
    found = by_name(ladder(tmp_path, ("inputs:", text)).first())
    names = found["unknown_noise"].job().problem.names
    assert {"sigma_w_1_one", "sigma_w_1_two", "sigma_theta_1"} <= set(names)
    names = found["ar1"].job().problem.names
    assert {"rho_w_1_one", "rho_w_1_two", "rho_theta_1"} <= set(names)
    names = found["missing_torque_rotor_1"].job().problem.names
    assert {"s_d", "tau_d"} <= set(names)


def test_a_memory_goes_with_the_size_of_its_noise(tmp_path: Path) -> None:
    """Mutant killed: a memory of its own in each experiment, of noise that they share."""
    free = "sigma: {prior: log_uniform, low: 0.01, high: 1}"
    changes = (
        ("inputs:", "experiments: {one: {}, two: {}}\nshared: [sigma_w_1]\ninputs:"),
        ("theta_1, unit: rad, sigma: 0.05", f"theta_1, unit: rad, {free}"),
        ("w_1, unit: rad/s, sigma: 0.05", f"w_1, unit: rad/s, {free}"),
    )
    names = by_name(ladder(tmp_path, *changes).first())["ar1"].job().problem.names
    assert {"rho_w_1", "rho_theta_1_one", "rho_theta_1_two"} <= set(names)


def test_where_a_rig_has_turned_to_makes_no_prior_wider(tmp_path: Path) -> None:
    """Mutant killed: springs as strong as both their angles."""
    here = ladder(tmp_path / "here").sizes
    start = ("inputs:", "initial: {theta_1: 1000, theta_2: 1000}\ninputs:")
    assert ladder(tmp_path / "far", start).sizes == pytest.approx(here, rel=1e-6)


def test_what_leaves_more_than_noise_gets_each_thing_that_it_has_not(tmp_path: Path) -> None:
    """Mutants killed: friction at rest that nothing slides with; a second friction, noise or torque."""
    made = ladder(tmp_path)
    found = [one.name for one in made.beyond(("friction_rotor_1", "ar1"))]
    assert found == [
        "friction_rotor_1-damping_rotor_1-ar1",
        "friction_rotor_1-damping_shaft-ar1",
        "friction_rotor_1-voltage_drop-ar1",
        "friction_rotor_1-static_rotor_1-ar1",
    ]
    assert set(found) <= set(selection.rung_names())
    rests = by_name(made.beyond(("friction_both",)))["friction_both-static_rotor_1"].job()
    assert {"t_cm", "t_c1", "t_s1", "w_s1"} <= set(rests.problem.names)
    torque = [one.name for one in made.beyond(("missing_torque_motor",))]
    assert torque == [
        "damping_rotor_1-missing_torque_motor",
        "damping_shaft-missing_torque_motor",
        "missing_torque_motor-unknown_noise",
    ]
    assert made.beyond(()) == made.beyond(("ar1",)) == []


def test_the_best_goes_on_with_other_noise_and_the_second(tmp_path: Path) -> None:
    """Mutants killed: what is worse than the config as given; a friction that the best one has."""
    made = ladder(tmp_path)
    assert made.then([]) == []
    assert made.then(["ar1", "unknown_noise"]) == []
    first = made.then(["ar1", "friction_both", "friction_motor", "damping_shaft", "voltage_drop"])
    assert [one.name for one in first] == [
        "friction_both-unknown_noise",
        "friction_both-ar1",
        "friction_both-damping_shaft",
    ]
    assert set(first[2].job().problem.names) == {"k_e", "j_1", "t_cm", "t_c1", "c_s"}
    assert {one.name for one in first} <= set(selection.rung_names())


def test_what_is_recommended_is_a_config_from_anywhere(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Mutant killed: a record that is looked for beside the new config."""

    def check(name: str) -> None:
        tmp_path = tmp_path_factory.mktemp("case")
        output = ("output: {predictive_draws: 10, figures: []}", "output: {figures: [corner]}")
        one = by_name(ladder(tmp_path / "here", output).first())[name]
        far = tmp_path / "far" / "away"
        far.mkdir(parents=True)
        path = far / "recommended.yaml"
        path.write_text(selection.recommended(one, "mine", far, "first\nsecond"))
        assert path.read_text().startswith("# first\n# second\nname: mine\n")
        case = loading.load(path)
        assert list(case.config.output.figures) == ["corner"]
        again = prepare(path).problem
        assert again.names == one.job().problem.names
        assert (again.experiment.y == one.job().problem.experiment.y).all()
        assert YAML(typ="safe").load(case.source.text)["record"]["file"] == "../../here/small.csv"

    for_each({name: (name,) for name in ["as_given", "ar1", "damping_shaft"]}, check)
