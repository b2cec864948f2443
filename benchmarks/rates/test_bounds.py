"""Cramer-Rao bounds against what they promise: posterior spreads and repeated fits."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.small_problems import replace_only

from bayesdrill.analysis.identifiability import information
from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.profile import Fitter
from bayesdrill.basics import seeds
from bayesdrill.basics.progress import Silent
from bayesdrill.config import loading
from bayesdrill.config.job import Job, assemble
from bayesdrill.sampling import ensembles
from bayesdrill.sampling.ensembles import MemoryBackend
from bayesdrill.sampling.workers import WorkerPool
from bayesdrill.tasks import conclusions

CONFIG = Path(__file__).parents[2] / "configs" / "nominal_step.yaml"
SIGMA = 1e-3
TWO = ("c_m", "k_e")
FITS = 500


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """The paper's verification study: two unknowns, noise of 0.001 on every channel."""
    source = loading.load(CONFIG).source
    entries = copy.deepcopy(source.data)
    for name in entries["parameters"]:
        if name not in TWO:
            entries["parameters"][name] = "nominal"
    for channel in entries["record"]["channels"].values():
        channel["sigma"] = SIGMA
    from bayesdrill.config.records import simulation

    changed = loading.validate(replace(source, data=entries))
    record = tmp_path_factory.mktemp("record") / "record.csv"
    record.write_text(simulation.simulate(changed, 11))
    entries["record"]["file"] = str(record)
    return assemble(loading.validate(replace(source, data=entries)))


def bounds_at_nominal(job: Job) -> np.ndarray:
    posterior = job.problem.posterior
    nominal = posterior.space.vector(job.problem.nominal)
    scenery = SensitivityStudy(posterior.likelihood)
    rows = scenery.sensitivities(nominal)
    return information.from_sensitivities(TWO, rows).bounds()


@pytest.mark.slow
def test_bounds_are_the_spread_of_the_posterior(job: Job) -> None:
    posterior = job.problem.posterior
    start = posterior.space.vector(job.problem.nominal)
    with WorkerPool(posterior, 1) as pool:
        plan = conclusions.plan(job.config)
        sampled = ensembles.sample(pool, start[None], plan, MemoryBackend(), Silent())
    assert sampled.convergence.converged
    spread = np.log(sampled.draws.reshape(-1, len(TWO))).std(axis=0)
    assert np.allclose(spread, bounds_at_nominal(job), rtol=0.1)


@pytest.mark.slow
def test_bounds_are_the_spread_of_repeated_fits(job: Job) -> None:
    """500 maximum-likelihood fits of fresh records; their own error of a spread is 3 %."""
    posterior = job.problem.posterior
    nominal = posterior.space.vector(job.problem.nominal)
    likelihood = posterior.likelihood
    clean = likelihood.signals(nominal[None])
    rng = seeds.stream(12, "record")
    scenery = SensitivityStudy(likelihood)
    fits = []
    for _ in range(FITS):
        y = likelihood.only_observation.noise.draw(clean, np.empty((1, 0)), rng)[0]
        fresh = replace_only(
            likelihood, response=likelihood.only_observation.response.with_record(y)
        )
        fits.append(Fitter(replace(posterior, likelihood=fresh), scenery, nominal).best.logs)
    logs = np.array(fits)
    bounds = bounds_at_nominal(job)
    assert np.allclose(logs.std(axis=0), bounds, rtol=0.1)
    # No bias either, to the error of a mean of 500.
    assert np.all(np.abs(logs.mean(axis=0) - np.log(nominal)) < 4 * bounds / np.sqrt(FITS))
