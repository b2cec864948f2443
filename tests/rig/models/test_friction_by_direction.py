"""Friction that differs by direction: against an integration from event to event, and its own laws."""

import numpy as np
from support.case_tables import run_cases
from support.servo_oracle import Servo
from support.state_records import record_of_states

from bayesdrill.basics.arrays import Array
from bayesdrill.rig.models.linear import weak_statics, with_named
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel

ARM = Train(inertias=("arm",), drives={"arm": "torque"})
REVERSED = Train(
    inertias=("arm", "load"), drives={"arm": "torque"},
    gears={"box": {"between": ("arm", "load"), "ratio": -1.0}},
)  # fmt: skip
SLIDING = {"j_arm": 0.02, "c_arm": 0.03, "c_arm_backward": 0.08, "t_c_arm": 0.2,
           "t_c_arm_backward": 0.1}  # fmt: skip
STATIC = {**SLIDING, "t_s_arm": 0.3, "t_s_arm_backward": 0.15, "w_s_arm": 0.5}
LEVELS, TIME = (0.5, -0.4, 0.1, -0.25, 0.28, -0.08, 0.6, 0.0, -0.5, -0.12), 0.2


def simulated(rig: Train, values: dict[str, float], samples: int) -> tuple[Array, Array]:
    """Times, and angle and speed of the arm under torques that jump, of a rig at rest."""
    train, way = with_named(rig, [*values]), -1.0 if rig is REVERSED else 1.0
    t = np.linspace(0.0, TIME * len(LEVELS), samples * len(LEVELS) + 1)
    u = np.append(np.repeat(LEVELS, samples), LEVELS[-1])
    record = record_of_states(train, t, {"t_arm": u})
    full = np.array([[values[name] for name in train.parameters]])
    return t, way * simulator(train, record, ObservationModel()).signals(full)[0]


def believed(values: dict[str, float], t: Array) -> Array:
    """What the oracle has."""
    corners = TIME * np.arange(1, len(LEVELS))
    later = 1e-12 * TIME

    def both(name: str) -> tuple[float, float]:
        return values[name], values[f"{name}_backward"]

    oracle = Servo(
        j=values["j_arm"],
        c=both("c_arm"),
        t_c=both("t_c_arm"),
        t_s=both("t_s_arm") if "t_s_arm" in values else None,
        w_s=values.get("w_s_arm", 1.0),
        torque=lambda s: LEVELS[min(int((s + later) / TIME), len(LEVELS) - 1)],
    )
    return oracle.simulate(t, corners=corners)


@run_cases("rig, law", [(ARM, SLIDING), (REVERSED, STATIC)])
def test_a_rig_that_rubs_more_one_way_moves_as_from_event_to_event(
    rig: Train, law: dict[str, float]
) -> None:
    """The error falls with the square of the step, and what sticks stays exactly where it is."""
    errors = []
    for samples in (100, 400):
        values = law if rig is ARM else {**law, "j_arm": 0.015, "j_load": 0.005}
        t, y = simulated(rig, values, samples)
        truth = believed(law, t[:: samples // 50])
        y = y[:: samples // 50]
        errors.append(np.max(np.abs(y - truth).max(axis=0) / np.ptp(truth, axis=0)))
        assert np.array_equal(y[:, 1] == 0.0, truth[:, 1] == 0.0)
    assert errors[1] < 2e-5
    assert errors[0] / errors[1] > 8.0


def test_static_friction_backwards_is_at_least_the_sliding_one() -> None:
    train = with_named(ARM, [*STATIC])
    assert not weak_statics(train, STATIC)
    weak = {**STATIC, "t_s_arm_backward": 0.05}
    assert [*weak_statics(train, weak)] == ["t_s_arm_backward"]
