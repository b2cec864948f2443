"""Laws of friction over the speeds of a record."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.small_problems import experiment

from bayesdrill.analysis.friction_motion import friction_curve
from bayesdrill.rig.models.motor_shaft import DrivenShaft
from bayesdrill.rig.models.train import Train
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
    perfect = np.array([[*full[0, :-2], 1.0, 0.0]])
    expected = simulator(rig, acting_record, sensing).signals(perfect)
    assert response.signals(full) == pytest.approx(expected, rel=1e-12)
    w = curve.speeds[-1]
    torque = acting * P["b_0"] * (np.tanh(P["b_1"] * w) + P["b_2"] * w / (1 + P["b_3"] * w**2))
    assert curve.sizes[0, -1] == pytest.approx(torque, rel=1e-9)


def test_a_law_before_a_gear_that_reverses_has_the_motors_own_directions() -> None:
    rig = Train(
        inertias=("motor", "arm"), drives={"motor": "torque"}, gravity=("arm",),
        gears={"box": {"between": ("motor", "arm"), "ratio": -0.5}},
        added=("t_c_motor", "t_c_motor_backward", "eta_box"),
    )  # fmt: skip
    known = {"t_c_motor": 0.2, "t_c_motor_backward": 0.3, "eta_box": 1.0}
    record = experiment(100, constant={"t_motor": 1.0}, measures={"w_arm": {"w_arm": 1.0}})
    response = simulator(rig, record, ObservationModel())
    observation: Any = SimpleNamespace(response=response, simulator_parameters=lambda x: x)
    motion: Any = SimpleNamespace(friction=rig.frictions[0], speed=np.array([2.0]), gear=-2.0)
    values = [known.get(name, 1.0) for name in rig.parameters]
    curve = friction_curve(observation, motion, np.array([values]))
    assert np.all(np.diff(curve.speeds) > 0.0)
    assert curve.sizes[0, [0, -1]] == pytest.approx([-0.3, 0.2])
