"""Rows whose sensors are not white: they remember, fail now and then, or count steps."""

from __future__ import annotations

from benchmarks.zoo import entries as e
from benchmarks.zoo.makers import Driven, Steady
from benchmarks.zoo.row import Entry, Row
from benchmarks.zoo.signals import RandomSteps

NINE = e.parameters(e.box())
LEVEL = e.unknown(0.001, 10.0)


def of_kind(channels: Entry, **kinds: str | Entry) -> Entry:
    """The same with other noise."""
    return {
        name: {**channel, **({"noise": kinds[name]} if name in kinds else {})}
        for name, channel in channels.items()
    }


def rows() -> tuple[Row, ...]:
    speeds = e.states(LEVEL, "w_1", "w_2")
    both = of_kind(speeds, w_1="ar1", w_2="ar1")
    return (
        Row(
            name="coloured_sensors",
            shows="two speeds whose noise remembers (0.95 and 0.8), all of it unknown: 13 unknowns",
            config=e.experiment(
                e.reversing(),
                both,
                NINE,
                v=e.measured("v"),
                simulation={
                    "sigma": e.noise(0.1, "w_1", "w_2"),
                    "truth": {"rho_w_1": 0.95, "rho_w_2": 0.8},
                },
            ),
            made=Driven(duration=20, rate=100, series={"v": RandomSteps(6.0, 0.4, seed=5)}),
        ),
        Row(
            name="coloured_and_rubbing",
            shows="the same sensors on a rig with dry friction at the motor, five unknown",
            config=e.experiment(
                e.reversing(),
                both,
                e.parameters(
                    "nominal", **{n: e.box() for n in ("k_e", "k_s", "j_1")}, t_cm=_friction()
                ),
                v=e.measured("v"),
                simulation={
                    "sigma": e.noise(0.1, "w_1", "w_2"),
                    "truth": {"rho_w_1": 0.95, "rho_w_2": 0.8},
                    "t_cm": 0.05,
                },
            ),
            made=Driven(duration=10, rate=100, series={"v": RandomSteps(6.0, 0.4, seed=6)}),
        ),
        Row(
            name="now_and_then_far_off",
            shows="four states with heavy tails (4 degrees of freedom), nine unknown and the tails",
            config=e.experiment(
                e.paper(),
                of_kind(e.states(0.1), **dict.fromkeys(e.FOUR, "student_t")),
                NINE,
                simulation={
                    "duration": 10,
                    "rate": 100,
                    "truth": {f"nu_{name}": 4.0 for name in e.FOUR},
                },
            ),
            made=Steady(),
        ),
        Row(
            name="coarse_encoders",
            shows="two angles in steps of 1.8 degrees, ten times their noise: five unknown",
            config=e.experiment(
                e.paper(),
                of_kind(
                    {n: e.channel(n, "deg", 0.18) for n in ("theta_1", "theta_2")},
                    theta_1=_steps(),
                    theta_2=_steps(),
                ),
                e.parameters(
                    "nominal", **{n: e.box() for n in ("k_e", "k_s", "j_1", "j_m", "r_m")}
                ),
                simulation={"duration": 10, "rate": 100},
            ),
            made=Steady(),
        ),
    )


def _steps() -> Entry:
    return {"name": "quantised", "step": 1.8}


def _friction() -> Entry:
    return {"prior": "log_uniform", "low": 0.005, "high": 0.5}
