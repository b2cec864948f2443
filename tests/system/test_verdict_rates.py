"""Verdicts on simulated records whose nominal values are true; `benchmarks/rates/` counts more."""

from __future__ import annotations

from pathlib import Path

from support import simulated_posteriors
from support.simulated_posteriors import Trial

from benchmarks.zoo import entries as e

BEGINS, ENDS = e.box(1.0, 1.5), e.box(0.5, 1.0)


def test_no_nominal_value_at_an_end_of_its_prior_disagrees(tmp_path: Path) -> None:
    """Six records of a rig at its nominal values; mutant killed: draws that no end lets pass count."""
    job = simulated_posteriors.built(
        tmp_path, simulated_posteriors.row(e.parameters("nominal", k_s=BEGINS, k_e=ENDS))
    )
    trial = Trial(job, simulated_posteriors.truly(job))
    for seed in range(6):
        verdict, reasons = trial.concluded(seed)
        assert not reasons
        assert {q.says for q in (*verdict.products, *verdict.parameters)} == {"cannot judge"}
        assert verdict.ends == {name: job.problem.nominal[name] for name in ("k_s", "k_e")}
