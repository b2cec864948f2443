"""Verdicts on simulated records whose truth is known: false alarms, and models that are wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.case_tables import run_cases
from support.linear_study import off_by

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.study import study_of
from bayesdrill.config.records import simulation
from benchmarks.rates import simulated_posteriors
from benchmarks.rates.simulated_posteriors import Trial
from benchmarks.zoo import entries as e
from benchmarks.zoo.friction import DryFriction
from benchmarks.zoo.row import Row
from benchmarks.zoo.texts import changed

RECORDS = 200
MOST_ALARMS = 7  # of 200 at a rate of 1 %: more have a probability of 1 in 1000
MISFITS = 100
HELD = {"j_1": "nominal", "r_m": "nominal"}
SEVEN = e.parameters(e.box(), **HELD)
COULOMB = {"t_cm": {"prior": "uniform", "low": 0.0, "high": 0.2}}
BOTH = {**COULOMB, "t_c1": {"prior": "uniform", "low": 0.0, "high": 1.0}}
DAMPED = {**COULOMB, "c_s": {"prior": "log_uniform", "low": 1e-4, "high": 0.1}}
TRUTH = {"t_cm": 0.03, "t_c1": 0.2, "c_s": 3e-3}  # of what no table names
RUBS = [e.parameters(e.box(), t_f=0.0, **own) for own in (BOTH, DAMPED)]
OFF = 0.1
WEIGHED = e.parameters(e.box(), j_m="nominal", k_s="nominal", j_1="nominal")
BEGINS, ENDS = e.box(1.0, 1.5), e.box(0.5, 1.0)


@pytest.mark.slow
def test_two_parameters_that_are_off_disagree_and_no_others(tmp_path: Path) -> None:
    job = simulated_posteriors.built(tmp_path, simulated_posteriors.row(SEVEN))
    off = {name: 1.2 * job.problem.nominal[name] for name in ("k_s", "j_m")}
    verdict, reasons = Trial(job, simulated_posteriors.truly(job, **off)).concluded(3)
    assert not reasons
    found = {
        verdict.names[q.exponents.index(1)]: q
        for q in verdict.parameters
        if sum(map(abs, q.exponents)) == 1
    }
    assert found["k_s"].says == found["j_m"].says == "disagrees"
    assert found["k_s"].mean == pytest.approx(off["k_s"], rel=1e-2)
    assert found["j_m"].mean == pytest.approx(off["j_m"], rel=0.05)
    others = {q.says for name, q in found.items() if name not in off}
    assert others <= {"agrees", "not determined"}


@pytest.mark.slow
@run_cases(
    "parameters",
    [
        SEVEN,
        e.parameters("nominal", k_s=BEGINS),
        e.parameters("nominal", k_s=BEGINS, k_e=ENDS),
        e.parameters("nominal", k_s=BEGINS, k_e=ENDS, j_m=BEGINS, c_m=ENDS, r_m=e.box()),
        e.parameters(BEGINS),
        *RUBS,
    ],
    ids=["seven, around nominal", "one", "two", "five", "nine", "friction", "friction, damped"],
)
def test_nominal_records_rarely_disagree(tmp_path: Path, parameters: e.Entry) -> None:
    """At most 1 % of them, as the verdict says, wherever the priors end.

    Mutants killed: a limit of 1.96 sigma; values at ends of their priors are judged.
    """
    job = simulated_posteriors.built(tmp_path, made(parameters))
    found = simulated_posteriors.outcomes(
        Trial(job, simulated_posteriors.truly(job, **true(job))), range(RECORDS)
    )
    alarms = sum(one.disagrees for one in found)
    print(f"{alarms} of {RECORDS} nominal records disagree")
    assert alarms <= MOST_ALARMS
    assert sum(one.believed for one in found) >= 0.95 * RECORDS
    assert sum(one.fits for one in found) >= 0.95 * RECORDS


def true(job: simulated_posteriors.Job) -> dict[str, float]:
    return {name: TRUTH[name] for name in job.problem.names if name in TRUTH}


def made(parameters: e.Entry) -> Row:
    """Its record with what no table names."""
    row = simulated_posteriors.row(parameters)
    values = {name: TRUTH[name] for name in parameters if name in TRUTH}
    return simulated_posteriors.replace(row, config={**row.config, "simulation": values})


@pytest.mark.slow
@run_cases("parameters", [SEVEN, *RUBS], ids=["seven", "friction", "damped"])
def test_a_value_of_the_table_that_is_off_is_told(tmp_path: Path, parameters: e.Entry) -> None:
    """Each in turn by 10 %, where a product that the record determines is off by 7 sigma and more.

    Mutant killed: products of the table's unknowns that lose their place to products with friction.
    """
    job = simulated_posteriors.built(tmp_path, made(parameters))
    posterior = job.problem.posterior
    theta = posterior.space.vector({**job.problem.nominal, **true(job)})
    found = study_of(
        SensitivityStudy(posterior.likelihood),
        posterior,
        theta,
        job.config.identify,
        job.config.seed,
    )
    named = [name for name in found.names if name in job.problem.nominal]
    shown = [name for name, sigmas in off_by(found, named, OFF).items() if sigmas > 7]
    assert len(shown) >= 4
    for seed, name in enumerate(shown):
        off = {name: (1 + OFF) * job.problem.nominal[name]}
        verdict, _ = Trial(job, simulated_posteriors.truly(job, **true(job), **off)).concluded(seed)
        assert not verdict.agrees, name


def late(clean: np.ndarray) -> np.ndarray:
    """Speeds a sample behind."""
    seen = clean.copy()
    seen[1:, 2:] = clean[:-1, 2:]
    return seen


def amplified(clean: np.ndarray) -> np.ndarray:
    return clean * np.array([1.0, 1.0, 1.05, 1.0])


def rubbed(job: simulated_posteriors.Job) -> np.ndarray:
    (one,), experiment = job.case.experiments, job.problem.experiment
    friction = DryFriction(motor=0.01, sliding=0.05, sticking=0.08)
    x = friction.states(1 / 8, simulation.truth(one), experiment.t, experiment.series["v"])
    return x[:, :4]


@pytest.mark.slow
@run_cases("wrong", ["lag", "gain", "friction", "gear", "correlated noise"])
def test_a_wrong_model_does_not_blame_the_table(tmp_path: Path, wrong: str) -> None:
    """The nominal table is the truth, and something else is wrong: the fit shows it, and the table
    is in doubt at most.  Mutant killed: a verdict that does not ask whether the rig fits.

    A wrong gear shows where what it turns was weighed: other inertias imitate it to the last digit.
    """
    one = simulated_posteriors.row(WEIGHED if wrong == "gear" else SEVEN)
    job = simulated_posteriors.built(tmp_path, one)
    clean, memory = simulated_posteriors.truly(job), 0.0
    if wrong == "lag":
        clean = late(clean)
    elif wrong == "gain":
        clean = amplified(clean)
    elif wrong == "friction":
        clean = rubbed(job)
    elif wrong == "gear":
        other = changed(one.config, {"model.i_m": 1 / 7.5})
        clean = simulated_posteriors.truly(
            simulated_posteriors.built(
                tmp_path / "other", simulated_posteriors.replace(one, config=other)
            )
        )
    else:
        memory = 0.6
    found = simulated_posteriors.outcomes(Trial(job, clean, memory), range(MISFITS))
    shown = sum(not one.fits or not one.believed for one in found)
    blamed = sum(one.disagrees for one in found)
    print(f"{wrong}: fit shows it in {shown}, table blamed in {blamed} of {MISFITS}")
    assert shown >= 0.95 * MISFITS
    assert blamed <= 0.01 * MISFITS
