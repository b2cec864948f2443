"""Intervals of simulated servos of three sizes: 94 % of them hold the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

import bayesdrill as bd
from bayesdrill.inference import laplace
from bayesdrill.rig.models.linear import with_named
from bayesdrill.rig.models.train import Train

SERVO = Train(inertias=("horn",), drives={"horn": "servo"}, gravity=("horn",))
RECORDS, DEVIATION = 20, 1.8808  # of each size; standard deviations of a 94 % interval
SIZES = {
    "micro": {"j_horn": 2e-4, "k_T_horn": 0.25, "r_horn": 6.0, "supply_horn": 5.0, "g_horn": 0.02,
              "t_c_horn": 0.012, "t_c_horn_backward": 0.008},
    "hobby": {"j_horn": 0.03, "k_T_horn": 2.4, "r_horn": 4.9, "supply_horn": 12.0, "g_horn": 0.6,
              "t_c_horn": 0.25, "t_c_horn_backward": 0.15},
    "robot": {"j_horn": 0.8, "k_T_horn": 12.0, "r_horn": 1.5, "supply_horn": 48.0, "g_horn": 15.0,
              "t_c_horn": 8.0, "t_c_horn_backward": 6.0},
}  # fmt: skip
LOOP = {"duty_horn": 0.16, "k_p_horn": 16.0, "limit_horn": 0.4}
UNKNOWN = ("j_horn", "k_T_horn", "limit_horn", "t_c_horn", "t_c_horn_backward")


def deviations(truth: dict[str, float], rng: np.random.Generator) -> np.ndarray:
    """Of each unknown of a simulated record, its error over its sd, in the sampler's coordinates."""
    rig = with_named(SERVO, [*truth])
    t = 0.01 * np.arange(301)
    goal = np.repeat(rng.uniform(-0.9, 0.9, 7), 43)[:301]
    y = bd.respond(rig, truth, t, {"goal_horn": goal}, ["theta_horn"])["theta_horn"]
    priors = {
        name: {"prior": "log_uniform", "low": value / 3, "high": min(3 * value, 1.0)}
        if name == "limit_horn"
        else {"prior": "log_uniform", "low": value / 3, "high": 3 * value}
        for name, value in truth.items()
        if name in UNKNOWN
    }
    case = bd.case(
        t,
        {"theta_horn": bd.Channel(y + rng.normal(0.0, 2e-3, len(t)), "rad", sigma=2e-3)},
        {"goal_horn": bd.Input(goal, "rad")},
        {**truth, **priors},
        rig=rig,
        seed=int(rng.integers(1 << 30)),
    )
    posterior = case.job.problem.posterior
    found = posterior.space.vector(case.find_map(quick=True).values)
    sds = np.sqrt(np.diag(laplace.covariance(posterior, found)))
    right = posterior.space.vector({name: truth[name] for name in UNKNOWN})
    apart = posterior.coordinates.from_physical(np.array([found, right]))
    return np.asarray((apart[0] - apart[1]) / sds)


@pytest.mark.slow
def test_intervals_of_servos_hold_the_truth_at_their_rate() -> None:
    rng = np.random.default_rng(63)
    every = []
    for size, values in SIZES.items():
        truth = {**values, **LOOP, "k_e_horn": values["k_T_horn"]}
        rows = np.array([deviations(truth, rng) for _ in range(RECORDS)])
        print(size, (np.abs(rows) < DEVIATION).mean(axis=0), np.sqrt((rows**2).mean(axis=0)))
        every.append(rows)
    inside = (np.abs(np.concatenate(every)) < DEVIATION).mean()
    spread = math.sqrt(0.94 * 0.06 / (len(SIZES) * RECORDS))  # as if all of a record were one
    assert inside == pytest.approx(0.94, abs=2.5 * spread)
