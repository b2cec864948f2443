"""Delays: a drive that repeats itself looks the same a period later."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.puzzle import Puzzle


def puzzles() -> tuple[Puzzle, ...]:
    t = np.arange(300) * 0.02
    long, fine = np.arange(400) * 0.05, np.arange(1000) * 0.02
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
        ),
        Puzzle(
            name="bits_t_0",
            kind="delay",
            shows="the moment of a repeated sequence of bits",
            config=p.shaft(
                "motor_shaft",
                1 / 14,
                p.SERVO,
                p.channel("w_2", "rad/s", 20.0),
                {"v": p.measured("V", "v"), "t_0": p.between(-1.0, 1.0)},
                {},
                simulation={"truth": {"t_0": 0.11}},
            ),
            t=t,
            series={"v": p.repeated_bits(t, 3.0, 0.06, 7, 5)},
            cells=(512,),
        ),
        Puzzle(
            name="long_bits",
            kind="delay",
            shows="the lag of a current's sensor under a long sequence that repeats itself",
            config=p.alone(
                p.channel("i", "A", 0.5, lag=p.between(0.0, 4.0)),
                {"j_m": 4e-4, "c_m": 1e-4, "k_e": 0.05, "k_T": 0.05, "r_m": 1.5, "l_m": 0.01},
                {"v": p.measured("V", "v")},
                simulation={"truth": {"lag_i": 1.37}},
            ),
            t=np.arange(400) * 0.02,
            series={"v": p.repeated_bits(np.arange(400) * 0.02, 5.0, 0.04, 31, 11)},
            read={"record.channels.i.mask": {"times": [[0.0, 5.3]]}},
            cells=(1024,),
        ),
        Puzzle(
            name="fifty_periods",
            kind="delay",
            shows="the lag of a tachometer under a fast square torque: nearly fifty periods",
            config=p.alone(
                p.channel("w_2", "rad/s", 5.0, lag=p.between(0.0, 14.0)),
                {"j_m": 2e-3, "c_m": 8e-3},
                {"t_m": p.measured("N*m", "t_m")},
                simulation={"truth": {"lag_w_2": 3.0}},
            ),
            t=long,
            series={"t_m": p.square(long, 0.06, 0.3)},
            read={"record.channels.w_2.mask": {"times": [[0.0, 15.5]]}},
            cells=(4096,),
        ),
        Puzzle(
            name="fine_bits",
            kind="delay",
            shows="the lag of a current's sensor under bits that are far finer than its prior",
            config=p.alone(
                p.channel("i", "A", 0.5, lag=p.between(0.0, 14.0)),
                {"j_m": 4e-4, "c_m": 1e-4, "k_e": 0.05, "k_T": 0.05, "r_m": 1.5, "l_m": 0.01},
                {"v": p.measured("V", "v")},
                simulation={"truth": {"lag_i": 1.37}},
            ),
            t=fine,
            series={"v": p.repeated_bits(fine, 5.0, 0.02, 127, 11)},
            read={"record.channels.i.mask": {"times": [[0.0, 15.3]]}},
            cells=(8192,),
        ),
        Puzzle(
            name="late_supply",
            kind="delay",
            shows="the moment of a fast square that goes on before and after, over many periods",
            config=p.shaft(
                "two_rotors",
                0.1,
                {**p.SERVO, "k_s": 2.0},
                p.channel("w_2", "rad/s", 6.0),
                {"v": p.measured("V", "v"), "t_0": p.between(-1.5, 1.5)},
                {"r_m": p.between(1.0, 3.0)},
                model={"j_2": 2e-4, "r_s": 0.2},
                simulation={"truth": {"t_0": 0.234}},
            ),
            t=np.arange(400) * 0.01,
            series={"v": p.square(np.arange(400) * 0.01, 6.0, 0.25)},
            read={"record.channels.w_2.mask": {"times": [[0.0, 1.7]]}},
            cells=(64, 1024),
        ),
        Puzzle(
            name="sine_lag",
            kind="delay",
            shows="the lag of a twist under a sine, and the stiffness",
            config=p.driven(
                p.channel(
                    "twist", "deg", 2.5, measures="theta_1 - theta_2", lag=p.between(0.0, 1.5)
                ),
                {"k_s": p.decades(0.5, 2.0), "j_1": 0.004, "c_s": 0.03},
                {"w_2": p.measured("rad/s", "w_2", "first")},
                simulation={"k_s": 0.9, "truth": {"lag_twist": 0.7}},
            ),
            t=t,
            series={"w_2": p.sine(t, 3.0, 0.5)},
            read={"record.channels.twist.mask": {"times": [[0.0, 1.6]]}},
            cells=(96, 384),
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
            read={
                "record.channels.theta_2.mask": {"times": [[0.0, 1.3]]},
                "record.channels.w_2.mask": {"times": [[0.0, 1.3]]},
            },
            cells=(256, 256),
        ),
        Puzzle(
            name="late_top",
            kind="delay",
            shows="the lag of an imposed speed that swings, on a damped shaft",
            config=p.driven(
                p.channel("w_1", "rpm", 40.0),
                {"k_s": 1.2, "j_1": 0.01, "c_s": 0.03},
                {"w_2": p.measured("rpm", "w_2", "first", lag=p.between(-1.2, 1.2))},
                simulation={"truth": {"lag_w_2": -0.35}},
            ),
            t=t,
            series={"w_2": p.sine(t, 25.0, 0.7)},
            read={"record.channels.w_1.mask": {"times": [[0.0, 1.3]]}},
            cells=(512,),
        ),
    )
