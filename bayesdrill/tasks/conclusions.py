"""What a finished chain means: rows, fit and verdict; in words, and for `run.json`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.analysis import plausibility, verdict
from bayesdrill.analysis.comparison import repeats
from bayesdrill.analysis.identifiability.information import Scenery
from bayesdrill.analysis.suspicions import half_a_sample
from bayesdrill.analysis.verdict import conclude
from bayesdrill.config.job import Job
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.report import tables, words
from bayesdrill.report.sections import fit_words, physics_words, torque_words, verdict_words
from bayesdrill.report.view import View
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import Plan, Sampled
from bayesdrill.sampling.mode_search import Mode

Array = NDArray[np.float64]


def concluded(
    job: Job,
    found: Mode,
    sampled: Sampled,
    scenery: Scenery | None = None,
    seconds: Mapping[str, float] | None = None,
) -> View:
    """`scenery`: of the job's likelihood, where there is one already."""
    problem = job.problem
    scenery = scenery or Scenery(problem.posterior.likelihood)
    rows, left, judged = conclude(problem, job.asked, found, sampled, scenery)
    at = problem.posterior.space.vector(found.values)
    # What another moment would leave looks like noise only where this fit does.
    moment = half_a_sample(scenery, at) if like_noise(left) else None
    late = (f"note: {one}" for one in fit_words.moment(moment))
    course = (f"note: {one}" for one in plausibility.plausibility_of_course(scenery, at))
    rig = (*plausibility.of_roles(problem), *plausibility.plausibility_of_gear(problem))
    geared = (f"note: {one}" for one in rig)
    made = (f"note: record: {one}" for one in words.record_made(problem))
    read = (f"note: record, {one}" for one in words.record_suspicions(problem))
    ends = (f"note: {one}" for one in verdict_words.not_kept(sampled.beyond))
    notes = (*tables.notes(rows, job.units), *ends, *late, *course, *geared, *made, *read)
    every = () if judged is None else verdict.basis(judged.study, judged.study.names)
    return View(
        problem=problem,
        config=job.config,
        mode=found,
        sampled=sampled,
        rows=rows,
        left=left,
        judged=judged,
        notes=notes,
        repeats=repeats(scenery, at, every),
        seconds=seconds or {},
    )


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


def entries(found: View) -> dict[str, Any]:
    """Of `run.json`."""
    sampled, c = found.sampled, found.sampled.convergence
    table = found.problem.compared_with
    return {
        "units": {symbol.name: symbol.unit for symbol in found.problem.symbols},
        "converged": c.converged,
        "reasons": list(found.reasons),
        "notes": list(found.notes),
        "fit": fit_words.residual_data(found.left),
        "repeats": verdict_words.repeats_data(found.repeats, found.names_of_rig),
        "causes": fit_words.causes_data(found.causes),
        **fit_words.instead_data(found.instead if c.converged else None),
        **({"pieces": verdict_words.step_data(found.step_errors)} if found.step_errors else {}),
        **({"torque": torque_words.torque_data(found.shaking)} if found.shaking else {}),
        **({"energy": physics_words.energy_data(found.accounts)} if found.accounts else {}),
        "verdict": None
        if found.judged is None
        else verdict_words.verdict_data(
            found.judged.verdict, table, converged=c.converged, believed=not found.reasons
        ),
        "steps": c.steps,
        "burn_in": c.burn_in,
        "burn_in_rule": c.burn_in_rule,
        "thin": c.thin,
        "n_tau": round(c.n_tau, 2),
        "tau": {
            name: round(float(x), 2) for name, x in zip(found.problem.names, c.tau, strict=True)
        },
        "r_hat": round(float(np.max(c.r_hat)), 5),
        "ess_bulk": round(float(np.min(c.ess_bulk)), 1),
        "acceptance": [round(float(x), 4) for x in sampled.acceptance],
        "failures": sampled.failures,
        **verdict_words.evidence_data(found.evidence, found.vague),
        **_learnt(found.problem, found.mode, sampled),
    }


def held(run: Mapping[str, Any]) -> Array | None:
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
