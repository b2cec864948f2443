"""A run at a glance: did it converge, does it fit, does the table hold."""

from __future__ import annotations

from collections.abc import Iterator

from bayesdrill.inference.residual_checks import like_noise
from bayesdrill.report.sections import Mark
from bayesdrill.report.view import View
from bayesdrill.setup.build import compared_with


def of_run(run: View) -> Iterator[Mark]:
    converged = run.sampled.convergence.converged
    yield Mark("converged", "good") if converged else Mark("not converged", "bad")
    yield _fit(run)
    if converged and run.judged is not None:
        yield _table(run)


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
    if found.agrees:
        return Mark(f"agrees with {table}", "good")
    return Mark(f"disagrees with {table}" if found.fits else "verdict in doubt", "doubt")
