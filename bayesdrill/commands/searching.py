"""The search for the MAP as a config asks for it, alone or beside other work."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import seeds
from bayesdrill.basics.progress import Reporter
from bayesdrill.engines import maxima, mode
from bayesdrill.engines.mode import Mode, Search
from bayesdrill.engines.workers import Crew
from bayesdrill.inference import residual_checks
from bayesdrill.insight.causes import causes
from bayesdrill.report import nuisance_words, residual_words, words
from bayesdrill.setup import build
from bayesdrill.setup.job import Job

Array = NDArray[np.float64]

BAD_FIT = (
    "     no posterior of such a fit can be believed; Ctrl-C stops it here, and units, inputs, gear and "
    "columns are what to look at first"
)


def find_mode(job: Job, processes: int, report: Reporter) -> Mode:
    """The MAP alone; nothing is written."""
    with Crew(job.problem.posterior, processes) as crew:
        return end(crew, begin(job, crew), job, report)


@dataclass(frozen=True, slots=True)
class Hunt:
    """Searches for the MAP under way, and for maxima elsewhere."""

    searches: list[Future[Search]]
    scouts: list[Future[tuple[Array, Array]]]


def begin(job: Job, crew: Crew) -> Hunt:
    settings, target = job.config.map, job.problem.posterior
    points = mode.starts(target, settings.starts, seeds.stream(job.config.seed, "map"))
    optimiser, most = build.optimiser(job.config), settings.evaluations
    searches = [crew.submit(mode.search, optimiser, most, point) for point in points]
    scouts = []
    if optimiser.polished:
        draws = target.space.draw(mode.SCOUTS, seeds.stream(job.config.seed, "scout"))
        scouts = [crew.submit(mode.scouts, some) for some in np.array_split(draws, 2)]
    return Hunt(searches, scouts)


def end(crew: Crew, hunt: Hunt, job: Job, report: Reporter) -> Mode:
    searches = []
    for done, task in enumerate(hunt.searches):
        report.update(done / len(hunt.searches), "searching the MAP")
        searches.append(task.result())
    scouted = maxima.together([task.result() for task in hunt.scouts]) if hunt.scouts else None
    found = crew.submit(mode.summarise, tuple(searches), scouted).result()
    report.update(1.0, "")
    report.say(words.mode(found, job.units))
    posterior = job.at(found).problem.posterior
    left = residual_checks.left(posterior.likelihood, posterior.space.vector(found.values))
    if any(one.unbelievable for one in left):
        said = nuisance_words.explained(
            causes(posterior, posterior.space.vector(found.values)), job.config
        )
        report.say("\n".join([residual_words.sentences(left, job.clock), said, BAD_FIT]))
    return found
