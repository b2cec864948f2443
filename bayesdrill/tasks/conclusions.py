"""What a finished chain means: rows, fit and verdict; in words, and for `run.json`."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bayesdrill
from bayesdrill.analysis.identifiability.information import Scenery
from bayesdrill.analysis.run_analysis import RunAnalysis, RunDraws, analyse
from bayesdrill.basics.records import as_data, from_data, schema
from bayesdrill.config.job import Job
from bayesdrill.config.records import sources
from bayesdrill.config.resolve import assembly, experiments
from bayesdrill.config.schema.config import Config
from bayesdrill.config.yaml_source import Source
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import words
from bayesdrill.report.sections import fit_words, physics_words, torque_words, verdict_words
from bayesdrill.report.view import View
from bayesdrill.results import provenance
from bayesdrill.results.run_folder import chain_mark
from bayesdrill.sampling.convergence import Targets
from bayesdrill.sampling.ensembles import Plan, Sampled
from bayesdrill.sampling.mode_search import Mode

Array = NDArray[np.float64]

ANALYSIS, ANALYSIS_OF = "analysis", "analysis_of"  # entries of `run.json`


def concluded(
    job: Job,
    found: Mode,
    sampled: Sampled,
    scenery: Scenery | None = None,
    seconds: Mapping[str, float] | None = None,
    *,
    alone: bool = True,
    kept: RunAnalysis | None = None,
) -> View:
    """`scenery`: of the job's likelihood, where there is one already; `alone`: no other model of the
    record is tried beside it; `kept`: what was evaluated before.
    """
    problem = job.problem
    chain = RunDraws(problem, found, sampled, job.config.seed)
    if kept is None:
        scenery = scenery or Scenery(problem.posterior.likelihood)
        suspicions = words.record_suspicions(problem, job.config)
        kept = analyse(chain, job.asked, scenery, suspicions, alone=alone)
    return View(chain, job.config, kept, seconds or {})


def settings(config: Config, source: Source) -> dict[str, Any]:
    """All of a config but where its record is."""
    own = (*experiments.SECTIONS, experiments.EXPERIMENTS)
    found = config.model_dump(exclude_none=True, exclude=set(own))
    for view in experiments.views(config, source):
        alone = view.config.model_dump(exclude_none=True, include=set(experiments.SECTIONS))
        for section, key in sources.named_in(alone):
            del section[key]
        found[f"experiment {view.label}"] = alone
    return found | {"held out": experiments.held_out(config)}


def analysis_mark(job: Job, found: Mode, sampled: Sampled) -> str:
    """A digest of all that an analysis is made of: config, record, maximum, chain, and the version."""
    given = {name: x for name, x in settings(job.config, job.source).items() if name != "output"}
    made_of = (
        bayesdrill.__version__,
        repr(given),
        repr(sorted(provenance.fingerprint(job.config, job.problem).items())),
        repr((dict(found.values), found.doubts, found.pieces, job.asked)),
        chain_mark(sampled.pieces),
        repr((sampled.evidence, sampled.beyond and (sampled.beyond.pressed, sampled.beyond.kept))),
    )
    return hashlib.sha256("\n".join(made_of).encode("utf-8", "replace")).hexdigest()


def kept_analysis(
    job: Job, found: Mode, sampled: Sampled, run: Mapping[str, Any]
) -> RunAnalysis | None:
    """What a finished run has kept in `run.json`; None where it is of something else, or not there."""
    if run.get(ANALYSIS_OF) != analysis_mark(job, found, sampled):
        return None
    try:
        return from_data(RunAnalysis, run.get(ANALYSIS))
    except ValueError:  # of an older form
        return None


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


def entries(job: Job, view: View) -> dict[str, Any]:
    """Of `run.json`."""
    found, c = view.analysis, view.analysis.convergence
    table = assembly.compared_with(view.config)
    return {
        "units": {symbol.name: symbol.unit for symbol in view.problem.symbols},
        "converged": c.converged,
        "reasons": list(view.reasons),
        "notes": list(view.notes),
        "fit": fit_words.residual_data(found.fit),
        "repeats": verdict_words.repeats_data(found.repeats, view.names_of_rig),
        "causes": fit_words.causes_data(found.causes),
        **fit_words.instead_data(found.instead if c.converged else None),
        **({"pieces": verdict_words.step_data(found.step_errors)} if found.step_errors else {}),
        **({"torque": torque_words.torque_data(found.torques)} if found.torques else {}),
        **({"energy": physics_words.energy_data(found.energy)} if found.energy else {}),
        "verdict": None
        if found.judged is None
        else verdict_words.verdict_data(
            found.judged.verdict, table, converged=c.converged, believed=not view.reasons
        ),
        "steps": c.steps,
        "burn_in": c.burn_in,
        "burn_in_rule": c.burn_in_rule,
        "thin": c.thin,
        "n_tau": round(c.n_tau, 2),
        "tau": {
            name: round(float(x), 2) for name, x in zip(view.problem.names, c.tau, strict=True)
        },
        "r_hat": round(float(np.max(c.r_hat)), 5),
        "ess_bulk": round(float(np.min(c.ess_bulk)), 1),
        "acceptance": [round(x, 4) for x in found.acceptance],
        "failures": found.failures,
        **verdict_words.evidence_data(found.evidence, found.vague),
        **_learnt(view.problem, view.mode, view.sampled),
        ANALYSIS: as_data(found),
        ANALYSIS_OF: analysis_mark(job, view.mode, view.sampled),
    }


ENTRIES: Mapping[str, str] = MappingProxyType(
    {
        "job": "the command that made the folder",
        "fingerprint": "what decides the chain, by name",
        "status": "running, interrupted or finished",
        "seed": "the seed of all random numbers",
        "versions": "of bayesdrill, Python and the libraries",
        "seconds": "how long the parts of the run took [s]",
        "missing": "tables and figures that could not be made, and why",
        "files": "digests of all files that were written, by name",
        "units": "SI units of the unknowns, by name",
        "converged": "whether all targets of the sampler are met",
        "reasons": "why the result must not be believed; empty where it may be",
        "notes": "sentences on priors, record and rig",
        "fit": "what the MAP leaves of each channel [sd of the noise]",
        "repeats": "products as each of several experiments has them [natural logs]",
        "causes": "what would explain a fit that leaves more than noise [SI]",
        "instead": "what the rig may lack, where the nominal table would be blamed [SI]",
        "pieces": "what the steps of a rig that is stepped do at the MAP [sd of the noise]",
        "torque": "the missing torque of each experiment [N m]",
        "energy": "where the energy goes, of a rig that rubs [J]",
        "verdict": "what the run says of the nominal table [sigma]",
        "steps": "steps of each ensemble",
        "burn_in": "steps that are dropped",
        "burn_in_rule": "how many these are, and why",
        "thin": "one of so many steps is kept",
        "n_tau": "length of the chain [autocorrelation times]",
        "tau": "autocorrelation times by unknowns [steps]",
        "r_hat": "the largest R-hat of all unknowns",
        "ess_bulk": "the fewest effective draws of all unknowns",
        "acceptance": "the share of proposals accepted, of each ensemble",
        "failures": "proposals inside the prior that had no finite response",
        "log_evidence": "how probable the record is under the model [natural log]",
        "log_evidence_error": "its standard error",
        "log_evidence_overlap": "what posterior and proposal have in common, from 0 to 1",
        "log_evidence_steps": "what finer steps of a rig that is stepped add to it [natural log]",
        "log_evidence_steps_error": "the standard error of that",
        "vague_priors": "unknowns whose priors are too wide for it to mean much",
        "importance": "posterior means that the proposal gives without a chain [SI]",
        "maxima": "maxima of the posterior, and the share of each [SI]",
        ANALYSIS: "all that is said of the run, evaluated once",
        ANALYSIS_OF: "a digest of what the analysis was made of",
        "checksum": "of all entries before it",
    }
)


def run_schema() -> str:
    """The JSON schema of `run.json`, as text."""
    analysis = schema(RunAnalysis)
    entries = {name: {"description": said} for name, said in ENTRIES.items()}
    entries[ANALYSIS] |= {"$ref": analysis["$ref"]}
    found = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "run.json of bayesdrill posterior",
        "type": "object",
        "properties": entries,
        "$defs": analysis["$defs"],
    }
    return json.dumps(found, indent=2) + "\n"


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
