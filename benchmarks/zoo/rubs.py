"""Rows of rigs that rub: friction that changes its sign, and what else goes beyond nine parameters."""

from __future__ import annotations

from benchmarks.zoo import entries as e
from benchmarks.zoo.driven import loop
from benchmarks.zoo.friction import DryFriction
from benchmarks.zoo.makers import Driven, Rubbing, Steady
from benchmarks.zoo.row import Entry, Row
from benchmarks.zoo.signals import Chirp, RandomSteps, Square


def rows() -> tuple[Row, ...]:
    return (*_slipping(), *_sticking(), *_servos(), *_more())


def _upto(high: float, low: float = 0.0) -> Entry:
    return {"prior": "uniform", "low": low, "high": high}


def _within(low: float, high: float) -> Entry:
    return {"prior": "log_uniform", "low": low, "high": high}


def _eight(**own: float | Entry) -> Entry:
    """Without friction of one sign, and with what is its `own`."""
    return e.parameters(e.box(), t_f=0.0, **own)


COULOMB = {"t_cm": _upto(0.2), "t_c1": _upto(1.0)}
STRIBECK = {**COULOMB, "t_s1": _upto(3.0), "w_s1": _within(0.05, 5.0)}
PLAIN = {"prior": "half_normal", "scale": 0.02}


def _slipping() -> tuple[Row, ...]:
    return (
        Row(
            name="rubs_one_way",
            shows="dry friction at both ends, one step of 8 V: it never turns back",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                _eight(**COULOMB),
                simulation={"duration": 10, "rate": 100, "t_cm": 0.05, "t_c1": 0.25},
            ),
            made=Steady(),
        ),
        Row(
            name="rubs_reversing",
            shows="dry friction at both ends, a square wave, a record of another integrator",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                _eight(**COULOMB),
                v=e.measured("v"),
                simulation={"t_cm": 0.05, "t_c1": 0.25},
            ),
            made=Rubbing(
                duration=10,
                rate=100,
                voltage=Square(6.0, 3.2),
                friction=DryFriction(motor=0.05, sliding=0.25, sticking=0.25, parts=400),
            ),
            quick=True,
        ),
        Row(
            name="rubs_not_at_all",
            shows="friction that may be and hardly is, under pseudo-random steps either way",
            config=e.experiment(
                e.paper(),
                e.states(0.05),
                _eight(t_cm=PLAIN, t_c1=PLAIN),
                v=e.measured("v"),
                simulation={"t_cm": 1e-6, "t_c1": 1e-6},
            ),
            made=Driven(duration=10, rate=100, series={"v": RandomSteps(6.0, 0.2, seed=8)}),
        ),
    )


def _sticking() -> tuple[Row, ...]:
    return (
        Row(
            name="rubs_stick_slip",
            shows="stick-slip of rotor 1 at 1.5 V, a record of another integrator",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                _eight(**STRIBECK),
                v=e.measured("v"),
                simulation={"t_cm": 0.01, "t_c1": 0.2, "t_s1": 0.7, "w_s1": 0.5},
            ),
            made=Rubbing(
                duration=15,
                rate=100,
                voltage=Square(1.5, 1000.0),
                friction=DryFriction(motor=0.01, sliding=0.2, sticking=0.7, fading=0.5, parts=400),
            ),
        ),
        Row(
            name="rubs_never_sticks",
            shows="static friction that one fast step does not show: left to its prior",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                _eight(**STRIBECK),
                simulation={
                    "duration": 10,
                    "rate": 100,
                    "t_cm": 0.03,
                    "t_c1": 0.2,
                    "t_s1": 0.4,
                    "w_s1": 0.3,
                },
            ),
            made=Steady(),
        ),
        Row(
            name="rubs_slowly",
            shows="static friction at both ends, a slow voltage straight between samples",
            config=e.experiment(
                e.paper(),
                e.states(0.03),
                _eight(**STRIBECK, t_sm=_upto(0.4), w_sm=_within(0.3, 30.0)),
                v=e.measured("v", "first"),
                simulation={
                    "t_cm": 0.04,
                    "t_sm": 0.09,
                    "w_sm": 3.0,
                    "t_c1": 0.2,
                    "t_s1": 0.5,
                    "w_s1": 0.6,
                },
            ),
            made=Driven(duration=12, rate=80, series={"v": Chirp(3.0, 0.15, 0.4)}),
        ),
    )


def _servo(rig: e.Rig, truth: float, friction: Entry, true: Entry) -> Entry:
    every = {name: e.box() for name in ("j_m", "k_e", "r_m", "k_s", "j_1")}
    return e.experiment(
        rig,
        e.in_degrees(e.unknown(1e-3, 1.0)),
        e.parameters(
            "nominal", **every, k_T={"tie": "k_e"}, c_m=e.decades(0.1, 10.0), t_f=0.0, **friction
        ),
        v=e.measured("v"),
        simulation={
            "sigma": e.noise(truth, "theta_2", "twist"), "k_s": 0.95, "j_1": 2.3e-3, **true,
        },
    )  # fmt: skip


def _servos() -> tuple[Row, ...]:
    motor = {"t_cm": _upto(0.01)}
    return (
        Row(
            name="rubs_servo",
            shows="a servo in its loop with dry friction at the motor, 2,500 samples, 0.1 deg",
            config=_servo(e.servo(), 0.1, motor, {"t_cm": 2.5e-3}),
            made=Driven(duration=4.998, rate=500, series={"v": loop(11)}),
        ),
        Row(
            name="rubs_servo_damped",
            shows="the same with friction at both ends, damping of its spring, and 0.02 deg",
            config=_servo(
                e.servo(),
                0.02,
                {**motor, "t_c1": _upto(0.03), "c_s": _within(1e-5, 1e-2)},
                {"t_cm": 2.5e-3, "t_c1": 6e-3, "c_s": 8e-4},
            ),
            made=Driven(duration=4.998, rate=500, series={"v": loop(12)}),
        ),
    )


def _more() -> tuple[Row, ...]:
    return (
        Row(
            name="rubs_drop",
            shows="the drop of a driver beside dry friction at the motor, three levels either way",
            config=e.experiment(
                e.paper(),
                e.states(0.05, "w_1", "w_2", "i"),
                _eight(t_cm=_upto(0.2), v_d=_upto(3.0)),
                v=e.measured("v"),
                simulation={"t_cm": 0.04, "v_d": 0.7},
            ),
            made=Driven(duration=8, rate=200, series={"v": RandomSteps(7.0, 0.5, seed=9)}),
        ),
        Row(
            name="rubs_gear",
            shows="a gear that loses, damping at rotor 1, another reduction, random steps",
            config=e.experiment(
                e.paper().geared(1 / 5),
                e.states(0.1),
                _eight(t_cm=_upto(0.2), eta=_upto(1.0, 0.5), c_1=_within(1e-4, 0.1)),
                v=e.measured("v"),
                simulation={"t_cm": 0.02, "eta": 0.8, "c_1": 4e-3},
            ),
            made=Driven(duration=10, rate=100, series={"v": RandomSteps(6.0, 0.4, seed=10)}),
        ),
    )
