"""The density: unknowns, priors, noise, likelihood, posterior, and its slopes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.late import late

if TYPE_CHECKING:
    from bayesdrill.inference.coordinates import Coordinates as Coordinates
    from bayesdrill.inference.likelihood import Likelihood as Likelihood
    from bayesdrill.inference.posterior import Posterior as Posterior
    from bayesdrill.inference.unknowns import ParameterSpace as ParameterSpace

__getattr__ = late(
    __name__,
    {
        "Coordinates": "coordinates",
        "Likelihood": "likelihood",
        "ParameterSpace": "unknowns",
        "Posterior": "posterior",
    },
)
