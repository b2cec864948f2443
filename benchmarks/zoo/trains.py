"""Rows of described trains: two to six inertias, masses on springs, gears, pendulums, friction."""

from __future__ import annotations

from benchmarks.zoo import entries as e
from benchmarks.zoo.makers import Driven
from benchmarks.zoo.row import Entry, Row
from benchmarks.zoo.signals import Chirp, RandomSteps, Square


def box(value: float, width: float = 3.0) -> Entry:
    """The prior of a number whose truth is `value`."""
    return {"prior": "log_uniform", "low": value / width, "high": value * width}


def train(
    model: Entry,
    channels: Entry,
    drive: tuple[str, str],
    truth: dict[str, float],
    held: tuple[str, ...] = (),
    hold: str = "zero",
) -> Entry:
    """All numbers of `truth` unknown within a factor of three, but those that are `held`."""
    name, unit = drive
    free = {key: value for key, value in truth.items() if key not in held}
    column: Entry = {"column": name, "unit": unit}
    return {
        "record": {"time": {"column": "t", "unit": "s"}, "channels": channels},
        "inputs": {name: {**column, "hold": hold} if unit != "rad" else column},
        "model": {"name": "train", **model},
        "parameters": {key: box(value) if key in free else value for key, value in truth.items()},
        "simulation": free,
    }


def seen(unit: str, sigma: float, *names: str) -> Entry:
    return {name: e.channel(name, unit, sigma) for name in names}


def rows() -> tuple[Row, ...]:
    return (*_rotary(), *_linear(), *_rubbing())


def _rotary() -> tuple[Row, ...]:
    pair: Entry = {
        "inertias": ["motor", "load"],
        "shafts": {"coupling": ["motor", "load"]},
        "drives": {"motor": "current"},
    }
    discs = [f"disc_{k}" for k in range(1, 7)]
    row: Entry = {
        "inertias": discs,
        "shafts": {f"s_{k}": discs[k - 1 : k + 1] for k in range(1, 6)},
        "drives": {"disc_1": "torque"},
    }
    return (
        Row(
            name="train_coupling",
            shows="a train: motor and load on a coupling, a measured current, both angles",
            config=train(
                pair,
                seen("rad", 2e-3, "theta_motor", "theta_load"),
                ("i_motor", "A"),
                {
                    "j_motor": 4e-3,
                    "j_load": 5e-3,
                    "k_coupling": 60.0,
                    "k_T_motor": 0.2,
                    "c_motor": 0.02,
                    "c_load": 0.01,
                    "c_coupling": 0.02,
                },
                held=("k_T_motor",),
            ),
            made=Driven(
                duration=9.99, rate=200, series={"i_motor": RandomSteps(4.0, 0.1, seed=21)}
            ),
            quick=True,
        ),
        Row(
            name="train_six_discs",
            shows="a train: six discs in a row, a torque at the first, speeds of three",
            config=train(
                row,
                seen("rad/s", 0.05, "w_disc_1", "w_disc_3", "w_disc_6"),
                ("t_disc_1", "N*m"),
                {
                    **{f"j_{name}": 0.01 * (1 + 0.1 * k) for k, name in enumerate(discs)},
                    **{f"k_s_{k}": 20.0 + 3.0 * k for k in range(1, 6)},
                    "c_disc_1": 0.05,
                    "c_s_3": 0.02,
                },
                held=("j_disc_2", "j_disc_4", "j_disc_5"),
            ),
            made=Driven(
                duration=7.995, rate=200, series={"t_disc_1": RandomSteps(2.0, 0.05, seed=22)}
            ),
        ),
        Row(
            name="train_two_gears",
            shows="a train: two gears, one of them backwards, and two shafts; angles at both ends",
            config=train(
                {
                    "inertias": ["motor", "pinion", "wheel", "drum", "load"],
                    "gears": {
                        "box": {"between": ["motor", "pinion"], "ratio": 0.2},
                        "mesh": {"between": ["wheel", "drum"], "ratio": -0.5},
                    },
                    "shafts": {"first": ["pinion", "wheel"], "second": ["drum", "load"]},
                    "drives": {"motor": "voltage"},
                },
                seen("rad", 3e-3, "theta_motor", "theta_load"),
                ("u_motor", "V"),
                {
                    "j_motor": 2e-4,
                    "j_pinion": 1e-3,
                    "j_wheel": 4e-3,
                    "j_drum": 2e-3,
                    "j_load": 0.02,
                    "k_first": 15.0,
                    "k_second": 8.0,
                    "k_T_motor": 0.05,
                    "r_motor": 1.2,
                    "k_e_motor": 0.05,
                    "c_load": 0.03,
                    "c_second": 0.02,
                },
                held=("j_pinion", "j_wheel", "j_drum", "k_T_motor", "k_e_motor"),
            ),
            made=Driven(duration=9.99, rate=200, series={"u_motor": Square(12.0, 1.7)}),
        ),
        Row(
            name="train_imposed",
            shows="a train: the angle of its top is imposed, a sprung disc behind it",
            config=train(
                {
                    "inertias": ["top", "disc", "end"],
                    "shafts": {
                        "upper": ["top", "disc"],
                        "lower": ["disc", "end"],
                        "spring": ["end", "ground"],
                    },
                    "drives": {"top": "speed"},
                },
                seen("rad", 5e-3, "theta_disc", "theta_end"),
                ("theta_top", "rad"),
                {
                    "j_disc": 0.02,
                    "j_end": 0.03,
                    "k_upper": 5.0,
                    "k_lower": 8.0,
                    "k_spring": 2.0,
                    "c_disc": 0.03,
                    "c_end": 0.02,
                },
                held=("j_disc",),
            ),
            made=Driven(duration=19.98, rate=100, series={"theta_top": Chirp(0.5, 0.2, 5.0)}),
        ),
    )


def _linear() -> tuple[Row, ...]:
    carts: Entry = {
        "motion": "linear",
        "inertias": ["cart_1", "cart_2"],
        "shafts": {"spring": ["cart_1", "cart_2"], "wall": ["cart_2", "ground"]},
        "drives": {"cart_1": "torque"},
    }
    return (
        Row(
            name="train_carts",
            shows="a train along a line: two carts, a spring to the wall, positions in mm",
            config=train(
                carts,
                seen("mm", 0.5, "x_cart_1", "x_cart_2"),
                ("f_cart_1", "N"),
                {
                    "m_cart_1": 1.2,
                    "m_cart_2": 0.8,
                    "k_spring": 300.0,
                    "k_wall": 150.0,
                    "c_cart_1": 2.0,
                    "c_cart_2": 1.0,
                },
            ),
            made=Driven(
                duration=9.99, rate=100, series={"f_cart_1": RandomSteps(6.0, 0.25, seed=23)}
            ),
            quick=True,
        ),
    )


def _rubbing() -> tuple[Row, ...]:
    return (
        Row(
            name="train_carts_rubbing",
            shows="a train along a line: carts on a spring that both rub, speeds in mm/s",
            config=train(
                {
                    "motion": "linear",
                    "inertias": ["cart_1", "cart_2"],
                    "shafts": {"spring": ["cart_1", "cart_2"]},
                    "drives": {"cart_1": "torque"},
                },
                seen("mm/s", 5.0, "v_cart_1", "v_cart_2"),
                ("f_cart_1", "N"),
                {
                    "m_cart_1": 0.64,
                    "m_cart_2": 0.33,
                    "k_spring": 78.0,
                    "c_cart_1": 8.4,
                    "c_cart_2": 1.7,
                    "f_c_cart_1": 0.4,
                    "f_c_cart_2": 0.2,
                },
            ),
            made=Driven(duration=7.99, rate=100, series={"f_cart_1": Square(2.0, 2.0)}),
        ),
        Row(
            name="train_pendulum",
            shows="a train: a geared motor swings a pendulum through large angles",
            config=train(
                {
                    "inertias": ["motor", "arm"],
                    "gears": {"box": {"between": ["motor", "arm"], "ratio": 0.05}},
                    "drives": {"motor": "torque"},
                    "gravity": ["arm"],
                },
                seen("rad", 5e-3, "theta_arm"),
                ("t_motor", "N*m"),
                {
                    "j_motor": 2e-6,
                    "j_arm": 5e-3,
                    "g_arm": 0.48,
                    "c_arm": 0.02,
                },
                held=("j_arm",),
            ),
            made=Driven(
                duration=7.99, rate=100, series={"t_motor": RandomSteps(0.02, 0.3, seed=24)}
            ),
        ),
        Row(
            name="train_pendulum_rubbing",
            shows="a train: a pendulum behind a gear that rubs, and a rod that bends",
            config=train(
                {
                    "inertias": ["motor", "arm", "bob"],
                    "gears": {"box": {"between": ["motor", "arm"], "ratio": 0.1}},
                    "shafts": {"rod": ["arm", "bob"]},
                    "drives": {"motor": "torque"},
                    "gravity": ["bob"],
                },
                seen("rad", 5e-3, "theta_motor", "theta_bob"),
                ("t_motor", "N*m"),
                {
                    "j_motor": 2e-5,
                    "j_arm": 1e-3,
                    "j_bob": 5e-3,
                    "k_rod": 4.0,
                    "g_bob": 0.48,
                    "c_rod": 0.01,
                    "t_c_motor": 3e-3,
                },
                held=("j_arm", "j_bob"),
            ),
            made=Driven(
                duration=4.99, rate=100, series={"t_motor": RandomSteps(0.03, 0.4, seed=25)}
            ),
        ),
    )
