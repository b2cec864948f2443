"""Screws at constant speeds of both signs: their friction differs by the way they turn.

Torques of real drives (Mablekos-Alexiou and others, IEEE T-RO 37, 2021), block after block.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases
from support.first_configs import shared
from support.unexplained_records import causes_of, try_only

import bayesdrill as bd
from bayesdrill.report.sections.causes import describe_causes

RATED = 9.84e-3  # N m at 100 %
SPEEDS = ("10", "20", "50", "100", "200", "n10", "n20", "n50", "n100", "n200")
PRIOR = {"prior": "log_uniform", "low": 1e-4, "high": 1e-1}


def blocks(folder: Path) -> list[tuple[float, np.ndarray]]:
    """The speed of each block [rad/s], and its torque [N m], the mean of ten samples each."""
    made = []
    for name in SPEEDS:
        lines = (folder / f"steady_{name}.csv").read_text().splitlines()[14:]
        _, speed, torque = np.array([[float(x) for x in line.split(";")[:3]] for line in lines]).T
        means = torque[: len(torque) // 10 * 10].reshape(-1, 10).mean(axis=1)
        made.append((float(speed.mean()) * math.pi / 30, means * RATED / 100))
    return made


def screw(made: list[tuple[float, np.ndarray]], **more: Any) -> bd.Case:
    """The speed is imposed, and a coupling of 1 N m/rad shows the torque as its twist."""
    w = np.concatenate([np.full(len(torque), speed) for speed, torque in made])
    torque = np.concatenate([[np.nan], *(torque for _, torque in made)])[:-1]
    rig = bd.Train(
        inertias=("motor", "screw"),
        shafts={"coupling": ("motor", "screw")},
        drives={"motor": "speed"},
    )
    sigma = {"prior": "log_uniform", "low": 1e-5, "high": 1e-2}
    return bd.case(
        0.02 * np.arange(len(w)),
        {"torque": bd.Channel(torque, "rad", sigma=sigma, measures="theta_motor - theta_screw")},
        {"w_motor": bd.Input(w, "rad/s")},
        {"j_screw": 2.186e-6, "k_coupling": 1.0, "c_coupling": 1e-3, "t_c_screw": PRIOR,
         "c_screw": {"prior": "log_uniform", "low": 1e-6, "high": 1e-3}, **more},
        rig=rig,
        record={"missing": "drop"},
    )  # fmt: skip


@pytest.mark.slow
@run_cases("drive, ratio", [("drive1", 0.79), ("drive2", 0.96), ("drive3", 0.52)])
def test_friction_forwards_and_backwards_is_that_of_the_means(drive: str, ratio: float) -> None:
    """A lead screw, one against backlash, and a worm, whose payload helps it one way."""
    made = blocks(shared(f"cases/ucl_screw_drives/{drive}"))
    found = screw(made, t_c_screw_backward=PRIOR).find_map(quick=True).values
    for name, way in (("t_c_screw", 1), ("t_c_screw_backward", -1)):
        each = [(abs(w), abs(torque.mean())) for w, torque in made if w * way > 0]
        model = np.mean([found[name] + found["c_screw"] * w for w, _ in each])
        assert model == pytest.approx(np.mean([torque for _, torque in each]), rel=0.05)
    assert found["t_c_screw_backward"] / found["t_c_screw"] == pytest.approx(ratio, abs=0.02)


@pytest.mark.slow
def test_an_offset_of_the_torque_is_not_told_from_friction_that_differs_by_direction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At an imposed speed, an offset moves the friction forwards and backwards by opposite amounts."""
    try_only(("offset_torque", "direction_screw", "gain_torque"), monkeypatch)
    causes = causes_of(screw(blocks(shared("cases/ucl_screw_drives/drive1"))))
    assert causes is not None
    said = describe_causes(causes)
    both = "an offset of torque, or dry friction at the screw that differs by direction"
    assert f"fit: {both}: the record cannot tell them apart." in said
    assert said.count("cannot tell them apart") == 1
