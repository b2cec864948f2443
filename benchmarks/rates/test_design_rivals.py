"""Designed experiments against the bundled step: the time in which they tell two models apart."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
from support.case_tables import run_cases

import bayesdrill as bd

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
FREE = dict.fromkeys(("k_s", "j_1", "j_m", "c_m"), BOX)
ODDS = 3.0  # log of 20
# With more channels a step shows the gear itself, and its angles grow with time.
MOTOR = ("w_2",)
LOOSE = {"parameters": {"k_e": BOX, "c_m": "nominal", "j_1": "nominal"}}
CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "friction and damping": ({"parameters": {"t_cm": 0.005}}, {}),
    "a lag and an inertia": ({"lag": 0.0003}, {}),
    "two gears": ({"channels": MOTOR, **LOOSE}, {"channels": MOTOR, **LOOSE, "i_m": 0.1275}),
}


def changed(
    *,
    lag: float = 0.0,
    i_m: float = 0.125,
    parameters: Any = None,
    channels: tuple[str, ...] = ("theta_1", "theta_2", "w_1", "w_2"),
) -> bd.Case:
    """Return the bundled case with few unknowns, a lag of `w_2`, another gear, or other parameters."""
    job = bd.load(CONFIG).job
    data = copy.deepcopy(dict(job.source.data))
    held = dict.fromkeys(data["parameters"], "nominal")
    data["parameters"] = held | FREE | (parameters or {})
    data["model"]["i_m"] = i_m
    data["record"]["channels"] = {name: data["record"]["channels"][name] for name in channels}
    if lag:
        data["record"]["channels"]["w_2"]["lag"] = lag
    return bd.Case(job.with_data(data))


@pytest.mark.slow
@run_cases("name", [*CASES])
def test_a_design_tells_models_apart_in_a_fifth_of_the_time_of_the_step(name: str) -> None:
    """The recorded step of 8 V does not reach odds of 20 to 1 in five times the time."""
    ours, rival = (changed(**entries) for entries in CASES[name])
    numbers = {"draws": 1, "low": -8.0, "high": 8.0, "duration": 2.0, "hold": 0.05}
    designed = ours.design(tell=rival, **numbers).design.log_odds
    print(name, {key: f"{odds:.3g}" for key, odds in designed.items()})
    assert designed["designed"] >= ODDS
    assert designed["as recorded"] < ODDS
