"""Priors that are too wide for an evidence to mean much, and what is said of it."""

from __future__ import annotations

import dataclasses

import numpy as np
from support.case_tables import run_cases

from bayesdrill.analysis.plausibility import DiffusePrior, diffuse_priors
from bayesdrill.inference.priors import (
    HalfNormal,
    LogNormal,
    LogUniform,
    Prior,
    TruncatedNormal,
    Uniform,
)
from bayesdrill.report.sections import verdict_words
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.tasks import run_entries

RNG = np.random.default_rng(6)
SHARP = 0.05 * (1.0 + 0.01 * RNG.standard_normal(4000))


@run_cases(
    "prior, wide",
    [
        (LogUniform(0.01, 1.0), False),
        (LogUniform(1e-3, 1e1), True),
        (LogNormal(0.05, 3.0), True),
        (Uniform(0.02, 0.1), False),
        (Uniform(0.0, 1.0), False),
        (Uniform(0.0, 100.0), True),
        (HalfNormal(0.1), False),
        (HalfNormal(30.0), True),
        (TruncatedNormal(0.0, 1.0, low=-np.inf), False),
        (TruncatedNormal(0.0, 30.0, low=-np.inf), True),
    ],
)
def test_a_prior_far_wider_than_what_is_found_is_vague(prior: Prior, wide: bool) -> None:
    """Mutants killed: half-normals in decades, of which they always have many; sds of logs alone."""
    found = diffuse_priors(SHARP[:, None], {"x": prior})
    assert [one.name for one in found] == (["x"] if wide else [])


def test_what_the_record_leaves_alone_costs_nothing_however_wide() -> None:
    """Mutant killed: all wide priors alike."""
    prior = LogUniform(1e-3, 1e1)
    left = prior.quantile(RNG.random(4000))
    assert [*diffuse_priors(left[:, None], {"x": prior})] == []


def test_as_many_digits_as_are_known_and_what_makes_them_doubtful() -> None:
    good = Evidence(log_z=3535.61044, error=0.0046, overlap=0.6)
    assert (
        verdict_words.evidence_sentences(good, (), converged=True)
        == "log evidence: 3535.610 +- 0.005"
    )
    rough = Evidence(log_z=3535.61044, error=0.3, overlap=0.01)
    said = verdict_words.evidence_sentences(
        rough, (DiffusePrior(name="c_s", decades=4.0),), converged=True
    )
    assert "3535.6 +- 0.3" in said
    assert "ROUGH" in said
    assert "that of c_s is 4.0 decades wide" in said
    assert "ROUGH" in verdict_words.evidence_sentences(good, (), converged=False)
    stepped = dataclasses.replace(rough, steps=-0.41, steps_error=0.29)
    said = verdict_words.evidence_sentences(stepped, (), converged=True)
    assert "of which -0.41 +- 0.3 for the error of its steps" in said
    assert "ROUGH: the steps of the rig are long for it" in said


def test_what_a_run_has_left_is_read_back() -> None:
    one = Evidence(log_z=-1.0 / 3.0, error=0.01, overlap=0.5)
    stepped = dataclasses.replace(one, steps=0.2, steps_error=0.009)
    for found in (one, stepped):
        assert run_entries.evidence_of_data(run_entries.evidence_data(found, ())) == found
    assert run_entries.evidence_of_data({}) is None
    forged = run_entries.evidence_data(one, ()) | {"log_evidence": "nan"}
    assert run_entries.evidence_of_data(forged) is None
    assert run_entries.evidence_data(None, ()) == {}
