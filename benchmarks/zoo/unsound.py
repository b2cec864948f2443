"""Rows whose records the rig does not fit: a run has to end soon and say so."""

from __future__ import annotations

from benchmarks.zoo import entries as e
from benchmarks.zoo.friction import DryFriction
from benchmarks.zoo.makers import Driven, Otherwise, Rubbing, Taken
from benchmarks.zoo.row import MORE_THAN_NOISE, Entry, Row
from benchmarks.zoo.signals import Levels, RandomSteps, Square

NINE = e.parameters(e.box())
TEN = {"duration": 10, "rate": 100}


def rows() -> tuple[Row, ...]:
    servos = {
        "square": "40 degrees to and fro",
        "sweep": "a sine from 0.2 to 3.4 Hz",
        "slow": "a slow sine, much sticking",
    }
    return (*(_servo(file, shows) for file, shows in servos.items()), *_friction(), *_mistakes())


def _servo(file: str, shows: str) -> Row:
    """Made by other code; its sensors round, and one is late."""
    channels = {
        "theta_2": {"column": "theta [deg]", "unit": "deg", "sigma": 0.03},
        "twist": {
            "column": "alpha [deg]",
            "unit": "deg",
            "measures": "theta_1 - theta_2",
            "sigma": 0.05,
        },
    }
    every = {name: e.box() for name in ("j_m", "k_e", "r_m", "k_s", "j_1")}
    parameters = e.parameters(
        "nominal", **every, k_T={"tie": "k_e"}, c_m=e.decades(0.1, 100.0), t_f=e.box(0.0, 50.0)
    )
    v = {"column": "voltage [V]", "unit": "V", "hold": "zero"}
    config = e.experiment(e.servo(), channels, parameters, v=v)
    config["record"]["time"] = {"column": "time [ms]", "unit": "ms"}
    return Row(
        name=f"servo_{file}",
        shows=f"a servo with dry friction at both ends, by other code: {shows}",
        config=config,
        made=Taken(f"simulated_servo/{file}.csv"),
        reason=MORE_THAN_NOISE,
    )


def _friction() -> tuple[Row, ...]:
    driven = e.experiment(e.reversing(), e.states(0.1), NINE, v=e.measured("v"))
    return (
        Row(
            name="dry_friction",
            shows="dry friction at motor and rotor under a square wave",
            config=driven,
            made=Rubbing(
                duration=10,
                rate=100,
                voltage=Square(6.0, 5.0),
                friction=DryFriction(motor=0.05, sliding=0.25, sticking=0.25),
            ),
            reason=MORE_THAN_NOISE,
        ),
        Row(
            name="stick_slip",
            shows="a bit that sticks and slips at a steady low voltage",
            config=e.experiment(e.paper(), e.states(0.1), NINE, v=e.measured("v")),
            made=Rubbing(
                duration=20,
                rate=50,
                voltage=Levels((1.0,)),
                friction=DryFriction(sliding=0.3, sticking=1.2, fading=0.5),
            ),
            reason=MORE_THAN_NOISE,
        ),
    )


def _mistakes() -> tuple[Row, ...]:
    speeds: Entry = {**e.states(0.1, "theta_2", "w_2"), "w_1": e.channel("w_1", "rad/s", 0.1)}
    held = e.parameters(e.box(), j_m="nominal", k_s="nominal", j_1="nominal")
    return (
        Row(
            name="wrong_gear",
            shows="a gear of 1/8 taken for 1/14, with both inertias and the stiffness held",
            config=e.experiment(e.paper().geared(1 / 14), e.states(0.1), held, simulation=TEN),
            made=Otherwise(changes={"model.i_m": 1 / 8}),
            reason=MORE_THAN_NOISE,
        ),
        Row(
            name="wrong_unit",
            shows="a rotor's speed in rpm taken for rad/s",
            config=e.experiment(e.paper(), speeds, NINE, simulation=TEN),
            made=Otherwise(
                changes={"record.channels.w_1.unit": "rpm", "record.channels.w_1.sigma": 1.0}
            ),
            reason=MORE_THAN_NOISE,
        ),
        Row(
            name="wrong_noise",
            shows="twice the noise that the config says, two unknowns",
            config=e.experiment(
                e.paper(),
                e.states(0.1, "theta_1", "w_1"),
                e.parameters("nominal", k_e=e.box(), k_s=e.box()),
                simulation={"duration": 6, "rate": 50},
            ),
            made=Otherwise(
                changes={f"record.channels.{name}.sigma": 0.2 for name in ("theta_1", "w_1")}
            ),
            reason=MORE_THAN_NOISE,
            quick=True,
        ),
        Row(
            name="bounded_noise",
            shows="noise levels unknown, but not as large as what a wrong load leaves",
            config=e.experiment(
                e.paper(),
                e.states(e.unknown(0.02, 0.15), "theta_1", "w_1"),
                NINE,
                inputs={"t_1": e.measured("t_1")},
                simulation={"sigma": e.noise(0.1, "theta_1", "w_1")},
            ),
            made=Driven(
                duration=10, rate=100, series={"t_1": Levels((0.0, 2.0, -1.0, 3.0))}, late=40
            ),
            reason=MORE_THAN_NOISE,
        ),
        Row(
            name="late_voltage",
            shows="pseudo-random steps of the voltage, written down a sample late",
            config=e.experiment(e.reversing(), e.states(0.1), NINE, v=e.measured("v")),
            made=Driven(duration=10, rate=100, series={"v": RandomSteps(6.0, 0.2, seed=6)}, late=1),
            reason=MORE_THAN_NOISE,
        ),
    )
