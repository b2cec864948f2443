"""Friction: a rig that sticks, for ever or for longer, or moves."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.puzzle import Puzzle


def puzzles() -> tuple[Puzzle, ...]:
    t = np.arange(200) * 0.02
    few = np.arange(30) * 0.4
    return (
        Puzzle(
            name="holds_or_moves",
            kind="friction",
            shows="a motor under a swinging torque, which static friction may hold for good",
            config=p.alone(
                p.channel("w_2", "rad/s", 15.0),
                {
                    "j_m": 1e-2, "c_m": p.decades(4e-3, 0.1), "t_cm": 0.05,
                    "t_sm": p.between(0.051, 0.4), "w_sm": 0.2,
                },
                {"t_m": p.measured("N*m", "t_m", "first")},
                model={"pieces": 2},
                simulation={"t_sm": 0.17, "c_m": 0.02},
            ),
            t=t,
            series={"t_m": p.sine(t, 0.2, 2.0)},
            cells=(48, 256),
            own_seed=2,
            split=("t_sm", 0.2),
        ),
        Puzzle(
            name="slips",
            kind="friction",
            shows="stick-slip, seen too seldom to count the slips",
            config=p.driven(
                p.channel("theta_1", "deg", 25.0),
                {
                    "k_s": 1.0, "j_1": 2e-3, "c_s": 0.02, "t_c1": 0.1, "t_s1": p.between(0.2, 1.6),
                    "w_s1": 0.5,
                },
                {"w_2": 1.0},
                model={"pieces": 16},
                simulation={"t_s1": 0.7},
            ),
            t=few,
            cells=(2048,),
        ),
        Puzzle(
            name="held_rotor",
            kind="friction",
            shows="a rotor that friction holds for good where the shaft is soft",
            config=p.driven(
                p.channel("w_1", "rpm", 100.0),
                {"k_s": p.decades(0.05, 20.0), "j_1": 4e-3, "c_s": 0.002, "t_c1": 0.35},
                {"w_2": p.measured("rad/s", "w_2", "first")},
                model={"pieces": 4},
                simulation={"k_s": 2.6},
            ),
            t=t,
            series={"w_2": p.sine(t, 2.0, 1.3)},
            cells=(4096,),
            own_seed=1,
        ),
        Puzzle(
            name="late_or_stuck",
            kind="friction",
            shows="a rotor that friction may hold for good, and a lag that shows only where it moves",
            config=p.driven(
                p.channel("w_1", "rpm", 60.0, lag=p.between(-0.4, 0.4)),
                {"k_s": 1.0, "j_1": 6e-3, "c_s": 0.01, "t_c1": p.between(0.02, 1.2)},
                {"w_2": p.measured("rad/s", "w_2", "first")},
                model={"pieces": 4},
                simulation={"t_c1": 0.2, "truth": {"lag_w_1": 0.13}},
            ),
            t=t,
            series={"w_2": p.sine(t, 2.0, 1.3)},
            cells=(256, 256),
            own_seed=1,
            split=("t_c1", 0.38),
        ),
        Puzzle(
            name="slips_of_a_string",
            kind="friction",
            shows="the stiffness of a shaft whose rotor sticks and slips, its speed seen seldom",
            config=p.driven(
                p.channel("theta_1", "deg", 30.0),
                {
                    "k_s": p.decades(0.4, 4.0), "j_1": 5e-3, "c_s": 0.03, "t_c1": 0.2, "t_s1": 0.9,
                    "w_s1": 0.4,
                },
                {"w_2": 1.3},
                model={"pieces": 16},
                simulation={"k_s": 1.1},
            ),
            t=np.arange(24) * 0.5,
            cells=(2048,),
            own_seed=1,
        ),
    )  # fmt: skip
