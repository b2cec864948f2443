"""Collect the contents of tables and figures of a finished run, each computed at its first use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import bayesdrill
from bayesdrill.analysis.run_analysis import RunAnalysis, RunDraws
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.equality import Value
from bayesdrill.basics.findings import Finding
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.derived import Derived
from bayesdrill.inference.display_units import DisplayedUnknowns, DisplayUnits
from bayesdrill.inference.posterior import Problem
from bayesdrill.report import words
from bayesdrill.report.doubts import describe_timing, figure_warning, prior_notes, run_doubts
from bayesdrill.report.findings import finding_sentences
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import Picture, Section
from bayesdrill.results import provenance
from bayesdrill.sampling.ensembles import MOST_MISSED, SamplingResult
from bayesdrill.sampling.mode_search import Mode

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import DataTree


@dataclass(frozen=True, slots=True)
class Drawing:
    """A drawing has a function that draws a figure, perhaps in another process, with `arguments`.

    `says` describes the figure, for its caption and for readers who do not see it.
    """

    figure: Callable[..., Figure]
    arguments: tuple[Any, ...] = ()
    says: str = ""

    def drawn(self) -> Figure:
        """Draw the figure."""
        return self.figure(*self.arguments)


type Recipe = Callable[[ReportContext], Drawing | tuple[Drawing, ...] | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportPart:
    """A report part is the contribution of one module to the report of a run.

    `sections` returns the part's text, with given pictures. `figures` has the function that
    draws each figure, by name. `files` has the function that returns the text of each table, by
    file name; the function returns None if a run has no such table.
    """

    sections: Callable[[ReportContext, Sequence[Picture]], Iterable[Section]]
    figures: Mapping[str, Recipe] = field(default_factory=dict)
    files: Mapping[str, Callable[[ReportContext], str | None]] = field(default_factory=dict)


def for_each_experiment(
    figure: Callable[[Any, float], Figure],
    items: Iterable[tuple[str, Any]],
    width: float,
    caption: str,
) -> tuple[Drawing, ...]:
    """Return a drawing for each pair (label, data) in `items`; a label begins the caption."""
    return tuple(
        Drawing(figure, (data, width), says=f"{label}: {caption}" if label else caption)
        for label, data in items
    )


@dataclass(frozen=True, eq=False)
class ReportContext(Value):
    """The context is a finished run, as tables and figures need it.

    `chain` has its draws. `analyse` computes its analysis at the first use. `seconds` has the
    duration of each part of the run, if known.
    """

    chain: RunDraws
    config: Config
    analyse: Callable[[RunDraws], RunAnalysis] = field(compare=False, repr=False)
    seconds: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def analysis(self) -> RunAnalysis:
        """Return the analysis of the run, which is evaluated once."""
        return self.analyse(self.chain)

    @property
    def problem(self) -> Problem:
        """Return the posterior with the names of its unknowns."""
        return self.chain.problem

    @property
    def mode(self) -> Mode:
        """Return the maximum of the posterior."""
        return self.chain.mode

    @property
    def sampled(self) -> SamplingResult:
        """Return the chains."""
        return self.chain.sampled

    @property
    def draws(self) -> Array:
        """Return the draws `(N, D)` of all ensembles."""
        return self.chain.draws

    @property
    def warning(self) -> str:
        """Return the warning that every figure must carry; it may be empty."""
        return figure_warning(self.sampled, self.chain.fit)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return reasons not to believe the result: it did not converge, or does not fit."""
        return run_doubts(self.sampled, self.analysis.fit, self.analysis.unsupported)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences on priors, record and rig that give no reason to doubt the draws."""
        analysis = self.analysis
        missed = Finding("some missed", {}, {"percent": 100 * self.sampled.missed})
        others = (
            *finding_sentences([missed] if 0 < self.sampled.missed <= MOST_MISSED else ()),
            *describe_timing(analysis.moment),
            *finding_sentences((*analysis.course, *analysis.rig)),
            *(f"record: {sentence}" for sentence in words.record_made(self.problem)),
            *(f"record, {sentence}" for sentence in finding_sentences(analysis.suspicions)),
        )
        return (
            *prior_notes(analysis.unknowns, self.units),
            *(f"note: {sentence}" for sentence in others),
        )

    @cached_property
    def marks(self) -> Mapping[str, str]:
        """Return the metadata of figures and of the ArviZ tree."""
        c = self.sampled.convergence
        return provenance.marks(self.config, self.problem, f"{c.burn_in} of {c.steps} steps")

    @cached_property
    def derived(self) -> Derived:
        """Return the draws of derived quantities."""
        return self.chain.derived(self.analysis.judged)

    @property
    def width(self) -> float:
        """Return the width of figures in inches."""
        return WIDTHS[self.config.output.size]

    @property
    def units(self) -> DisplayUnits:
        """Return the units in which unknowns and derived quantities are shown."""
        return self.problem.units

    def shown(self, names: Sequence[str] | None = None) -> DisplayedUnknowns:
        """Return the displayed unknowns with these names, or all if no name is that of an unknown."""
        problem, display_units = self.problem, self.units
        columns = range(len(problem.symbols))
        selected = [k for k in columns if problem.names[k] in (names or ())] or columns
        picked = [problem.symbols[k] for k in selected]
        return DisplayedUnknowns(
            columns=tuple(selected),
            factors=display_units.factors(picked),
            symbols=display_units.symbols(picked),
            priors=display_units.priors(problem.posterior.space.priors),
            nominal=display_units.values(problem.nominal),
            mode=display_units.values(self.mode.values),
        )

    @cached_property
    def tree(self) -> DataTree:
        """Return the tree of draws for ArviZ."""
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
