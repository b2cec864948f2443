"""Define the posterior density: unknowns, priors, noise, likelihood, and slopes.

The package `sampling` explores a density, and `analysis` interprets its draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayesdrill.basics.registry import lazy_attributes

if TYPE_CHECKING:
    from bayesdrill.inference.derived import HDI_PROBABILITY as HDI_PROBABILITY
    from bayesdrill.inference.derived import hdi as hdi
    from bayesdrill.inference.noise.contract import NoisyChannel as NoisyChannel
    from bayesdrill.inference.noise.contract import Residuals as Residuals
    from bayesdrill.inference.noise.white import White as White
    from bayesdrill.inference.posterior import Likelihood as Likelihood
    from bayesdrill.inference.posterior import Posterior as Posterior
    from bayesdrill.inference.priors import Uniform as Uniform
    from bayesdrill.inference.unknowns import Coordinates as Coordinates
    from bayesdrill.inference.unknowns import ParameterSpace as ParameterSpace
    from bayesdrill.inference.unknowns import Unknown as Unknown

__getattr__ = lazy_attributes(__name__)
