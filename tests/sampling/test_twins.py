"""Twins of a maximum: branches of a train that no channel tells apart are exchanged."""

from __future__ import annotations

import numpy as np
import pytest

import bayesdrill as bd
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.multiple_modes import twin_starts

T = 0.01 * np.arange(400)
TORQUE = 0.5 * np.sign(np.sin(3.0 * T)) + 0.3 * np.sin(11.0 * T)
TRUTH = {"j_hub": 0.01, "j_left": 0.005, "j_right": 0.002, "k_a": 1.0, "k_b": 2.0, "c_hub": 0.02}
HELD = {"c_a": 0.0035, "c_b": 0.0035}


def about(value: float) -> dict[str, object]:
    return {"prior": "log_uniform", "low": value / 10, "high": value * 10}


def case(seen: str = "w_hub", **priors: object) -> bd.Case:
    """Two discs on shafts at a hub that a torque turns; `seen`: what is measured."""
    rig = bd.Train(
        inertias=("hub", "left", "right"),
        shafts={"a": ["hub", "left"], "b": ["hub", "right"]},
        drives={"hub": "torque"},
        added=("c_a", "c_b", "c_hub"),
    )
    y = bd.respond(rig, TRUTH | HELD, T, {"t_hub": TORQUE}, [seen])[seen]
    noisy = y + 0.05 * np.random.default_rng(1).standard_normal(len(T))
    free = {"j_left": about(3e-3), "j_right": about(3e-3), "k_a": about(1.4), "k_b": about(1.4)}
    return bd.case(
        T,
        {seen: bd.Channel(noisy, "rad/s", 0.05)},
        {"t_hub": bd.Input(TORQUE, "N*m")},
        TRUTH | HELD | free | priors,
        rig=rig,
        map={"starts": 1},
        sampler={"ess": 400},
    )


def twins(of: bd.Case) -> list[dict[str, float]]:
    """Of the true values."""
    posterior = of.job.problem.posterior
    surface = LogDensity(posterior, physical=True)
    theta = posterior.space.vector({name: TRUTH[name] for name in posterior.space.free})
    u = posterior.coordinates.from_physical(theta[None])[0]
    found = [start.u[0] for start in twin_starts(surface, u)]
    physical = [posterior.coordinates.to_physical(each[None])[0] for each in found]
    return [dict(zip(posterior.space.free, map(float, each), strict=True)) for each in physical]


def test_two_branches_that_nothing_tells_apart_are_exchanged() -> None:
    """Mutants killed: one part of a branch alone; a twin that is lower."""
    (twin,) = twins(case())
    expected = {"j_left": 0.002, "j_right": 0.005, "k_a": 2.0, "k_b": 1.0}
    assert twin == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("told", ["a channel", "a prior", "a number"])
def test_what_is_told_apart_has_no_twin(told: str) -> None:
    cases = {
        "a channel": lambda: case("w_left"),
        "a prior": lambda: case(k_a={"prior": "log_normal", "median": 1.0, "sd_log": 0.5}),
        "a number": lambda: case(j_left=0.005),
    }
    assert twins(cases[told]()) == []


def test_each_of_two_twins_holds_half_of_the_posterior() -> None:
    run = case().sample(seed=1)
    shares = run.sampled.mode_shares
    assert shares is not None
    assert np.asarray(shares) == pytest.approx([0.5, 0.5], abs=0.02)
