"""What is tried beside a fit is tried in its own steps: else it would explain what these do."""

from __future__ import annotations

import numpy as np
import pytest
from lacking import MEASURES, believed
from rubbing_cases import CASES
from stepping import experiment_of, model_of, parameters

from bayesdrill.inference import pieces
from bayesdrill.insight.causes import SENSORS
from bayesdrill.insight.widened import widened

CASE = CASES["falling"]


@pytest.mark.parametrize("taken", [(1, 1), (3, 2)])
def test_what_changes_nothing_leaves_the_likelihood_as_it_is(taken: pieces.Taken) -> None:
    """Mutant killed: what turns in a step is made in other parts than in those of the fit."""
    model = model_of(CASE)
    known = dict(zip(model.parameters, parameters(CASE)[0], strict=True))
    record = experiment_of(CASE, MEASURES)
    posterior = pieces.taking(believed(record, model, **known), {"": taken})
    theta = posterior.space.vector(known)
    wide = widened(posterior, theta, SENSORS)
    neutral = np.concatenate([theta, [one.neutral for one in wide.every]])
    assert wide.posterior.likelihood(neutral[None])[0] == posterior.likelihood(theta[None])[0]
    assert pieces.taken(wide.posterior) == {"": taken}
