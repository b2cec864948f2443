"""What draws say: of each unknown, of what the fit leaves, and of the nominal table."""

from __future__ import annotations

from bayesdrill.engines import mode
from bayesdrill.engines.mode import Mode
from bayesdrill.engines.sampling import Sampled
from bayesdrill.inference import residual_checks
from bayesdrill.inference.problem import Problem
from bayesdrill.inference.residual_checks import Left
from bayesdrill.insight import verdict
from bayesdrill.insight.diagnostics import Row, summarise
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.insight.identifiability.study import Asked
from bayesdrill.insight.verdict import Judgement
from bayesdrill.insight.wording import reconciled


def conclude(
    problem: Problem, asked: Asked, found: Mode, sampled: Sampled, scenery: Scenery
) -> tuple[tuple[Row, ...], tuple[Left, ...], Judgement | None]:
    """A row for each unknown, one for each channel, and the verdict where there is a table."""
    target = problem.posterior
    rows = summarise(problem, sampled.draws, found, sampled.convergence)
    tops = mode.tops(target, found)
    draws = sampled.draws.reshape(-1, tops.shape[1])
    left = residual_checks.left(target.likelihood, tops[0])
    fits = residual_checks.like_noise(left)
    judged = verdict.judgement(
        problem, asked, scenery, tops[0], draws, rows, sampled.beyond, fits=fits
    )
    return rows if judged is None else reconciled(rows, judged.verdict), left, judged
