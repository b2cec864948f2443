"""The structure of a posterior, looked at where its priors are, and proven there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.posterior import Posterior
from bayesdrill.insight.identifiability import structure
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.identifiability.structure import Exponents, Structure

Array = NDArray[np.float64]

PRIOR_POINTS = 4  # beside the start: where symmetries are looked for and proven
MOST_DRAWS = 100  # of the prior, to find that many with a finite response


def structure_of(
    posterior: Posterior, scenery: Scenery, theta: Array, rng: np.random.Generator
) -> Structure:
    """At `theta (D,)` and at draws from the prior."""
    drawn = posterior.space.draw(MOST_DRAWS, rng)
    finite = drawn[np.isfinite(posterior.density(drawn))][:PRIOR_POINTS]
    points = np.vstack([theta, finite])
    likelihood = posterior.likelihood
    here = likelihood.every_signal(points)

    def unchanged(exponents: Exponents) -> bool:
        there = likelihood.every_signal(structure.doubled(points, exponents))
        return all(map(structure.same_response, here, there))

    sensitivities = [scenery.sensitivities(point) for point in points]
    return structure.analyse(scenery.unknowns, sensitivities, unchanged)
