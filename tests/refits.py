"""Whole posteriors of simulated records, as `bayesdrill posterior` finds them, without the files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayesdrill import job, loading, mode, pipeline, sampling, seeds, simulation
from bayesdrill.config import Config
from bayesdrill.crew import Crew
from bayesdrill.identifiability.scenes import Scenery
from bayesdrill.identifiability.study import Study, Thresholds, study_of
from bayesdrill.job import Job
from bayesdrill.posterior import Posterior
from bayesdrill.progress import Silent
from bayesdrill.shelf import Memory
from bayesdrill.verdict import PRIOR_DRAWS, Verdict, judge

CONFIG = Path(__file__).parents[1] / "configs" / "nominal_step.yaml"


def simulated(
    folder: Path, held: tuple[str, ...], truth: Mapping[str, float] | None = None, seed: int = 11
) -> Job:
    """The bundled config with parameters `held`, and a record of a rig whose values are `truth`."""
    config, source = loading.load(CONFIG)
    entries = config.model_dump(exclude_unset=True, exclude_none=True)
    for name in held:
        entries["parameters"][name] = "nominal"
    entries["simulation"] = {**entries.get("simulation", {}), **(truth or {})}
    changed = Config.model_validate(entries)
    record = folder / "record.csv"
    record.write_text(simulation.simulate(changed, source, seed))
    entries["record"]["file"] = str(record)
    return job.assemble(Config.model_validate(entries), source)


@dataclass(frozen=True)
class Judge:
    """What is the same for all records of one job."""

    job: Job
    study: Study
    prior_draws: np.ndarray

    def verdict(self, posterior: Posterior, seed: int) -> tuple[Verdict, bool]:
        """The verdict on a posterior, and whether its ensembles converged."""
        plan = replace(pipeline.plan(self.job.config), seed=seed)
        space = posterior.space
        optimiser, evaluations = mode.roughly(len(space.free), 8000)
        search = mode.search(posterior, optimiser, evaluations, space.vector(space.start))
        scouted = mode.scouts(posterior, space.draw(mode.SCOUTS, seeds.stream(seed, "scout")))
        found = mode.summarise(posterior, (search,), scouted)
        tops = mode.tops(posterior, found)
        with Crew(posterior, 1) as crew:
            sampled = sampling.sample(crew, posterior, tops, plan, Memory(), Silent())
        draws = sampled.draws.reshape(-1, len(space.free))
        nominal = self.job.problem.nominal
        verdict = judge(self.study, draws, self.prior_draws, nominal, {}, (), Thresholds())
        return verdict, sampled.convergence.converged


def make_judge(built: Job) -> Judge:
    posterior = built.problem.posterior
    start = posterior.space.vector(posterior.space.start)
    study = study_of(Scenery(posterior.likelihood), posterior, start, built.config)
    return Judge(built, study, posterior.space.draw(PRIOR_DRAWS, seeds.stream(1, "prior")))


def false_alarm(made: Judge, seed: int) -> tuple[bool, bool]:
    """Of one nominal record: whether anything disagrees with the table, and convergence."""
    posterior = made.job.problem.posterior
    likelihood = posterior.likelihood
    nominal = posterior.space.vector(made.job.problem.nominal)
    clean = likelihood.signals(nominal[None])
    y = likelihood.noise.draw(clean, np.empty((1, 0)), seeds.stream(seed, "record"))[0]
    fresh = replace(likelihood, response=likelihood.response.with_record(y))
    verdict, converged = made.verdict(replace(posterior, likelihood=fresh), seed)
    return not verdict.agrees, converged
