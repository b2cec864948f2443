"""Laws of friction over the speeds of a record."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.small_problems import experiment

from bayesdrill.analysis.friction_motion import friction_curve
from bayesdrill.rig.models.motor_shaft import DrivenShaft
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

ROCK = {"b_0": 2e-3, "b_1": 1.7, "b_2": 5.5, "b_3": 3.9}
P = {"k_s": 4.3, "j_1": 8.1e-3, "c_s": 0.02, "c_1": 0.03, **ROCK}


def test_a_law_is_shown_at_the_root_mean_square_of_the_weight_that_acts() -> None:
    """The weight on the bit is not the recorded one: its sensor has a gain and an offset."""
    rig = DrivenShaft(added=("c_s", "c_1", *ROCK))
    weight = 500.0 + 80.0 * np.sin(np.arange(100))
    record = experiment(
        100, series={"wob": weight}, constant={"w_2": 9.0, "t_1": 0.0},
        measures={"w_1": {"w_1": 1.0}},
    )  # fmt: skip
    sensing = ObservationModel(input_gains={"wob": "gain"}, input_offsets={"wob": "offset"})
    response = simulator(rig, record, sensing)
    full = np.array([[*(P[name] for name in rig.parameters), 0.5, 30.0]])
    (rock,) = rig.frictions
    observation: Any = SimpleNamespace(response=response, simulator_parameters=lambda x: x)
    motion: Any = SimpleNamespace(friction=rock, speed=np.array([2.0]), gear=1.0)
    curve = friction_curve(observation, motion, full)
    acting = np.sqrt(np.mean((0.5 * weight + 30.0) ** 2))
    acting_record = replace(record, series={"wob": 0.5 * weight + 30.0})
    expected = simulator(rig, acting_record, ObservationModel()).signals(full[:, :-2])
    assert response.signals(full) == pytest.approx(expected, rel=1e-12)
    w = curve.speeds[-1]
    torque = acting * P["b_0"] * (np.tanh(P["b_1"] * w) + P["b_2"] * w / (1 + P["b_3"] * w**2))
    assert curve.sizes[0, -1] == pytest.approx(torque, rel=1e-9)
