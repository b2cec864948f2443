"""Gaps: bursts between which a slow swing may have turned once more or less."""

from __future__ import annotations

import numpy as np

from benchmarks.modes import parts as p
from benchmarks.modes.puzzle import Array, Puzzle


def bursts(*parts: tuple[float, float], rate: float) -> Array:
    """Times of all of them, both ends included."""
    return np.concatenate([np.arange(round((b - a) * rate) + 1) / rate + a for a, b in parts])


def puzzles() -> tuple[Puzzle, ...]:
    return (
        Puzzle(
            name="two_bursts",
            kind="gap",
            shows="a rotor's speed in two bursts: the times have a gap",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.8),
                {"k_s": p.between(0.4, 1.2), "j_1": 0.05},
                {"w_2": 2.0},
                simulation={"k_s": 0.74},
            ),
            t=bursts((0, 2), (24, 26), rate=25),
            cells=(2048,),
        ),
        Puzzle(
            name="far_apart",
            kind="gap",
            shows="the same with less noise, four times as far apart, in a prior of two decades",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.3),
                {"k_s": p.between(0.05, 5.0), "j_1": 0.05},
                {"w_2": 2.0},
                simulation={"k_s": 0.74},
            ),
            t=bursts((0, 2), (100, 102), rate=25),
            cells=(16384,),
            own_seed=2,
        ),
        Puzzle(
            name="three_windows",
            kind="gap",
            shows="three windows of a long record, between which the rig goes on",
            config=p.driven(
                p.channel("theta_1", "deg", 25.0),
                {"k_s": p.decades(2.0, 9.0), "j_1": 0.1, "c_s": 0.004},
                {"w_2": 1.0},
                simulation={"k_s": 4.3},
            ),
            t=np.arange(400) * 0.05,
            read={"record.window": [[0.0, 1.2], [9.0, 10.0], [17.8, 19.0]]},
            cells=(2048,),
        ),
        Puzzle(
            name="far_bursts",
            kind="gap",
            shows="two bursts a minute and a half apart, and two unknowns",
            config=p.shaft(
                "motor_shaft",
                0.125,
                {**p.PAPER, "k_e": 0.002, "c_m": 2e-6, "j_m": 4e-4, "k_T": 0.002, "t_f": 0.004},
                p.channel("w_1", "rpm", 6.0),
                {"v": 4.0},
                {"k_s": p.between(0.13, 0.5), "t_f": p.between(0.0, 0.01)},
            ),
            t=bursts((0, 4), (88, 92), rate=20),
            cells=(1024, 128),
        ),
        Puzzle(
            name="two_days",
            kind="gap",
            shows="two bursts of a drill string far apart, in a prior of two decades",
            config=p.driven(
                p.channel("w_1", "rpm", 6.0),
                {"k_s": p.decades(0.05, 5.0), "j_1": 0.08, "c_s": p.decades(1e-4, 1e-2)},
                {"w_2": 1.2},
                simulation={"k_s": 0.62, "c_s": 4e-4},
            ),
            t=bursts((0, 9), (240, 249), rate=8),
            cells=(4096, 16),
        ),
        Puzzle(
            name="three_bursts",
            kind="gap",
            shows="three bursts with two gaps, one of them seven times the other",
            config=p.shaft(
                "motor_shaft",
                0.25,
                {**p.SERVO, "j_m": 6e-4, "k_e": 0.002, "k_T": 0.002, "c_m": 1e-7},
                p.channel("twist", "deg", 0.3, measures="theta_1 - theta_2"),
                {"v": 4.0},
                {"k_s": p.decades(0.1, 10.0)},
            ),
            t=bursts((0, 0.6), (4, 4.6), (32, 32.6), rate=60),
            cells=(32768,),
            own_seed=1,
        ),
        Puzzle(
            name="held_out",
            kind="gap",
            shows="the middle of a servo's record is held out",
            config=p.shaft(
                "two_rotors",
                1 / 14,
                {**p.SERVO, "j_m": 1e-4, "c_m": 1e-7, "k_e": 0.004, "k_T": 0.004},
                p.channel("twist", "deg", 0.25, measures="theta_1 - theta_2"),
                {"v": 2.0},
                {"k_s": p.decades(0.4, 2.0)},
                model={"j_2": 3e-4, "r_s": 0.1},
            ),
            t=np.arange(301) * 0.02,
            read={"record.held_out": [[0.7, 5.3]]},
            cells=(4096,),
            own_seed=1,
        ),
        Puzzle(
            name="blank",
            kind="gap",
            shows="a sensor of a long shaft that was blind for most of the record",
            config=p.shaft(
                "long_shaft",
                0.2,
                {**p.SERVO, "k_e": 0.002, "k_T": 0.002, "c_m": 5e-8, "j_s": 3e-4},
                p.channel("w_1", "rad/s", 0.35),
                {"v": 3.0},
                {"k_s": p.decades(0.3, 3.0)},
                model={"elements": 2},
            ),
            t=np.arange(241) * 0.025,
            dropped=slice(24, 200),
            read={"record.missing": "drop"},
            cells=(4096,),
        ),
        Puzzle(
            name="masked_motor",
            kind="gap",
            shows="a motor whose current swings, most of the record masked",
            config=p.alone(
                p.channel("w_2", "rad/s", 10.0),
                {
                    "j_m": p.decades(2e-5, 2e-4), "c_m": 1e-6, "k_e": 0.05, "k_T": 0.05, "r_m": 0.1,
                    "l_m": 0.5,
                },
                {"v": 1.5},
                simulation={"j_m": 6e-5},
            ),
            t=np.arange(251) * 0.04,
            read={"record.channels.w_2.mask": {"times": [[0.7, 9.1]]}},
            cells=(4096,),
        ),
        Puzzle(
            name="two_short_experiments",
            kind="gap",
            shows="two experiments, each with aliases of its own",
            config=p.driven(
                p.channel("w_1", "rad/s", 0.35),
                {"k_s": p.between(0.5, 2.0), "j_1": 0.02},
                {"w_2": 1.5},
                initial={"time": 0.0},
                simulation={"k_s": 1.1},
            ),
            t=np.arange(300) * 0.05,
            read={
                "initial": {"time": 0.0},
                "experiments": {
                    "late": {"record": {"window": [6.0, 6.25]}},
                    "later": {"record": {"window": [12.5, 12.75]}},
                },
            },
            cells=(4096,),
        ),
    )  # fmt: skip
