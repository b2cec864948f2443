"""A finished run as tables and figures look at it; each thing is made once, when asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import bayesdrill
from bayesdrill.analysis.run_analysis import RunAnalysis, RunDraws
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.units import Unit
from bayesdrill.basics.values import Value
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.derived import Derived
from bayesdrill.inference.display_units import DisplayedUnknowns, DisplayUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import section, words
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.sections import fit_words, verdict_words
from bayesdrill.results import provenance
from bayesdrill.sampling.ensembles import Sampled
from bayesdrill.sampling.mode_search import Mode

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import DataTree


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure to be drawn, perhaps by another process: what draws it, and what it is given.

    `says`: what is seen in it, for its caption and for those who do not see it.
    """

    figure: Callable[..., Figure]
    arguments: tuple[Any, ...] = ()
    says: str = ""

    def drawn(self) -> Figure:
        return self.figure(*self.arguments)


def captioned(label: str, says: str) -> str:
    return f"{label}: {says}" if label else says


def for_each_experiment(
    figure: Callable[[Any, float], Figure],
    shown: Iterable[tuple[str, Any]],
    width: float,
    says: str,
) -> tuple[Drawing, ...]:
    """A drawing of what is `shown` of each, by its label."""
    return tuple(Drawing(figure, (one, width), says=captioned(label, says)) for label, one in shown)


@dataclass(frozen=True, eq=False)
class View(Value):
    """`chain`: its draws; `analysis`: all that is said of it; `seconds`: how long its parts took, where
    that is known.
    """

    chain: RunDraws
    config: Config
    analysis: RunAnalysis
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def problem(self) -> Problem:
        return self.chain.problem

    @property
    def mode(self) -> Mode:
        return self.chain.mode

    @property
    def sampled(self) -> Sampled:
        return self.chain.sampled

    @property
    def draws(self) -> Array:
        """`(N, D)`, of all ensembles."""
        return self.chain.draws

    @property
    def warning(self) -> str:
        """What every figure must carry; empty where there is nothing to warn of."""
        return words.warning(self.sampled, self.analysis.fit)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the result must not be believed: it did not converge, or does not fit."""
        return words.reasons(self.sampled, self.analysis.fit)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on priors, record and rig that are no reason to doubt the draws."""
        found = self.analysis
        others = (
            *verdict_words.not_kept(self.sampled.beyond),
            *fit_words.moment(found.moment),
            *found.course,
            *found.rig,
            *(f"record: {one}" for one in words.record_made(self.problem)),
            *(f"record, {one}" for one in found.suspicions),
        )
        return (*section.notes(found.unknowns, self.units), *(f"note: {one}" for one in others))

    @cached_property
    def marks(self) -> Mapping[str, str]:
        """For the inside of figures and tree."""
        c = self.sampled.convergence
        return provenance.marks(self.config, self.problem, f"{c.burn_in} of {c.steps} steps")

    @property
    def names_of_rig(self) -> tuple[str, ...]:
        """Of which products are made."""
        return () if self.analysis.judged is None else self.analysis.judged.study.names

    @cached_property
    def derived(self) -> Derived:
        """Draws of what follows from the unknowns."""
        return self.chain.derived(self.analysis.judged)

    @property
    def width(self) -> float:
        """Of figures, inches."""
        return WIDTHS[self.config.output.size]

    @property
    def units(self) -> DisplayUnits:
        """In which people are shown unknowns and what follows from them."""
        return self.problem.units

    @property
    def clock(self) -> Unit:
        """In which people are told times."""
        return self.problem.clock

    def shown(self, names: Sequence[str] | None = None) -> DisplayedUnknowns:
        """For figures: the unknowns of these names, or all where none is among them."""
        problem, own = self.problem, self.units
        every = range(len(problem.symbols))
        chosen = [k for k in every if problem.names[k] in (names or ())] or every
        picked = [problem.symbols[k] for k in chosen]
        return DisplayedUnknowns(
            columns=tuple(chosen),
            factors=own.factors(picked),
            symbols=own.symbols(picked),
            priors=own.priors(problem.posterior.space.priors),
            nominal=own.values(problem.nominal),
            mode=own.values(self.mode.values),
        )

    @cached_property
    def tree(self) -> DataTree:
        """For ArviZ."""
        # Late: xarray takes half a second to load.
        from bayesdrill.results.arviz_tree import make_tree

        c = self.sampled.convergence
        attributes = {
            **{name.lower(): value for name, value in self.marks.items()},
            "name": self.config.name,
            "creation_library": "bayesdrill",
            "creation_library_version": bayesdrill.__version__,
            "inference_library": "emcee",
            "chain_is": "an independent ensemble",
            "steps": c.steps,
            "burn_in": c.burn_in,
            "thin": c.thin,
            "converged": int(c.converged),
            "seed": self.config.seed,
            "sample_dims": ["chain", "draw"],
        }
        return make_tree(
            self.problem,
            self.sampled,
            words.predictive_draws(self.problem, self.config),
            seeds.stream(self.config.seed, "predictive"),
            seeds.stream(self.config.seed, "prior"),
            attributes,
            self.derived,
        )
