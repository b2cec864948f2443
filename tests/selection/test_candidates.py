"""Candidate models: each is a valid config, which differs in what its name says."""

from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from support import command_line
from support.case_tables import run_cases, slow_except
from support.small_problems import starts_believed
from support.unexplained_records import merged

from bayesdrill.analysis.causes import SCALE
from bayesdrill.config import loading, yaml_source
from bayesdrill.config.job import prepare
from bayesdrill.config.yaml_source import as_yaml
from bayesdrill.record.formats import csv
from bayesdrill.results.provenance import fingerprint
from bayesdrill.selection import config_edits
from bayesdrill.selection.candidates import MOST_PARTS, CandidateModel, CandidateModels

TORQUES = {"missing_torque_motor", "missing_torque_rotor_1"}
PHYSICS = {
    "friction_motor": ("t_cm",),
    "friction_rotor_1": ("t_c1",),
    "friction_both": ("t_cm", "t_c1"),
    "sticking_motor": ("t_cm", "t_sm", "w_sm"),
    "sticking_rotor_1": ("t_c1", "t_s1", "w_s1"),
    "voltage_drop": ("v_d",),
    "drag_motor": ("d_m",),
    "drag_rotor_1": ("d_1",),
    "damping_rotor_1": ("c_1",),
    "damping_shaft": ("c_s",),
    "load_friction_motor": ("eta",),
    "inertia_rotor_1": ("j_0", "k_0", "c_0"),
}
CHANNELS = ("theta_1", "w_1")
UNKNOWN_OF_SENSORS = {"t_0"} | {
    f"{kind}_{c}" for c in CHANNELS for kind in ("lag", "gain", "offset")
}
OF_SENSORS = {*UNKNOWN_OF_SENSORS, "sign_theta_1", "sign_w_1", "free_start"}
FREE = "sigma: {prior: log_uniform, low: 0.01, high: 1}"
FREE_ANGLE = ("theta_1, unit: rad, sigma: 0.05", f"theta_1, unit: rad, {FREE}")
load_yaml = YAML(typ="safe").load


def candidates(folder: Path, *changes: tuple[str, str]) -> CandidateModels:
    config = command_line.small_config(folder, ("walkers: 8", "walkers: 24"), *changes)
    return CandidateModels.from_job(prepare(config), {})


def singles(models: CandidateModels) -> dict[str, CandidateModel]:
    """Candidates with one part, by name: causes, and what absorbs any misfit."""
    both = (*models.singles(), *models.singles(absorbing=True))
    return {name: candidate for candidate in both for name in candidate.names}


def unknowns(candidate: CandidateModel) -> set[str]:
    return {*candidate.job().problem.names}


@starts_believed()
def test_each_candidate_frees_what_its_name_says(tmp_path: Path) -> None:
    models = candidates(tmp_path)
    every = singles(models)
    assert {*every} == {"unknown_noise", "ar1", *PHYSICS, *TORQUES, *OF_SENSORS}
    sizes, memories = ({f"{name}_{c}" for c in CHANNELS} for name in ("sigma", "rho"))
    noise = {"unknown_noise": sizes, "ar1": sizes | memories}
    for name, candidate in every.items():
        names = unknowns(candidate)
        expected = {"k_e", "j_1", *PHYSICS.get(name, ()), *noise.get(name, ())}
        expected |= {name} & UNKNOWN_OF_SENSORS
        assert expected <= names, name
        free = (
            {"s_d", "tau_d"}
            if name in TORQUES
            else {f"{x}_0" for x in (*CHANNELS, "theta_2", "w_2", "i")}
        )
        if name in TORQUES or name == "free_start":
            assert free <= names, name
        else:
            assert names == expected, name
    (geared,) = models.with_numbers(gear=2.0).rungs([("gear",)])
    assert geared.job().problem.model.i_m == 2.0 * models.job.problem.model.i_m
    assert geared.config_lines == "model: {i_m: 0.25}"
    assert every["sign_w_1"].config_lines == "record:\n  channels:\n    w_1: {gain: -1.0}"


TRAIN = (command_line.CONFIGS / "arm_by_torque.yaml").read_text(encoding="utf-8")
CONSTANTS = {
    "shaft": {"gear": 2.0, "later": 0.1},
    "train": {"clock": 0.98, "later": 0.1, "prior_j_arm": 1.0},
    "experiments": {},
}


def calls_of(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[Any]:
    """Return a list that gets the arguments of each call from now on."""
    calls, original = list[Any](), getattr(owner, name)

    def counted(*arguments: Any) -> Any:
        calls.append(arguments)
        return original(*arguments)

    monkeypatch.setattr(owner, name, counted)
    return calls


@pytest.mark.parametrize("rig", slow_except(("train",), CONSTANTS))
@starts_believed()
def test_pasted_lines_make_the_posterior_of_a_candidate_which_reads_nothing_again(
    rig: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    several = ("inputs:", EXPERIMENTS.replace(", lag: 0.01", ""))
    changes = [several] if rig == "experiments" else []
    config = command_line.small_config(tmp_path, ("walkers: 8", "walkers: 40"), *changes)
    if rig == "train":
        config.write_text(TRAIN)
    tables, texts = calls_of(monkeypatch, csv, "read"), calls_of(monkeypatch, yaml_source, "parse")
    job = prepare(config)
    before = len(tables), len(texts)
    models = CandidateModels.from_job(job, {}).with_numbers(**CONSTANTS[rig])
    both = (*models.singles(), *models.singles(absorbing=True))
    jobs = {candidate.names: candidate.job() for candidate in both}
    assert len(jobs) > 10
    assert (len(tables), len(texts)) == before
    pasted = tmp_path / "pasted.yaml"
    for candidate in both:
        lines = merged(load_yaml(config.read_text()), load_yaml(candidate.config_lines))
        pasted.write_text(as_yaml(lines))
        given, changed = (
            {
                name: text
                for name, text in fingerprint(job.config, job.problem).items()
                if not name.startswith(("map.", "sampler."))
            }
            for job in (prepare(pasted), jobs[candidate.names])
        )
        assert changed == given, candidate.names


EXPERIMENTS = """\
experiments:
  a: {}
  b: {record: {channels: {w_1: {column: w_1, unit: rad/s, sigma: 0.1, lag: 0.01}}}}
inputs:"""


@starts_believed()
def test_parts_of_several_experiments_are_shared_or_own(tmp_path: Path) -> None:
    """Sensors are the same, but for offsets of channels; noise is an experiment's own."""
    every = singles(candidates(tmp_path, ("inputs:", EXPERIMENTS)))
    for name, freed in {
        "gain_w_1": {"gain_w_1"},
        "offset_theta_1": {"offset_theta_1_a", "offset_theta_1_b"},
        "lag_w_1": {"lag_w_1_a"},
        "unknown_noise": {"sigma_w_1_a", "sigma_w_1_b", "sigma_theta_1"},
        "ar1": {f"{x}_{c}" for x in ("sigma", "rho") for c in ("w_1_a", "w_1_b", "theta_1")},
    }.items():
        assert unknowns(every[name]) == {"k_e", "j_1", *freed}, name
    without_lag = EXPERIMENTS.replace(", lag: 0.01", "")
    torque = singles(candidates(tmp_path, ("inputs:", without_lag)))["missing_torque_rotor_1"]
    assert unknowns(torque) == {"k_e", "j_1", "s_d", "tau_d"}


@starts_believed()
def test_physics_and_noise_of_a_config_are_not_tried_again(tmp_path: Path) -> None:
    ar1 = ("w_1, unit: rad/s, sigma: 0.05", f"w_1, unit: rad/s, noise: ar1, {FREE}")
    friction = ("t_f: nominal", "t_f: nominal\n  t_cm: {prior: uniform, low: 0, high: 0.1}")
    every = singles(candidates(tmp_path, friction, FREE_ANGLE, ar1))
    assert not {"friction_motor", "friction_both", "unknown_noise"} & {*every}
    assert {"friction_rotor_1", "ar1"} <= {*every}
    assert "rho_theta_1" in unknowns(every["ar1"])


@starts_believed()
def test_windows_leave_an_experiment_that_is_held_out(tmp_path: Path) -> None:
    text = "experiments:\n  away: {held_out: true}\n  a: {}\ninputs:"
    halves = candidates(tmp_path, ("inputs:", text)).windows(2)
    experiments = [half.data["experiments"] for half in halves]
    assert [each["away"] for each in experiments] == [{"held_out": True}] * 2
    first, second = (each["a"]["record"]["window"] for each in experiments)
    assert first[1] == second[0] > first[0]


@starts_believed()
def test_a_memory_is_shared_as_the_size_of_its_noise(tmp_path: Path) -> None:
    shared = ("inputs:", "experiments: {a: {}, b: {}}\nshared: [sigma_w_1]\ninputs:")
    free_speed = ("w_1, unit: rad/s, sigma: 0.05", f"w_1, unit: rad/s, {FREE}")
    every = singles(candidates(tmp_path, shared, FREE_ANGLE, free_speed))
    assert {"rho_w_1", "rho_theta_1_a", "rho_theta_1_b"} <= unknowns(every["ar1"])


def test_angles_of_many_turns_widen_no_prior(tmp_path: Path) -> None:
    sizes = candidates(tmp_path / "here").sizes
    start = ("inputs:", "initial: {theta_1: 1000, theta_2: 1000}\ninputs:")
    assert candidates(tmp_path / "far", start).sizes == pytest.approx(sizes, rel=1e-6)


@starts_believed()
def test_only_parts_that_go_together_are_combined(tmp_path: Path) -> None:
    models = candidates(tmp_path)
    every = [name for name in models.changes if not name.startswith(SCALE)]
    rests_of = ("static_motor", "static_rotor_1")

    def beyond(*parts: str) -> set[str]:
        return {x.names[-1] for x in models.extensions(parts, every)}

    smooth = {"damping_rotor_1", "damping_shaft", "inertia_rotor_1", *OF_SENSORS}
    rubbing = {"voltage_drop", "drag_motor", "drag_rotor_1", "load_friction_motor"}
    assert beyond("friction_rotor_1", "ar1") == {
        *smooth, *rubbing, "static_rotor_1", "sticking_motor"
    }  # fmt: skip
    assert beyond("missing_torque_motor") == {"unknown_noise", *smooth}
    rests = {x.names[-1]: x for x in models.extensions(("friction_both",), rests_of)}
    assert {*rests} == {"static_motor", "static_rotor_1"}
    names = unknowns(rests["static_rotor_1"])
    assert {"t_cm", "t_c1", "t_s1", "w_s1"} <= names
    fewer = models.without_each(("friction_both", "static_motor", "ar1"))
    without = [("friction_both", "ar1"), ("friction_both", "static_motor")]
    lesser = [("friction_motor", "static_motor", "ar1"), (*without[1], "unknown_noise")]
    assert [x.names for x in fewer] == without + lesser
    assert models.extensions(tuple(f"x{k}" for k in range(MOST_PARTS)), every) == []


@run_cases("name", ["as_given", "ar1", "damping_shaft"])
def test_a_recommended_config_can_be_read_from_another_folder(name: str, tmp_path: Path) -> None:
    output = ("output: {predictive_draws: 10, figures: []}", "output: {figures: [corner]}")
    models = candidates(tmp_path / "here", output)
    candidate = {**singles(models), "as_given": models.rungs([()])[0]}[name]
    path = tmp_path / "far" / "away" / "recommended.yaml"
    path.parent.mkdir(parents=True)
    given = candidate.data, models.job.source, path.parent
    path.write_text(config_edits.as_file(*given, ["first", "second"], "mine"))
    assert path.read_text().startswith("# first\n# second\nname: mine\n")
    case, problem = loading.load(path), candidate.job().problem
    assert list(case.config.output.figures) == ["corner"]
    again = prepare(path).problem
    assert again.names == problem.names
    assert (again.experiment.y == problem.experiment.y).all()
    assert load_yaml(case.source.text)["record"]["file"] == "../../here/small.csv"
