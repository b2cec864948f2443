"""Physics that a config switches on by naming its parameter."""

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.config_texts import write_composed
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
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


@run_cases(
    "entry, usual, k_s",
    [("0.05", 0.05, 0.05), ("{default: 0.05, k_s: 0.1}", 0.05, 0.1), ("{k_s: 0.1}", 0.0, 0.1)],
)
def test_tolerances_are_given_by_a_number_or_by_symbol(
    entry: str, usual: float, k_s: float, tmp_path: Path
) -> None:
    path = write_composed(tmp_path, nominal=f"{{table: tables_2_3, tolerance: {entry}}}")
    (experiment,) = loading.load(path).experiments
    assert experiment.nominal.tolerance["r_m"] == usual
    assert experiment.nominal.tolerance["k_s"] == k_s
