"""A posterior that is computed in another process, perhaps on another machine."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from bayesdrill.basics import seeds
from bayesdrill.basics.progress import SILENT
from bayesdrill.commands.concluding import plan
from bayesdrill.engines import maxima, mode
from bayesdrill.engines.learning.learn import Nowhere
from bayesdrill.engines.mode import Mode
from bayesdrill.engines.optimisers.contract import Optimiser
from bayesdrill.engines.sampling import Plan, Sampled, sample, weighed
from bayesdrill.engines.shelf import Memory
from bayesdrill.engines.workers import Crew
from bayesdrill.inference import pieces
from bayesdrill.inference.posterior import Posterior
from bayesdrill.insight.calibration.refit import same_software
from bayesdrill.insight.opened_priors import with_open_ends
from bayesdrill.setup import build
from bayesdrill.setup.job import Job


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """All that decides a posterior: what `bayesdrill posterior` would do with it."""

    posterior: Posterior
    nominal: Mapping[str, float]
    optimiser: Optimiser
    starts: int
    evaluations: int
    plan: Plan


def packed(job: Job) -> bytes:
    """What `work` wants: compiled code is left out, and made once by each process."""
    task = Task(
        posterior=job.problem.posterior,
        nominal=job.problem.nominal,
        optimiser=build.optimiser(job.config),
        starts=job.config.map.starts,
        evaluations=job.config.map.evaluations,
        plan=plan(job.config),
    )
    return pickle.dumps(task)


# A process computes one posterior at a time, whoever asks: limits on threads hold for all of it.
_ONE_AT_A_TIME = threading.Lock()


def work(blob: bytes, versions: Mapping[str, str]) -> tuple[Mode, Sampled] | str:
    """In any process that has the same software; raises `InputError` in any other.

    A sentence where nothing can be sampled.
    """
    same_software(versions)
    with _ONE_AT_A_TIME, threadpool_limits(1):
        task: Task = pickle.loads(blob)
        try:
            return computed(task)
        except Nowhere as error:
            return str(error)


def computed(task: Task) -> tuple[Mode, Sampled]:
    """As one process does it that does nothing else."""
    posterior, seed = task.posterior, task.plan.seed
    points = mode.starts(posterior, task.starts, seeds.stream(seed, "map"))
    searches = tuple(
        mode.search(posterior, task.optimiser, task.evaluations, point) for point in points
    )
    scouted = None
    if task.optimiser.polished:
        draws = posterior.space.draw(mode.SCOUTS, seeds.stream(seed, "scout"))
        scouted = maxima.together(
            [mode.scouts(posterior, some) for some in np.array_split(draws, 2)]
        )
    found = mode.summarise(posterior, searches, scouted)
    posterior = pieces.taking(posterior, found.pieces)
    with Crew(posterior, 1) as crew:
        tops = mode.tops(posterior, found)
        sampled = sample(crew, posterior, tops, task.plan, Memory(), SILENT).doubted(found.doubts)
    sampled = weighed(posterior, sampled, seed)
    return found, with_open_ends(sampled, posterior, task.nominal, tops, task.plan, SILENT)
