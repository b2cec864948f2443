"""The studies of the paper, one after the other, each beside what a full posterior says of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from bayesdrill import build, job, pipeline, provenance
from bayesdrill.crew import Crew
from bayesdrill.errors import InputError, Interrupted
from bayesdrill.identifiability.scenes import Scenery
from bayesdrill.identifiability.study import study_of
from bayesdrill.job import Job
from bayesdrill.optimisers.contract import Optimiser
from bayesdrill.progress import Reporter, Silent
from bayesdrill.report import paper_report, paper_tables
from bayesdrill.reproduction import (
    bounds,
    causes,
    forward,
    heuristic,
    misfit,
    printed,
    shaft,
    simultaneous,
)
from bayesdrill.reproduction.control import Control, control
from bayesdrill.reproduction.findings import Findings, Misfits, Nine
from bayesdrill.reproduction.truths import truth_of
from bayesdrill.reproduction.verification import Verification, verify
from bayesdrill.store import RUN, Folder

Array = NDArray[np.float64]

TWO = "two_parameters.yaml"
NINES = ("estimates.yaml", "measured.yaml")
MAKERS = ("estimates.yaml", "missing_physics.yaml")  # make records, whose truth is known
RECORDS = 400  # of each sigma in the verification study
STARTS = 40  # of the simultaneous searches, each way
OTHERS = 24  # further starts of the heuristic ...
EVALUATIONS = 50_000  # ... which may spend so many
CONTROLS = 12  # records of the rig that is as the table says
LENGTHS = ((1.0, 1000.0), (10.0, 100.0), (10.0, 1000.0), (100.0, 100.0), (100.0, 1000.0))
TONES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    folder: Path
    converged: bool
    text: str


def reproduce(
    configs: Path, output: Path, processes: int, report: Reporter, *, force: bool
) -> Outcome:
    """Everything, from the configs of a folder; the tables do not depend on `processes`."""
    jobs = {name: job.prepare(configs / name) for name in (TWO, *NINES)}
    _refuse_unknown_noise(jobs)
    if (output / RUN).exists() and not force:
        message = "results exist already; make them anew with --force, or give another --output"
        raise InputError.one(str(output), message)
    with Folder(output, "force" if force else "fresh", {}, own=paper_report.OWN) as folder:
        folder.write_run(status="running", versions=provenance.versions())
        try:
            findings = _studies(jobs, configs, folder, processes, _Clock(report))
        except (KeyboardInterrupt, Interrupted):
            folder.write_run(status="interrupted")
            raise Interrupted(
                f"stopped; {output} is not complete; start over with --force"
            ) from None
        except BrokenProcessPool:
            folder.write_run(status="interrupted")
            message = "a worker process was killed (out of memory?); start over with --force"
            raise InputError.one(str(output), message) from None
    return Outcome(
        folder=output, converged=findings.converged, text=paper_tables.in_words(findings)
    )


def _studies(
    jobs: Mapping[str, Job], configs: Path, folder: Folder, processes: int, clock: _Clock
) -> Findings:
    two = jobs[TWO]
    readings, errors = _forward(two)
    verification, lengths = _verification(two, processes)
    clock.done(f"two parameters: {RECORDS} records at each of {len(verification.sigmas)} sigmas")
    nines = [_nine(jobs[name], configs, folder.path, processes, clock) for name in NINES]
    ends, symmetries = _simultaneous(jobs[NINES[0]], nines[0], processes)
    clock.done(f"all at once: {len(ends)} searches")
    nominal = two.problem.nominal
    findings = Findings(
        readings=readings,
        errors=errors,
        verification=verification,
        lengths=lengths,
        searched=nines[0].name,
        symmetries=symmetries,
        ends=ends,
        control=_control(jobs[NINES[0]], processes),
        nines=tuple(nines),
        tones=shaft.tones(nominal["j_1"], nominal["j_m"] / causes.I_M**2, TONES),
    )
    with Crew(two.problem.posterior, processes) as crew:
        paper_report.write(findings, folder, crew)
    clock.done("tables and figures")
    folder.write_run(status="finished", converged=findings.converged, seconds=clock.seconds)
    return findings


def _refuse_unknown_noise(jobs: Mapping[str, Job]) -> None:
    message = "the paper's misfit needs known noise; give each sigma as a number"
    found = [
        own.source.problem(("record", "channels"), message)
        for own in jobs.values()
        if own.problem.posterior.likelihood.noise.unknown
    ]
    if found:
        raise InputError(found)


class _Clock:
    """Says what was done, and how long it took."""

    def __init__(self, report: Reporter) -> None:
        self._report = report
        self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def done(self, what: str) -> None:
        now = time.perf_counter()
        self.seconds[what] = round(now - self._last, 1)
        self._report.say(f"{what}: {self.seconds[what]:.0f} s")
        self._last = now


def _forward(two: Job) -> tuple[Any, Any]:
    experiment = two.problem.experiment
    return (
        forward.readings(experiment, two.problem.nominal),
        forward.errors(experiment, two.problem.nominal),
    )


def _verification(two: Job, processes: int) -> tuple[Verification, tuple[bounds.Length, ...]]:
    posterior = two.problem.posterior
    truth = posterior.space.vector(two.problem.nominal)
    sigmas = tuple(printed.TWO_PARAMETERS)
    with Crew(posterior, processes) as crew:
        found = verify(crew, posterior, truth, sigmas, RECORDS, pipeline.plan(two.config))
    return found, bounds.lengths(posterior.likelihood, truth, LENGTHS)


def _control(nine: Job, processes: int) -> tuple[Control, ...]:
    posterior = nine.problem.posterior
    with Crew(posterior, processes) as crew:
        return control(crew, posterior, _pairwise(nine), EVALUATIONS, CONTROLS, nine.config.seed)


def _pairwise(nine: Job) -> Optimiser:
    own = nine.config.map.model_copy(update={"method": "pairwise"})
    repeated = nine.config.model_copy(update={"map": own})
    return build.optimiser(repeated, nine.problem.names)


def _nine(nine: Job, configs: Path, folder: Path, processes: int, clock: _Clock) -> Nine:
    """Heuristic and posterior of one record; the posterior has a results folder of its own."""
    name, posterior = nine.config.name, nine.problem.posterior
    with Crew(posterior, processes) as crew:
        found = heuristic.run(
            crew, posterior, _pairwise(nine), EVALUATIONS, OTHERS, nine.config.seed
        )
    clock.done(f"{name}: the heuristic from {OTHERS + 1} starts")
    whole = pipeline.posterior(nine, folder / name, "force", processes, Silent())
    state = "converged" if whole.sampled.convergence.converged else "NOT converged"
    clock.done(f"{name}: the posterior, {state}")
    draws = whole.sampled.draws.reshape(-1, len(found.estimate))
    values = truth_of(nine.config, nine.source, [configs / maker for maker in MAKERS])
    truth = None if values is None else posterior.space.vector(values)
    assert whole.verdict is not None  # the nine have nominal values
    return Nine(
        name=name,
        names=nine.problem.names,
        experiment=nine.problem.experiment,
        heuristic=found,
        signals=posterior.likelihood.signals(found.estimate[None])[0],
        truth=truth,
        draws=draws,
        verdict=whole.verdict,
        misfits=_misfits(nine, found.guess, found.estimate, whole.mode.values, truth),
        causes=causes.causes(nine.problem.names, found.guess, found.estimate, draws),
        converged=whole.sampled.convergence.converged,
    )


def _misfits(
    nine: Job, guess: Array, estimate: Array, mode: Mapping[str, float], truth: Array | None
) -> Misfits:
    posterior = nine.problem.posterior
    noise = posterior.likelihood.noise
    numbers = noise.n_samples * noise.n_channels
    low, high = chi2.ppf((0.025, 0.975), numbers) / numbers
    return Misfits(
        record=nine.config.name,
        numbers=numbers,
        guess=misfit.per_number(posterior, guess),
        heuristic=misfit.per_number(posterior, estimate),
        map=misfit.per_number(posterior, posterior.space.vector(mode)),
        truth=None if truth is None else misfit.per_number(posterior, truth),
        low=float(low),
        high=float(high),
    )


def _simultaneous(
    nine: Job, found: Nine, processes: int
) -> tuple[tuple[simultaneous.End, ...], tuple[str, ...]]:
    """Distances are from the truth, or else from the median of the posterior."""
    posterior = nine.problem.posterior
    centre = posterior.space.vector(posterior.space.start)
    structure = study_of(Scenery(posterior.likelihood), posterior, centre, nine.config).structure
    reference = np.median(found.draws, axis=0) if found.truth is None else found.truth
    with Crew(posterior, processes) as crew:
        ends = simultaneous.many(
            crew, posterior, reference, structure.symmetries, STARTS, nine.config.seed
        )
    words = tuple(
        ", ".join(name for name, e in zip(found.names, exponents, strict=False) if e)
        for exponents in structure.symmetries
    )
    return ends, words
