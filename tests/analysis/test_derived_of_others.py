"""Derived quantities and remedies of rigs without a motor, without a shaft, and with modes in a part."""

from __future__ import annotations

import numpy as np
import pytest
from support.scipy_oracles import NOMINAL
from support.small_problems import experiment

from bayesdrill.inference import derived
from bayesdrill.record.experiment import typical_inputs
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor, MotorShaft

SHAFT = {"k_s": 4.1, "j_1": 7.8e-3, "c_s": 0.017, "c_1": 0.011}
CIRCUIT = {"k_e": 0.061, "k_T": 0.057, "r_m": 0.41, "l_m": 9e-4}


def of(rig: Model, p: dict[str, float], **inputs: float) -> dict[str, float]:
    linear = rig.linear(p)
    found = derived.poles(rig, linear, 1) | derived.steady_values(rig, linear, 1, inputs)
    return {name: float(x[0]) for name, x in found.items()}


def test_a_driven_shaft_swings_as_one_mass_on_a_spring() -> None:
    """And ends at the speed that is imposed; it has no current, and no motor's time."""
    found = of(with_named(DrivenShaft(), SHAFT), SHAFT, w_2=9.0, t_1=1.7)
    omega = np.sqrt(4.1 / 7.8e-3)
    assert found["omega_n"] == pytest.approx(omega)
    assert found["zeta"] == pytest.approx((0.017 + 0.011) / (2 * 7.8e-3 * omega))
    assert found["w_end"] == pytest.approx(9.0)
    assert np.isnan([found[name] for name in ("tau_e", "tau_m", "i_end")]).all()


def test_a_motor_has_the_times_of_what_it_consists_of() -> None:
    """Mutant killed: the time of a motor without a circuit taken for that of a current."""
    p = {"j_m": 1.4e-4, "c_m": 9.3e-5, "t_f": 0.037}
    found = of(with_named(Motor(), p), p, t_m=0.05)
    assert found["tau_m"] == pytest.approx(1.4e-4 / 9.3e-5)
    assert found["w_end"] == pytest.approx((0.05 - 0.037) / 9.3e-5)
    assert np.isnan([found[name] for name in ("tau_e", "omega_n", "zeta", "i_end")]).all()
    found = of(with_named(Motor(), p | CIRCUIT), p | CIRCUIT, v=6.0)
    slow = p["c_m"] + CIRCUIT["k_T"] * CIRCUIT["k_e"] / CIRCUIT["r_m"]
    roots = np.roots([1.4e-4 * 9e-4, 1.4e-4 * 0.41 + 9.3e-5 * 9e-4, slow * CIRCUIT["r_m"]])
    assert [found["tau_m"], found["tau_e"]] == pytest.approx(np.sort(-1 / roots)[::-1])
    end = (CIRCUIT["k_T"] * 6.0 / CIRCUIT["r_m"] - 0.037) / slow
    assert found["w_end"] == pytest.approx(end)
    assert found["i_end"] == pytest.approx((6.0 - CIRCUIT["k_e"] * end) / CIRCUIT["r_m"])


def test_the_swing_of_a_long_shaft_is_not_one_within_it() -> None:
    """Though the modes within are damped least.  Mutant killed: the least damped pair, however fast."""
    p = NOMINAL | {"j_s": 1.5e-7}
    found, plain = of(LongShaft(), p, v=8.0), of(MotorShaft(), NOMINAL, v=8.0)
    for name in ("omega_n", "zeta", "tau_e", "tau_m", "w_end", "i_end"):
        assert found[name] == pytest.approx(plain[name], rel=2e-5), name


def test_what_drives_a_rig_is_usual_by_its_size() -> None:
    """Of one that goes both ways too; a load by its mean.  Mutant killed: the mean of a drive."""
    both = np.array([3.0, -4.0, 3.0, -4.0])
    series = {"w_2": both, "t_1": both + 2.0}
    found = typical_inputs(experiment(4, constant={}, series=series))
    assert found == {"w_2": pytest.approx(np.sqrt(12.5)), "t_1": pytest.approx(1.5)}
    assert typical_inputs(experiment(4, constant={"t_m": -0.3})) == {"t_m": pytest.approx(0.3)}
