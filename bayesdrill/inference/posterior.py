"""The log posterior over unknowns and over the sampler's coordinates, with names and nominal
values (a `Problem`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.formulas import Expression
from bayesdrill.basics.symbols import Symbol
from bayesdrill.basics.units import SECOND, Unit
from bayesdrill.inference.display_units import SI, OwnUnits
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.unknowns import Coordinates, ParameterSpace
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Posterior:
    """Unnormalised posterior (normalised prior times normalised likelihood).

    `posterior(z: (W, D)) -> (W,)` is the density over the coordinates, Jacobian included: finite
    or -inf, never NaN.  `evaluate` also counts the failures.
    """

    space: ParameterSpace
    likelihood: Likelihood
    coordinates: Coordinates

    def __call__(self, z: Array) -> Array:
        return self.evaluate(z)[0]

    def evaluate(self, z: Array) -> tuple[Array, int]:
        """Log density over `z` and the number of walkers inside the prior whose model failed."""
        theta, log_jacobian = self.coordinates.with_jacobian(z)
        log_p, failures = self._density(theta)
        inside = log_p > -np.inf
        log_p[inside] += log_jacobian[inside]
        return log_p, failures

    def supports(self, z: Array) -> NDArray[np.bool_]:
        """Whether the priors have a density at `z (W, D)`: `(W,)`, without asking the model."""
        theta = self.coordinates.to_physical(z)
        return np.asarray(self.space.log_prior(theta) > -np.inf)

    def density(self, theta: Array) -> Array:
        """Log density over the physical unknowns `(W, D)`, whose maximum is the MAP: `(W,)`."""
        return self._density(theta)[0]

    def _density(self, theta: Array) -> tuple[Array, int]:
        log_p = self.space.log_prior(theta)
        log_p[np.isnan(log_p)] = -np.inf
        inside = np.flatnonzero(log_p > -np.inf)  # the model is not asked outside the prior
        if len(inside) == 0:
            return log_p, 0
        log_p[inside] += self.likelihood(theta[inside])
        failed = np.isnan(log_p)
        log_p[failed] = -np.inf
        return log_p, int(failed.sum())


@dataclass(frozen=True, slots=True)
class Formula:
    symbol: Symbol
    expression: Expression


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """All that inference needs: `symbols` of the unknowns and their nominal values (if any).

    `published`: names whose nominal value a table gives; `tolerance`: relative, of nominal values;
    `derived`: formulas of the config's own, beside what is always derived; `units` in which people are
    shown unknowns and what follows from them, and `clock`, times; `compared_with`: what the nominal
    values are called in sentences.
    """

    posterior: Posterior
    symbols: tuple[Symbol, ...]
    nominal: Mapping[str, float]
    published: frozenset[str] = frozenset()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    derived: tuple[Formula, ...] = ()
    units: OwnUnits = SI
    clock: Unit = SECOND
    compared_with: str = ""

    @property
    def observations(self) -> tuple[Observation, ...]:
        return self.posterior.likelihood.observations

    @property
    def every(self) -> tuple[Observation, ...]:
        """Those that are held out as a whole, too."""
        return (*self.observations, *self.posterior.likelihood.apart)

    @property
    def experiment(self) -> Experiment:
        """The only one; raises `ValueError` where there are more."""
        return self.posterior.likelihood.alone.experiment

    @property
    def model(self) -> Model:
        """The rig, which all observations share."""
        return self.observations[0].response.model

    @property
    def names(self) -> tuple[str, ...]:
        return self.posterior.space.free
