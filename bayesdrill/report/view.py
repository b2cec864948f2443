"""A finished run as tables and figures look at it; each thing is made once, when asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import bayesdrill
from bayesdrill.analysis import energy
from bayesdrill.analysis.causes import Causes, Instead, causes, instead
from bayesdrill.analysis.comparison import Repeat
from bayesdrill.analysis.diagnostics import Row, leaning
from bayesdrill.analysis.energy import Rubbing, rubbings
from bayesdrill.analysis.latent_torque import Shaking, shakings
from bayesdrill.analysis.plausibility import Vague, vague
from bayesdrill.analysis.verdict import Judgement
from bayesdrill.basics import seeds
from bayesdrill.basics.units import Unit
from bayesdrill.basics.values import Value
from bayesdrill.config.schema.config import Config
from bayesdrill.inference.derived import Derived, derive, summarise, with_products
from bayesdrill.inference.derived import Row as Following
from bayesdrill.inference.display_units import OwnUnits, Shown
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.residual_checks import Left, like_noise
from bayesdrill.inference.step_error import StepError, step_errors
from bayesdrill.report import words
from bayesdrill.report.scales import WIDTHS
from bayesdrill.report.section import Sparing
from bayesdrill.results import provenance
from bayesdrill.sampling.ensembles import Sampled
from bayesdrill.sampling.evidence import Evidence
from bayesdrill.sampling.mode_search import Mode

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from xarray import DataTree


Array = NDArray[np.float64]

BANDS, ACCOUNTS, PATHS = 100, 25, 300  # draws


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


@dataclass(frozen=True, eq=False)
class View(Value):
    """`rows`: of the unknowns; `left`: what the best fit leaves of each channel; `judged`: None where
    there is no table; `notes`: sentences; `repeats`: products as each of several experiments has them;
    `seconds`: how long the parts of the run took, where that is known.  `sparing` is told of derived
    quantities that fail.  `alone`: no other model of the record is tried beside it, so that the report
    is to say what could be missing.
    """

    problem: Problem
    config: Config
    mode: Mode
    sampled: Sampled
    rows: tuple[Row, ...]
    left: tuple[Left, ...]
    judged: Judgement | None
    notes: tuple[str, ...]
    repeats: tuple[Repeat, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    sparing: Sparing = field(default_factory=Sparing, compare=False)
    alone: bool = True

    @property
    def warning(self) -> str:
        """What every figure must carry; empty where there is nothing to warn of."""
        return words.warning(self.sampled, self.left)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the result must not be believed: it did not converge, or does not fit."""
        return words.reasons(self.sampled, self.left)

    @cached_property
    def marks(self) -> Mapping[str, str]:
        """For the inside of figures and tree."""
        c = self.sampled.convergence
        burn_in = f"{c.burn_in} of {c.steps} steps"
        return provenance.marks(self.config, self.problem, burn_in)

    @cached_property
    def draws(self) -> Array:
        """`(N, D)`, of all ensembles."""
        return self.sampled.draws.reshape(-1, self.sampled.draws.shape[-1])

    @cached_property
    def best(self) -> Array:
        """The MAP `(D,)`."""
        return self.problem.posterior.space.vector(self.mode.values)

    @cached_property
    def causes(self) -> Causes | None:
        """What would explain a fit that leaves more than noise."""
        if like_noise(self.left) or not self.alone:
            return None
        return causes(self.problem.posterior, self.best)

    @cached_property
    def instead(self) -> Instead | None:
        """Of a table that would be blamed: what the rig may lack."""
        if self.judged is None or not self.judged.verdict.far or not self.alone:
            return None
        return instead(self.problem, self.best)

    def some(self, n: int) -> Array:
        """At most `n` draws `(n, D)`, evenly spaced."""
        return self.draws[:: max(1, -(-len(self.draws) // n))]

    @cached_property
    def rubbing(self) -> tuple[tuple[Rubbing, ...], ...]:
        """Of each experiment; nothing where the rig does not rub."""
        if not self.problem.model.frictions:
            return ()
        return rubbings(self.problem.posterior, self.best, self.some(BANDS))

    @cached_property
    def step_errors(self) -> tuple[StepError, ...]:
        """What the steps of a rig that is stepped do at the MAP."""
        return step_errors(self.problem.posterior.likelihood, self.best)

    @cached_property
    def accounts(self) -> tuple[energy.Account, ...]:
        """Where the energy goes, of a rig that rubs."""
        if not self.problem.model.frictions:
            return ()
        return energy.accounts(self.problem.posterior, self.best, self.some(ACCOUNTS))

    @property
    def evidence(self) -> Evidence | None:
        """None where it was not computed, or there was nothing to compute it of."""
        return self.sampled.evidence

    @cached_property
    def vague(self) -> tuple[Vague, ...]:
        """Priors that are too wide for the evidence to mean much."""
        return vague(self.rows, self.draws, self.problem.posterior.space.priors)

    @cached_property
    def shaking(self) -> tuple[Shaking, ...]:
        """The missing torque of each experiment, where there is one."""
        rng = seeds.stream(self.config.seed, "torque")
        return shakings(self.problem.posterior, self.some(PATHS), rng)

    @cached_property
    def leaning(self) -> Mapping[str, tuple[str, ...]]:
        """What is determined only with the priors of others, and of which."""
        return leaning(self.rows, self.draws)

    @property
    def names_of_rig(self) -> tuple[str, ...]:
        """Of which products are made."""
        return () if self.judged is None else self.judged.study.names

    @property
    def width(self) -> float:
        """Of figures, inches."""
        return WIDTHS[self.config.output.size]

    @property
    def units(self) -> OwnUnits:
        """In which people are shown unknowns and what follows from them."""
        return self.problem.units

    @property
    def clock(self) -> Unit:
        """In which people are told times."""
        return self.problem.clock

    def shown(self, names: Sequence[str] | None = None) -> Shown:
        """For figures: the unknowns of these names, or all where none is among them."""
        problem, own = self.problem, self.units
        every = range(len(problem.symbols))
        chosen = [k for k in every if names is not None and problem.names[k] in names] or every
        picked = [problem.symbols[k] for k in chosen]
        return Shown(
            columns=tuple(chosen),
            factors=own.factors(picked),
            symbols=own.symbols(picked),
            priors=own.priors(problem.posterior.space.priors),
            nominal=own.values(problem.nominal),
            mode=own.values(self.mode.values),
        )

    @cached_property
    def derived(self) -> Derived:
        """Nothing where they cannot be made."""
        problem, draws, judged = self.problem, self.sampled.draws, self.judged
        with self.sparing.making("derived quantities"):
            derived = derive(problem, draws)
            if judged is None:
                return derived
            products = [quantity.exponents for quantity in judged.verdict.products]
            return with_products(derived, problem, draws, products)
        return Derived(symbols=(), values=np.empty((*draws.shape[:2], 0)), nominal={})

    @cached_property
    def following(self) -> tuple[Following, ...]:
        """A row for each derived quantity; none where they cannot be made."""
        with self.sparing.making("derived quantities"):
            return summarise(self.derived)
        return ()

    @cached_property
    def tree(self) -> DataTree:
        """For ArviZ."""
        # Late: xarray takes half a second to load.
        from bayesdrill.results.arviz_tree import make_tree

        return make_tree(
            self.problem,
            self.sampled,
            words.predictive_draws(self.problem, self.config),
            seeds.stream(self.config.seed, "predictive"),
            seeds.stream(self.config.seed, "prior"),
            self._attributes(),
            self.derived,
        )

    def _attributes(self) -> dict[str, object]:
        c = self.sampled.convergence
        return {
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
