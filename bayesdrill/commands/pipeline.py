"""The main job: a config goes in, a results folder comes out. Reads like a method section."""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections.abc import Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import own_files, seeds, software
from bayesdrill.basics.errors import InputError, Interrupted
from bayesdrill.basics.progress import Reporter
from bayesdrill.basics.sealed import opened, sealed
from bayesdrill.commands.identify import preflight
from bayesdrill.engines import maxima, mode
from bayesdrill.engines.convergence import Targets
from bayesdrill.engines.learning.learn import Nowhere
from bayesdrill.engines.mode import Mode, Other, Search
from bayesdrill.engines.optimisers.contract import Optimiser
from bayesdrill.engines.sampling import Plan, Sampled, loaded, sample, stored
from bayesdrill.engines.workers import Crew
from bayesdrill.inference.problem import Problem
from bayesdrill.insight import plausibility
from bayesdrill.insight.conclusions import conclude
from bayesdrill.insight.diagnostics import Row
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.verdict import Verdict
from bayesdrill.report import publish, residual_words, tables, verdict_words, words
from bayesdrill.results import provenance, run_folder
from bayesdrill.results.chain_files import COMPUTED_AGAIN
from bayesdrill.results.run_folder import Folder
from bayesdrill.setup import build
from bayesdrill.setup.config import Config
from bayesdrill.setup.job import Job as Job
from bayesdrill.setup.job import assemble as assemble
from bayesdrill.setup.job import prepare as prepare

Array = NDArray[np.float64]

MAP_FILE = "map.json"
CONFIG_FILE = "config.yaml"
RESOLVED_FILE = "config.resolved.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """`shown`: table and verdict for the terminal, in paragraphs.

    `reasons`: why the result must not be believed: it did not converge, or does not fit.
    `missing`: tables and figures that could not be made.
    """

    folder: Path
    mode: Mode
    sampled: Sampled
    rows: tuple[Row, ...]
    verdict: Verdict | None
    shown: tuple[str, ...]
    reasons: tuple[str, ...]
    missing: tuple[str, ...]
    seconds: Mapping[str, float]


def posterior(
    job: Job, output: Path, how: run_folder.Mode, processes: int, report: Reporter
) -> Outcome:
    """The whole job. Raises `Interrupted` when asked to stop, and `BrokenProcessPool` when a worker
    was killed; what was sampled is saved.
    """
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, how, marks) as folder:
        known = _taken_up(job, folder) if how == "resume" else None
        report.say(f"{words.opening(job.problem)}\n{words.size(job.problem, job.config)}")
        seed, versions = job.config.seed, software.versions()
        folder.begin(status="running", seed=seed, versions=versions)
        folder.write_text(CONFIG_FILE, job.source.text)
        folder.write_text(RESOLVED_FILE, provenance.resolved(job.config, job.source, output))
        try:
            return _run(job, folder, known, processes, report)
        except KeyboardInterrupt:
            folder.write_run(status="interrupted")
            message = f"stopped; what was sampled is saved in {output}; continue with --resume"
            raise Interrupted(message) from None
        except BrokenProcessPool:
            folder.write_run(status="interrupted")
            raise


def _taken_up(job: Job, folder: Folder) -> Mode | None:
    """What was done is read before anything is written: what cannot go on stays as it is."""
    folder.read_ahead(job.config.sampler.ensembles)
    return _read_mode(folder.path / MAP_FILE)


def _run(job: Job, folder: Folder, known: Mode | None, processes: int, report: Reporter) -> Outcome:
    clock = [time.perf_counter()]
    posterior = job.problem.posterior
    with Crew(posterior, processes) as crew:
        hunt = None if known else _begin_search(job, crew)
        # While others search the MAP, this process looks at what the record can show, and loads
        # what sampling and report will need.
        scenery = Scenery(posterior.likelihood)
        report.say(preflight(job, scenery))
        if not crew.alone:
            for _ in range(processes):  # one for each, as it is done with its searches
                crew.submit(loaded)
            _load_ahead()
        if hunt is not None:
            known = _end_search(crew, hunt, report)
            folder.write_text(MAP_FILE, sealed(dataclasses.asdict(known)))
        assert known is not None
        found = known
        clock.append(time.perf_counter())
        tops = mode.tops(posterior, found)
        try:
            sampled = sample(crew, posterior, tops, plan(job.config), folder, report)
        except Nowhere as error:
            message = (
                f"{error}; the record and the priors do not go together, check units and values"
            )
            raise InputError([job.source.problem(("parameters",), message)]) from None
        clock.append(time.perf_counter())
        names = ",".join(job.problem.names)
        coordinates = ",".join("log" if log else "linear" for log in posterior.coordinates.logs)
        folder.finish_chain(sampled.pieces, {"coordinates": coordinates, "unknowns": names})
        seconds = {"map": clock[1] - clock[0], "sampling": clock[2] - clock[1]}
        return _publish(job, folder, found, sampled, scenery, seconds, crew)


def republish(output: Path, processes: int) -> Outcome:
    """Tables and figures again, from the chain that `output` holds."""
    run = run_folder.read_run(output)
    if run is None:
        raise InputError.one(str(output), "no results here; give the folder of a finished run")
    if run.get("job") != own_files.POSTERIOR.job:
        message = (
            f"results of `bayesdrill {run.get('job')}`, which makes its tables and figures itself"
        )
        raise InputError.one(str(output), f"{message}; give the folder of a posterior")
    if not (output / RESOLVED_FILE).exists():
        raise InputError.one(str(output), "the run stopped as it began; continue it with --resume")
    job = prepare(output / RESOLVED_FILE)
    marks = provenance.fingerprint(job.config, job.problem)
    with Folder(output, "report", marks) as folder:
        posterior = job.problem.posterior
        held = _held(run)
        again = stored(posterior, plan(job.config), folder.pieces, str(output))
        sampled = dataclasses.replace(again, held=held)
        found = _read_mode(output / MAP_FILE)
        if found is None:
            message = "is not there; continue with --resume, which searches the MAP again"
            raise InputError.one(str(output / MAP_FILE), message)
        folder.begin()
        with Crew(posterior, processes) as crew:
            scenery = Scenery(posterior.likelihood)
            return _publish(job, folder, found, sampled, scenery, {}, crew)


def find_mode(job: Job, processes: int, report: Reporter) -> Mode:
    """The MAP alone; nothing is written."""
    with Crew(job.problem.posterior, processes) as crew:
        return _end_search(crew, _begin_search(job, crew), report)


def plan(config: Config) -> Plan:
    sampler = config.sampler
    return Plan(
        ensembles=sampler.ensembles,
        walkers=sampler.walkers,
        moves=sampler.moves,
        targets=Targets(r_hat=sampler.r_hat, n_tau=sampler.n_tau, ess=sampler.ess),
        max_steps=sampler.max_steps,
        seed=config.seed,
    )


@dataclass(frozen=True, slots=True)
class _Hunt:
    """Searches for the MAP under way, and for maxima elsewhere."""

    searches: list[Future[Search]]
    scouts: list[Future[tuple[Array, Array]]]


def _begin_search(job: Job, crew: Crew) -> _Hunt:
    settings, target = job.config.map, job.problem.posterior
    points = mode.starts(target, settings.starts, seeds.stream(job.config.seed, "map"))
    optimiser: Optimiser = build.optimiser(job.config, job.problem.names)
    # The paper's ways are kept as they are: they are there to be seen.
    polish = settings.method == "nelder_mead"
    evaluations = settings.evaluations
    if polish:
        optimiser, evaluations = mode.roughly(len(job.problem.names), evaluations)
    searches = [crew.submit(mode.search, optimiser, evaluations, point, polish) for point in points]
    draws = target.space.draw(mode.SCOUTS, seeds.stream(job.config.seed, "scout"))
    scouts = [crew.submit(mode.scouts, some) for some in np.array_split(draws, 2)] if polish else []
    return _Hunt(searches, scouts)


def _end_search(crew: Crew, hunt: _Hunt, report: Reporter) -> Mode:
    searches = []
    for done, task in enumerate(hunt.searches):
        report.update(done / len(hunt.searches), "searching the MAP")
        searches.append(task.result())
    scouted = maxima.together([task.result() for task in hunt.scouts]) if hunt.scouts else None
    found = crew.submit(mode.summarise, tuple(searches), scouted).result()
    report.update(1.0, "")
    report.say(words.mode(found))
    return found


def _load_ahead() -> None:
    """Libraries that take a while to load."""
    for name in ("scipy.stats", "arviz_stats.base"):
        importlib.import_module(name)


def _read_mode(path: Path) -> Mode | None:
    """None where no search has ended yet."""
    if not path.exists():
        return None
    try:
        data = opened(path.read_bytes())
        searches = tuple(Search(**search) for search in data.pop("searches"))
        others = tuple(Other(**other) for other in data.pop("others"))
        at_bound = tuple(data.pop("at_bound"))
        found = Mode(**data, searches=searches, at_bound=at_bound, others=others)
        places = [found.values, *(one.values for one in found.others), *(s.end for s in searches)]
        numbers = [value for place in places for value in place.values()]
        heights = [one.log_posterior for one in found.maxima]
        if not np.isfinite([*numbers, *heights, *found.slope.values(), found.gain]).all():
            raise ValueError
        return found
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError.one(str(path), COMPUTED_AGAIN) from None


def _publish(
    job: Job,
    folder: Folder,
    found: Mode,
    sampled: Sampled,
    scenery: Scenery,
    seconds: dict[str, float],
    crew: Crew,
) -> Outcome:
    begun = time.perf_counter()
    c = sampled.convergence
    table = build.compared_with(job.config)
    rows, left, judged = conclude(job.problem, job.asked, found, sampled, scenery, plan(job.config))
    at = job.problem.posterior.space.vector(found.values)
    notes = [*tables.notes(rows), *(f"note: {one}" for one in plausibility.of_course(scenery, at))]
    missing = publish.everything(
        job.problem, found, left, sampled, rows, judged, job.config, folder, crew
    )
    if seconds:
        seconds["report"] = time.perf_counter() - begun
        folder.write_run(seconds={name: round(value, 3) for name, value in seconds.items()})
    folder.write_run(
        status="finished",
        converged=c.converged,
        reasons=[*c.reasons, *residual_words.reasons(left)],
        notes=notes,
        missing=missing,
        fit=residual_words.as_data(left),
        verdict=None
        if judged is None
        else verdict_words.as_data(judged.verdict, table, converged=c.converged),
        steps=c.steps,
        burn_in=c.burn_in,
        burn_in_rule=c.burn_in_rule,
        thin=c.thin,
        n_tau=round(c.n_tau, 2),
        tau={name: round(float(x), 2) for name, x in zip(job.problem.names, c.tau, strict=True)},
        r_hat=round(float(np.max(c.r_hat)), 5),
        ess_bulk=round(float(np.min(c.ess_bulk)), 1),
        acceptance=[round(float(x), 4) for x in sampled.acceptance],
        failures=sampled.failures,
        **_learnt(job.problem, found, sampled),
    )
    doubts = residual_words.reasons(left)
    said_first = [words.maxima(found, sampled), words.unbelievable(doubts, converged=c.converged)]
    shown = [
        *(text for text in said_first if text),
        *(residual_words.sentences(left), tables.as_text(rows), tables.in_words(rows, notes)),
    ]
    if judged is not None:
        said = verdict_words.sentences(judged.verdict, table, converged=c.converged)
        shown += [verdict_words.as_text(judged.verdict), said]
    return Outcome(
        folder=folder.path,
        mode=found,
        sampled=sampled,
        rows=rows,
        verdict=None if judged is None else judged.verdict,
        shown=tuple(shown),
        reasons=(*c.reasons, *doubts),
        missing=missing,
        seconds=seconds,
    )


def _held(run: Mapping[str, Any]) -> Array | None:
    """What each maximum holds, as a finished run has counted it."""
    try:
        return np.array([float(one["weight"]) for one in run["maxima"]])
    except (KeyError, TypeError, ValueError):
        return None


def _learnt(problem: Problem, found: Mode, sampled: Sampled) -> dict[str, Any]:
    """For `run.json`: what the proposal says without a chain, and where the maxima are."""
    learnt, space = sampled.learnt, problem.posterior.space
    if learnt is None or sampled.held is None:
        return {}
    theta = problem.posterior.coordinates.to_physical(learnt.u)
    mean = learnt.weights @ theta
    error = np.sqrt(learnt.weights**2 @ (theta - mean) ** 2)
    return {
        "importance": {
            "draws": len(theta),
            "share": round(learnt.share, 4),
            "acceptance": round(learnt.acceptance, 4),
            "mean": dict(zip(space.free, map(float, mean), strict=True)),
            "error": dict(zip(space.free, map(float, error), strict=True)),
        },
        "maxima": [
            {
                "values": dict(one.values),
                "log_posterior": one.log_posterior,
                "weight": float(weight),
            }
            for one, weight in zip(found.maxima, sampled.held, strict=True)
        ],
    }
