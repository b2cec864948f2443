"""Trains, which columns make that have symbols of their parts."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.first_configs import channels_of, draft_of, reversing_rig, write_table


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two inertias that a current drives; the load counts backwards."""
    t, u, x = reversing_rig()
    return write_table(tmp_path / "bench.csv", {"a": t, "b": u, "c": x[:, 1], "d": -x[:, 0]})


def test_columns_with_the_symbols_of_a_train_make_one(bench: Path) -> None:
    draft = draft_of(
        bench, "a=t [s]", "b=i_motor [A]", "c=theta_motor [rad]", "d=-theta_load [rad]"
    )
    assert draft["model"] == {
        "name": "train",
        "inertias": ["motor", "load"],
        "shafts": {"shaft": ["motor", "load"]},
        "drives": {"motor": "current"},
    }
    assert channels_of(draft) == {"theta_motor": ("c", "rad"), "theta_load": ("d", "rad")}
    assert draft["record"]["channels"]["theta_load"]["measures"] == "-theta_load"
    assert draft["inputs"]["i_motor"]["column"] == "b"
    assert draft["parameters"]["k_T_motor"] == 1.0
    assert draft["initial"] == "free"


def test_positions_make_a_train_along_a_line(bench: Path) -> None:
    draft = draft_of(bench, "a=t [s]", "b=f_cart [N]", "c=x_cart [mm]", "d=v_end [mm/s]")
    assert draft["model"]["motion"] == "linear"
    assert draft["model"]["drives"] == {"cart": "torque"}
    assert draft["inputs"]["f_cart"]["unit"] == "N"
    assert {"m_cart", "m_end", "k_shaft", "c_cart"} <= {*draft["parameters"]}


def test_a_train_that_nothing_drives_has_no_inputs(bench: Path) -> None:
    draft = draft_of(bench, "a=t [s]", "c=theta_arm [rad]")
    assert draft["model"] == {"name": "train", "inertias": ["arm"]}
    assert draft["inputs"] == {}


def test_a_symbol_of_another_rig_is_none_of_a_train(bench: Path) -> None:
    draft = draft_of(bench, "a=t [s]", "b=t_m [N*m]", "c=theta_2 [rad]", rig="motor")
    assert draft["model"]["name"] == "motor"
