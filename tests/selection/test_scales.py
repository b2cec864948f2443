"""Values and units that are off by a factor: what is tried, and that map and check name the line."""

import re
from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases, slow_except
from support.command_line import CONFIGS
from support.small_problems import starts_believed
from support.unexplained_records import causes_of, write

import bayesdrill as bd
from bayesdrill.config.job import prepare
from bayesdrill.report.sections.causes import describe_causes
from bayesdrill.selection.scales import scale_entries

T = np.linspace(0.0, 0.5, 251)
TRUE = {"j_hub": 1e-4, "k_T_hub": 0.05, "k_e_hub": 0.05, "c_hub": 1e-4, "r_hub": 1.2, "l_hub": 1e-3}
MOTOR = (CONFIGS / "scaled_motor.yaml").read_text(encoding="utf-8")
BOX = "{prior: log_uniform, low: 0.1, high: 10, relative: true}"
MODEL = bd.Train(inertias=["hub"], drives={"hub": "voltage"})


def motor(folder: Path, *changes: tuple[str, str], w: float = 1.0) -> Path:
    """Write a motor under 24 V, whose speeds are multiplied, and values or units wrong."""
    exact = bd.respond(MODEL, TRUE, T, {"u_hub": 24.0}, ["w_hub", "i_hub"])
    noise = np.random.default_rng(8).standard_normal((2, len(T)))
    columns = {"w": w * (exact["w_hub"] + 0.5 * noise[0]), "i": exact["i_hub"] + 0.02 * noise[1]}
    text = MOTOR.replace("BOX", BOX).replace("sigma: 0.5", f"sigma: {0.5 * w:.4g}")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return write(folder, text, {"t": T, **columns})


# What is wrong: changes of the config, factors of columns, the part that says so, and its line.
WRONG = {
    "nominal value in mN m s": (
        [("j_hub: 1.0e-4", "j_hub: 0.1")],
        {},
        "j_hub_0.001",
        "j_hub: 0.0001",
    ),
    "held value in mH": ([("l_hub: 1.0e-3", "l_hub: 1.0")], {}, "l_hub_0.001", "l_hub: 0.001"),
    "rpm as rad/s": ([], {"w": 30 / np.pi}, "w_hub_0.105", "unit: rpm"),
}


@pytest.mark.parametrize("name", slow_except(("rpm as rad/s",), WRONG))
def test_a_wrong_unit_is_found_before_physics_is_invented(name: str, tmp_path: Path) -> None:
    """Kills the mutant that ranks all other candidates first, which takes minutes."""
    changes, columns, part, line = WRONG[name]
    causes = causes_of(bd.load(motor(tmp_path, *changes, **columns)))
    assert causes.best.name == f"scale_{part}"
    assert causes.best.explains_all
    assert line in causes.best.lines
    assert all(cause.off_by_a_factor for cause in causes.ranked)
    text = describe_causes(causes)
    assert re.search(r"given.yaml:\d+: (nominal|parameters|record)", text)
    assert "a value or unit is off by a factor" in text


@run_cases(
    "wrong",
    [
        ("k_T_hub: 0.05", "k_T_hub: 50", "With 0.001 times the value of k_T_hub"),
        ("l_hub: 1.0e-3", "l_hub: 1.0", "With 0.001 times the value of l_hub"),
        ("map:", "map:", ""),
    ],
)
def test_check_compares_the_size_of_the_record_with_nominal_values(
    wrong: tuple[str, str, str], tmp_path: Path
) -> None:
    text = bd.load(motor(tmp_path, wrong[:2])).preview()
    assert ("REVIEW" in text) == bool(wrong[2])
    assert wrong[2] in text


@starts_believed()
def test_values_that_follow_from_others_are_not_scaled(tmp_path: Path) -> None:
    names = [name for name, *_ in scale_entries(prepare(motor(tmp_path)))]
    assert not any(name.startswith("scale_k_e") for name in names)
    assert {"scale_u_hub_1e+03", "scale_r_hub_0.001", "scale_c_hub_9.55"} <= {*names}
    assert "scale_r_hub_9.55" not in names
