"""Records of rigs with one fault: in 95 of 100 records of each kind the ranking names it first."""

from __future__ import annotations

import time

import numpy as np
import pytest
from support.scipy_oracles import NOMINAL
from support.unexplained_records import causes_of

import bayesdrill as bd
from bayesdrill.analysis.causes import Causes

RECORDS, RIGHT = 100, 95
SECONDS = 20.0  # of the processor, once the code is compiled
N, DT = 600, 0.01
SIGMA = {"theta_2": 0.02, "twist": 0.02, "w_1": 0.1}
MEASURES = {"theta_2": "theta_2", "twist": "theta_1 - theta_2", "w_1": "w_1"}
HELD = ("r_m", "l_m", "t_f")
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
RHO = 0.8
# The fault of each kind, and the candidate that repairs it.
KINDS = {
    "gain": "gain_twist",
    "lag": "lag_w_1",
    "friction": "friction_rotor_1",
    "gear": "gear",
    "damping": "damping_shaft",
    "memory": "ar1",
}


def case(kind: str, seed: int) -> bd.Case:
    """Of a rig within a few tens of per cent of the nominal one, turned both ways."""
    rng = np.random.default_rng([seed, 35])
    t = DT * np.arange(N)
    turns = np.sign(np.sin(rng.uniform(2, 5) * t + rng.uniform(0, 6)))
    v = 6.0 * turns + rng.uniform(-1, 1) + 1.5 * np.sin(rng.uniform(6, 14) * t)
    truth = {
        name: x if name in HELD else x * np.exp(0.08 * rng.standard_normal())
        for name, x in NOMINAL.items()
    }
    truth |= {"friction": {"t_c1": 0.12}, "damping": {"c_s": 6e-3}}.get(kind, {})
    rig = bd.MotorShaft(i_m=1 / 14 if kind == "gear" else 1 / 8)
    moved = bd.respond(rig, truth, t, {"v": v}, [*MEASURES.values()])
    y = {name: moved[what] for name, what in MEASURES.items()}
    if kind == "gain":
        y["twist"] = 1.3 * y["twist"]
    if kind == "lag":
        y["w_1"] = np.concatenate([y["w_1"][:1], y["w_1"][:1], y["w_1"][:-2]])
    for name, sigma in SIGMA.items():
        noise = rng.standard_normal(N)
        if kind == "memory":
            for k in range(1, N):
                noise[k] = RHO * noise[k - 1] + np.sqrt(1 - RHO**2) * noise[k]
        y[name] = y[name] + sigma * noise
    return bd.case(
        t,
        channels={
            name: bd.Channel(
                y[name], "rad/s" if name == "w_1" else "rad", sigma, measures=MEASURES[name]
            )
            for name, sigma in SIGMA.items()
        },
        inputs={"v": bd.Input(v, "V")},
        parameters={name: "nominal" if name in HELD else BOX for name in NOMINAL},
        nominal="tables_2_3",
    )


def ranked(kind: str, seed: int) -> tuple[Causes | None, float]:
    """Return the ranking, and the seconds of the processor that it took."""
    bad = case(kind, seed)
    start = time.process_time()
    causes = causes_of(bad)
    return causes, time.process_time() - start


def first(causes: Causes | None) -> tuple[str, ...]:
    return () if causes is None else causes.ranked[0].parts


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_95_of_100_records_are_explained_rightly_within_20_seconds(kind: str) -> None:
    rankings = [ranked(kind, seed) for seed in range(RECORDS)]
    wrong = {seed: first(causes) for seed, (causes, _) in enumerate(rankings)}
    wrong = {seed: parts for seed, parts in wrong.items() if parts != (KINDS[kind],)}
    assert len(wrong) <= RECORDS - RIGHT, wrong
    late = [seed for seed, (_, seconds) in enumerate(rankings) if seconds > SECONDS]
    assert len(late) <= 5  # those that compile kernels; a second ranking of them is fast
    assert all(ranked(kind, seed)[1] <= SECONDS for seed in late)
