"""Write and read the record of a finished run in `run.json`, and describe its schema."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import TypeAdapter, WrapValidator
from pydantic.json_schema import GenerateJsonSchema

from bayesdrill.analysis.run_analysis import RunAnalysis
from bayesdrill.analysis.verdict import Verdict
from bayesdrill.basics.errors import InputError
from bayesdrill.basics.json_records import as_data, field_descriptions, from_data
from bayesdrill.inference.compression import CompressionCheck
from bayesdrill.output_files import RUN
from bayesdrill.report.sections.nominal import (
    no_verdict,
    quantity_name,
    verdict_rows,
    verdict_sentence,
)
from bayesdrill.report.view import ReportContext
from bayesdrill.results.run_folder import FolderEntries
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.sampling.proposal.learning import LearnedProposal

# Version of `RunRecord`, and the older version that is read, too.  The analysis in version 2 has
# sentences instead of findings, so it is not read but evaluated again.
FORM, READ_TOO = 3, 2
OLDER = (
    "was written by an older version of bayesdrill, and is not read any more. `bayesdrill posterior "
    "CONFIG --resume` continues its chain and writes it again"
)


def _analysis_of_this_form(value: Any, read: Callable[[Any], RunAnalysis]) -> RunAnalysis | None:
    """Return an analysis, or None if another version wrote it; it is then evaluated again."""
    try:
        return read(value)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightedMaximum:
    """A maximum of the posterior in SI, and the fraction of the draws near it."""

    values: Mapping[str, float]
    log_posterior: float
    weight: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """The record of a finished run has these fields in `run.json`.

    form: the version of this record
    units: SI units of the unknowns, by name
    converged: whether all targets of the sampler are met
    reasons: reasons not to believe the result; empty if there are none
    notes: sentences on priors, record and rig
    verdict: verdict on the nominal table [sigma]
    evidence: log probability of the record under the model [natural log]
    missed: estimated fraction of the posterior that the proposal hardly ever reaches
    compression: comparison of the compressed likelihood of long records with the exact one
    maxima: maxima of the posterior, and the fraction of draws near each [SI]
    importance: posterior means from weighted draws of the proposal, without a chain [SI]
    analysis: analysis of the run, evaluated once; null if another version has written it
    analysis_of: digest of the inputs of the analysis
    """

    form: int = FORM
    units: Mapping[str, str]
    converged: bool
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    verdict: Mapping[str, Any] | None
    evidence: Evidence | None
    missed: float
    compression: CompressionCheck | None
    maxima: tuple[WeightedMaximum, ...]
    importance: Mapping[str, Any] | None = None
    analysis: Annotated[RunAnalysis | None, WrapValidator(_analysis_of_this_form)]
    analysis_of: str


def entries(view: ReportContext, made_of: str) -> dict[str, Any]:
    """Return record and analysis as data; `made_of` is the digest of the inputs of the analysis."""
    analysis, problem, sampled = view.analysis, view.problem, view.sampled
    converged, shares = analysis.convergence.converged, sampled.mode_shares
    verdict = None
    if analysis.judged is not None:
        believed, judged = not view.reasons, analysis.judged.verdict
        table = problem.compared_with
        verdict = verdict_data(judged, table, converged=converged, believed=believed)
    pairs = [] if shares is None else zip(view.mode.maxima, shares.tolist(), strict=True)
    record = RunRecord(
        units={symbol.name: symbol.unit for symbol in problem.symbols},
        converged=converged,
        reasons=tuple(view.reasons),
        notes=tuple(view.notes),
        verdict=verdict,
        evidence=analysis.evidence,
        missed=sampled.missed,
        compression=sampled.compression,
        maxima=tuple(
            WeightedMaximum(values=m.values, log_posterior=m.log_posterior, weight=share)
            for m, share in pairs
        ),
        importance=None if sampled.proposal is None else _weighted_means(view, sampled.proposal),
        analysis=analysis,
        analysis_of=made_of,
    )
    data = as_data(record)
    if record.importance is None:
        del data["importance"]  # `run.json` keeps its entry if a report has no proposal
    return dict(data)


def read_record(run: Mapping[str, Any], folder: Path) -> RunRecord | None:
    """Return the record in the `run.json` of `folder`, or None if that run never finished.

    Raises `InputError` if an older version has written it.
    """
    if run.get("form") is None and run.get("status") != "finished":
        return None
    try:
        if run.get("form") in (FORM, READ_TOO):
            return from_data(RunRecord, run)
    except ValueError:
        pass
    raise InputError.at(str(folder / RUN), OLDER)


def _weighted_means(view: ReportContext, proposal: LearnedProposal) -> dict[str, Any]:
    """Return posterior means from weighted draws of the proposal, which need no chain."""
    posterior, draws = view.problem.posterior, proposal.draws
    theta, free = posterior.coordinates.to_physical(draws.u), posterior.space.free
    mean = draws.weights @ theta
    error = np.sqrt(draws.weights**2 @ (theta - mean) ** 2)
    return {
        "draws": len(theta),
        "share": round(draws.effective_share, 4),
        "acceptance": round(draws.acceptance, 4),
        "mean": dict(zip(free, mean.tolist(), strict=True)),
        "error": dict(zip(free, error.tolist(), strict=True)),
    }


class _RunSchema(GenerateJsonSchema):
    """The schema of records that `as_data` converts, with descriptions from their docstrings."""

    def float_schema(self, _: Any) -> dict[str, Any]:
        """Return the schema of a number, or of a string for infinities and NaN."""
        return {"anyOf": [{"type": "number"}, {"enum": ["Infinity", "-Infinity", "NaN"]}]}

    def dataclass_schema(self, schema: Any) -> dict[str, Any]:
        """Return the schema of a record without additional fields."""
        record = super().dataclass_schema(schema)
        for name, described in field_descriptions(schema["cls"]).items():
            record["properties"][name] |= described
        return record | {"additionalProperties": False}

    def field_title_should_be_set(self, _: Any) -> bool:
        """Return False, so that names of fields are not repeated as titles."""
        return False


def run_schema() -> str:
    """Return the JSON schema of `run.json` as text."""
    record, folder = (
        TypeAdapter(kind).json_schema(schema_generator=_RunSchema, mode="serialization")
        for kind in (RunRecord, FolderEntries)
    )
    described = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "run.json of bayesdrill posterior",
        "type": "object",
        "properties": record["properties"] | folder["properties"],
        "$defs": record["$defs"],
    }
    return json.dumps(described, indent=2) + "\n"


def verdict_data(
    verdict: Verdict, table: str, *, converged: bool = True, believed: bool = True
) -> dict[str, Any]:
    """Return the verdict as data; `agrees` is None if the run cannot be believed or judged."""
    sentence = verdict_sentence(verdict, table)
    unjudged = verdict.saying("cannot judge") and not verdict.judged
    return {
        "table": table,
        "agrees": verdict.agrees if believed and verdict.fits and not unjudged else None,
        "fits": verdict.fits,
        "sentence": sentence if believed else no_verdict(converged=converged),
        "joint_sigma": None if verdict.joint is None else round(verdict.joint, 3),
        "limit_sigma": round(verdict.limit, 3),
        "ends": dict(verdict.ends),
        "quantities": {
            quantity_name(verdict, q): {"says": q.says, "sigma": round(q.tension, 3)}
            for q in verdict_rows(verdict)
        },
    }
