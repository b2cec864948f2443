"""Whole posteriors of simulated records and their verdicts, as `bayesdrill posterior` finds them."""

import multiprocessing
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.verdict import Verdict, conclude
from bayesdrill.basics import seeds
from bayesdrill.config import job
from bayesdrill.config.job import Job
from bayesdrill.inference.residual_checks import like_noise, residual_summaries
from bayesdrill.report.doubts import residual_reasons
from bayesdrill.report.findings import finding_sentences
from bayesdrill.sampling.fit import fit
from bayesdrill.tasks import calibrate
from benchmarks.zoo import entries as e
from benchmarks.zoo import folder
from benchmarks.zoo.makers import Driven
from benchmarks.zoo.row import Entry, Row
from benchmarks.zoo.signals import RandomSteps

SIGMA = 0.1
VOLTAGE = RandomSteps(6.0, 0.4, seed=5)
TARGETS = {"n_tau": 50, "ess": 1000, "max_steps": 5000}


@dataclass(frozen=True)
class Trial:
    """Records of `clean (T, K)` with noise whose neighbours are correlated by `memory`."""

    job: Job
    clean: np.ndarray
    memory: float = 0.0

    def concluded(self, seed: int) -> tuple[Verdict, list[str]]:
        """The verdict on record `seed`, and why it must not be believed, if so."""
        noise = seeds.stream(seed, "record").standard_normal(self.clean.shape)
        shaped = lfilter([np.sqrt(1.0 - self.memory**2)], [1.0, -self.memory], noise, axis=0)
        posterior = self.job.problem.posterior.edit(records=[self.clean + SIGMA * shaped])
        own = replace(self.job, problem=replace(self.job.problem, posterior=posterior))
        plan = calibrate.study(own).plan
        found, sampled = fit(posterior, replace(plan, chains=replace(plan.chains, seed=seed)))
        scenery = SensitivityStudy(posterior.likelihood)
        left = residual_summaries(posterior.likelihood, posterior.space.vector(found.values))
        fits = like_noise(left)
        _, judged = conclude(
            own.problem, own.config.identify, own.config.seed, found, sampled, scenery, fits=fits
        )
        assert judged is not None
        reasons = finding_sentences(sampled.convergence.reasons)
        return judged.verdict, [*reasons, *residual_reasons(left)]


@dataclass(frozen=True)
class Outcome:
    """What a user reads: `disagrees` together with status 0, and whether the fit leaves only noise."""

    disagrees: bool
    fits: bool
    believed: bool


def outcome(trial: Trial, seed: int) -> Outcome:
    verdict, reasons = trial.concluded(seed)
    disagrees = not verdict.agrees and verdict.fits and not reasons
    return Outcome(disagrees, verdict.fits, not reasons)


def outcomes(trial: Trial, records: Iterable[int]) -> list[Outcome]:
    """Of many records, in two processes."""
    wanted = list(records)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, context, initializer=threadpool_limits, initargs=(1,)) as pool:
        return list(pool.map(outcome, [trial] * len(wanted), wanted, chunksize=5))


def row(parameters: Entry, *channels: str, name: str = "trial") -> Row:
    """301 samples of the paper's rig, nearly without dry friction, under random steps of 6 V."""
    config = e.experiment(
        e.reversing(),
        e.states(SIGMA, *channels),
        parameters,
        v=e.measured("v"),
        sampler={"walkers": 32},
        calibration=TARGETS,
    )
    return Row(
        name=name,
        shows=name,
        config=config,
        made=Driven(duration=6, rate=50, series={"v": VOLTAGE}),
    )


def built(tmp_path: Path, one: Row) -> Job:
    return job.prepare(folder.write(one, tmp_path)[0])


def truly(made: Job, **off: float) -> np.ndarray:
    """Signals `(T, K)` of the rig of a job at its nominal values, but for those that are `off`."""
    posterior = made.problem.posterior
    values = {**made.problem.nominal, **off}
    return posterior.likelihood.signals(posterior.space.vector(values)[None])[0]
