"""Models of one record that are only said to be: for what is made of their evidence."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

from pictures import posterior

import bayesdrill as bd
from bayesdrill.engines.evidence import Evidence
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left, limits
from bayesdrill.insight.comparison import Contender
from bayesdrill.insight.overlay import Layer
from bayesdrill.insight.vagueness import Vague

CONFIG = Path(__file__).parents[1] / "configs" / "nominal_step.yaml"
CHANNELS = ("theta_1", "theta_2", "w_1", "w_2")


@cache
def problem() -> Problem:
    return bd.load(CONFIG).job.problem


def left(rms: float = 1.0, correlation: float = 0.0) -> tuple[Left, ...]:
    return tuple(
        Left(
            channel=name,
            rms=rms * (1.0 + 0.01 * k),
            share=0.01,
            correlation=correlation * (1.0 - 0.1 * k),
            farthest=3.0,
            time=1.0,
            limits=limits(1001, 4, 9),
        )
        for k, name in enumerate(CHANNELS)
    )


def model(
    name: str,
    log_z: float,
    rig: str = "rig",
    noise: str = "white",
    *,
    error: float = 0.01,
    rms: float = 1.0,
    correlation: float = 0.0,
    vague: str = "",
    prior: str = "the same",
    unknowns: int = 3,
    moved: float = 0.0,
) -> Contender:
    x = posterior(1500)[:, :unknowns]
    layer = Layer(
        name=name,
        mark=name,
        problem=dataclasses.replace(problem(), symbols=problem().symbols[:unknowns]),
        draws=x + moved * x.std(axis=0),
        settings={"the model": rig, "the noise": noise},
    )
    return Contender(
        layer=layer,
        converged=name != "stopped",
        evidence=Evidence(log_z=log_z, error=error, overlap=0.7),
        left=left(rms, correlation),
        vague=(Vague(name=vague, decades=4.0),) if vague else (),
        rig={"the model": rig},
        noise={"w_1": noise},
        beliefs={vague: prior} if vague else {},
        held_out=None,
        loo="no samples",
    )
