"""Aliases: swings that are faster than the samples are close."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.puzzle import Puzzle


def puzzles() -> tuple[Puzzle, ...]:
    return (
        Puzzle(
            name="sixteen",
            kind="aliases",
            shows="an undamped rotor: sixteen stiffnesses leave the very same samples",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.3),
                {"k_s": p.decades(1.0, 800.0), "j_1": 0.02},
                {"w_2": 1.0},
                simulation={"k_s": 36.0},
            ),
            t=np.arange(40) * 0.25,
            cells=(16384,),
        ),
        Puzzle(
            name="eight_damped",
            kind="aliases",
            shows="a damped shaft, each alias of which damps its swings otherwise",
            config=p.driven(
                p.channel("w_1", "rpm", 5.0),
                {"k_s": p.between(2.0, 200.0), "j_1": 0.05, "c_s": 0.0035},
                {"w_2": 1.2},
                simulation={"k_s": 40.0},
            ),
            t=np.arange(60) * 0.4,
            cells=(16384,),
            quick=True,
        ),
        Puzzle(
            name="ridges",
            kind="aliases",
            shows="stiffness and inertia of an undamped rotor: a ridge for each alias",
            config=p.driven(
                p.channel("w_1", "rpm", 3.0),
                {"k_s": p.decades(2.0, 200.0), "j_1": p.decades(0.08, 0.13)},
                {"w_2": 1.0},
                simulation={"k_s": 7.3, "j_1": 0.1},
            ),
            t=np.arange(12) * 0.3,
            cells=(512, 256),
        ),
        Puzzle(
            name="servo_aliases",
            kind="aliases",
            shows="a servo's shaft, sampled at 12 Hz",
            config=p.shaft(
                "motor_shaft",
                1 / 14,
                {**p.SERVO, "k_e": 0.004, "k_T": 0.004, "c_m": 1e-7},
                p.channel("w_1", "rad/s", 0.5),
                {"v": 2.0},
                {"k_s": p.decades(0.3, 60.0)},
            ),
            t=np.arange(48) / 12,
            cells=(16384,),
        ),
        Puzzle(
            name="twenty",
            kind="aliases",
            shows="twenty of them, the highest prior where they are closest",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.4),
                {"k_s": {"prior": "log_normal", "median": 100.0, "sd_log": 1.2}, "j_1": 0.01},
                {"w_2": 1.0},
                simulation={"k_s": 130.0},
            ),
            t=np.arange(36) * 0.2,
            cells=(32768,),
        ),
    )
