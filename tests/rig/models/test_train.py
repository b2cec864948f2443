"""Trains against integration from event to event by other code, and what does not go together."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.case_tables import run_cases
from support.state_records import record_of_states
from support.train_oracle import Oracle, springs

import bayesdrill as bd
from bayesdrill.basics.errors import InputError
from bayesdrill.rig.models.train import Train
from bayesdrill.rig.simulators import simulator
from bayesdrill.rig.simulators.sensors import ObservationModel


def values(train: Train, rng: np.random.Generator) -> dict[str, float]:
    """Of each parameter a number of its kind, no two alike."""
    usual = {"kg*m**2": 0.01, "kg": 2.0, "N*m/rad": 20.0, "N/m": 900.0, "N*m*s/rad": 0.02,
             "N*s/m": 1.5, "N*m": 0.05, "N": 1.5, "rad": 0.1, "1": 0.8}  # fmt: skip
    return {
        name: usual[train.symbols[name].unit] * rng.uniform(0.7, 1.4) for name in train.parameters
    }


def square_wave(n: int, every: int, size: float, rng: np.random.Generator) -> np.ndarray:
    return np.repeat(size * rng.choice([-1.0, 1.0], n // every + 1), every)[:n]


def oracle(
    train: Train, p: dict[str, float], ratios: np.ndarray, u: np.ndarray, dt: float
) -> Oracle:
    """Typed from the train's entries; `ratios (n, q)`."""
    linear, names = train.motion == "linear", train.inertias
    j, t = ("m", "f") if linear else ("j", "t")
    driven = np.array([float(drive.kind == "torque") for drive in train.drives])
    places = [names.index(drive.inertia) for drive in train.drives]
    sliding = np.zeros(ratios.shape[1])
    for k, name in enumerate(names):
        coordinate = int(np.flatnonzero(ratios[k])[0])
        sliding[coordinate] += abs(ratios[k, coordinate]) * p.get(f"{t}_c_{name}", 0.0)

    def push(s: float) -> np.ndarray:
        pushed = np.array([-p.get(f"{t}_f_{name}", 0.0) for name in names])
        pushed[places] += driven * u[int(s / dt)]
        return pushed

    return Oracle(
        inertias=np.array([p[f"{j}_{name}"] for name in names]),
        ratios=ratios,
        springs=springs(train, p),
        dampers=np.array([p.get(f"c_{name}", 0.0) for name in names]),
        sliding=sliding,
        weights=np.array([p.get(f"g_{name}", 0.0) for name in names]),
        tilts=np.array([p.get(f"a_{name}", 0.0) for name in names]),
        push=push,
    )


def compare(
    train: Train,
    ratios: np.ndarray,
    *,
    pieces: int = 1,
    n: int = 121,
    dt: float = 0.01,
    size: float = 1.0,
) -> float:
    """How far the responses are apart, over the largest of each kind of state."""
    rng = np.random.default_rng(20)
    p, (name,) = values(train, rng), train.inputs
    u = square_wave(n, 20, size, rng)
    experiment = record_of_states(train, dt * np.arange(n), {name: u})
    full = np.array([[p[name] for name in train.parameters]])
    y = simulator(train, experiment, ObservationModel(), pieces).signals(full)[0]
    other = oracle(train, p, ratios, u, dt).solve(experiment.t, np.zeros(2 * ratios.shape[1]))
    half = ratios.shape[1]
    scales = np.repeat([np.abs(other[:, :half]).max(), np.abs(other[:, half:]).max()], half)
    return float((np.abs(y - other).max(axis=0) / scales).max())


def two_gears(**entries) -> tuple[Train, np.ndarray]:
    """A motor, a gear, a shaft, another gear that turns the other way, a shaft to a load."""
    train = Train(
        inertias=("motor", "pinion", "wheel", "drum", "load"),
        gears={
            "box": {"between": ("motor", "pinion"), "ratio": 0.25},
            "mesh": {"between": ("wheel", "drum"), "ratio": -0.5},
        },
        shafts={"first": ("pinion", "wheel"), "second": ("drum", "load")},
        drives={"motor": "torque"},
        **entries,
    )
    ratios = np.zeros((5, 3))  # of pinion, drum, load
    ratios[[0, 1, 2, 3, 4], [0, 0, 1, 1, 2]] = [4.0, 1.0, -2.0, 1.0, 1.0]
    return train, ratios


def test_friction_behind_gears_moves_the_train_as_in_the_oracle():
    train, ratios = two_gears(added=("c_motor", "c_load", "t_c_motor", "t_c_load"))
    assert train.states[:3] == ("theta_pinion", "theta_drum", "theta_load")
    assert train.combinations["theta_wheel"] == {"theta_drum": -2.0}
    errors = [compare(train, ratios, pieces=pieces, size=0.4) for pieces in (8, 32)]
    assert errors[1] < 2e-4
    assert errors[1] < errors[0]


def test_a_gear_loses_of_the_weight_behind_it():
    """Believes an integration of an arm that is turned over without ever stopping."""
    gears = {"box": {"between": ("motor", "arm"), "ratio": 0.5}}
    train = Train(
        inertias=("motor", "arm"), gears=gears, drives={"motor": "torque"}, gravity=("arm",),
        added=("a_arm", "eta_box"),
    )  # fmt: skip
    p = {"j_motor": 0.02, "j_arm": 0.1, "g_arm": 0.5, "a_arm": 0.1, "eta_box": 0.7}
    inertia, lost = p["j_arm"] + 4 * p["j_motor"], 1 / p["eta_box"] - 1

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
    drive = {"t_motor": -0.05 if held else 0.0}
    found = bd.respond(train, p, t, drive, ["theta_arm"], initial={"theta_arm": 2.0})["theta_arm"]
    assert expected[-1] > 0.2
    assert found == pytest.approx(expected, abs=1e-4)


def test_a_gear_that_passes_nothing_on_has_no_efficiency():
    gears = {"box": {"between": ("motor", "arm"), "ratio": 0.5}}
    assert "eta_box" not in Train(inertias=("motor", "arm"), gears=gears).offers
    assert "eta_box" not in Train(inertias=("motor", "arm"), gears=gears, gravity=("motor",)).offers
    assert "eta_box" in Train(inertias=("motor", "arm"), gears=gears, gravity=("arm",)).offers


@pytest.mark.parametrize(
    ("entries", "entry", "said"),
    [
        ({"shafts": {"s": ("motor", "lod")}}, "shafts", "s joins 'lod', which is no inertia"),
        ({"shafts": {"s": ("motor", "motor")}}, "shafts", "s joins motor to itself"),
        ({"drives": {"motr": "torque"}}, "drives", "did you mean motor?"),
        ({"drives": {"motor": "torqe"}}, "drives", "did you mean torque?"),
        ({"gravity": ("arm",)}, "gravity", "'arm' is no inertia"),
        ({"gravity": ("load",), "motion": "linear"}, "gravity", "no pendulum"),
        ({"shafts": {"load": ("motor", "load")}}, "inertias", "two parts are called load"),
        (
            {
                "gears": {
                    "a": {"between": ("motor", "load"), "ratio": 1},
                    "b": {"between": ("load", "motor"), "ratio": 1},
                }
            },
            "gears",
            "b joins inertias that other gears join",
        ),
        (
            {
                "gears": {"a": {"between": ("motor", "load"), "ratio": 0.5}},
                "rock": ("load",),
                "added": ("t_c_motor",),
            },
            "gears",
            "name parameters of friction",
        ),
    ],
)
def test_a_train_whose_entries_contradict_each_other_is_refused(entries, entry, said):
    with pytest.raises(InputError, match=r".") as error:
        Train(**{"inertias": ("motor", "load"), **entries})
    assert [said in issue.message for issue in error.value.problems if issue.place == entry] == [
        True
    ]
