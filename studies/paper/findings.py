"""Collect what the studies of the paper find, and check their configs before anything runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill import output_files
from bayesdrill.analysis import Verdict
from bayesdrill.basics import Array, InputError, Issue
from bayesdrill.config import Job, ResolvedCase, job, loading
from bayesdrill.report import Fit
from studies.paper import printed
from studies.paper.forward import MatrixReading
from studies.paper.printed import Row
from studies.paper.searches import Heuristic, SearchEnd, Verification


@dataclass(frozen=True, slots=True, kw_only=True)
class NineParameterStudy:
    """The nine-parameter study of one record; vectors `(D,)` of `names`, physical, SI.

    `draws (N, D)` of the posterior; `fit` of the estimate; `given`: what was not searched.
    """

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    given: tuple[str, ...]
    heuristic: Heuristic
    fit: Fit
    truth: Array | None
    draws: Array
    verdict: Verdict
    misfits: Row
    causes: Sequence[Row]
    converged: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperFindings:
    """All that the studies find; `ends` of searches have distances from the truth of `searched`."""

    readings: tuple[MatrixReading, ...]
    errors: Sequence[Row]
    verification: Verification
    lengths: Sequence[Row]
    implied: Sequence[Row]
    searched: str
    symmetries: tuple[tuple[str, ...], ...]
    ends: tuple[SearchEnd, ...]
    control: Sequence[Row]
    nines: tuple[NineParameterStudy, ...]
    tones: Sequence[Row]

    @property
    def converged(self) -> bool:
        """Whether all posteriors have converged."""
        return self.verification.converged and all(nine.converged for nine in self.nines)


TWO = "two_parameters.yaml"
NINES = ("estimates.yaml", "measured.yaml")
MAKERS = ("estimates.yaml", "missing_physics.yaml")  # make records, whose truth is known


@dataclass(frozen=True, slots=True, kw_only=True)
class Studies:
    """The configs of all studies, and `makers` of the records whose truth is known."""

    two: Job
    nines: tuple[Job, ...]
    makers: tuple[ResolvedCase, ...]


def prepare(configs: Path) -> Studies:
    """Prepare all studies; raises `InputError` with all that would stop them later."""
    if not configs.is_dir():
        message = (
            f"no such folder; give the one that holds {', '.join((TWO, *NINES))}, "
            "or have it written by `bayesdrill example`"
        )
        raise InputError.at(str(configs), message)
    two, *nines = (job.prepare(configs / name) for name in (TWO, *NINES))
    makers = tuple(loading.load(configs / name) for name in MAKERS)
    problems = [*_of_noise((two, *nines)), *_of_two(two), *_of_nines(nines)]
    if problems:
        raise InputError(problems)
    return Studies(two=two, nines=tuple(nines), makers=makers)


def _of_noise(jobs: Sequence[Job]) -> Iterator[Issue]:
    message = "the paper's misfit needs known noise; give each sigma as a number"
    for each in jobs:
        if each.problem.posterior.likelihood.only_observation.unknowns:
            yield each.source.issue(("record", "channels"), message)


def _of_two(two: Job) -> Iterator[Issue]:
    if set(two.problem.names) != set(printed.TWO_UNKNOWNS):
        names = " and ".join(printed.TWO_UNKNOWNS)
        message = f"Table 2 has the unknowns {names}; give a prior to these alone"
        yield two.source.issue(("parameters",), message)
    if two.problem.experiment.series:
        message = "Table 2 is simulated under a constant voltage; give each input as a number"
        yield two.source.issue(("inputs",), message)


def _of_nines(nines: Sequence[Job]) -> Iterator[Issue]:
    used = {output_files.FIGURES}
    for nine in nines:
        if len(set(nine.problem.names) & set(printed.NINE_PARAMETERS)) < 2:
            message = "the heuristic needs two unknown parameters or more; give a prior to more"
            yield nine.source.issue(("parameters",), message)
        name = nine.config.name.casefold()  # as some file systems do
        if name in used:
            message = f"{name} is the name of something else in the results; give another"
            yield nine.source.issue(("name",), message)
        used.add(name)
