"""Trains against integration from event to event by other code."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.case_tables import run_cases
from support.state_records import record_of_states
from support.train_oracle import Oracle, springs

import bayesdrill as bd
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel


def test_friction_behind_gears_moves_the_train_as_in_the_oracle():
    """A motor, a gear, a shaft, another gear, a shaft to a load; both gears reverse the motion."""
    train = Train(
        inertias=("motor", "pinion", "wheel", "drum", "load"),
        gears={
            "box": {"between": ("motor", "pinion"), "ratio": -0.25},
            "mesh": {"between": ("wheel", "drum"), "ratio": -0.5},
        },
        shafts={"first": ("pinion", "wheel"), "second": ("drum", "load")},
        drives={"motor": "torque"},
        added=("c_motor", "c_load", "t_c_motor", "t_c_load"),
    )
    assert train.states[:3] == ("theta_pinion", "theta_drum", "theta_load")
    assert train.combinations["theta_wheel"] == {"theta_drum": -2.0}
    rng, t, nothing = np.random.default_rng(20), 0.01 * np.arange(121), np.zeros(5)
    usual = {"kg*m**2": 0.01, "N*m/rad": 20.0, "N*m*s/rad": 0.02, "N*m": 0.05}
    p = {name: usual[train.symbols[name].unit] * rng.uniform(0.7, 1.4) for name in train.parameters}
    u = np.repeat(0.4 * rng.choice([-1.0, 1.0], 7), 20)[:121]
    turns = np.zeros((5, 3))  # of pinion, drum, load
    turns[[0, 1, 2, 3, 4], [0, 0, 1, 1, 2]] = [-4.0, 1.0, -2.0, 1.0, 1.0]

    def of_each_inertia(kind: str) -> np.ndarray:
        return np.array([p.get(f"{kind}_{name}", 0.0) for name in train.inertias])

    oracle = Oracle(
        inertias=of_each_inertia("j"), ratios=turns, springs=springs(train, p),
        dampers=of_each_inertia("c"), sliding=np.abs(turns).T @ of_each_inertia("t_c"),
        weights=nothing, tilts=nothing,
        push=lambda s: np.array([u[int(s / 0.01)], 0.0, 0.0, 0.0, 0.0]),
    )  # fmt: skip
    truth = oracle.solve(t, np.zeros(6))
    scales = np.repeat([np.abs(truth[:, :3]).max(), np.abs(truth[:, 3:]).max()], 3)
    record = record_of_states(train, t, {"t_motor": u})
    full = np.array([[p[name] for name in train.parameters]])
    coarse, fine = (
        np.abs(simulator(train, record, ObservationModel(), pieces).signals(full)[0] - truth)
        for pieces in (8, 32)
    )
    assert (fine / scales).max() < 2e-4
    assert (fine / scales).max() < (coarse / scales).max()


def test_a_gear_loses_of_the_weight_behind_it():
    """Believes an integration of an arm that is turned over; a tip behind it turns three times."""
    ends = {"box": (("motor", "arm"), 0.5), "more": (("arm", "tip"), 3.0)}
    train = Train(
        inertias=("motor", "arm", "tip"), drives={"motor": "torque"}, gravity=("arm",),
        gears={name: {"between": pair, "ratio": ratio} for name, (pair, ratio) in ends.items()},
        added=("a_arm", "eta_box"),
    )  # fmt: skip
    p = {"j_motor": 0.02, "j_arm": 0.01, "j_tip": 0.01, "g_arm": 0.5, "a_arm": 0.1, "eta_box": 0.7}
    inertia, lost = p["j_arm"] + 4 * p["j_motor"] + 9 * p["j_tip"], 1 / p["eta_box"] - 1

    def slope(_, x):
        weight = p["g_arm"] * np.sin(x[0] + p["a_arm"])
        return x[1], (2 * 0.5 - weight - lost * abs(weight)) / inertia

    t = 0.01 * np.arange(301)
    expected = solve_ivp(slope, (0, 3), (0, 0), t_eval=t, rtol=1e-9, atol=1e-9).y[0]
    found = bd.respond(train, p, t, {"t_motor": 0.5}, ["theta_arm"])["theta_arm"]
    assert expected[-1] > 2 * np.pi
    assert found == pytest.approx(expected, abs=1e-4 * expected[-1])


@run_cases("held", [True, False])
def test_a_gear_that_is_driven_back_has_an_efficiency_of_its_own(held: bool) -> None:
    """At rest power flows nowhere: the arm falls, and the motor is driven by (eta) of its weight."""
    gears = {"box": {"between": ("motor", "arm"), "ratio": 0.5}}
    train = Train(
        inertias=("motor", "arm"), gears=gears, drives={"motor": "torque"}, gravity=("arm",),
        added=("eta_box", "eta_box_backward"),
    )  # fmt: skip
    p = {"j_motor": 0.02, "j_arm": 0.1, "g_arm": 0.5, "eta_box": 0.7, "eta_box_backward": 0.4}
    inertia, share = p["j_arm"] + 4 * p["j_motor"], p["eta_box_backward"]
    push = 2 * -0.05 if held else 0.0
    t = 0.005 * np.arange(121)

    def slope(_, x):  # it falls towards zero from 2 rad: the load drives all the time
        return x[1], (push - share * p["g_arm"] * np.sin(x[0])) / inertia

    expected = solve_ivp(slope, (0, t[-1]), (2.0, 0.0), t_eval=t, rtol=1e-10, atol=1e-10).y[0]
    drive = {"t_motor": np.full(len(t), -0.05 if held else 0.0)}
    found = bd.respond(train, p, t, drive, ["theta_arm"], initial={"theta_arm": 2.0})["theta_arm"]
    assert expected[-1] > 0.2
    assert found == pytest.approx(expected, abs=1e-4)


def test_a_gear_that_passes_nothing_on_has_no_efficiency():
    gears = {"box": {"between": ("motor", "arm"), "ratio": 0.5}}
    assert "eta_box" not in Train(inertias=("motor", "arm"), gears=gears).offers
    assert "eta_box" not in Train(inertias=("motor", "arm"), gears=gears, gravity=("motor",)).offers
    assert "eta_box" in Train(inertias=("motor", "arm"), gears=gears, gravity=("arm",)).offers
