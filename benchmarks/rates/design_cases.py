"""Cases in which designed experiments are measured: the bundled rig and a servo, with changes."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

import bayesdrill as bd

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
SAMPLER = {"ensembles": 4, "walkers": 64, "r_hat": 1.03, "n_tau": 20, "ess": 1000}
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
SIGMA = {"prior": "log_uniform", "low": 0.01, "high": 1.0}
FORWARD: Mapping[str, Any] = MappingProxyType({"high": 12.0, "limits": "w_2=0:"})
BOTH_WAYS: Mapping[str, Any] = MappingProxyType({"low": -12.0, "high": 12.0, "hold": 0.5})
LIMITED: Mapping[str, Any] = MappingProxyType(
    {"low": -10.0, "high": 10.0, "hold": 0.05, "limits": ("i=-1:1", "theta_1=-2:2")}
)
SERVO = {  # of the notebook about a closed loop, SI
    "j_m": 4.5e-6, "c_m": 2e-5, "k_e": 0.02, "k_T": 0.02, "r_m": 1.8, "l_m": 0.6e-3,
    "k_s": 0.90, "j_1": 2.4e-3,
}  # fmt: skip


def servo() -> bd.Case:
    """Return a servo with a soft spring, whose record is a square wave of 2 V."""
    t = np.arange(1001) * 0.002
    v = np.where(t % 1.0 < 0.5, 2.0, -2.0)
    rig = bd.MotorShaft(i_m=1 / 14)
    exact = bd.respond(
        rig, {**SERVO, "t_f": 0.0}, t, inputs={"v": v}, signals=["theta_1", "theta_2"]
    )
    rng = np.random.default_rng(5)
    noise, degree = 0.1, np.pi / 180
    channels = {
        name: bd.Channel(y / degree + noise * rng.standard_normal(len(t)), "deg", sigma=noise)
        for name, y in exact.items()
    }
    parameters = dict.fromkeys(("k_s", "j_1", "j_m", "c_m", "k_e"), BOX)
    held = {"k_T": SERVO["k_T"], "r_m": SERVO["r_m"], "l_m": SERVO["l_m"], "t_f": 0.0}
    return bd.case(
        t, channels=channels, inputs={"v": bd.Input(v, "V", hold="zero")},
        parameters=parameters | held, rig=rig, nominal=SERVO, sampler=SAMPLER,
    )  # fmt: skip


def changed(case: str) -> bd.Case:
    """Return the bundled case with another noise, fewer channels, or friction; or the servo."""
    if case == "servo":
        return servo()
    job = bd.load(CONFIG).job
    data = copy.deepcopy(dict(job.source.data))
    channels = data["record"]["channels"]
    data["sampler"] = SAMPLER
    if case == "bundled":
        return bd.Case(job.with_data(data))
    data["parameters"] = data["parameters"] | {"c_m": "nominal"}
    if case == "unknown noise":
        channels.update({name: spec | {"sigma": SIGMA} for name, spec in channels.items()})
    if case == "AR(1)":
        channels.update({name: spec | {"noise": "ar1"} for name, spec in channels.items()})
    if case == "two channels":
        data["record"]["channels"] = {name: channels[name] for name in ("theta_1", "w_2")}
    if case == "friction":
        friction = {"t_cm": {"prior": "log_uniform", "low": 0.01, "high": 0.2}, "c_m": BOX}
        held = dict.fromkeys(data["parameters"], "nominal") | {"t_f": 1e-6, "k_s": BOX}
        data["parameters"] = held | friction
    return bd.Case(job.with_data(data))
