"""Physics that a config switches on by naming its parameter."""

from pathlib import Path

from support.case_tables import run_cases
from support.config_texts import write_composed

from bayesdrill.config import loading
from bayesdrill.rig.models.motor_shaft import OFFERS, MotorShaft

C_S = "c_s: {prior: log_uniform, low: 1.0e-4, high: 0.1}"


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
