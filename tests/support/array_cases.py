"""Cases of arrays, for tests of the API."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from support.command_line import ROOT
from support.scipy_oracles import NOMINAL

import bayesdrill as bd
from bayesdrill.rig.models.motor_shaft import MotorShaft

CONFIG = ROOT / "configs" / "nominal_step.yaml"
CAMPAIGN = ROOT / "configs" / "campaign" / "shaft.yaml"
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
FAST = {"ensembles": 4, "walkers": 16, "r_hat": 1.1, "n_tau": 5, "ess": 100}
T = np.linspace(0.0, 6.0, 241)
SHAFT = {**NOMINAL, "k_s": 0.31}


def noisy(name: str, scale: float, sigma: float) -> bd.Channel:
    """Of a rig with a stiffer shaft, in units that are `scale` of SI."""
    exact = bd.respond(MotorShaft(), SHAFT, T, {"v": 5.0}, [name])[name]
    noise = np.random.default_rng(len(name)).standard_normal(len(T))
    return bd.Channel(
        (exact + sigma * noise) / scale, "deg" if scale < 1 else "rad/s", sigma / scale
    )


def two(**entries: Any) -> bd.Case:
    """Of two channels and two unknowns; `entries` in the place of what it has."""
    usual: dict[str, Any] = {
        "t": T,
        "channels": {"theta_2": noisy("theta_2", np.pi / 180, 0.05), "w_1": noisy("w_1", 1.0, 0.1)},
        "inputs": {"v": 5.0},
        "parameters": dict.fromkeys(NOMINAL, "nominal") | {"k_s": BOX, "t_f": BOX},
        "rig": bd.MotorShaft(i_m=1 / 8),
        "nominal": "tables_2_3",
        "seed": 4,
        "sampler": FAST,
        "output": {"figures": ["corner"]},
    }
    return bd.case(**usual | entries)


def late_angle() -> bd.Channel:
    """Return the angle of `two` as it is known with a lag, an unknown offset and AR(1) noise."""
    offset = {"prior": "normal", "mean": 0.0, "sd": 5.0}
    angle = two().columns["theta_2"]
    return bd.Channel(angle, "deg", 3.0, noise="ar1", offset=offset, lag=0.013)


@cache
def run() -> bd.Run:
    return two().sample()


@cache
def results() -> dict[str, Any]:
    """Return one of each kind of result that the API hands out, by its public name."""
    judged, again = run().judge(), dataclasses.replace(run())
    return {
        "Case": two(),
        "Best": bd.Best(run().job, run().mode, run().columns),
        "Run": run(),
        "RunReport": judged,
        "Findings": two().identify(),
        "Verdict": judged.verdict,
        "Overlay": bd.overlay([run(), run()]),
        "Comparison": bd.compare([run(), again]),
        "Ladder": bd.ladder(CONFIG),
        "Calibration": bd.calibration(CONFIG),
        "Campaign": bd.campaign(CAMPAIGN),
    }
