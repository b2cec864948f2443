"""Physics that a config switches on by naming its parameter."""

from pathlib import Path

import numpy as np
import pytest
from support import command_line
from support.case_tables import run_cases
from support.config_texts import write, write_composed
from support.first_configs import draft_of, reversing_rig, write_table
from support.scipy_oracles import NOMINAL, with_damping

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.config.records import simulation
from bayesdrill.report import words
from bayesdrill.results import provenance
from bayesdrill.rig.models.motor_shaft import OFFERS, MotorShaft

C_S = "c_s: {prior: log_uniform, low: 1.0e-4, high: 0.1}"
T = 0.025 * np.arange(161)


@run_cases(
    "lines, added",
    [
        ((), ()),
        ((C_S,), ("c_s",)),
        (("v_d: 0.0", "c_1: 0.001", "c_s: 0.01"), ("c_s", "c_1", "v_d")),
        (("t_cm: {tie: t_f}", "j_2: 0.2*j_1", "r_s: r_m/2"), ("j_2", "r_s", "t_cm")),
        (("eta: {prior: uniform, low: 0.6, high: 1}",), ("eta",)),
        (tuple(f"{name}: 0.5" for name in OFFERS), tuple(OFFERS)),
    ],
)
def test_naming_a_parameter_switches_its_physics_on(
    lines: tuple[str, ...], added: tuple[str, ...], tmp_path: Path
) -> None:
    """In the order of the rig, not of the file."""
    rig = "{name: motor_shaft, i_m: 0.2, stribeck: 2}"
    (experiment,) = loading.load(write_composed(tmp_path, *lines, model=rig)).experiments
    assert experiment.model == MotorShaft(0.2, 2, added)
    space = experiment.rig_numbers.space()
    assert space.model == experiment.model.parameters
    unknown = {line.partition(":")[0] for line in lines if "prior" in line}
    assert {*space.free} == {"k_e", "j_1", *unknown}


def test_a_spoilt_parameter_still_switches_its_physics_on(tmp_path: Path) -> None:
    """One mistake hides no other and makes none."""
    formula = "eta_0: {prior: uniform, low: 1, high: 2, unit: mm}"
    path = write_composed(
        tmp_path,
        *("t_cm: 0.1", "w_sm: 2.0", "t_sm: many", "c_s: -1.0"),
        quantities=f"{{{formula}}}",
        derived="{ratio: c_s/c_m, other: c_x}",
    )
    with pytest.raises(InputError) as caught:
        loading.load(path)
    places = {problem.place.partition(": ")[2] for problem in caught.value.problems}
    assert places == {"derived.other", "parameters.c_s", "parameters.t_sm"}


def test_a_run_names_the_added_physics(tmp_path: Path) -> None:
    """In words, and so that no run is resumed with other physics."""
    path = write_composed(tmp_path, C_S, "r_s: 0.1")
    assert command_line.cli("simulate", path).status == 0
    job = prepare(path)
    assert words.model(job.problem).startswith("motor_shaft with c_s, r_s (i_m = 0.125; the motor")
    shown = command_line.cli("check", path).out
    for text in ("unknown: k_e, j_1, c_s\n", "r_s = 0.1"):
        assert text in shown
    assert "c_s [N m s/rad]: log-uniform from 0.0001 to 0.1" in shown
    marks = provenance.fingerprint(job.config, job.problem)
    assert marks["the model"] == "MotorShaft(i_m=0.125, added=('c_s', 'r_s'))"
    plain = prepare(write_composed(tmp_path))
    marks = provenance.fingerprint(plain.config, plain.problem)
    assert marks["the model"] == "MotorShaft(i_m=0.125)"


def test_each_experiment_may_have_its_own_damping(tmp_path: Path) -> None:
    names = "{slow: {record: {file: a.csv}}, fast: {record: {file: b.csv}, inputs: {v: 12.0}}}"
    case = loading.load(write_composed(tmp_path, C_S, experiments=names, own="[c_s]"))
    assert case.model.parameters[9:] == ("c_s",)
    assert case.space().free == ("k_e", "j_1", "c_s_slow", "c_s_fast")
    assert len(simulation.simulate_all(case, 1, tmp_path)) == 2


def test_lines_of_a_first_config_switch_physics_on(tmp_path: Path) -> None:
    t, v, x = reversing_rig()
    record = write_table(tmp_path / "both.csv", {"t": t, "v": v, "w_1": x[:, 2], "w_2": x[:, 3]})
    draft = draft_of(record)["text"]
    assert loading.load(write(tmp_path, draft)).model.parameters == MotorShaft.parameters
    offered = [line for line in draft.splitlines() if "half_normal" in line]
    lines = [line for line in offered if "# c_s" in line or "# t_cm" in line]
    assert len(lines) == 2
    on = write(tmp_path, draft, *((line, line.replace("# ", "", 1)) for line in lines))
    assert loading.load(on).model.parameters[9:] == ("c_s", "t_cm")


def test_damping_is_found_again_in_arrays() -> None:
    x, rng = with_damping(0.02, NOMINAL["r_m"] / 2, T), np.random.default_rng(4)
    channels = {
        name: bd.Channel(x[:, k] + 0.01 * rng.standard_normal(len(T)), "rad/s", 0.01)
        for name, k in (("w_1", 2), ("w_2", 3))
    }
    box = {"prior": "uniform", "low": 0.5, "high": 2.0, "relative": True}
    damping = {"prior": "half_normal", "scale": 0.05}
    added = {"c_s": damping, "k_s": box, "r_s": "r_m/2", "j_2": 0.0, "c_1": "c_s*1.0e-6"}
    parameters = dict.fromkeys(NOMINAL, "nominal") | added
    case = bd.case(T, channels, {"v": 8.0}, parameters, nominal="tables_2_3")
    assert case.unknowns == ("k_s", "c_s")
    values = case.find_map().values
    assert values["c_s"] == pytest.approx(0.02, rel=0.02)
    assert values["k_s"] == pytest.approx(NOMINAL["k_s"], rel=0.005)
    with pytest.raises(InputError, match=r"parameters\.v_d: the rig has it; give a prior"):
        bd.case(T, channels, {"v": 8.0}, parameters, rig=MotorShaft(added=("c_s", "v_d")))
    with pytest.raises(InputError, match=r"^added: motor_shaft has no 'c_2' to add; did you mean"):
        MotorShaft(added=("c_2",))


def test_a_rig_without_a_config_takes_added_physics() -> None:
    added = {"c_s": 0.02, "r_s": 0.11}
    response = bd.respond("motor_shaft", NOMINAL | added, T, {"v": 8.0}, ["w_1", "i"])
    states = with_damping(0.02, 0.11, T)
    assert response["w_1"] == pytest.approx(states[:, 2], abs=1e-8)
    assert response["i"] == pytest.approx(states[:, 4], abs=1e-8)
    free = bd.respond("motor_shaft", NOMINAL | {"t_f": 0.0, "c_m": 0.0}, T, {"v": 0.0}, ["w_2"])
    assert np.abs(free["w_2"]).max() == 0.0


@run_cases(
    "wrong, message",
    [
        ({"t_sm": 0.1}, "parameters.t_sm: t_sm means nothing without t_cm and w_sm"),
        ({"c_s": -0.1}, "parameters.c_s: -0.1 is negative"),
        ({"eta": 1.1}, "parameters.eta: 1.1 is more than 1"),
        ({"c_2": 0.1}, "parameters.c_2: the rig has none"),
        (
            {"t_cm": 0.2, "t_sm": 0.1, "w_sm": 1.0},
            "parameters.t_sm: is below t_cm; static friction",
        ),
    ],
)
def test_impossible_physics_of_a_rig_is_refused(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(InputError) as caught:
        bd.respond("motor_shaft", NOMINAL | wrong, T, {"v": 8.0}, ["w_1"])
    assert [str(x)[: len(message)] for x in caught.value.problems] == [message]
