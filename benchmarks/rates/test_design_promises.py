"""What designs promise against repeated fits of simulated records of their waveforms.

The damping c_m is held in rigs without dry friction, as no such record determines it: what depends on
it then follows the form of its prior, and the promise takes that for Gaussian.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.case_tables import run_cases

import bayesdrill as bd
from bayesdrill.design.responses import ComingExperiment
from bayesdrill.design.targets import parse_targets
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.gauss_newton import gauss_newton

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
FITS = 50
STEPS = 30
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
SIGMA = {"prior": "log_uniform", "low": 0.01, "high": 1.0}
FORWARD: Mapping[str, Any] = {"high": 12.0, "limits": "w_2=0:"}
BOTH_WAYS: Mapping[str, Any] = {"low": -12.0, "high": 12.0, "hold": 0.5, "learn": ("t_cm", "c_m")}


def changed(case: str) -> bd.Case:
    """Return the bundled case with another noise, fewer channels, or dry friction."""
    job = bd.load(CONFIG).job
    data = copy.deepcopy(dict(job.source.data))
    channels = data["record"]["channels"]
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


def achieved(case: bd.Case, numbers: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return for each determined target the mean and sd of its log over fits, over the promise."""
    design = case.design(draws=1, **numbers).design
    problem, request = case.job.problem, design.request
    known = [target for target in design.targets if target.designed < 0.2 * target.now]
    coming = ComingExperiment.like(problem.observations[0], request.source, ())
    posterior = coming.posterior(design.levels)
    space, rng = posterior.space, np.random.default_rng(5)
    truth = space.vector(space.start)[None]
    formulas = [x.formula for x in parse_targets(problem, [x.name for x in known], truth)]
    (observation,) = posterior.likelihood.observations
    signals = observation.signals(space.full(truth))
    logs = np.empty((FITS, len(formulas)))
    for k in range(FITS):
        record = observation.draw(signals, truth, rng)[0]
        surface = LogDensity(posterior.edit(records=[record]), physical=True)
        best = gauss_newton(surface, posterior.coordinates.from_physical(truth), STEPS).u
        ratio = space.named(posterior.coordinates.to_physical(best)), space.named(truth)
        logs[k] = [
            float(np.squeeze(np.log(f.value(ratio[0]) / f.value(ratio[1])))) for f in formulas
        ]
    scaled = logs / np.array([target.designed for target in known])
    means, sds = scaled.mean(axis=0), scaled.std(axis=0)
    names = [target.name for target in known]
    return {n: (float(m), float(s)) for n, m, s in zip(names, means, sds, strict=True)}


@pytest.mark.slow
@run_cases(
    "name, numbers",
    [
        ("white noise", FORWARD),
        ("unknown noise", FORWARD),
        ("AR(1)", FORWARD),
        ("two channels", FORWARD),
        ("friction", BOTH_WAYS),
    ],
)
def test_repeated_fits_have_the_promised_spread(name: str, numbers: Mapping[str, Any]) -> None:
    """With 50 fits, sds of fits are within a third of their value, and their mean within 10 %."""
    results = achieved(changed(name), numbers)
    print(name, {k: f"mean {m:+.2f}, sd {s:.2f}" for k, (m, s) in results.items()})
    means, sds = np.array([*results.values()]).T
    assert np.abs(means).max() < 4.0 / np.sqrt(FITS)
    assert np.abs(sds - 1.0).max() < 0.34
    assert abs(sds.mean() - 1.0) < 0.15
