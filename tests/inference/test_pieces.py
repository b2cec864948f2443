"""How fine steps are: chosen from the noise, and looked at where the posterior is highest."""

from __future__ import annotations

import numpy as np
import pytest
from support.case_tables import run_cases
from support.friction_cases import CASES, moved
from support.small_problems import likelihood_of
from support.stepped_friction import experiment_of, model_of, parameters

from bayesdrill.inference.noise.contract import NoisyChannel
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Likelihood, Posterior
from bayesdrill.inference.step_error import (
    CANDIDATE_STEPS,
    MAX_ERROR_OVER_NOISE,
    choose_steps,
    step_errors,
)
from bayesdrill.inference.unknowns import Coordinates, ParameterSpace
from bayesdrill.rig.simulators.contract import REVERSAL_SUBSTEPS
from bayesdrill.rig.simulators.sensors import ObservationModel
from bayesdrill.rig.simulators.stepped import Stepped

NAME = "falling"
CASE = CASES[NAME]


def likelihood(sigma: float, pieces: int = 1) -> Likelihood:
    """Of a rig whose friction falls with the speed; all is known of it."""
    model, record = model_of(CASE), experiment_of(CASE)
    noise = White.from_channels(
        [NoisyChannel(channel=c, sigma=sigma, start=sigma) for c in record.channels], len(record.t)
    )
    values = dict(zip(model.parameters, parameters(CASE)[0], strict=True))
    space = ParameterSpace(model=model.parameters, unknowns=(), fixed=values)
    return likelihood_of(space, (Stepped(model, record, ObservationModel(), pieces), noise))


def off(pieces: int, turns: int = REVERSAL_SUBSTEPS) -> np.ndarray:
    """The largest distance of each state from the oracle `(K,)`."""
    rig = Stepped(model_of(CASE), experiment_of(CASE), ObservationModel(), pieces, turns)
    return np.asarray(np.abs(rig.signals(parameters(CASE))[0] - moved(NAME).states).max(axis=0))


@run_cases("pieces", [1, 4])
def test_errors_are_those_from_the_oracle(pieces: int) -> None:
    """In sd of the noise; mutants killed: another sd, a truth that is no finer."""
    (found,) = step_errors(likelihood(0.03, pieces), np.zeros(0))
    assert found.pieces == pieces
    assert np.array(found.errors) * 0.03 == pytest.approx(off(pieces), rel=0.05)


@run_cases("sigma", [0.5, 0.3, 0.01])
def test_as_few_pieces_are_chosen_as_are_enough(sigma: float) -> None:
    posterior = Posterior(
        space=likelihood(sigma).space,
        likelihood=likelihood(sigma),
        coordinates=Coordinates((), (), ()),
    )
    response = choose_steps(posterior, np.zeros(0)).likelihood.observations[0].response
    assert isinstance(response, Stepped)
    taken = response.pieces, response.turns
    assert off(*taken).max() < MAX_ERROR_OVER_NOISE * sigma
    fewer = [off(*one).max() for one in CANDIDATE_STEPS[: CANDIDATE_STEPS.index(taken)]]
    assert all(error > 0.5 * MAX_ERROR_OVER_NOISE * sigma for error in fewer)
