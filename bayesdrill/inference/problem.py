"""A posterior with the names and the nominal values of its unknowns: what is asked of a record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesdrill.basics.formulas import Expression
from bayesdrill.basics.symbols import Symbol
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import Experiment


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
    def experiment(self) -> Experiment:
        return self.posterior.likelihood.response.experiment

    @property
    def names(self) -> tuple[str, ...]:
        return self.posterior.space.free
