"""What `run.json` says of a finished run, from its `RunAnalysis`, and its schema."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesdrill.analysis.plausibility import DiffusePrior
from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.values import as_data, schema
from bayesdrill.inference.compression import CompressionCheck
from bayesdrill.inference.posterior import Problem
from bayesdrill.report.sections import verdict_words
from bayesdrill.report.view import ReportContext
from bayesdrill.sampling.ensembles import SamplingResult
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.sampling.mode_search import Mode

ANALYSIS, ANALYSIS_OF = "analysis", "analysis_of"  # entries of `run.json`


ENTRIES: Mapping[str, str] = {
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
    "compression": "how the compressed likelihood of long records compares with the exact one",
    "log_evidence": "how probable the record is under the model [natural log]",
    "log_evidence_error": "its standard error",
    "log_evidence_overlap": "what posterior and proposal have in common, from 0 to 1",
    "log_evidence_steps": "what finer steps of a rig that is stepped add to it [natural log]",
    "log_evidence_steps_error": "the standard error of that",
    "vague_priors": "unknowns whose priors are too wide for it to mean much",
    "importance": "posterior means that the proposal gives without a chain [SI]",
    "missed": "about how much of the posterior the proposal hardly ever reaches",
    "maxima": "maxima of the posterior, and the share of each [SI]",
    ANALYSIS: "all that is said of the run, evaluated once",
    ANALYSIS_OF: "a digest of what the analysis was made of",
    "checksum": "of all entries before it",
}


def run_schema() -> str:
    """The JSON schema of `run.json`, as text."""
    analysis = schema(RunAnalysis)
    entries = {name: {"description": said} for name, said in ENTRIES.items()}
    entries[ANALYSIS] |= {"$ref": analysis["$ref"]}
    described = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "run.json of bayesdrill posterior",
        "type": "object",
        "properties": entries,
        "$defs": analysis["$defs"],
    }
    return json.dumps(described, indent=2) + "\n"


def entries(view: ReportContext, made_of: str) -> dict[str, Any]:
    """All of them, from the analysis; `made_of`: a digest of what that is of."""
    analysis, c, problem = view.analysis, view.analysis.convergence, view.problem
    ensembles = ("steps", "burn_in", "burn_in_rule", "thin")
    return {
        "units": {symbol.name: symbol.unit for symbol in problem.symbols},
        "converged": c.converged,
        "reasons": list(view.reasons),
        "notes": list(view.notes),
        "verdict": analysis.judged
        and verdict_data(
            analysis.judged.verdict,
            problem.compared_with,
            converged=c.converged,
            believed=not view.reasons,
        ),
        **{name: getattr(c, name) for name in ensembles},
        "n_tau": round(c.n_tau, 2),
        "tau": {name: round(float(x), 2) for name, x in zip(problem.names, c.tau, strict=True)},
        "r_hat": round(float(np.max(c.r_hat)), 5),
        "ess_bulk": round(float(np.min(c.ess_bulk)), 1),
        "acceptance": [round(x, 4) for x in analysis.acceptance],
        "failures": analysis.failures,
        **evidence_data(analysis.evidence, analysis.vague),
        **({"compression": as_data(check)} if (check := view.sampled.compression) else {}),
        **({"missed": view.sampled.missed} if view.sampled.missed else {}),
        **_learnt(problem, view.mode, view.sampled),
        ANALYSIS: as_data(analysis),
        ANALYSIS_OF: made_of,
    }


def _learnt(problem: Problem, mode: Mode, sampled: SamplingResult) -> dict[str, Any]:
    """What the proposal says without a chain, and where the maxima are."""
    learnt, free = sampled.learnt, problem.posterior.space.free
    if learnt is None or sampled.mode_shares is None:
        return {}
    theta = problem.posterior.coordinates.to_physical(learnt.draws.u)
    weights = learnt.draws.weights
    mean = weights @ theta
    error = np.sqrt(weights**2 @ (theta - mean) ** 2)
    return {
        "importance": {
            "draws": len(theta),
            "share": round(learnt.draws.share, 4),
            "acceptance": round(learnt.draws.acceptance, 4),
            "mean": dict(zip(free, mean.tolist(), strict=True)),
            "error": dict(zip(free, error.tolist(), strict=True)),
        },
        "maxima": [
            {
                "values": dict(maximum.values),
                "log_posterior": maximum.log_posterior,
                "weight": float(weight),
            }
            for maximum, weight in zip(mode.maxima, sampled.mode_shares, strict=True)
        ],
    }


def maxima_weights(run: Mapping[str, Any]) -> Array | None:
    """What each maximum holds, as a finished run has counted it."""
    try:
        return np.array([float(maximum["weight"]) for maximum in run["maxima"]])
    except (KeyError, TypeError, ValueError):
        return None


def evidence_data(evidence: Evidence | None, priors: Sequence[DiffusePrior]) -> dict[str, Any]:
    """Entries of their own; those of steps only where there are any."""
    if evidence is None:
        return {}
    names = [name for name in _EVIDENCE if evidence.steps_error or not name.startswith(_OF_STEPS)]
    numbers = {name: getattr(evidence, _EVIDENCE[name]) for name in names}
    return numbers | {"vague_priors": [prior.name for prior in priors]}


_OF_STEPS = "log_evidence_steps"
_EVIDENCE = {
    "log_evidence": "log_z",
    "log_evidence_error": "error",
    "log_evidence_overlap": "overlap",
    _OF_STEPS: "steps",
    f"{_OF_STEPS}_error": "steps_error",
}


def compression_of_data(run: Mapping[str, Any]) -> CompressionCheck | None:
    """What `run.json` says of the check of a compressed likelihood."""
    try:
        return CompressionCheck(**run["compression"])
    except (KeyError, TypeError):
        return None


def missed_of_data(run: Mapping[str, Any]) -> float:
    """How much of the posterior the proposal missed, by `run.json`; 0 where it says nothing."""
    missed = run.get("missed")
    return missed if isinstance(missed, float) and 0.0 < missed <= 1.0 else 0.0


def evidence_of_data(run: Mapping[str, Any]) -> Evidence | None:
    """What `evidence_data` has left in `run.json`; None where it is not there, or no numbers."""
    told = {_OF_STEPS: 0.0, f"{_OF_STEPS}_error": 0.0, **run}
    try:
        numbers = {key: float(told[name]) for name, key in _EVIDENCE.items()}
    except (KeyError, TypeError, ValueError):
        return None
    return Evidence(**numbers) if all(map(math.isfinite, numbers.values())) else None


def verdict_data(
    verdict: Verdict, table: str, *, converged: bool = True, believed: bool = True
) -> dict[str, Any]:
    """`agrees` is None where the run is not believed, the fit is not noise, or no end lets it judge."""
    whole = verdict_words.verdict_sentence(verdict, table)
    unjudged = verdict.saying("cannot judge") and not verdict.judged
    return {
        "table": table,
        "agrees": verdict.agrees if believed and verdict.fits and not unjudged else None,
        "fits": verdict.fits,
        "sentence": whole if believed else verdict_words.no_verdict(converged=converged),
        "joint_sigma": None if verdict.joint is None else round(verdict.joint, 3),
        "limit_sigma": round(verdict.limit, 3),
        "ends": dict(verdict.ends),
        "quantities": {
            verdict_words.quantity_name(verdict, q): {"says": q.says, "sigma": round(q.tension, 3)}
            for q in verdict_words.verdict_rows(verdict)
        },
    }
