"""A run at a glance: did it converge, does it fit, does the table hold."""

from __future__ import annotations

from dataclasses import replace

from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.report.sections import Mark
from bayesdrill.report.view import View
from bayesdrill.setup.build import compared_with


def of_run(run: View) -> tuple[Mark, ...]:
    """Nothing is good about a run that must not be believed; what is bad about it comes first."""
    converged = run.sampled.convergence.converged
    first = Mark("converged", "good") if converged else Mark("not converged", "bad")
    fit = _fit(run)
    if run.reasons:
        plain = [replace(one, tone="plain") if one.tone == "good" else one for one in (fit, first)]
        return tuple(sorted(plain, key=lambda one: one.tone != "bad"))
    return (first, fit) if run.judged is None else (first, fit, _table(run))


def _fit(run: View) -> Mark:
    if any(one.unbelievable for one in run.left):
        return Mark("does not fit", "bad")
    if like_noise(run.left):
        return Mark("fits: noise is left", "good")
    return Mark("more than noise is left", "doubt")


def _table(run: View) -> Mark:
    assert run.judged is not None
    found, table = run.judged.verdict, compared_with(run.config)
    if all(quantity.says == "not determined" for quantity in found.products):
        return Mark(f"says nothing of {table}", "doubt")
    if not found.fits:
        return Mark("verdict in doubt", "doubt")
    return (
        Mark(f"agrees with {table}", "good")
        if found.agrees
        else Mark(f"disagrees with {table}", "doubt")
    )
