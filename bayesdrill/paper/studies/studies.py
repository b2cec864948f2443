"""The configs of the paper's studies, with all that would stop them told before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayesdrill.basics import InputError, Problem, own_files
from bayesdrill.engines import Optimiser
from bayesdrill.paper.studies import printed
from bayesdrill.setup import Config, Job, Source, build, job, loading

TWO = "two_parameters.yaml"
NINES = ("estimates.yaml", "measured.yaml")
MAKERS = ("estimates.yaml", "missing_physics.yaml")  # make records, whose truth is known


@dataclass(frozen=True, slots=True, kw_only=True)
class Studies:
    """`pairwise`: the heuristic for the unknowns of each of `nines`; `makers` made the records."""

    two: Job
    nines: tuple[Job, ...]
    pairwise: tuple[Optimiser, ...]
    makers: tuple[tuple[Config, Source], ...]


def prepare(configs: Path) -> Studies:
    """Raises `InputError` with all that would stop them later."""
    if not configs.is_dir():
        message = (
            f"no such folder; give the one that holds {', '.join((TWO, *NINES))}, "
            "or have it written by `bayesdrill example`"
        )
        raise InputError.one(str(configs), message)
    two, *nines = (job.prepare(configs / name) for name in (TWO, *NINES))
    makers = tuple(loading.load(configs / name) for name in MAKERS)
    problems = [*_of_noise((two, *nines)), *_of_two(two), *_of_nines(nines)]
    if problems:
        raise InputError(problems)
    pairwise = tuple(_pairwise(nine) for nine in nines)
    return Studies(two=two, nines=tuple(nines), pairwise=pairwise, makers=makers)


def _of_noise(jobs: Sequence[Job]) -> list[Problem]:
    return [
        own.source.problem(
            ("record", "channels"),
            "the paper's misfit needs known noise; give each sigma as a number",
        )
        for own in jobs
        if own.problem.posterior.likelihood.noise.unknowns
    ]


def _of_two(two: Job) -> list[Problem]:
    problems = []
    if set(two.problem.names) != set(printed.START):
        message = (
            f"Table 2 has the unknowns {' and '.join(printed.START)}; give a prior to these alone"
        )
        problems.append(two.source.problem(("parameters",), message))
    if two.problem.experiment.series:
        message = "Table 2 is simulated under a constant voltage; give each input as a number"
        problems.append(two.source.problem(("inputs",), message))
    return problems


def _of_nines(nines: Sequence[Job]) -> list[Problem]:
    taken, problems = {own_files.FIGURES}, []
    for nine in nines:
        if len(set(nine.problem.names) & set(printed.NINE_PARAMETERS)) < 2:
            message = "the heuristic needs two unknown parameters or more; give a prior to more"
            problems.append(nine.source.problem(("parameters",), message))
        name = nine.config.name.casefold()  # as some file systems do
        if name in taken:
            message = f"{name} is the name of something else in the results; give another"
            problems.append(nine.source.problem(("name",), message))
        taken.add(name)
    return problems


def _pairwise(nine: Job) -> Optimiser:
    own = nine.config.map.model_copy(update={"method": "pairwise"})
    repeated = nine.config.model_copy(update={"map": own})
    found = build.optimiser(repeated)
    found.check(nine.problem.names)
    return found
