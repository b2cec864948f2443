"""Several modes beside a noise that is unknown, or a direction of which the record says little."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.gaps import bursts
from benchmarks.modes.puzzle import Puzzle

GAIN = {"prior": "log_normal", "median": 1, "sd_log": 0.2}


def puzzles() -> tuple[Puzzle, ...]:
    t = np.arange(300) * 0.02
    return (
        Puzzle(
            name="bursts_and_noise",
            kind="mixed",
            shows="two bursts, and a noise that is unknown",
            config=p.driven(
                p.channel("theta_1", "deg", p.decades(1.0, 200.0)),
                {"k_s": p.between(1.0, 6.0), "j_1": 0.06},
                {"w_2": 1.5},
                simulation={"k_s": 2.6, "sigma": {"theta_1": 14.0}},
            ),
            t=bursts((0, 1.6), (20, 21.2), rate=20),
            cells=(1024, 32),
        ),
        Puzzle(
            name="aliases_and_noise",
            kind="mixed",
            shows="aliases of a damped shaft, and a noise that is unknown",
            config=p.driven(
                p.channel("w_1", "rpm", p.decades(0.5, 100.0)),
                {"k_s": p.decades(0.8, 150.0), "j_1": 0.04, "c_s": 0.003},
                {"w_2": 1.5},
                simulation={"k_s": 9.0, "sigma": {"w_1": 4.0}},
            ),
            t=np.arange(40) * 0.35,
            cells=(4096, 24),
        ),
        Puzzle(
            name="bits_and_noise",
            kind="mixed",
            shows="the moment of repeated bits, and a noise that is unknown",
            config=p.alone(
                p.channel("w_2", "rpm", p.decades(10.0, 5000.0)),
                {"j_m": 2e-4, "c_m": 6e-4},
                {"t_m": p.measured("N*m", "t_m"), "t_0": p.between(-1.5, 1.5)},
                simulation={"truth": {"t_0": -0.4}, "sigma": {"w_2": 400.0}},
            ),
            t=t,
            series={"t_m": p.repeated_bits(t, 0.02, 0.1, 9, 3)},
            cells=(512, 24),
        ),
        Puzzle(
            name="bursts_of_a_rotor",
            kind="mixed",
            shows="two bursts, and an inertia that its drawing knows to 2 %",
            config=p.driven(
                p.channel("w_1", "rad/s", 2.4),
                {
                    "k_s": p.decades(0.3, 3.0),
                    "j_1": {"prior": "normal", "mean": 0.05, "sd": 0.001},
                },
                {"w_2": 2.0},
                simulation={"k_s": 0.95, "j_1": 0.0505},
            ),
            t=bursts((0, 2), (14, 16), rate=20),
            cells=(1024, 48),
        ),
        Puzzle(
            name="aliases_and_gain",
            kind="mixed",
            shows="aliases of a rotor whose tachometer has an unknown gain",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.25, gain=GAIN),
                {"k_s": p.decades(2.0, 300.0), "j_1": 0.03},
                {"w_2": 1.0},
                simulation={"k_s": 21.0, "truth": {"gain_w_1": 1.1}},
            ),
            t=np.arange(45) * 0.3,
            cells=(4096, 32),
        ),
        Puzzle(
            name="aliases_that_remember",
            kind="mixed",
            shows="aliases under noise whose neighbours are alike",
            config=p.shaft(
                "motor_shaft",
                0.25,
                {**p.SERVO, "j_m": 3e-4, "k_e": 0.003, "k_T": 0.003, "c_m": 1e-7},
                p.channel(
                    "twist", "deg", p.decades(0.01, 10.0), measures="theta_1 - theta_2",
                    noise={"name": "ar1", "rho": 0.6},
                ),
                {"v": 6.0},
                {"k_s": p.decades(0.2, 12.0)},
                simulation={"sigma": {"twist": 2.0}},
            ),
            t=np.arange(60) * 0.15,
            cells=(4096, 24),
        ),
        Puzzle(
            name="lag_and_stiffness",
            kind="mixed",
            shows="a lag under a periodic drive, and a stiffness between whose swings it chooses",
            config=p.driven(
                p.channel("w_1", "rpm", 80.0, lag=p.between(0.0, 1.0)),
                {"k_s": p.decades(0.3, 30.0), "j_1": 0.01, "c_s": 0.02},
                {"w_2": p.measured("rpm", "w_2", "first")},
                simulation={"k_s": 3.0, "truth": {"lag_w_1": 0.45}},
            ),
            t=t,
            series={"w_2": p.sine(t, 30.0, 0.4)},
            read={"record.channels.w_1.mask": {"times": [[0.0, 1.1]]}},
            cells=(256, 256),
        ),
    )  # fmt: skip
