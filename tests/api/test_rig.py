"""The response of a rig at given parameters: exact, at any times, and refused where there is none."""

import numpy as np
import pytest
from support.array_cases import T
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL

import bayesdrill as bd

STATIC = {"t_cm": 0.2, "t_sm": 0.1, "w_sm": 1.0}


@run_cases(
    "changes, message",
    [
        ({"t": np.array([0.0, 0.5, 0.1])}, "t: "),
        ({"t": [0.0]}, "give at least two"),
        ({"parameters": {**NOMINAL, "j_1": -1.0}}, "parameters.j_1: -1.0 is not a positive number"),
        ({"parameters": {**NOMINAL, "c_2": 0.1}}, "parameters.c_2: the rig has no such name"),
        ({"parameters": {**NOMINAL, "t_sm": 0.1}}, "t_sm means nothing without t_cm and w_sm"),
        ({"parameters": {**NOMINAL, "c_s": -0.1}}, "parameters.c_s: -0.1 is negative"),
        ({"parameters": {**NOMINAL, "eta": 1.1}}, "parameters.eta: 1.1 is more than 1"),
        ({"parameters": {**NOMINAL, **STATIC}}, "parameters.t_sm: is below t_cm; static friction"),
        ({"parameters": {"k_s": 1.0}}, "parameters.j_m: is missing"),
        ({"inputs": {}}, "inputs.v: is missing"),
        ({"inputs": {"v": "8"}}, "inputs.v: '8' is not a number"),
        ({"inputs": {"v": np.ones(3)}}, "inputs.v: give one finite number for each time"),
        ({"inputs": {"v": 5.0, "u": 1.0}}, "inputs.u: the rig has no such name"),
        ({"hold": "cubic"}, "hold: 'cubic' is neither"),
        ({"initial": {"w_3": 1.0}}, "initial.w_3: the rig has no such name"),
        ({"initial": np.zeros(5)}, "initial: give a number for each state, not ndarray"),
        ({"signals": "w_3"}, "w_3"),
    ],
)
def test_a_response_that_no_rig_can_give_is_refused(
    changes: dict[str, object], message: str
) -> None:
    arguments = {"t": T, "parameters": NOMINAL, "inputs": {"v": 5.0}, "signals": ["w_1"]}
    with pytest.raises(bd.InputError, match=message):
        bd.respond(bd.MotorShaft(), **arguments | changes)  # type: ignore[arg-type]
