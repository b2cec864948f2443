"""The registry of a run's figures: one file and one line here, or an entry point `bayesdrill.figure`.

A recipe says of a finished run what is to be drawn, or None where there is nothing.  Recipes load what
draws when they are asked: matplotlib takes a second, and drawing longer than all tables together.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics import seeds
from bayesdrill.basics.own_files import ON_REQUEST, numbered
from bayesdrill.basics.registry import Registry, callable_one
from bayesdrill.inference.priors import flat_in_logs
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.report import derived_words, words
from bayesdrill.report.view import BANDS, Drawing, View
from bayesdrill.report.widths import WIDTHS
from bayesdrill.setup.config import Config

if TYPE_CHECKING:
    from bayesdrill.report.fitted import Fit

CORNER = (
    "The posterior of each parameter and each pair (corner plot), beside nominal values and MAP."
)
INVARIANTS = "The products of parameters that such a record can show (corner plot)."
RIDGE = (
    "The ridge: parameters that no such record can tell apart, and the line along which they go."
)
TRACE = "What the walkers of each ensemble did, step by step."
PRIOR_POSTERIOR = "Prior against posterior of each parameter: what the record has added."
FRICTION = "Each friction against its speed: its law, where the record saw it, and nominal values."
TORQUE = "The missing torque over time, and against what the rig did: speeds, angle, inputs."
ENERGY = "Where the energy goes: what came in, and what became of it, in joules and as shares."
FIT = "Record, model at the MAP and posterior predictive band; beside them what is left, and the noise."
FIT_RUBBED = f"{FIT} Below: what rubs, and when it sticks."
FIT_ALONE = "Record and model at the MAP; beside them what is left, and the noise."
RANK = "Whether the ensembles see the same: ranks of the draws of each among those of all."
AUTOCORRELATION = "How long the walkers remember: autocorrelation, its time and its window."
PREDICTIVE_CHECK = "Whether the record is as the posterior predicts it, channel by channel."

Array = NDArray[np.float64]

Recipe = Callable[[View], Drawing | tuple[Drawing, ...] | None]


def drawings(name: str, run: View) -> dict[str, Drawing]:
    """What is to be drawn of this run, by the stems of the files: one, or one for each experiment.

    Raises `TypeError` for a recipe that is none.
    """
    found = FIGURES[name](run)
    every = found if isinstance(found, tuple) else () if found is None else (found,)
    for one in every:
        if not isinstance(one, Drawing):
            raise TypeError(f"a recipe gives a Drawing or None, not {type(one).__name__}")
    return numbered(name, every)


def _corner(run: View) -> Drawing:
    from bayesdrill.report.corner_plot import corner_figure

    own, at_map = run.units, run.best[None]
    names = run.config.output.corner or run.config.output.parameters
    shown = derived_words.shown(run.problem, names, run.sampled.draws, run.derived, at_map)
    draws = shown.draws / own.factors(shown.symbols)
    nominal, mode = own.values(shown.nominal), own.values(shown.mode)
    priors = own.priors(run.problem.posterior.space.priors)
    given = (draws, own.symbols(shown.symbols), nominal, mode, priors, run.width)
    return Drawing(corner_figure, given, says=CORNER)


def _invariants(run: View) -> Drawing | None:
    from bayesdrill.report.invariants_plot import invariants_figure

    if run.judged is None or not run.judged.verdict.products:
        return None
    verdict, symbols = run.judged.verdict, run.problem.symbols
    return Drawing(
        invariants_figure, (verdict, run.draws, run.best, symbols, run.width), says=INVARIANTS
    )


def _ridge(run: View) -> Drawing | None:
    """Where there is a symmetry."""
    from bayesdrill.report.ridge_plot import ridge_figure, strongest_pair

    judged, shown = run.judged, run.shown()
    pair = None if judged is None else strongest_pair(run.draws, judged.study.structure)
    if pair is None:
        return None
    given = (shown.of(run.draws), pair, shown.symbols, shown.priors, shown.nominal, shown.mode)
    return Drawing(ridge_figure, given, says=RIDGE)


def _trace(run: View) -> Drawing:
    from bayesdrill.report.trace_plot import trace_figure

    shown, sampled = run.shown(run.config.output.parameters), run.sampled
    logs = [name for name, prior in shown.priors.items() if flat_in_logs(prior)]
    values = (shown.nominal, shown.mode, logs, run.width)
    burn_in = sampled.convergence.burn_in
    return Drawing(
        trace_figure, (shown.of(sampled.theta), shown.symbols, burn_in, *values), says=TRACE
    )


def _prior_posterior(run: View) -> Drawing:
    from bayesdrill.report.prior_posterior_plot import prior_posterior_figure

    shown = run.shown(run.config.output.parameters)
    values = (shown.priors, shown.nominal, shown.mode, run.width)
    return Drawing(
        prior_posterior_figure, (shown.of(run.draws), shown.symbols, *values), says=PRIOR_POSTERIOR
    )


def _fit(run: View) -> tuple[Drawing, ...]:
    from bayesdrill.report.fitted import every_fit

    group = run.tree["posterior_predictive"]
    draws = {str(name): np.asarray(values) for name, values in group.data_vars.items()}
    found = every_fit(run.problem, run.config, run.best, run.left, draws, run.rubbing)
    return _fits(found, run.width, FIT_RUBBED if run.rubbing else FIT)


def _friction(run: View) -> tuple[Drawing, ...]:
    """Of a rig that rubs."""
    from bayesdrill.report.friction_plot import friction_figure
    from bayesdrill.report.rubbed import laws

    drawings = []
    for one, found in zip(run.problem.observations, run.rubbing, strict=False):
        shown = laws(one, found, run.problem, run.best, run.some(BANDS))
        says = _captioned(one.label, FRICTION)
        drawings.append(Drawing(friction_figure, (shown, run.width), says=says))
    return tuple(drawings)


def _energy(run: View) -> tuple[Drawing, ...]:
    from bayesdrill.report.energy_plot import energy_figure
    from bayesdrill.report.energy_words import balance

    model = run.problem.model
    return tuple(
        Drawing(
            energy_figure,
            (balance(one, model, run.clock), run.width),
            says=_captioned(one.label, ENERGY),
        )
        for one in run.accounts
    )


def _torque(run: View) -> tuple[Drawing, ...]:
    """Of a rig whose equations leave one out."""
    from bayesdrill.report.torque_plot import torque_figure
    from bayesdrill.report.torque_shown import shown

    return tuple(
        Drawing(
            torque_figure, (shown(one, run.clock), run.width), says=_captioned(one.label, TORQUE)
        )
        for one in run.shaking
    )


def fits_alone(
    problem: Problem, config: Config, best: Array, left: Sequence[Left]
) -> dict[str, Drawing]:
    """Of the MAP `(D,)`, without draws, by stem; `left`: what it leaves."""
    from bayesdrill.report.fitted import every_fit

    found = every_fit(problem, config, best, left)
    return numbered("fit", _fits(found, WIDTHS[config.output.size], FIT_ALONE))


def _fits(every: Sequence[Fit], width: float, says: str) -> tuple[Drawing, ...]:
    from bayesdrill.report.fit_plot import fit_figure

    return tuple(
        Drawing(fit_figure, (fit, width), says=_captioned(fit.label, says)) for fit in every
    )


def _captioned(label: str, says: str) -> str:
    return f"{label}: {says}" if label else says


def alone_captions(problem: Problem) -> dict[str, str]:
    """What `fits_alone` shows, without drawing it."""
    return numbered("fit", [_captioned(one.label, FIT_ALONE) for one in problem.observations])


def _rank(run: View) -> Drawing:
    from bayesdrill.insight.ensemble_ranks import independent, ranks
    from bayesdrill.report.rank_plot import rank_figure

    c = run.sampled.convergence
    draws = independent(run.sampled.theta, c.burn_in, float(c.tau.max()))
    found = ranks(draws, seeds.stream(run.config.seed, "rank"))
    return Drawing(rank_figure, (found, run.problem.symbols, run.width), says=RANK)


def _autocorrelation(run: View) -> Drawing:
    from bayesdrill.report.autocorrelation_plot import autocorrelation_figure

    kept = run.sampled.theta[:, run.sampled.convergence.burn_in :]
    return Drawing(
        autocorrelation_figure, (kept, run.problem.symbols, run.width), says=AUTOCORRELATION
    )


def _predictive_check(run: View) -> Drawing:
    from bayesdrill.insight.predictive import checks
    from bayesdrill.report.predictive_plot import predictive_figure

    draws = run.sampled.draws
    each = words.predictive_draws(run.problem, run.config)
    chosen = np.unique(np.linspace(0, draws.shape[1] - 1, each).astype(int))
    theta = draws[:, chosen].reshape(-1, draws.shape[-1])
    found = checks(run.problem.posterior.likelihood, theta)
    return Drawing(predictive_figure, (found, run.width), says=PREDICTIVE_CHECK)


FIGURES: Registry[Recipe] = Registry(
    "figure",
    {
        "corner": _corner,
        "invariants": _invariants,
        "ridge": _ridge,
        "trace": _trace,
        "prior_posterior": _prior_posterior,
        "friction": _friction,
        "energy": _energy,
        "torque": _torque,
        "fit": _fit,  # last of those usually drawn: its draws take a while
        "rank": _rank,
        "autocorrelation": _autocorrelation,
        "predictive_check": _predictive_check,
    },
    judge=callable_one,
)


def drawn(wanted: Collection[str] | None) -> list[str]:
    """Names of the figures that a config asks for; None: all but those on request."""
    if wanted is None:
        return [name for name in FIGURES if name not in ON_REQUEST]
    return [name for name in FIGURES if name in wanted]
