"""The oracle of dry friction itself: against a formula; and what its cases show."""

import math

import numpy as np
import pytest
from support.case_tables import run_cases, slow_except
from support.friction_cases import moved
from support.friction_oracle import Rig, simulate
from support.scipy_oracles import NOMINAL

# The ends of the shaft move apart.
FREE = {**NOMINAL, "t_f": 0.0, "c_m": 0.0, "k_s": 0.0, "k_e": 0.0, "k_T": 0.0}
AT_REST = np.zeros(2)


@run_cases("viscous, sign", [(viscous, sign) for viscous in [0.0, 0.021] for sign in [1, -1]])
def test_a_rotor_coasts_until_it_sticks(viscous: float, sign: int) -> None:
    """j w' = -T - c w: (w_0 + T/c) exp(-c t/j) - T/c, and it stays where it has stopped."""
    w_0, torque, j = 13.0, 0.25, NOMINAL["j_1"]
    t = np.linspace(3.0, 6.0, 97)
    rig = Rig(p={**FREE, "t_c1": torque, "c_1": viscous})
    found = simulate(rig, t[[0, -1]], AT_REST, at=t, start={"w_1": sign * w_0, "theta_1": 0.7})
    s = t - 3.0
    if viscous:
        rate, drag = viscous / j, torque / viscous
        stop = math.log(1 + w_0 / drag) / rate
        s = np.minimum(s, stop)
        w = (w_0 + drag) * np.exp(-rate * s) - drag
        angle = (w_0 + drag) * (1 - np.exp(-rate * s)) / rate - drag * s
    else:
        stop = w_0 * j / torque
        s = np.minimum(s, stop)
        w, angle = w_0 - torque / j * s, w_0 * s - 0.5 * torque / j * s**2
    assert stop < 2.9
    assert found.of("w_1") == pytest.approx(sign * w, rel=1e-9, abs=1e-10)
    assert found.of("theta_1") == pytest.approx(0.7 + sign * angle, rel=1e-9)
    stuck = t - 3.0 > stop
    assert (found.stuck[:, 1] == stuck).all()
    assert not found.of("w_1")[stuck].any()


STICK = {
    "stick slip": (1,),
    "reversing": (0, 1),
    "static": (0, 1),
    "servo": (0, 1),
    "other": (0, 2),
}
REVERSE = {"reversing": (2, 3, 4), "other": (2,), "servo": (2, 4)}


@pytest.mark.parametrize("name", slow_except(("stick slip", "other"), STICK))
def test_the_cases_are_what_they_are_called(name: str) -> None:
    """Sticking of motor and rotor, a current that is held at zero, and reversals that do not stick."""
    sticks = moved(name).stuck.sum(axis=0)[[*STICK[name]]]
    assert (sticks > (500 if name == "stick slip" else 0)).all()
    signs = np.sign(moved(name).states[:, [*REVERSE.get(name, ())]])
    assert (signs[1:] * signs[:-1] < 0).any(axis=0).all()
