"""Represent the knowledge before an experiment: priors, or draws of a posterior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array, StoredArray
from bayesdrill.inference.posterior import Problem
from bayesdrill.inference.unknowns import SIMULATOR_ROLES


@dataclass(frozen=True, slots=True, kw_only=True)
class PresentKnowledge:
    """A design is averaged over `draws (W, D)`; limits are checked at the draws `checked (C, D)`.

    `precision (m, m)` is the inverse covariance of the simulator's unknowns on natural scales.  It
    only approximates the priors unless `gaussian`.  `source` is "the prior" or "the posterior".
    """

    draws: StoredArray
    checked: StoredArray
    precision: StoredArray
    source: str
    gaussian: bool = False


def prior_knowledge(problem: Problem, draws: int, checked: int, seed: int) -> PresentKnowledge:
    """Return the knowledge from the priors; if `draws` is 1, the start values are the only draw."""
    space = problem.posterior.space
    start = space.vector(space.start)[None]
    drawn = space.draw(draws + 4 * checked, seeds.stream(seed, "design"))
    drawn = drawn[np.isfinite(space.log_prior(drawn))]
    return PresentKnowledge(
        draws=start if draws <= 1 else drawn[:draws],
        checked=start if draws <= 1 else drawn[draws : draws + checked],
        precision=np.diag(SensitivityStudy(problem.posterior.likelihood).prior_spreads ** -2.0),
        source="the prior",
    )


def posterior_knowledge(
    problem: Problem, chain: Array, draws: int, checked: int
) -> PresentKnowledge:
    """Return the knowledge from posterior draws `chain (N, D)`, as a Gaussian on natural scales."""
    posterior = problem.posterior
    m = len(posterior.space.columns(*SIMULATOR_ROLES))
    logs = np.array([not unknown.signed for unknown in posterior.space.unknowns[:m]])
    scales = np.array([unknown.scale for unknown in posterior.space.unknowns[:m]])
    natural = np.where(logs, np.log(np.where(logs, chain[:, :m], 1.0)), chain[:, :m] / scales)
    spread = np.cov(natural, rowvar=False).reshape(m, m)
    sds = np.sqrt(np.diag(spread))
    precision = np.linalg.pinv(spread / np.outer(sds, sds), hermitian=True) / np.outer(sds, sds)

    def thinned(count: int) -> Array:
        return np.asarray(chain[np.linspace(0, len(chain) - 1, min(count, len(chain))).astype(int)])

    return PresentKnowledge(
        draws=thinned(draws),
        checked=thinned(checked),
        precision=precision,
        source="the posterior",
        gaussian=True,
    )
