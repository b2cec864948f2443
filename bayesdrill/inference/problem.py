"""A posterior with the names and the nominal values of its unknowns: what is asked of a record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesdrill.basics.formulas import Expression
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import Model


@dataclass(frozen=True, slots=True)
class Formula:
    symbol: Symbol
    expression: Expression


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """All that inference needs: `symbols` of the unknowns and their nominal values (if any).

    `published`: names whose nominal value a table gives; `tolerance`: relative, of nominal values;
    `derived`: formulas of the config's own, beside what is always derived.
    """

    posterior: Posterior
    symbols: tuple[Symbol, ...]
    nominal: Mapping[str, float]
    published: frozenset[str] = frozenset()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    derived: tuple[Formula, ...] = ()

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
