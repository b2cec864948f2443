"""What is tried beside a fit is tried in its own steps: else it would explain what these do."""

from __future__ import annotations

import numpy as np
from lacking import MEASURES, believed
from rubbing_cases import CASES
from stepping import experiment_of, model_of, parameters
from together import for_each

from bayesdrill.analysis.causes import SENSORS
from bayesdrill.analysis.edits import widened
from bayesdrill.inference import step_error

CASE = CASES["falling"]


def test_what_changes_nothing_leaves_the_likelihood_as_it_is() -> None:
    """Mutant killed: what turns in a step is made in other parts than in those of the fit."""

    def check(taken: step_error.Taken) -> None:
        model = model_of(CASE)
        known = dict(zip(model.parameters, parameters(CASE)[0], strict=True))
        record = experiment_of(CASE, MEASURES)
        posterior = step_error.taking(believed(record, model, **known), {"": taken})
        theta = posterior.space.vector(known)
        wide = widened(posterior, theta, SENSORS)
        neutral = np.concatenate([theta, [one.neutral for one in wide.every]])
        assert wide.posterior.likelihood(neutral[None])[0] == posterior.likelihood(theta[None])[0]
        assert step_error.taken(wide.posterior) == {"": taken}

    for_each({str(taken): (taken,) for taken in [(1, 1), (3, 2)]}, check)
