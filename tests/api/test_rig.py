"""The response of a rig at given parameters: exact, at any times, and refused where there is none."""

import numpy as np
import pytest
from support.array_cases import SHAFT, T
from support.case_tables import run_cases
from support.scipy_oracles import NOMINAL, by_expm

import bayesdrill as bd

SIGNALS = ["w_1", "theta_1 - theta_2"]


def test_the_response_is_that_of_the_matrix_exponential() -> None:
    start, inputs = {"theta_1": 0.3, "w_1": -0.2}, {"v": 5.0, "t_1": 0.2}
    signals = bd.respond(bd.MotorShaft(), SHAFT, T, inputs, SIGNALS, initial=start)
    exact = by_expm(SHAFT, T, np.array([0.3, 0.0, -0.2, 0.0, 0.0]), 5.0, 0.2)
    expected = exact[:, 2], exact[:, 0] - exact[:, 1]
    for values, column in zip(signals.values(), expected, strict=True):
        assert values == pytest.approx(column, rel=1e-9, abs=1e-12)


@run_cases("hold", ["zero", "first"])
def test_a_response_at_uneven_times_is_that_on_a_fine_grid(hold: str) -> None:
    """Of a voltage that changes at those times alone."""
    fine = 0.25 + 0.005 * np.arange(201)
    picked = np.array([0, 3, 4, 40, 41, 90, 170, 200])
    v = np.array([6.0, -3.0, 5.0, 4.0, -7.0, 1.0, 2.0, 2.0])
    held = v[np.searchsorted(picked, np.arange(201), side="right") - 1]
    dense = np.interp(fine, fine[picked], v) if hold == "first" else held
    exact, signals = (
        bd.respond(
            bd.MotorShaft(), SHAFT, t, {"v": volts}, SIGNALS,
            initial={"w_1": 3.0, "theta_2": 0.2}, hold=hold,
        )
        for t, volts in ((fine, dense), (fine[picked], v))
    )  # fmt: skip
    for name, values in signals.items():
        assert values == pytest.approx(exact[name][picked], rel=1e-9, abs=1e-10)


@run_cases(
    "changes, message",
    [
        ({"t": np.array([0.0, 0.5, 0.1])}, "t: "),
        ({"t": [0.0]}, "give at least two"),
        ({"parameters": {**NOMINAL, "j_1": -1.0}}, "parameters.j_1: -1.0 is not a positive number"),
        ({"parameters": {**NOMINAL, "x": 1.0}}, "parameters.x: the rig has none"),
        ({"parameters": {"k_s": 1.0}}, "parameters.j_m: is missing"),
        ({"inputs": {}}, "inputs.v: is missing"),
        ({"inputs": {"v": "8"}}, "inputs.v: '8' is not a number"),
        ({"inputs": {"v": np.ones(3)}}, "inputs.v: give one number for each of the times"),
        ({"inputs": {"v": 5.0, "u": 1.0}}, "inputs.u: the rig has none"),
        ({"hold": "cubic"}, "hold: 'cubic' is neither"),
        ({"initial": {"w_3": 1.0}}, "initial.w_3: the rig has none"),
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
