"""The rig with a second rotor, constants of rigs, and what a rig has no value for."""

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases

from bayesdrill.basics.errors import InputError
from bayesdrill.config import loading
from bayesdrill.inference import derived
from bayesdrill.rig.models.linear import Linear, Model
from bayesdrill.rig.models.motor_shaft import MotorShaft

ROOT = Path(__file__).parents[3]


def test_a_rig_that_never_settles_has_no_end_values() -> None:
    """Held by neither angle nor friction in one state: NaN, and no error."""
    a = {("theta_1", "w_1"): 1.0, ("w_1", "theta_1"): -1.0, ("theta_2", "w_2"): 1.0}
    linear = Linear(A={**a, ("i", "i"): -1.0}, B={}, c={"w_2": 1.0})
    found = derived.steady_values(MotorShaft(), linear, 2, {})
    assert np.isnan(found["w_end"]).all()
    assert np.isnan(found["i_end"]).all()


def load(tmp_path: Path, model: str) -> Model:
    text = (ROOT / "configs" / "nominal_step.yaml").read_text()
    old = "model:\n  name: motor_shaft\n  i_m: 0.125                # gear 8:1\n"
    assert text.count(old) == 1
    path = tmp_path / "config.yaml"
    path.write_text(text.replace(old, f"model: {model}\n"))
    return loading.load(path).model


@run_cases(
    "text, said",
    [
        (
            "{name: motor_shaft, j_2: 7.0e-3}",
            "model.j_2: the model motor_shaft has no j_2; remove it, or name: two_rotors",
        ),
        (
            "{name: two_rotors, elements: 3}",
            "model.elements: the model two_rotors has no elements; remove it, or name: long_shaft",
        ),
        ("{name: two_rotors, r_s: -0.1}", "model.r_s: -0.1"),
        ("{name: motor_shaft, stribeck: 3}", "model.stribeck: '3' is not possible"),
        ("{name: two_rotor}", "model.name: 'two_rotor' is not a model; did you mean two_rotors?"),
    ],
)
def test_a_constant_of_another_model_is_an_error_with_its_line(
    text: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"{tmp_path / 'config.yaml'}:24: {said}")
