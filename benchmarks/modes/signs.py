"""Signs, turns and exchanges: what is known up to a sign, a period, or the order of two."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.puzzle import Puzzle


def puzzles() -> tuple[Puzzle, ...]:
    t = np.arange(240) * 0.005
    slow = np.arange(160) * 0.025
    return (
        Puzzle(
            name="two_lags_of_a_motor",
            kind="signs",
            shows="inertia and inductance of a motor: which of two time constants is whose",
            config=p.alone(
                p.channel("w_2", "rad/s", 3.0),
                {
                    "j_m": {"prior": "log_normal", "median": 1e-4, "sd_log": 1.3},
                    "l_m": p.decades(1e-3, 0.3), "c_m": 2e-3, "k_e": 0.02, "k_T": 0.02, "r_m": 1.0,
                },
                {"v": p.measured("V", "v")},
                simulation={"j_m": 1e-4, "l_m": 5e-3},
            ),
            t=t,
            series={"v": p.square(t, 6.0, 0.4)},
            cells=(256, 256),
        ),
        Puzzle(
            name="side_of_an_arm",
            kind="signs",
            shows="an arm that is clamped on one side of its middle or the other",
            config=p.driven(
                p.channel("w_1", "rpm", 6.0),
                {"k_s": 0.5, "j_1": "0.002 + 0.4*(x - 0.14)**2", "c_s": 0.002},
                {"w_2": 1.0},
                quantities={"x": {"prior": "normal", "mean": 0.16, "sd": 0.05, "unit": "m"}},
                simulation={"quantities": {"x": 0.19}},
            ),
            t=slow,
            cells=(512,),
        ),
        Puzzle(
            name="two_springs",
            kind="signs",
            shows="two springs in series whose dampings add: which is which",
            config=p.driven(
                p.channel("w_1", "rpm", 2.0),
                {"k_s": "1/(1/ka + 1/kb)", "j_1": 0.02, "c_s": "0.002*(ka + kb)"},
                {"w_2": 2.0},
                quantities={
                    "ka": {"prior": "log_normal", "median": 1.2, "sd_log": 0.8, "unit": "N*m/rad"},
                    "kb": {"prior": "log_normal", "median": 2.0, "sd_log": 0.8, "unit": "N*m/rad"},
                },
                simulation={"quantities": {"ka": 0.8, "kb": 4.0}},
            ),
            t=slow,
            cells=(256, 256),
        ),
        Puzzle(
            name="switched_on",
            kind="signs",
            shows="when a rotor was set going, of whose swings only later ones are seen",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.4),
                {"k_s": 1.6, "j_1": 0.02, "c_s": 5e-4},
                {"w_2": 1.0, "t_0": p.between(0.0, 3.0)},
                simulation={"truth": {"t_0": 1.1}},
            ),
            t=np.arange(200) * 0.03,
            read={"record.channels.w_1.mask": {"times": [[0.0, 3.1]]}},
            cells=(512,),
            quick=True,
        ),
        Puzzle(
            name="rotors_change_places",
            kind="signs",
            shows="two rotors on a heavy shaft, of which the twist alone is seen",
            config=p.shaft(
                "long_shaft",
                0.2,
                {**p.SERVO, "k_e": 1e-5, "k_T": 1e-5, "c_m": 0.0, "t_f": 0.0, "j_s": 3e-3, "j_m": 4e-4},
                p.channel("twist", "deg", 0.4, measures="theta_1 - theta_2"),
                {"v": 0.0},
                {"j_m": p.decades(2e-5, 1e-3), "j_1": p.decades(1e-3, 4e-2)},
                initial={"theta_1": 0.3},
                model={"elements": 2},
            ),
            t=np.arange(120) * 0.01,
            cells=(192, 192),
        ),
    )  # fmt: skip
