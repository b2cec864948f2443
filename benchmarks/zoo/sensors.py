"""Rows that differ in what is measured, and on which rig."""

from __future__ import annotations

from benchmarks.zoo import entries as e
from benchmarks.zoo.makers import Driven, Steady
from benchmarks.zoo.row import Row
from benchmarks.zoo.signals import RandomSteps

NINE = e.parameters(e.box())


def rows() -> tuple[Row, ...]:
    return (*_sensors(), *_rigs())


def _sensors() -> tuple[Row, ...]:
    turning = {"duration": 10, "rate": 50}
    twist = {"twist": e.channel("twist", "deg", 1.0, "theta_1 - theta_2")}
    return (
        Row(
            name="twist_alone",
            shows="nothing but the twist, in degrees: eight unknowns",
            config=e.experiment(
                e.paper(), twist, e.parameters(e.box(), j_1="nominal"), simulation=turning
            ),
            made=Steady(),
        ),
        Row(
            name="rotor_speed_alone",
            shows="nothing but the rotor's speed, its noise unknown: four of the rig",
            config=e.experiment(
                e.paper(),
                e.states(e.unknown(0.01, 1.0), "w_1"),
                e.parameters("nominal", **{n: e.box() for n in ("k_e", "k_s", "j_1", "t_f")}),
                simulation={**turning, "sigma": {"w_1": 0.1}, "k_e": 0.063},
            ),
            made=Steady(),
        ),
        Row(
            name="motor_speed_alone",
            shows="nothing but the motor's speed in rpm, under pseudo-random steps",
            config=e.experiment(
                e.paper(),
                {"motor": e.channel("motor", "rpm", 8.0, "8 * w_2")},
                NINE,
                v=e.measured("v"),
            ),
            made=Driven(
                duration=8, rate=200, series={"v": RandomSteps(3.0, 0.2, seed=5, offset=6.0)}
            ),
        ),
        Row(
            name="current_measured",
            shows="the current and the rotor's speed: one scale is settled",
            config=e.experiment(
                e.paper(),
                e.states(0.1, "w_1", "i"),
                NINE,
                simulation={"duration": 10, "rate": 100, "r_m": 0.36},
            ),
            made=Steady(),
        ),
        Row(
            name="five_channels",
            shows="all five states under a load: both scales are settled",
            config=e.experiment(
                e.paper(),
                e.states(0.1, *e.FOUR, "i"),
                NINE,
                inputs={"t_1": 0.5},
                simulation={"duration": 10, "rate": 100},
            ),
            made=Steady(),
        ),
    )


def _rigs() -> tuple[Row, ...]:
    return (
        Row(
            name="gear_one",
            shows="no gear: the motor swings with the rotor",
            config=e.experiment(
                e.paper().geared(1.0), e.states(0.1), NINE, simulation={"duration": 8, "rate": 100}
            ),
            made=Steady(),
        ),
        Row(
            name="gear_seventy",
            shows="a gear of 1/70: the motor hardly feels the shaft",
            config=e.experiment(
                e.paper().geared(1 / 70),
                e.states(0.01),
                NINE,
                simulation={"duration": 10, "rate": 100},
            ),
            made=Steady(),
        ),
        Row(
            name="small_and_fast",
            shows="a rig of milliseconds, turned by -3 V",
            config=e.experiment(
                e.small().but(t_f=1e-6),
                {**e.states(0.005, "theta_1"), **e.states(1.0, "w_1", "w_2")},
                NINE,
                v=-3.0,
                simulation={"duration": 0.06, "rate": 10_000},
            ),
            made=Steady(),
        ),
        Row(
            name="large_and_slow",
            shows="a rig of minutes, noise unknown",
            config=e.experiment(
                e.large(),
                e.states(e.unknown(1e-3, 1.0), "w_1", "w_2"),
                NINE,
                v=200.0,
                simulation={"duration": 600, "rate": 2, "sigma": e.noise(0.03, "w_1", "w_2")},
            ),
            made=Steady(),
        ),
        Row(
            name="two_rotors",
            shows="an inertia at the gear and a resistance in the supply, both known",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                NINE,
                model={"name": "two_rotors", "j_2": 7.0e-3, "r_s": 0.2},
                simulation={"duration": 10, "rate": 100},
            ),
            made=Steady(),
        ),
    )
