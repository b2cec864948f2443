"""Delays: a drive that repeats itself looks the same a period later."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.puzzle import Puzzle


def puzzles() -> tuple[Puzzle, ...]:
    t = np.arange(300) * 0.02
    return (
        Puzzle(
            name="square_lag",
            kind="delay",
            shows="the lag of a tachometer under a square torque, three periods to choose from",
            config=p.alone(
                p.channel("w_2", "rad/s", 5.0, lag=p.between(0.0, 2.4)),
                {"j_m": 2e-3, "c_m": 8e-3},
                {"t_m": p.measured("N*m", "t_m")},
                simulation={"truth": {"lag_w_2": 0.95}},
            ),
            t=t,
            series={"t_m": p.square(t, 0.02, 0.8)},
            cells=(512,),
            quick=True,
        ),
        Puzzle(
            name="two_lags",
            kind="delay",
            shows="two sensors, each with a lag of its own",
            config=p.alone(
                {
                    **p.channel("theta_2", "deg", 3.0, lag=p.between(0.0, 1.0)),
                    **p.channel("w_2", "rpm", 20.0, lag=p.between(0.0, 1.2)),
                },
                {"j_m": 1e-3, "c_m": 4e-3},
                {"t_m": p.measured("N*m", "t_m")},
                simulation={"truth": {"lag_theta_2": 0.33, "lag_w_2": 0.7}},
            ),
            t=t,
            series={"t_m": p.square(t, 0.012, 0.4)},
            cells=(256, 256),
        ),
    )
