"""The registry of a run's figures: one file and one line here, or an entry point `bayesdrill.figure`.

A recipe says of a finished run what is to be drawn, or None where there is nothing.  Recipes load what
draws when they are asked: matplotlib takes a second, and drawing longer than all tables together.
"""

from __future__ import annotations

from collections.abc import Callable

from bayesdrill.basics.registry import Registry
from bayesdrill.inference.priors import flat_in_logs
from bayesdrill.report import derived_words
from bayesdrill.report.view import Drawing, View

CORNER = (
    "The posterior of each parameter and each pair (corner plot), beside nominal values and MAP."
)
INVARIANTS = "The products of parameters that such a record can show (corner plot)."
RIDGE = (
    "The ridge: parameters that no such record can tell apart, and the line along which they go."
)
TRACE = "What the walkers of each ensemble did, step by step."
PRIOR_POSTERIOR = "Prior against posterior of each parameter: what the record has added."
FIT = "Record, model at the MAP and posterior predictive band; beside them what is left, and the noise."

Recipe = Callable[[View], Drawing | None]


def drawing(name: str, run: View) -> Drawing | None:
    """What is to be drawn in a figure of this run; raises `TypeError` for a recipe that is none."""
    found = FIGURES[name](run)
    if found is not None and not isinstance(found, Drawing):
        raise TypeError(f"a recipe gives a Drawing or None, not {type(found).__name__}")
    return found


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


def _fit(run: View) -> Drawing:
    from bayesdrill.report.fit_plot import fit_figure
    from bayesdrill.report.fitted import fitted

    return Drawing(fit_figure, (fitted(run), run.width), says=FIT)


FIGURES: Registry[Recipe] = Registry(
    "figure",
    {
        "corner": _corner,
        "invariants": _invariants,
        "ridge": _ridge,
        "trace": _trace,
        "prior_posterior": _prior_posterior,
        "fit": _fit,  # last: its draws take a while
    },
)
