"""The benches: rigs with records of others, and what was published of each."""

from __future__ import annotations

import math

from benchmarks.real.bench import Bench, Criterion, File, Values
from benchmarks.real.servos import BAM, PADOVA


def _hertz(square: float) -> float:
    return math.sqrt(square) / (2 * math.pi)


def _waterloo(name: str, digest: str) -> File:
    file = f"velocity_response_{name}.mat"
    return File(file, f"Project3/Lab3 360 Data/{file}", digest)


WATERLOO = Bench(
    name="waterloo",
    folder="flexible_drive_waterloo_2022",
    repository="ParthSareen/controls-projects",
    commit="51934eb6e6193edb53b850cc2abc5a2e0ab28ef5",
    licence="none stated",
    published="m 0.266 and 0.144, k 35.1, Coulomb 0.593 and 0.059, over k_F/r",
    files=(
        _waterloo("2", "267a01177dad6c92e6104b193792337076fa76e7674c9d992cf0a25b775d2828"),
        _waterloo("1_5", "d2abdc1b1463e544d0113768038c1b27dfb2be28ce3a9bf368d285a8f485ee6d"),
        _waterloo("sine_1", "f1b58485518d7ba898fa839326d5d8483f4fb037dce259eaa6a70c30d1a82323"),
        _waterloo("sine_3", "f4b74148cdc1eea8b7ec7386a8499739d6ee65d09a6fb92a592688957ed54eab"),
        _waterloo("sine_5", "360a4cdc7e58402edb0d454fca9866f5803a4aff78b7d10ea40eb640e5643687"),
    ),
    criteria=(
        Criterion("m_cart_1 over published", "1", lambda v: v["m_cart_1"] / 0.26634, 1.5, 3.2),
        Criterion("m_cart_2 over published", "1", lambda v: v["m_cart_2"] / 0.14383, 1.5, 3.2),
        Criterion(
            "resonance",
            "Hz",
            lambda v: _hertz(v["k_spring"] * (1 / v["m_cart_1"] + 1 / v["m_cart_2"])),
            2.7,
            3.1,
        ),
        Criterion("f_c_cart_1", "V", lambda v: v["f_c_cart_1"], 0.2, 0.5),
    ),
    left=0.20,
    disagrees=("m_cart_1", "m_cart_2", "k_spring"),
)


def _tokyo(name: str, digest: str) -> File:
    file = f"MultisineType{name}.mat"
    return File(file, f"Examples/private/{file}", digest)


TOKYO = Bench(
    name="tokyo",
    folder="two_inertia_bench_tokyo",
    repository="WataruOhnishi/FdiTools",
    commit="760b945947491d93917557a145e8637fa209c7d8",
    licence="MIT",
    published="nothing; a fit of frequency responses: ratio 0.99, 54.0 and 76.3 Hz",
    files=(
        _tokyo("A", "a15dadc2e756ceddd927935f9c4c547cdcaef95c8611fc39087c848b3a8acb26"),
        _tokyo("B", "5618374be2c4c9c4eef5b180eb5bc64c82c5bd216c025d363b547d0ccc83dc11"),
    ),
    criteria=(
        Criterion("j_load/j_motor", "1", lambda v: v["j_load"] / v["j_motor"], 0.99, 1.0),
        Criterion(
            "antiresonance", "Hz", lambda v: _hertz(v["k_coupling"] / v["j_load"]), 53.8, 54.2
        ),
        Criterion(
            "resonance",
            "Hz",
            lambda v: _hertz(v["k_coupling"] * (1 / v["j_load"] + 1 / v["j_motor"])),
            76.0,
            76.6,
        ),
        Criterion("delay", "ms", lambda v: 1e3 * v["t_0"], 0.08, 0.14),
    ),
)


def _modes(values: Values) -> tuple[float, float]:
    """The squares of the two frequencies of a free chain of j, j and r j on two equal shafts."""
    k, r = values["k_shaft_1"] / values["j_disc_1"], values["r"]
    middle, product = k * (3 + 1 / r) / 2, k**2 * (1 + 2 / r)
    half = math.sqrt(middle**2 - product)
    return middle - half, middle + half


EPFL = Bench(
    name="epfl",
    folder="three_disc_epfl",
    repository="cartacamilla/SystemIdentification",
    commit="55d53b89baec2f73c4bc8f014d20b247351fc327",
    licence="none stated",
    published="resonances at 14.1 and 26.6 rad/s",
    files=(
        File(
            "FPdata.mat",
            "FPdata.mat",
            "71f667cd54d4efe0e0cb6a0e18d9f5704c02fd176679d0b8dd03239c54359d01",
        ),
    ),
    criteria=(
        Criterion("low resonance", "rad/s", lambda v: math.sqrt(_modes(v)[0]), 13.8, 14.4),
        Criterion("high resonance", "rad/s", lambda v: math.sqrt(_modes(v)[1]), 26.1, 27.1),
    ),
)

BENCHES = (WATERLOO, TOKYO, EPFL, BAM, PADOVA)
