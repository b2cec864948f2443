"""Look along Newton ridges for posterior mass that a proposal misses.

A proposal is judged by its own draws, which never go where it does not lead.  So points are brought
to the ridge by Gauss and Newton, wherever its loose directions go; and only where some of the
posterior was left out is a part of the steps made in this dearer way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.proposal.ridge_tracing import distances, moments, newton_mixture, trace
from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.ensemble import State, advance
from bayesdrill.sampling.samplers.independence import (
    LONG_LOG_RATIO,
    NEWTON_LOCAL_SHARE,
    Mixture,
    Proposal,
    Random,
    WeightedDraws,
)
from bayesdrill.sampling.samplers.ridge import RidgeMap

DRAWS_PER_ROUND, LAST_DRAWS = 400, 1600  # of a round; the last ones judge once more
LEARNING_ROUNDS = 2
FAR_LOG_RATIO = 3.0  # p over q is e^3 times what is usual: ...
MAX_MISSED_MASS = 0.01  # ... of the posterior, no more may be there
MIN_EFFECTIVE_SHARE = 0.02  # of effective draws: with less nothing is seen, and one looks on
MAX_TRIES_PER_DRAW = 10  # times as many at most, where few are inside the prior
MIN_TEMPERED_SHARE = 0.1  # of effective draws: the density is flattened until there are as many
NEGLIGIBLE_WEIGHT = 1e-9  # of the posterior: where a sheet has none of the draws
MAX_ADDED_RIDGES = 4  # of places that walkers get to and draws do not
MAX_TRAPPED_WALKERS = 0.01  # of the walkers, in places that are left too slowly
MAX_STILL_TRAPPED = 0.02  # of them: with more, such a place gets another ridge
WALKERS, STEPS, THINNING = 96, 90, 3  # that look for them; the last two thirds are seen
WIDTH_ALONG, WIDTH_ACROSS = 1.3, 1.05  # times as wide as what is known of a ridge
LOOKING = "looking for what the proposal leaves out"


@dataclass(frozen=True, slots=True)
class CoverageCheck:
    """A proposal along Newton ridges, and its `draws`, all of which have a density."""

    proposal: Proposal
    draws: WeightedDraws


def check_coverage(
    surface: LogDensity,
    proposal: Proposal,
    sheets: Sequence[int],
    weighted_draws: tuple[Array, Array],
    random: Random,
    rng: np.random.Generator,
    report: Reporter = SILENT,
) -> CoverageCheck | None:
    """Look for posterior mass that `proposal` misses; None where there is none, or nothing is seen.

    `sheets`: those of the proposal that are looked along.  `weighted_draws`: draws of the posterior
    `(N, D)`, and their weights for each of those sheets `(S, N)`.
    """
    selected = [proposal.mixture.sheets[s] for s in sheets]
    if all(sheet.n_loose in (0, len(sheet.frame.centre)) for sheet in selected):
        return None
    for k in range(LEARNING_ROUNDS):
        mixture = _wide(selected, *weighted_draws)
        draws, shares, inside = _drawn(surface, mixture, DRAWS_PER_ROUND, random)
        if len(draws.u) == 0 or (k == 0 and _covers(surface, proposal, draws)):
            return None
        least = MIN_TEMPERED_SHARE * len(draws.u)
        weighted_draws = draws.u, shares * draws.tempered(least)
    begin = draws.u[random.choice(len(draws.u), size=WALKERS, p=draws.weights)]
    mixture = _wide(selected, *weighted_draws)
    walking = Proposal(mixture, inside, draws.typical_log_ratio, local_share=1.0)
    mixture = _add_ridges(surface, walking, begin, random, rng, report)
    draws, _, inside = _drawn(surface, mixture, LAST_DRAWS, random)
    if _covers(surface, proposal, draws):
        return None  # a few draws of many looked like it by chance
    newton = Proposal(mixture, inside, draws.typical_log_ratio, local_share=NEWTON_LOCAL_SHARE)
    return CoverageCheck(newton, draws)


def _add_ridges(
    surface: LogDensity,
    newton_proposal: Proposal,
    begin: Array,
    random: Random,
    rng: np.random.Generator,
    report: Reporter,
) -> Mixture:
    """With a sheet more wherever walkers that `begin (W, D)` come to places that they hardly leave.

    Where one unknown takes over from another, what was tight is loose, and the ridge of the maximum
    leads to nothing but the edge of such a place.  Walkers that step by themselves go on into it.
    """
    state = State(begin, surface.value(begin), tuple(random.get_state()))
    first = len(newton_proposal.mixture.sheets)
    for k in range(MAX_ADDED_RIDGES):
        report.update((k + 1) / (MAX_ADDED_RIDGES + 1), LOOKING)
        # Into such a place walkers of all others have to step first: then those that are there go on.
        limit = -np.inf if k == 0 else newton_proposal.typical_log_ratio
        walking = replace(
            newton_proposal,
            mixture=newton_mixture(newton_proposal.mixture, surface.approximate_model),
            typical_log_ratio=limit,
        )
        evaluate = lambda u: (surface.value(u), 0)  # noqa: E731
        segment = advance(evaluate, state, STEPS, {"independence": 1.0}, walking, surface.inside)
        u, value = (
            some[STEPS // 3 :: THINNING].reshape(-1, *some.shape[2:])
            for some in (segment.z, segment.log_p)
        )
        shares, log_q = walking.mixture.shares(*walking.mixture.straightened(u))
        waiting = _waiting(value - log_q)
        if waiting.mean() < MAX_TRAPPED_WALKERS:
            return _wide(newton_proposal.mixture.sheets, u, shares / len(u))
        known = np.where(waiting, 0.0, shares)
        # The last ridge began at the edge of what is seen by now: once more from its middle.
        joint = [np.vstack([known[:-1], known[-1] + waiting])] if len(known) > first else []
        for trial_shares in [*joint, np.vstack([known, waiting])]:
            mixture, ratio = _ending(surface, newton_proposal.mixture, u, value, trial_shares, rng)
            if _waiting(ratio).mean() < MAX_STILL_TRAPPED:
                break
        usual = float(np.median(ratio))
        newton_proposal = replace(newton_proposal, mixture=mixture, typical_log_ratio=usual)
        state = segment.state
    return newton_proposal.mixture


def _waiting(ratio: Array) -> Flags:
    """Which walkers wait long, of logs of p over q `(N,)`."""
    return np.asarray(ratio > np.median(ratio) + LONG_LOG_RATIO)


def _ending(
    surface: LogDensity,
    before: Mixture,
    u: Array,
    value: Array,
    shares: Array,
    rng: np.random.Generator,
) -> tuple[Mixture, Array]:
    """Trace one more sheet from the middle of the draws `u (N, D)` that are mostly its own.

    It follows those of `before`; `shares (S, N)`.  Returns the logs of p over q then, `(N,)`, too.
    """
    mine = shares[-1] > 0.5
    some, weights = u[mine], shares[-1][mine] / shares[-1][mine].sum()
    centre = some[np.argmin(distances(some, weights))]
    last = trace(surface, centre, rng, (some, weights)).ridge
    sheets = [*before.sheets[: len(shares) - 1], last]
    # The places begin where others end: which points belong to which, once more.
    whole = newton_mixture(_wide(sheets, u, shares / len(u)), surface.approximate_model)
    shares, log_q = whole.shares(*whole.straightened(u))
    return _wide(sheets, u, shares / len(u)), value - log_q


def _wide(sheets: Sequence[RidgeMap], u: Array, weights: Array) -> Mixture:
    """A component for each sheet, wider than draws `u (N, D)` of `weights (S, N)` along it."""
    means, roots = [], []
    for sheet, sheet_weights in zip(sheets, weights, strict=True):
        tight = u.shape[1] - sheet.n_loose
        middle, root = moments(sheet.frame.split(u)[0], sheet_weights + NEGLIGIBLE_WEIGHT)
        means.append(np.append(middle, np.zeros(tight)))
        roots.append(scipy.linalg.block_diag(WIDTH_ALONG * root, WIDTH_ACROSS * np.eye(tight)))
    return independence.mixture(sheets, range(len(sheets)), weights.sum(axis=1), means, roots)


def _drawn(
    surface: LogDensity, mixture: Mixture, n: int, random: Random
) -> tuple[WeightedDraws, Array, float]:
    """Draw `n` times along Newton ridges, or more where many are outside; keep those with a density.

    Returns each sheet's shares of them `(S, N)`, and how many of all are inside, too.
    """
    mixture = newton_mixture(mixture, surface.approximate_model)
    inside = surface.inside(mixture.draw(n, random).u).mean()
    drawn = mixture.draw(int(n / max(float(inside), 1.0 / MAX_TRIES_PER_DRAW)), random)
    value = surface.value(drawn.u)
    good = np.isfinite(value)
    valid = drawn.select(good)
    shares, log_q = mixture.shares(*mixture.coordinates(valid))
    return WeightedDraws(valid.u, value[good] - log_q, np.zeros(len(log_q))), shares, float(inside)


def _covers(surface: LogDensity, proposal: Proposal, draws: WeightedDraws) -> bool:
    """Whether hardly any of the posterior is where the proposal hardly ever goes, as far as one sees."""
    ratio = surface.value(draws.u) - proposal.mixture.log_density(draws.u)
    missed = ratio > proposal.typical_log_ratio + FAR_LOG_RATIO
    missed_mass = float(draws.weights[missed].sum())
    seen = draws.effective > MIN_EFFECTIVE_SHARE * len(draws.u)
    return missed_mass < MAX_MISSED_MASS and seen
