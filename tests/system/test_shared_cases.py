"""Small inputs that showed a fault, each through the commands that a user would give."""

import shutil
from pathlib import Path

import pytest
from support.command_line import cli
from support.first_configs import shared

# For each case a command line, its status, words that it says, and words that it does not say.
SAID: dict[str, tuple[str, int, list[str], list[str]]] = {
    "check_own_train": ("check motor.yaml", 0, ["the record determines every unknown"], []),
    "every_unknown": ("check config.yaml", 0, ["every unknown but theta_motor_0"], []),
    "identify_stuck": (
        "identify stuck.yaml",
        0,
        ["AT REST: at the start values the rig does not move"],
        ["timing:"],
    ),
    "clock_2_percent_slow": (
        "map config.yaml",
        3,
        ["A is the config with a clock of the record whose times are 0.98"],
        [],
    ),
    "sign_flipped": ("map config.yaml", 3, ["w_1: {gain: -1.0}", "looks like the noise"], []),
    "swapped_columns": ("map config.yaml", 3, ["the columns of w_1 and w_2 exchanged"], []),
    "t0_prior_end": (
        "map config.yaml",
        3,
        ["t_0 is at an end of its prior, 0.02 s. Widen it", "A is the config with a wider prior"],
        [],
    ),
    "rest_windows": (
        "map config.yaml",
        0,
        ["A is the config with dry friction at the motor."],
        ["What changes most", "  t_s_motor: {"],
    ),
    "lag_undriven": ("map config.yaml", 3, ["quadratic drag at the cart"], ["a lag of x_cart"]),
    "lag_of_only_channel": ("map drop.yaml", 3, ["That leaves more than noise"], ["a lag of"]),
    "ar1_as_noise": ("map arm.yaml", 3, ["one more inertia on a spring at the hub"], ["kind: ar1"]),
}
QUICK = ("check_own_train", "every_unknown", "identify_stuck")
PARAMETERS = [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in SAID]


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_case_ends_as_its_readme_says(name: str, tmp_path: Path) -> None:
    folder = shutil.copytree(shared(f"cases/small/{name}"), tmp_path / name)
    line, status, words, nowhere = SAID[name]
    command, config = line.split()
    ran = cli(command, folder / config)
    assert ran.status == status, ran.text
    assert [each for each in words if each not in ran.text] == []
    assert [each for each in nowhere if each in ran.text] == []
