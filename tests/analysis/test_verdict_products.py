"""Products that a verdict looks at where unknowns are in no table.

Of each rig the posterior of a record is exact: Gaussian in the logs, by the information of its study.
"""

import numpy as np
import pytest
from support.case_tables import slow_except
from support.linear_study import off_by

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.analysis.identifiability.study import IdentifiabilityStudy, study_of
from bayesdrill.analysis.verdict import Verdict, basis, judge
from bayesdrill.config.job import Job
from bayesdrill.config.schema.config import IdentifySpec
from benchmarks.rates import simulated_posteriors
from benchmarks.zoo import entries as e


def up_to(high: float) -> e.Entry:
    return {"prior": "uniform", "low": 0.0, "high": high}


WEIGHED = {"prior": "normal", "mean": 1.0, "sd": 0.01, **e.RELATIVE}
RIGS = {
    "no friction": e.parameters(e.box()),
    "one weighed": e.parameters(e.box(), j_1=WEIGHED),
    "friction": e.parameters(e.box(), t_f=0.0, t_cm=up_to(0.2), t_c1=up_to(1.0)),
    "friction and damping": e.parameters(
        e.box(), t_f=0.0, t_cm=up_to(0.2), c_s={"prior": "log_uniform", "low": 1e-4, "high": 0.1}
    ),
}


def study(job: Job, values: dict[str, float]) -> IdentifiabilityStudy:
    posterior = job.problem.posterior
    theta = posterior.space.vector({**posterior.space.start, **values})
    return study_of(
        SensitivityStudy(posterior.likelihood),
        posterior,
        theta,
        job.config.identify,
        job.config.seed,
    )


@pytest.fixture(scope="module", params=slow_except(("friction",), RIGS))
def rig(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> IdentifiabilityStudy:
    row = simulated_posteriors.row(RIGS[request.param])
    true = {"t_cm": 0.03, "t_c1": 0.2, "c_s": 3e-3}
    own = {name: x for name, x in true.items() if name in row.config["parameters"]}
    row = simulated_posteriors.replace(row, config={**row.config, "simulation": own})
    job = simulated_posteriors.built(tmp_path_factory.mktemp("rig"), row)
    return study(job, {**job.problem.nominal, **own})


def table_names(study: IdentifiabilityStudy) -> list[str]:
    return [name for name in study.names if name not in ("t_cm", "t_c1", "t_s1", "w_s1", "c_s")]


def verdict(study: IdentifiabilityStudy, **deviations: float) -> Verdict:
    """Return that on the most likely record of a rig with these relative deviations from its table."""
    priors = np.array([one.prior_sd for one in study.parameters])
    known = study.information.root.T @ study.information.root
    covariance = np.linalg.inv(known + np.diag(priors**-2.0))
    truth = np.log1p([deviations.get(name, 0.0) for name in study.names])
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(covariance)
    draws = covariance @ known @ truth + rng.standard_normal((4000, len(truth))) @ root.T
    prior = priors * rng.standard_normal((20_000, len(truth)))
    table = dict.fromkeys(table_names(study), 1.0)
    return judge(study, np.exp(draws), np.exp(prior), table, {}, (), IdentifySpec())


def test_products_span_all_that_no_symmetry_changes(rig: IdentifiabilityStudy) -> None:
    """They are of the table's unknowns alone: as many as these, less the symmetries that they have."""
    own = np.array([name in table_names(rig) for name in rig.names])
    symmetries = np.array(rig.structure.symmetries, dtype=float)
    powers = np.array(basis(rig, table_names(rig)), dtype=float)
    assert not (powers @ symmetries.T).any()
    assert not powers[:, ~own].any()
    free = own.sum() - np.linalg.matrix_rank(symmetries[:, own])
    assert np.linalg.matrix_rank(powers) == len(powers) == free
    spring = [{"k_s": 1, "j_1": -1}.get(name, 0) for name in rig.names]
    assert spring in powers[:2].tolist()


def test_a_value_of_the_table_that_is_off_disagrees(rig: IdentifiabilityStudy) -> None:
    """Each in turn by 10 %, where any product shows it; and nothing does where nothing is off."""
    shown = [name for name, sigmas in off_by(rig, table_names(rig), 0.1).items() if sigmas > 6]
    assert {"j_m", "k_s", "j_1"} <= {*shown}
    assert len(shown) >= 5
    assert [name for name in shown if verdict(rig, **{name: 0.1}).agrees] == []
    assert verdict(rig).agrees
