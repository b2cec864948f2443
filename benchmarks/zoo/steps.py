"""Rows with a constant voltage: steps, noise and samples of them, coasting, swinging, loads."""

from __future__ import annotations

from bayesdrill.config.yaml_source import read
from benchmarks.zoo import entries as e
from benchmarks.zoo.makers import ROOT, Driven, Steady
from benchmarks.zoo.row import Entry, Row
from benchmarks.zoo.signals import Levels
from benchmarks.zoo.texts import changed

CONFIGS = ROOT / "configs"
NINE = e.parameters(e.box())


def bundled(name: str, changes: Entry | None = None) -> Entry:
    """A config of the project without what a row has of its own."""
    data = read(CONFIGS / f"{name}.yaml").data
    record = {key: value for key, value in data["record"].items() if key != "file"}
    own = {key: value for key, value in data.items() if key not in ("name", "seed")}
    return changed({**own, "record": record}, changes or {})


def _with_noise(sigma: float) -> Entry:
    return {f"record.channels.{name}.sigma": sigma for name in e.FOUR}


def rows() -> tuple[Row, ...]:
    return (*_bundled(), *_steps(), *_lengths(), *_coasting(), *_loads())


def _bundled() -> tuple[Row, ...]:
    step = "nominal_step"
    return (
        Row(
            name="bundled",
            shows="the bundled record: nine unknowns, a step of 8 V, noise of 0.1",
            config=bundled(step),
            made=Steady(),
            own_seed=2013,
        ),
        Row(
            name="bundled_quiet",
            shows="the bundled config with a hundredth of its noise",
            config=bundled(step, _with_noise(0.001)),
            made=Steady(),
        ),
        Row(
            name="bundled_loud",
            shows="the bundled config with ten times its noise",
            config=bundled(step, _with_noise(1.0)),
            made=Steady(),
        ),
        Row(
            name="bundled_one_held",
            shows="the bundled config with j_1 held: one scale is settled",
            config=bundled(step, {"parameters.j_1": "nominal"}),
            made=Steady(),
        ),
        Row(
            name="bundled_two_held",
            shows="the bundled config with j_1 and r_m held: both scales are settled",
            config=bundled(step, {"parameters.j_1": "nominal", "parameters.r_m": "nominal"}),
            made=Steady(),
        ),
        Row(
            name="example_rig",
            shows="the bundled example: degrees and rpm, three unknown noise levels, six families",
            config=bundled("example_rig"),
            made=Steady(),
        ),
        Row(
            name="example_ties",
            shows="the bundled example of a tie and of a stiffness by geometry",
            config=bundled("example_ties"),
            made=Steady(),
        ),
    )


def _steps() -> tuple[Row, ...]:
    ten = {"duration": 10, "rate": 100}
    return (
        Row(
            name="least_noise",
            shows="a step with a ten-thousandth of the bundled noise",
            config=e.experiment(e.paper(), e.states(1e-5), NINE, simulation=ten),
            made=Steady(),
        ),
        Row(
            name="unknown_noise",
            shows="a step with three times the bundled noise, all four levels unknown: 13 unknowns",
            config=e.experiment(
                e.paper(),
                e.states(e.unknown(0.03, 3.0)),
                NINE,
                simulation={**ten, "sigma": e.noise(0.3)},
            ),
            made=Steady(),
        ),
        Row(
            name="step_back",
            shows="a step of -8 V with hardly any dry friction",
            config=e.experiment(
                e.reversing(), e.states(0.1), NINE, v=-8.0, simulation={**ten, "k_s": 0.29}
            ),
            made=Steady(),
        ),
    )


def _lengths() -> tuple[Row, ...]:
    return (
        Row(
            name="samples_30",
            shows="30 samples in 10 s: nine unknowns",
            config=e.experiment(
                e.paper(), e.states(0.1), NINE, simulation={"duration": 29 / 3, "rate": 3}
            ),
            made=Steady(),
        ),
        Row(
            name="samples_300",
            shows="300 samples of two channels in 3 s: five unknowns",
            config=e.experiment(
                e.paper(),
                e.states(0.05, "theta_1", "w_2"),
                e.parameters(
                    "nominal", **{n: e.box() for n in ("k_e", "k_s", "j_1", "t_f", "l_m")}
                ),
                simulation={"duration": 2.99, "rate": 100, "t_f": 0.11},
            ),
            made=Steady(),
        ),
        Row(
            name="samples_100000",
            shows="100,000 samples of four channels in 10 s: nine unknowns",
            config=e.experiment(
                e.paper(), e.states(0.1), NINE, simulation={"duration": 9.9999, "rate": 10_000}
            ),
            made=Steady(),
        ),
    )


def _coasting() -> tuple[Row, ...]:
    turning = {"w_1": 15.0, "w_2": 15.0}
    return (
        Row(
            name="coast_shorted",
            shows="a turning rig whose motor is shorted: v = 0, nine unknowns",
            config=e.experiment(
                e.reversing(),
                e.states(0.1),
                NINE,
                v=0.0,
                initial={**turning, "i": 2.0},
                simulation={"duration": 10, "rate": 50},
            ),
            made=Steady(),
        ),
        Row(
            name="coast_open",
            shows="a turning rig cut from its supply, until dry friction has stopped it",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                e.parameters(e.box(), k_e="nominal", k_T="nominal", r_m=1e4, l_m="nominal"),
                v=0.0,
                initial=turning,
                simulation={"duration": 0.8, "rate": 500},
            ),
            made=Steady(),
        ),
        Row(
            name="free_swing",
            shows="a wound shaft let go at v = 0: two unknowns from the rotor's angle",
            config=e.experiment(
                e.reversing(),
                e.states(0.02, "theta_1"),
                e.parameters("nominal", k_s=e.box(), c_m=e.box(0.0, 20.0)),
                v=0.0,
                initial={"theta_1": {"value": 90, "unit": "deg"}},
                simulation={"duration": 12, "rate": 25, "c_m": 4e-4},
            ),
            made=Steady(),
            quick=True,
        ),
    )


def _loads() -> tuple[Row, ...]:
    three = e.states(0.1, "theta_1", "theta_2", "w_1")
    return (
        Row(
            name="load_constant",
            shows="a known constant load torque, which settles one scale",
            config=e.experiment(
                e.paper(),
                e.states(0.1),
                NINE,
                inputs={"t_1": 0.6},
                simulation={"duration": 10, "rate": 100, "j_1": 0.03},
            ),
            made=Steady(),
        ),
        Row(
            name="load_measured",
            shows="a measured load torque in steps, either sign, held between samples",
            config=e.experiment(e.paper(), three, NINE, inputs={"t_1": e.measured("t_1")}),
            made=Driven(
                duration=12, rate=50, series={"t_1": Levels((0.0, 1.0, -0.5, 2.0, 0.0, 0.5))}
            ),
        ),
    )
