"""The bundled example of several experiments: its records are what `simulate` makes of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.api.files import FILES
from bayesdrill.config import loading
from bayesdrill.config.job import prepare
from bayesdrill.config.records import simulation
from bayesdrill.tasks import identify

CONFIGS = Path(__file__).parents[2] / "configs"
EXAMPLE = CONFIGS / "example_experiments.yaml"


def test_its_records_are_what_simulate_makes() -> None:
    """The voltage of the second is its own, and stays."""
    case = loading.load(EXAMPLE)
    made = simulation.simulate_all(case, case.config.seed)
    assert [path.name for path in made] == ["example_step.csv", "example_rundown.csv"]
    for path, text in made.items():
        assert text == path.read_text()
    assert {"example_experiments.yaml", "records/example_step.csv"} <= set(FILES)


@pytest.mark.slow
def test_what_it_was_made_with_is_plausible_and_its_start_is_not() -> None:
    """Misfit per number: 1 where only noise is left."""
    job = prepare(EXAMPLE)
    posterior = job.problem.posterior
    truth = dict(job.problem.nominal) | {"gain_twist": 1.06, "lag_twist": 0.018, "t_0_step": 0.035}
    theta = posterior.space.vector(truth)[None]
    n = posterior.likelihood.n_measured
    assert abs(posterior.likelihood.mean_square(theta)[0] - 1) < 4 * np.sqrt(2 / n)
    start = posterior.space.vector(posterior.space.start)[None]
    assert posterior.likelihood.mean_square(start)[0] > 20
    said = identify.preflight(job, SensitivityStudy(posterior.likelihood))
    first, resting = said.splitlines()
    assert first == "the record determines every unknown"
    assert resting.startswith("k_s, j_1 and t_f depend on j_m, c_m and k_T, which the config holds")
