"""Run the studies of the paper, one after the other, each beside a full posterior."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis import SensitivityStudy, study_of
from bayesdrill.basics import Array, Interrupted, Reporter, Silent, software
from bayesdrill.config import Job, ResolvedCase
from bayesdrill.inference import residual_checks
from bayesdrill.report import every_fit
from bayesdrill.results import Folder
from bayesdrill.rig import MotorShaft
from bayesdrill.sampling import WorkerPool
from bayesdrill.tasks import conclusions, pipeline
from studies.paper import forward, precision, printed, reproduction
from studies.paper.findings import NineParameterStudy, PaperFindings, Studies, prepare
from studies.paper.optimisers import Pairwise
from studies.paper.precision import truth_of
from studies.paper.printed import Row
from studies.paper.searches import (
    Heuristic,
    MisfitSearch,
    control,
    many_searches,
    run_heuristic,
    verify,
)

RECORDS = 400  # of each sigma in the verification study
STARTS = 40  # of the simultaneous searches, each way
OTHERS = 24  # further starts of the heuristic
PAIRWISE = MisfitSearch(Pairwise(), 50_000)  # evaluations at most
CONTROLS = 12  # records of the rig that is as the table says, at each of ...
SIGMAS = (0.01, 0.1, 1.0)
LENGTHS = ((1.0, 1000.0), (10.0, 100.0), (10.0, 1000.0), (100.0, 100.0), (100.0, 1000.0))
TONES = 4


def reproduce(
    configs: Path, output: Path, processes: int, report: Reporter, *, force: bool
) -> PaperFindings:
    """Reproduce everything from the configs of a folder; tables do not depend on `processes`."""
    studies = prepare(configs)
    names = [nine.config.name for nine in studies.nines]
    for name in names:
        Folder(output / name, "force", {}, output_files.POSTERIOR).check()  # not after minutes
    kind = reproduction.files_of(names)
    with Folder(output, "force" if force else "fresh", {}, kind) as folder:
        folder.begin(status="running", versions=software.installed_versions())
        report.say("two parameters, nine of two records: two to five minutes with two processes")
        try:
            return _run(studies, folder, processes, _Clock(report))
        except (KeyboardInterrupt, Interrupted):
            folder.write_run(status="interrupted")
            message = f"stopped; {output} is not complete; start over with --force"
            raise Interrupted(message) from None
        except BaseException:
            with suppress(OSError):  # a full disk
                folder.write_run(status="interrupted")
            raise


def _run(studies: Studies, folder: Folder, processes: int, clock: _Clock) -> PaperFindings:
    two, nominal = studies.two.problem, studies.two.problem.nominal
    likelihood, experiment = two.posterior.likelihood, two.experiment
    truth, plan = two.posterior.space.vector(nominal), conclusions.plan(studies.two.config)
    sigmas = tuple(printed.TWO_PARAMETERS)
    with WorkerPool(two.posterior, processes) as pool:
        verification = verify(pool, two.posterior, truth, sigmas, RECORDS, plan)
    lengths = tuple(precision.lengths(likelihood, nominal, LENGTHS))
    clock.done(f"two parameters: {RECORDS} records at each of {len(sigmas)} sigmas")
    nines = tuple(
        _nine(nine, studies.makers, folder.path, processes, clock) for nine in studies.nines
    )
    first = studies.nines[0]
    posterior, seed = first.problem.posterior, first.config.seed
    start = posterior.space.vector(posterior.space.start)
    study = study_of(
        SensitivityStudy(posterior.likelihood),
        posterior,
        start,
        first.config.identify,
        first.config.seed,
    )
    symmetries, centre = study.structure.symmetries, nines[0].truth
    if centre is None:  # of the distances of ends
        centre = np.median(nines[0].draws, axis=0)
    with WorkerPool(posterior, processes) as pool:
        ends = many_searches(pool, posterior, centre, symmetries, STARTS, seed)
        clock.done(f"all at once: {len(ends)} searches")
        controls = control(pool, posterior, PAIRWISE, SIGMAS, CONTROLS, seed)
    clock.done(f"the heuristic on {CONTROLS} nominal records at each of {len(SIGMAS)} sigmas")
    j_2 = nominal["j_m"] / MotorShaft().i_m ** 2
    findings = PaperFindings(
        readings=forward.readings(experiment, nominal),
        errors=forward.errors(experiment, nominal),
        verification=verification,
        lengths=lengths,
        implied=precision.implied_noise(precision.at_sigma_1(likelihood, nominal)),
        searched=nines[0].name,
        symmetries=tuple(
            tuple(name for name, e in zip(nines[0].names, exponents, strict=False) if e)
            for exponents in symmetries
        ),
        ends=ends,
        control=controls,
        nines=nines,
        tones=printed.natural_frequencies(nominal["j_1"], j_2, TONES),
    )
    with WorkerPool(two.posterior, processes) as pool:
        reproduction.write(findings, folder, pool)
    clock.done("tables and figures")
    folder.write_run(status="finished", converged=findings.converged, seconds=clock.seconds)
    return findings


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


def _nine(
    nine: Job,
    makers: Sequence[ResolvedCase],
    folder: Path,
    processes: int,
    clock: _Clock,
) -> NineParameterStudy:
    """Heuristic and posterior of one record; the posterior has a results folder of its own."""
    name, posterior = nine.config.name, nine.problem.posterior
    with WorkerPool(posterior, processes) as pool:
        heuristic = run_heuristic(pool, posterior, PAIRWISE, OTHERS, nine.config.seed)
    clock.done(f"{name}: the heuristic from {OTHERS + 1} starts, and with the paper's integrator")
    whole = pipeline.run_posterior(nine, folder / name, "force", processes, Silent())
    converged = whole.sampled.convergence.converged
    clock.done(f"{name}: the posterior, {'converged' if converged else 'NOT converged'}")
    draws = whole.sampled.draws.reshape(-1, len(heuristic.estimate))
    values, vector = truth_of(nine.case, makers), posterior.space.vector
    truth, mode = None if values is None else vector(values), vector(whole.mode.values)
    left = residual_checks.residual_summaries(posterior.likelihood, heuristic.estimate)
    (fit,) = every_fit(nine.problem, heuristic.estimate, left)
    assert whole.verdict is not None  # there are unknowns with nominal values
    return NineParameterStudy(
        name=name,
        names=nine.problem.names,
        units=tuple(symbol.plain_unit for symbol in nine.problem.symbols),
        given=(
            *(f"{name} = {value:.4g}" for name, value in posterior.space.fixed.items()),
            *(f"{name} = {tie.text}" for name, tie in posterior.space.relations.items()),
        ),
        heuristic=heuristic,
        fit=fit,
        truth=truth,
        draws=draws,
        verdict=whole.verdict,
        misfits=_misfits(nine, heuristic, mode, truth),
        causes=printed.causes(posterior, mode, heuristic.estimate, draws),
        converged=converged,
    )


def _misfits(nine: Job, heuristic: Heuristic, mode: Array, truth: Array | None) -> Row:
    """The paper's misfit per measured number of one record, of which there are `numbers`.

    `others`: the largest of the heuristic's from other starts.  `stepped`: with the paper's integrator,
    where there is no measured input.  95 % of records have it between `low` and `high` at the truth.
    """
    posterior = nine.problem.posterior
    numbers = posterior.likelihood.n_measured
    low, high = precision.expected_misfit(numbers)
    return {
        "record": nine.config.name,
        "numbers": numbers,
        "guess": precision.misfit_per_number(posterior, heuristic.guess),
        "heuristic": precision.misfit_per_number(posterior, heuristic.estimate),
        "others": float(heuristic.others_misfits.max()),
        "stepped": heuristic.stepped_misfit,
        "map": precision.misfit_per_number(posterior, mode),
        "truth": None if truth is None else precision.misfit_per_number(posterior, truth),
        "low": low,
        "high": high,
    }
