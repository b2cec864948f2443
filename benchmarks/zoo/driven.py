"""Rows whose voltage is measured: square waves, chirps, pseudo-random steps, closed loops."""

from __future__ import annotations

import math

from benchmarks.zoo import entries as e
from benchmarks.zoo.entries import Rig
from benchmarks.zoo.makers import Driven
from benchmarks.zoo.row import Entry, Row
from benchmarks.zoo.signals import Chirp, Loop, RandomSteps, Square

NINE = e.parameters(e.box())
DEGREE = math.pi / 180.0


def rows() -> tuple[Row, ...]:
    return (*_open(), *_random(), *_closed())


def _open() -> tuple[Row, ...]:
    return (
        Row(
            name="square",
            shows="a square wave of 8 V either way, held between samples",
            config=e.experiment(e.reversing(), e.states(0.1), NINE, v=e.measured("v")),
            made=Driven(duration=10, rate=100, series={"v": Square(8.0, 3.2)}),
        ),
        Row(
            name="chirp",
            shows="a chirp of 6 V through the torsion, straight between samples",
            config=e.experiment(e.reversing(), e.states(0.1), NINE, v=e.measured("v", "first")),
            made=Driven(duration=15, rate=100, series={"v": Chirp(6.0, 0.1, 4.0)}),
        ),
    )


def _random() -> tuple[Row, ...]:
    return (
        Row(
            name="random_steps",
            shows="pseudo-random steps between 5 and 9 V, 3,000 samples",
            config=e.experiment(e.paper(), e.states(0.1), NINE, v=e.measured("v")),
            made=Driven(
                duration=14.995, rate=200, series={"v": RandomSteps(2.0, 0.15, seed=3, offset=7.0)}
            ),
            own_seed=11,
        ),
        Row(
            name="random_steps_quiet",
            shows="pseudo-random steps of 6 V either way, a hundredth of the noise",
            config=e.experiment(e.reversing(), e.states(1e-3), NINE, v=e.measured("v")),
            made=Driven(duration=10, rate=100, series={"v": RandomSteps(6.0, 0.1, seed=4)}),
        ),
        *(
            Row(
                name=f"random_steps_{size}",
                shows=f"pseudo-random steps of 8 V either way, {size} samples, compressed",
                config=e.experiment(e.reversing(), e.states(0.1), NINE, v=e.measured("v")),
                made=Driven(
                    duration=duration, rate=1000, series={"v": RandomSteps(8.0, 0.2, seed=5)}
                ),
            )
            for size, duration in (("100000", 99.999), ("1000000", 999.999))
        ),
        Row(
            name="random_steps_10000000",
            shows="pseudo-random steps of 8 V either way, 10000000 samples of two channels, compressed",
            config=e.experiment(
                e.reversing(), e.states(0.1, "theta_1", "w_2"), NINE, v=e.measured("v")
            ),
            made=Driven(duration=9999.999, rate=1000, series={"v": RandomSteps(8.0, 0.2, seed=5)}),
            seconds=360.0,
        ),
    )


def loop(seed: int) -> Loop:
    """Of the servo: 30 degrees to and fro, twice in 5 s."""
    return Loop(
        amplitude=30 * DEGREE,
        period=2.5,
        gain=12.0,
        damping=0.6,
        limit=10.0,
        sensor=0.05 * DEGREE,
        seed=seed,
    )


def seven(rig: Rig, truth: float, hold: str = "zero") -> Entry:
    """A closed loop with seven unknowns of the rig and two noise levels, truly `truth` degrees."""
    every = {name: e.box() for name in ("j_m", "k_e", "r_m", "k_s", "j_1")}
    return e.experiment(
        rig,
        e.in_degrees(e.unknown(1e-3, 1.0)),
        e.parameters(
            "nominal", **every, k_T={"tie": "k_e"}, c_m=e.decades(0.1, 10.0), t_f=e.box(0.0, 10.0)
        ),
        v=e.measured("v", hold),
        simulation={"sigma": e.noise(truth, "theta_2", "twist"), "k_s": 0.95, "j_1": 2.3e-3},
    )


def _closed() -> tuple[Row, ...]:
    return (
        Row(
            name="closed_loop",
            shows="a servo in its loop, 2,500 samples: seven of the rig, two noise levels, 0.1 deg",
            config=seven(e.servo(), 0.1),
            made=Driven(duration=4.998, rate=500, series={"v": loop(1)}),
            quick=True,
        ),
        Row(
            name="closed_loop_fine",
            shows="the same servo with noise of 0.01 degrees",
            config=seven(e.servo(), 0.01),
            made=Driven(duration=4.998, rate=500, series={"v": loop(2)}),
        ),
        Row(
            name="closed_loop_straight",
            shows="the same servo, its voltage straight between samples",
            config=seven(e.servo(), 0.1, "first"),
            made=Driven(duration=4.998, rate=500, series={"v": loop(3)}),
        ),
        Row(
            name="closed_loop_geared",
            shows="the same servo with a gear of 1/70",
            config=seven(e.servo().geared(1 / 70), 0.1),
            made=Driven(
                duration=4.998,
                rate=500,
                series={
                    "v": Loop(
                        amplitude=30 * DEGREE,
                        period=2.5,
                        gain=40.0,
                        damping=2.0,
                        limit=10.0,
                        sensor=0.05 * DEGREE,
                        seed=4,
                    )
                },
            ),
        ),
    )
