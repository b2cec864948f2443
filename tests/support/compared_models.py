"""Models of one record that are only said to be: for what is made of their evidence."""

import dataclasses
from functools import cache
from pathlib import Path

from support.figure_checks import posterior

import bayesdrill as bd
from bayesdrill.analysis.comparison import PosteriorSummary, RunSummary
from bayesdrill.analysis.plausibility import DiffusePrior
from bayesdrill.inference.posterior import Posterior, Problem
from bayesdrill.inference.residual_checks import ResidualSummary, limits
from bayesdrill.sampling.evidence import Evidence

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
CHANNELS = ("theta_1", "theta_2", "w_1", "w_2")


@cache
def problem() -> Problem:
    return bd.load(CONFIG).job.problem


def of_experiments(posterior: Posterior, names: tuple[str, ...]) -> Posterior:
    """The same record under each of these names."""
    (one,) = posterior.likelihood.observations
    several = tuple(dataclasses.replace(one, label=name) for name in names)
    likelihood = dataclasses.replace(posterior.likelihood, observations=several)
    return dataclasses.replace(posterior, likelihood=likelihood)


def left(
    rms: float = 1.0, correlation: float = 0.0, experiments: tuple[str, ...] = ("",)
) -> tuple[ResidualSummary, ...]:
    return tuple(
        ResidualSummary(
            channel=name,
            experiment=experiment,
            rms=rms * (1.0 + 0.01 * k),
            share=0.01,
            correlation=correlation * (1.0 - 0.1 * k),
            farthest=3.0,
            time=1.0,
            limits=limits(1001, 4, 9),
        )
        for experiment in experiments
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
    experiments: tuple[str, ...] = ("",),
) -> RunSummary:
    x = posterior(1500)[:, :unknowns]
    layer = PosteriorSummary(
        name=name,
        mark=name,
        problem=dataclasses.replace(
            problem(),
            symbols=problem().symbols[:unknowns],
            posterior=of_experiments(problem().posterior, experiments),
        ),
        draws=x + moved * x.std(axis=0),
        settings={"the model": rig, "the noise": noise},
    )
    return RunSummary(
        layer=layer,
        converged=name != "stopped",
        evidence=Evidence(log_z=log_z, error=error, overlap=0.7),
        residuals=left(rms, correlation, experiments),
        vague=(DiffusePrior(name=vague, decades=4.0),) if vague else (),
        rig={"the model": rig},
        noise={"w_1": noise},
        beliefs={vague: prior} if vague else {},
        held_out=None,
        loo="no samples",
    )
