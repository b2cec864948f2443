"""What simulators take away from a run, read back by other code."""

import dataclasses
import json
from xml.etree import ElementTree

import numpy as np
import pytest
from support import finished_runs
from support.array_cases import run as sampled_run
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.rig.models.linear import dynamics, with_named
from bayesdrill.tasks import export
from bayesdrill.tasks.export import ExportedNumber, SimulatorModel, simulator_model


@pytest.fixture(scope="module")
def run() -> bd.Run:
    return sampled_run()


@pytest.fixture(scope="module")
def model(run):
    return simulator_model(run, 200, np.random.default_rng(1))


def means(run, rows: int = 200) -> dict[str, float]:
    """Parameters of the rig at the mean of the draws that are exported."""
    problem = run.job.problem
    chain = run.sampled.draws.reshape(-1, len(problem.names))
    picked = np.sort(np.random.default_rng(1).choice(len(chain), rows, replace=False))
    parameters = problem.posterior.likelihood.rig_parameters(chain[picked])
    return {name: float(draws.mean()) for name, draws in parameters.items()}


def test_mjcf_has_the_rig(run, model):
    """Springs, dampers and inertias of the file make the matrix of the rig's equations."""
    root = ElementTree.fromstring(export.as_mjcf(model))
    joints = {joint.get("name"): joint for joint in root.iter("joint") if joint.get("name")}
    names = [*joints]
    mass = np.diag([float(joints[name].get("armature")) for name in names])
    damping = np.diag([float(joints[name].get("damping", "0")) for name in names])
    stiffness = np.zeros_like(mass)
    for spring in root.iter("fixed"):
        turns = np.zeros(len(names))
        for end in spring.iter("joint"):
            turns[names.index(end.get("joint"))] = float(end.get("coef"))
        stiffness += float(spring.get("stiffness")) * np.outer(turns, turns)
    rig = run.job.problem.model
    p = means(run)
    states = [{"rotor_1": "1", "gearbox": "2", "motor": "2"}[name] for name in names]
    a = dynamics(rig.linear(p), rig.states, 1)[0]
    angles = [rig.states.index(f"theta_{index}") for index in states]
    speeds = [rig.states.index(f"w_{index}") for index in states]
    assert np.linalg.solve(mass, -stiffness) == pytest.approx(a[np.ix_(speeds, angles)], rel=1e-7)
    assert np.linalg.solve(mass, -damping) == pytest.approx(a[np.ix_(speeds, speeds)], rel=1e-7)
    (motor,) = root.iter("general")
    turns, gain = float(motor.get("gear")), float(motor.get("gainprm"))
    assert turns * gain == pytest.approx(p["k_T"] / p["r_m"] / rig.i_m, rel=1e-7)
    assert float(motor.get("biasprm").split()[2]) == pytest.approx(-gain * p["k_e"], rel=1e-7)


def test_dcmotor_has_the_circuit_and_all_else_as_before(run, model):
    root = ElementTree.fromstring(export.FORMS["dcmotor"](model))
    (motor,) = root.iter("dcmotor")
    p, plain = means(run), ElementTree.fromstring(export.as_mjcf(model))
    assert [*root.iter("general")] == []
    assert float(motor.get("resistance")) == pytest.approx(p["r_m"], rel=1e-7)
    assert [*map(float, motor.get("motorconst").split())] == pytest.approx(
        [p["k_T"], p["k_e"]], rel=1e-7
    )
    assert float(motor.get("inductance").split()[0]) == pytest.approx(p["l_m"], rel=1e-7)
    (general,) = plain.iter("general")
    assert (motor.get("joint"), motor.get("gear")) == (general.get("joint"), general.get("gear"))
    for tree in (root, plain):
        tree.remove(tree.find("actuator"))
    assert ElementTree.tostring(root) == ElementTree.tostring(plain)
    torque_driven = dataclasses.replace(
        model, quantities=tuple(q for q in model.quantities if q.name != "resistance")
    )
    assert "<dcmotor" not in export.FORMS["dcmotor"](torque_driven)


def test_a_servo_whose_supply_is_measured_has_the_usual_one() -> None:
    rig = with_named(bd.Train(inertias=("arm",), drives={"arm": {"servo": 12}}), ["k_p_arm"])
    joints = rig.roles.moving(rig.states, rig.parameters).values()
    ones = {name: np.ones(3) for name in rig.parameters}
    found = {quantity.name: quantity for quantity in export._quantities(rig, ones, joints)}
    assert found["supply"].map == 12.0
    assert found["supply"].draws.tolist() == [12.0, 12.0]
    assert found["proportional_gain"].map == 1.0


def test_directions_of_friction_are_those_of_the_joint() -> None:
    gears = {"box": {"between": ("motor", "arm"), "ratio": -0.5}}
    train = bd.Train(inertias=("motor", "arm"), gears=gears, drives={"motor": "torque"})
    numbers = {"c_motor": 1.0, "c_motor_backward": 2.0, "c_arm": 0.5, "t_f_motor": 3.0}
    rig = with_named(train, [*numbers])
    p = {name: np.full(3, numbers.get(name, 0.1)) for name in rig.parameters}
    joints = rig.roles.moving(rig.states, rig.parameters).values()
    found = {each.name: each.mean for each in export._quantities(rig, p, joints)}
    assert (found["damping"], found["damping_backward"]) == (2.0 * 4 + 0.5, 1.0 * 4 + 0.5)
    assert (found["armature"], found["constant_friction"]) == (0.1 * 4 + 0.1, -3.0 * 2)


def test_json_has_spread_and_draws(run, model):
    data = json.loads(export.as_json(model))
    keys, draws = [*data["quantities"]], np.array(data["draws"])
    assert draws.shape == (200, len(keys))
    for key, values in zip(keys, draws.T, strict=True):
        assert data["quantities"][key]["mean"] == pytest.approx(values.mean())
        assert data["quantities"][key]["sd"] == pytest.approx(values.std())
    free = [k for k, values in enumerate(draws.T) if np.ptp(values) > 0]
    assert free
    expected = np.corrcoef(draws[:, free].T)
    assert np.array(data["correlations"])[np.ix_(free, free)] == pytest.approx(expected, abs=1e-5)
    stiffness = data["quantities"]["shaft.stiffness"]
    assert stiffness["map"] == pytest.approx(run.mode.values.get("k_s", means(run)["k_s"]))


def test_command_writes_and_refuses(tmp_path, tmp_path_factory):
    folder = finished_runs.run(tmp_path_factory).folder
    target = tmp_path / "rig.xml"
    text = bd.export(folder, "mjcf", target)
    assert target.read_text() == text
    with pytest.raises(bd.InputError, match="exists already"):
        bd.export(folder, "mjcf", target)
    with pytest.raises(bd.InputError, match="did you mean"):
        bd.export(folder, "mjfc")
    with pytest.raises(bd.InputError, match="does not exist"):
        bd.export(folder, "json", tmp_path / "none" / "rig.json")


@run_cases("reserved", ["world", "base"])
def test_a_part_may_be_called_what_simulators_have_themselves(reserved: str) -> None:
    """The body has another name then, which no other part has; its joint keeps its own."""
    rig = bd.Train(inertias=(reserved, f"{reserved}_body"), drives={reserved: "torque"})
    names = {f"w_{name}": name for name in rig.inertias}
    quantities = tuple(
        ExportedNumber(part=name, name="armature", unit="kg*m**2", draws=np.ones(3), map=1.0)
        for name in rig.inertias
    )
    model = SimulatorModel(
        title="x", linear=False, joints=names, springs={}, drives={}, quantities=quantities
    )
    mjcf = ElementTree.fromstring(export.as_mjcf(model))
    bodies = ["world", *(body.get("name") for body in mjcf.iter("body"))]
    assert len({*bodies}) == len(bodies) == 3
    assert [joint.get("name") for joint in mjcf.iter("joint")] == [*rig.inertias]
