"""What draws say: of each unknown, of what the fit leaves, and of the nominal table."""

from __future__ import annotations

from bayesdrill import mode, residuals, verdict
from bayesdrill.diagnostics import Row, summarise
from bayesdrill.identifiability.scenes import Scenery
from bayesdrill.identifiability.study import Asked
from bayesdrill.mode import Mode
from bayesdrill.opening import open_ends
from bayesdrill.problem import Problem
from bayesdrill.residuals import Left
from bayesdrill.sampling import Plan, Sampled
from bayesdrill.verdict import Judgement
from bayesdrill.wording import reconciled


def conclude(
    problem: Problem, asked: Asked, found: Mode, sampled: Sampled, scenery: Scenery, plan: Plan
) -> tuple[tuple[Row, ...], tuple[Left, ...], Judgement | None]:
    """A row for each unknown, one for each channel, and the verdict where there is a table.

    `plan`: how another posterior is sampled, where ends of priors are in the way.
    """
    c = sampled.convergence
    target = problem.posterior
    rows = summarise(problem, sampled.draws, found, c)
    tops = mode.tops(target, found)
    draws = sampled.draws.reshape(-1, tops.shape[1])
    left = residuals.left(target.likelihood, tops[0])
    fits = residuals.like_noise(left)
    beyond = open_ends(target, problem.nominal, draws, tops, plan) if c.converged else None
    judged = verdict.judgement(problem, asked, scenery, tops[0], draws, rows, beyond, fits=fits)
    return rows if judged is None else reconciled(rows, judged.verdict), left, judged
