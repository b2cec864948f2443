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

SEARCHING = "searching the MAP"
BAD_FIT = (
    "     no posterior of such a fit can be believed; Ctrl-C stops it here, and units, inputs, gear and "
    "columns are what to look at first"
)


def find_mode(job: Job, processes: int, report: Reporter) -> Mode:
    """The MAP alone; nothing is written."""
    with Crew(job.problem.posterior, processes) as crew:
        return end(crew, begin(job, crew, report), job, report)


@dataclass(frozen=True, slots=True)
class Hunt:
    """Searches for the MAP under way, and for maxima elsewhere."""

    searches: list[Future[Search]]
    scouts: list[Future[tuple[Array, Array]]]


def begin(job: Job, crew: Crew, report: Reporter) -> Hunt:
    """All searches under way; of a crew that is alone they are done then."""
    settings, target = job.config.map, job.problem.posterior
    points = mode.starts(target, settings.starts, seeds.stream(job.config.seed, "map"))
    optimiser, most = build.optimiser(job.config), settings.evaluations
    searches, scouts = [], []
    for done, point in enumerate(points):
        report.update(done / len(points), SEARCHING)
        searches.append(crew.submit(mode.search, optimiser, most, point))
    if optimiser.polished:
        draws = target.space.draw(mode.SCOUTS, seeds.stream(job.config.seed, "scout"))
        scouts = [crew.submit(mode.scouts, some) for some in np.array_split(draws, 2)]
    return Hunt(searches, scouts)


def end(crew: Crew, hunt: Hunt, job: Job, report: Reporter) -> Mode:
    searches = []
    for done, task in enumerate(hunt.searches, 1):
        searches.append(task.result())
        report.update(done / (len(hunt.searches) + 1), SEARCHING)
    report.update(0.0, "looking for other maxima")
    scouted = maxima.together([task.result() for task in hunt.scouts]) if hunt.scouts else None
    found = crew.submit(mode.summarise, tuple(searches), scouted).result()
    report.update(1.0, "")
    report.say(words.mode(found, job.units))
    posterior = job.at(found).problem.posterior
    report.update(0.0, "looking at what the best fit leaves")
    left = residual_checks.left(posterior.likelihood, posterior.space.vector(found.values))
    if residual_words.reasons(left):
        said = nuisance_words.explained(
            causes(posterior, posterior.space.vector(found.values)), job.config
        )
        report.say("\n".join([residual_words.sentences(left, job.clock), said, BAD_FIT]))
    report.update(1.0, "")
    return found
