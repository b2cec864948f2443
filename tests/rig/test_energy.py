"""Where the energy goes: against the oracle's powers, and a sum that closes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from oracles import skewed
from rigs import experiment
from rubbing_cases import CASES, moved
from stepping import parameters, stepped
from together import for_each

from bayesdrill.rig.energy import Energies, can_balance, energies
from bayesdrill.rig.models.linear import Linear, Model
from bayesdrill.rig.models.long_shaft import LongShaft
from bayesdrill.rig.models.motor_shaft import DrivenShaft, Motor, MotorShaft, TwoRotors
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

T = 0.01 * np.arange(401)
SENSING = ObservationModel(input_gains={"v": "g"}, input_offsets={"v": "o"}, input_lags={"v": "l"})
TOLD = (0.87, 0.9, 0.023)
LINEAR = skewed() | {"c_s": 2e-3, "r_s": 0.1, "c_1": 1.2e-3}


def drive() -> np.ndarray:
    return 6.0 * np.sign(np.sin(4.0 * T + 0.3)) + 1.0


def total(found: Energies) -> float:
    """All that went to and fro."""
    every = [*found.given.values(), *found.lost.values(), found.converted]
    return float(sum(np.abs(part).max() for part in every))


def linear(*, first_order: bool, sensing: ObservationModel = SENSING) -> Energies:
    """Of a rig without friction, behind a supply that is not what it says."""
    rig = MotorShaft(1 / 6, added=("c_s", "r_s", "c_1"))
    one = experiment(
        len(T), 0.01, series={"v": drive()}, constant={"t_1": 0.07}, first_order=first_order,
        start={"w_1": 3.0, "w_2": -1.0, "theta_1": 0.4, "i": 0.2},
    )  # fmt: skip
    told = TOLD if sensing.names else ()
    full = np.array([*(LINEAR[name] for name in rig.parameters), *told])
    return energies(Stepped(rig, one, sensing), full)


def test_without_friction_it_closes_to_rounding() -> None:
    """Mutants killed: a row that weighs something else, an input as it was recorded."""

    def check(first_order: bool) -> None:
        found = linear(first_order=first_order)
        assert np.abs(found.open).max() < 1e-11 * total(found)
        assert abs(found.converted[-1]) > 0.01 * found.given["v"][-1]  # k_T is not k_e
        assert found.stored[0] > 0

    for_each({str(first_order): (first_order,) for first_order in [False, True]}, check)


def test_each_part_is_the_integral_of_its_power() -> None:
    """Oracle: Simpson's rule over powers that are typed in, of states at a sixteenth of a sample."""
    rig = MotorShaft(1 / 6, added=("c_s", "r_s", "c_1"))
    one = experiment(
        len(T), 0.01, series={"v": drive()}, constant={"t_1": 0.07}, start={"w_1": 3.0}
    )
    full = np.array([LINEAR[name] for name in rig.parameters])
    fine, p = Stepped(rig, one, ObservationModel(), 16), LINEAR
    theta_1, theta_2, w_1, w_2, i = fine.steps(full[None]).motion.states[0].T
    held = np.repeat(drive(), 16)[: len(i) - 1]
    w_3, twisting = w_2 * 6, (w_1 - w_2) ** 2
    powers = {
        "r_m": p["r_m"] * i**2, "r_s": p["r_s"] * i**2, "c_m": p["c_m"] * w_3**2,
        "c_s": p["c_s"] * twisting, "c_1": p["c_1"] * w_1**2, "t_f": p["t_f"] * w_3,
    }  # fmt: skip
    found = energies(Stepped(rig, one, ObservationModel()), full)
    for name, power in powers.items():
        assert found.lost[name][-1] == pytest.approx(_simpson(power), rel=1e-4), name
    assert set(found.lost) == set(powers)
    half = 0.5 * (held * i[:-1] + held * i[1:]) * 0.01 / 16
    assert found.given["v"][-1] == pytest.approx(half.sum(), rel=1e-3)
    assert found.given["t_1"][-1] == pytest.approx(-0.07 * (theta_1[-1] - theta_1[0]), rel=1e-9)
    gained = (p["k_T"] - p["k_e"]) * i * w_3
    assert found.converted[-1] == pytest.approx(_simpson(gained), rel=1e-3)
    kinetic = p["j_1"] * w_1**2 + p["j_m"] * w_3**2 + p["l_m"] * i**2
    stored = 0.5 * (kinetic + p["k_s"] * (theta_1 - theta_2) ** 2)
    assert found.stored[-1] == pytest.approx(stored[-1], rel=1e-12)


def _simpson(power: np.ndarray) -> float:
    """Over steps of a sixteenth of 10 ms."""
    return float((power[0:-1:2] + 4 * power[1::2] + power[2::2]).sum() * 0.01 / 16 / 3)


def test_of_rigs_that_rub_it_is_the_oracle_s() -> None:
    """Mutants killed: a speed that sticks taken to move, work of an effort of the wrong sign."""

    def check(name: str) -> None:
        case, true = CASES[name], moved(name)
        found = energies(stepped(case, 8), parameters(case)[0])
        scale = total(found)
        kinds = {
            "supply": found.given["v"],
            "load": -found.given["t_1"],
            "motor": -found.converted,
            "resistor": _sum(found, "r_m", "r_s"),
            "viscous": _sum(found, "c_m", "c_s", "c_1"),
            "constant": _sum(found, "t_f"),
            "friction": _sum(found, "friction_m", "friction_1", "drop"),
        }
        assert {*kinds} == {*true.taken}
        for kind, part in kinds.items():
            assert np.abs(part[::8] - true.taken[kind]).max() < 1e-3 * scale, kind
        stored = sum(true.stored.values())
        assert np.abs(found.stored[::8] - stored).max() < 1e-3 * scale
        assert np.abs(found.open).max() < 1e-3 * scale

    for_each({name: (name,) for name in ["sine", "servo", "other", "stick slip"]}, check)


def _sum(found: Energies, *names: str) -> np.ndarray:
    return np.asarray(
        sum((found.lost[n] for n in names if n in found.lost), np.zeros(len(found.t)))
    )


def test_it_closes_the_better_the_shorter_the_steps() -> None:
    case = CASES["reversing"]
    left = [
        np.abs(energies(stepped(case, pieces), parameters(case)[0]).open).max()
        for pieces in (1, 4, 16)
    ]
    assert left[1] < 0.5 * left[0]
    assert left[2] < 0.5 * left[1]


def test_what_is_held_takes_nothing() -> None:
    """Rotor 1 sticks while the motor winds up the shaft: all that comes in goes elsewhere."""
    case = CASES["stick slip"]
    rig = stepped(case)
    found = energies(rig, parameters(case)[0])
    steps = rig.steps(parameters(case))
    still = steps.motion.states[0, :, 2] == 0.0
    held = still[:-1] & still[1:]
    assert held.sum() > 20
    assert not np.diff(found.lost["friction_1"])[held].any()


def test_a_rig_at_rest_takes_nothing() -> None:
    """Everything is held, all the time."""
    case = CASES["reversing"]
    still = replace(stepped(case).experiment, series={"v": np.zeros(len(case.t))})
    found = energies(stepped(case, record=still), parameters(case)[0])
    assert total(found) == 0.0


def test_a_delay_of_sensors_changes_no_energy() -> None:
    with_lags = ObservationModel(lags={"theta_1": "l"})
    rig = MotorShaft(1 / 6)
    one = experiment(len(T), 0.01, series={"v": drive()}, constant={"t_1": 0.0})
    full = np.array([skewed()[name] for name in rig.parameters])
    plain = energies(Stepped(rig, one, ObservationModel()), full)
    late = energies(Stepped(rig, one, with_lags), np.append(full, 0.03))
    assert plain.stored == pytest.approx(late.stored)


@dataclass(frozen=True, slots=True)
class Loadless(MotorShaft):
    """Nobody knows what rotor 1 weighs."""

    inputs: ClassVar[tuple[str, ...]] = ("v",)

    def linear(self, p) -> Linear:
        found = MotorShaft(self.i_m).linear(p)
        b = {key: value for key, value in found.B.items() if key[1] != "t_1"}
        return Linear(A=found.A, B=b, c=found.c)


def test_what_states_store_is_known_of_all_rigs_but_of_nodes_within_a_shaft() -> None:
    for rig in (
        MotorShaft(),
        TwoRotors(j_2=1e-3),
        Loadless(),
        DrivenShaft(),
        Motor(),
        *TRAINS.values(),
    ):
        assert can_balance(rig), rig
    assert not can_balance(LongShaft())


CHAIN = {
    "inertias": ("motor", "disc", "bit"),
    "shafts": {"up": ["motor", "disc"], "low": ["disc", "bit"]},
}
GEARED = {
    "inertias": ("motor", "arm", "load"),
    "shafts": {"up": ["arm", "load"], "spring": ["load", "ground"]},
    "gears": {"box": {"between": ["motor", "arm"], "ratio": -0.2}},
}
LOSSES = ("c_motor", "c_arm", "c_load", "c_up", "c_spring", "t_f_arm")
TRAINS: dict[str, Model] = {
    "torque": Train(**CHAIN, drives={"motor": "torque"}, added=("c_disc", "c_low", "t_f_bit")),
    "in the middle": Train(**CHAIN, drives={"disc": "torque"}, added=("c_bit", "c_up")),
    "current": Train(**GEARED, drives={"motor": "current"}, added=LOSSES),
    "voltage": Train(
        **GEARED, drives={"motor": "voltage"}, added=(*LOSSES, "k_e_motor", "l_motor")
    ),
    "voltage without inductance": Train(
        **GEARED, drives={"motor": "voltage"}, added=(*LOSSES, "k_e_motor")
    ),
    "speed": Train(**CHAIN, drives={"motor": "speed"}, added=("c_up", "c_bit")),
    "speed before a gear": Train(**GEARED, drives={"motor": "speed"}, added=("c_up", "c_load")),
    "linear": Train(
        inertias=("cart", "mass"),
        shafts={"s": ["cart", "mass"], "wall": ["ground", "cart"]},
        motion="linear",
        drives={"cart": "torque"},
        added=("c_s", "c_wall"),
    ),
    "added inertia": Motor(0.2, added=("k_e", "k_T", "r_m", "l_m", "t_f", "j_2")),
    "driven": DrivenShaft(added=("c_s", "c_1")),
    "imposed motor": Train(
        inertias=("motor", "load"),
        gears={"box": {"between": ("motor", "load"), "ratio": 0.2}},
        drives={"load": "speed", "motor": "voltage"},
        shafts={"stop": ("load", "ground")},
        added=("k_e_motor", "l_motor", "c_stop"),
    ),
    "frictions of constant sign": Train(
        inertias=("motor", "load"),
        gears={"box": {"between": ("motor", "load"), "ratio": 0.2}},
        drives={"motor": "torque"},
        added=("t_f_motor", "t_f_load"),
    ),
    "a disc that nothing else moves": Train(
        inertias=("motor", "disc"), drives={"motor": "torque"}, added=("t_f_disc",)
    ),
}


def test_of_any_train_all_goes_where_it_is_said_to() -> None:
    """No motor gives more than it takes where k_T is k_e, so that nothing is left.

    Mutants killed: a speed before its gear, a twist of one end, the current of a voltage without Ohm's
    law, an imposed speed that does not move its damper.
    """

    def check(name: str) -> None:
        rig = TRAINS[name]
        p = dict(zip(rig.parameters, np.linspace(0.5, 1.4, len(rig.parameters)), strict=True))
        p |= {m.back_emf: p[m.torque_constant] for m in rig.roles.motors if m.back_emf in p}
        one = experiment(
            len(T), 0.01, series={rig.inputs[0]: drive()}, constant=dict.fromkeys(rig.inputs[1:], 0.3),
            start={name: 0.3 for name in rig.states if name not in rig.angles},
            measures={name: {name: 1.0} for name in rig.states},
        )  # fmt: skip
        found = energies(Stepped(rig, one, ObservationModel()), np.array([*p.values()]))
        assert np.abs(found.converted).max() < 1e-12 * total(found)
        assert np.abs(found.open).max() < 1e-12 * total(found)
        assert {*found.lost} == {n for n in p if n.startswith(("c_", "r_", "t_f"))}, name
        for lost, part in found.lost.items():
            assert "t_f" in lost or (np.diff(part) >= -1e-12 * total(found)).all(), lost

    for_each({name: (name,) for name in TRAINS}, check)


def test_a_chain_stores_in_its_inertias_and_its_shafts() -> None:
    rig = TRAINS["torque"]
    p = dict(zip(rig.parameters, np.linspace(0.5, 1.4, len(rig.parameters)), strict=True))
    one = experiment(
        len(T), 0.01, series={}, constant={"t_motor": 0.7},
        start={"theta_disc": 0.4, "w_bit": -2.0}, measures={n: {n: 1.0} for n in rig.states},
    )  # fmt: skip
    full = np.array([[p[name] for name in rig.parameters]])
    response = Stepped(rig, one, ObservationModel())
    x = dict(zip(rig.states, response.steps(full).motion.states[0].T, strict=True))
    found = energies(response, full[0])
    moving = sum(p[f"j_{i}"] * x[f"w_{i}"] ** 2 for i in ("motor", "disc", "bit"))
    twisted = p["k_up"] * (x["theta_motor"] - x["theta_disc"]) ** 2
    twisted = twisted + p["k_low"] * (x["theta_disc"] - x["theta_bit"]) ** 2
    assert found.stored == pytest.approx(0.5 * (moving + twisted), rel=1e-12)
    turned = x["theta_motor"] - x["theta_motor"][0]
    assert found.given["t_motor"] == pytest.approx(0.7 * turned, rel=1e-9, abs=1e-12)


def test_a_pendulum_stores_by_its_height() -> None:
    """It closes to the square of the step.  Mutants killed: a spring alone, a tilt left out."""
    parts = {
        "inertias": ("motor", "arm"),
        "gears": {"box": {"between": ["motor", "arm"], "ratio": 0.2}},
    }
    rig = Train(**parts, drives={"motor": "torque"}, gravity=("arm",), added=("c_arm", "a_arm"))
    p = {"j_motor": 2e-3, "j_arm": 0.05, "g_arm": 1.5, "c_arm": 0.02, "a_arm": 0.3}
    one = experiment(
        len(T), 0.01, series={}, constant={"t_motor": 0.1}, start={"w_arm": 6.0},
        measures={name: {name: 1.0} for name in rig.states},
    )  # fmt: skip
    full = np.array([p[name] for name in rig.parameters])
    steps = [Stepped(rig, one, ObservationModel(), pieces) for pieces in (1, 4)]
    left = [np.abs(energies(response, full).open).max() for response in steps]
    found = energies(steps[1], full)
    assert left[1] < 1e-3 * total(found)
    assert left[1] < left[0] / 10
    theta, w = steps[1].steps(full[None]).motion.states[0].T
    assert np.abs(theta).max() > 2.0  # far from a spring
    height = 1.5 * (1 - np.cos(theta + 0.3))
    assert found.stored == pytest.approx(0.5 * (0.05 + 25 * 2e-3) * w**2 + height, rel=1e-9)
    assert {*found.lost} == {"c_arm"}
    assert np.abs(found.converted).max() < 1e-12 * total(found)
