"""The evidence of a model, in sentences and as data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bayesdrill.engines.evidence import Evidence
from bayesdrill.insight.vagueness import Vague

POOR = 0.1  # error, from which on it is said to be rough

EXPLAINED = (
    "The log evidence is the natural log of how probable this very record is under the model with all "
    "that its priors allow, not just its best fit. By itself it says nothing; the difference of two "
    "models of the same record is the log of their odds, where both were thought as likely before "
    "(`bayesdrill compare`)."
)


def sentences(found: Evidence, priors: Sequence[Vague], *, converged: bool) -> str:
    """A line, and one for what makes it doubtful."""
    lines = [f"log evidence: {said(found)}"]
    if found.steps_error:
        lines.append(
            f"  of which {found.steps:+.2g} +- {found.steps_error:.1g} for the error of its steps"
        )
    if not converged:
        lines.append("  ROUGH: the ensembles did not converge")
    elif found.error > POOR and found.steps_error > 0.5 * found.error:
        lines.append("  ROUGH: the steps of the rig are long for it; a larger `model.pieces` helps")
    elif found.error > POOR:
        lines.append(
            "  ROUGH: the proposal and the posterior have little in common; longer chains would help"
        )
    if priors:
        lines.append(
            f"  VAGUE PRIORS: {', '.join(map(_wide, priors))}: each halves the evidence as often as "
            "its range is doubled, and little else may be seen in a comparison with a model that is "
            "without it; give it the range that you believe"
        )
    return "\n".join(lines)


def said(found: Evidence) -> str:
    """To as many digits as are known."""
    digits = max(0, min(4, -math.floor(math.log10(max(found.error, 1e-4)))))
    return f"{found.log_z:.{digits}f} +- {found.error:.1g}"


def _wide(one: Vague) -> str:
    if one.decades is not None:
        return f"that of {one.name} is {one.decades:.1f} decades wide"
    return f"that of {one.name} is {one.times:.0f} times as wide as what was found is large"


def as_data(found: Evidence | None, priors: Sequence[Vague]) -> dict[str, Any]:
    """For `run.json`."""
    if found is None:
        return {}
    return {
        "log_evidence": found.log_z,
        "log_evidence_error": found.error,
        "log_evidence_overlap": found.overlap,
        **(
            {"log_evidence_steps": found.steps, "log_evidence_steps_error": found.steps_error}
            if found.steps_error
            else {}
        ),
        "vague_priors": [one.name for one in priors],
    }


def of_data(run: Mapping[str, Any]) -> Evidence | None:
    """What `as_data` has left in `run.json`."""
    try:
        return Evidence(
            log_z=float(run["log_evidence"]),
            error=float(run["log_evidence_error"]),
            overlap=float(run["log_evidence_overlap"]),
            steps=float(run.get("log_evidence_steps", 0.0)),
            steps_error=float(run.get("log_evidence_steps_error", 0.0)),
        )
    except (KeyError, TypeError, ValueError):
        return None
