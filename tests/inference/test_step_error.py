"""How fine steps are: chosen from the noise, by errors that are those from the oracle."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import run_cases
from support.friction_cases import CASES, moved
from support.small_problems import posterior_of
from support.stepped_friction import experiment_of, model_of, parameters

from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.step_error import (
    CANDIDATE_STEPS,
    MAX_ERROR_OVER_NOISE,
    choose_steps,
    step_errors,
)
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

NAME = "falling"  # the friction falls with the speed
CASE = CASES[NAME]


def stepped(substeps: int, reversal_substeps: int = REVERSAL_SUBSTEPS) -> Stepped:
    experiment, sensing = experiment_of(CASE), ObservationModel()
    return Stepped(model_of(CASE), experiment, sensing, substeps, reversal_substeps)


def posterior(sigma: float, substeps: int = 1) -> Posterior:
    """Return one without unknowns."""
    rig = stepped(substeps)
    values = dict(zip(rig.model.parameters, parameters(CASE)[0], strict=True))
    return posterior_of(rig, [sigma] * len(rig.experiment.channels), {}, values)


def errors_from_oracle(rig: Stepped) -> np.ndarray:
    """Return the largest distance of each state from the oracle `(K,)`."""
    return np.asarray(np.abs(rig.signals(parameters(CASE))[0] - moved(NAME).states).max(axis=0))


@run_cases("substeps", [1, 4])
def test_errors_are_those_from_the_oracle_in_sds_of_the_noise(substeps: int) -> None:
    (result,) = step_errors(posterior(0.03, substeps).likelihood, np.zeros(0))
    assert result.pieces == substeps
    expected = errors_from_oracle(stepped(substeps)) / 0.03
    assert np.array(result.errors) == pytest.approx(expected, rel=0.05)


@run_cases("sigma", [0.5, 0.3, 0.01])
def test_the_fewest_steps_are_chosen_whose_error_is_small_beside_the_noise(sigma: float) -> None:
    response = choose_steps(posterior(sigma), np.zeros(0)).likelihood.only_observation.response
    chosen = response.pieces, response.turns
    limit = MAX_ERROR_OVER_NOISE * sigma
    assert errors_from_oracle(stepped(*chosen)).max() < limit
    for fewer in CANDIDATE_STEPS[: CANDIDATE_STEPS.index(chosen)]:
        assert errors_from_oracle(stepped(*fewer)).max() > 0.5 * limit
