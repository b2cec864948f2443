"""Search along Newton ridges for posterior mass that a proposal misses.

The draws of a proposal cannot show the mass that it misses.  So draws are spread wider along the
loose directions, Gauss-Newton moves each to the ridge, and the densities there are computed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.proposal.ridge_tracing import moments, newton_ridge
from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.independence import Mixture, Proposal, Random, WeightedDraws
from bayesdrill.sampling.samplers.ridge import RidgeMap

ROUNDS = (400, 400, 1600)  # number of draws of each round; the last round gives the estimate
FAR_LOG_RATIO = 3.0  # mass is missed where log (p/q) is this much above its typical value
MAX_MISSED_MASS = 0.01  # fraction of the posterior; less missed mass counts as zero
MIN_EFFECTIVE_SHARE = 0.02  # one round may be enough if this fraction of its draws is effective
MAX_TRIES_PER_DRAW = 10  # largest number of tries for each draw inside the prior
MIN_TEMPERED_SHARE = 0.1  # the weights are tempered until this fraction of the draws is effective
NEGLIGIBLE_WEIGHT = 1e-9  # added to each weight, as all draws of a sheet may have the weight zero
WIDTH_ALONG, WIDTH_ACROSS = 1.3, 1.05  # widths of a component, relative to the weighted draws
LOOKING = "looking for posterior mass that the proposal misses"


def missed_mass(
    surface: LogDensity,
    proposal: Proposal,
    sheets: Sequence[int],
    weighted_draws: tuple[Array, Array],
    random: Random,
) -> float:
    """Estimate the posterior mass that `proposal` hardly ever reaches, 0 if negligible.

    Only the sheets (ridges) of the proposal with indices `sheets` are searched.  `weighted_draws`
    are draws of the posterior `(N, D)`, and their weights for each of these sheets `(S, N)`.
    """
    selected = [proposal.mixture.sheets[s] for s in sheets]
    if all(sheet.n_loose in (0, len(sheet.frame.centre)) for sheet in selected):
        return 0.0
    missed = 0.0
    for k, n in enumerate(ROUNDS):
        draws, shares = _ridge_draws(surface, _wide(selected, *weighted_draws), n, random)
        if len(draws.u) == 0:
            return 0.0
        ratio = surface.value(draws.u) - proposal.mixture.log_density(draws.u)
        is_missed = ratio > proposal.typical_log_ratio + FAR_LOG_RATIO
        missed = float(draws.weights[is_missed].sum())
        seen = draws.effective > MIN_EFFECTIVE_SHARE * len(draws.u)
        if k == 0 and seen and missed < MAX_MISSED_MASS:
            break
        weighted_draws = draws.u, shares * draws.tempered(MIN_TEMPERED_SHARE * len(draws.u))
    return missed if missed >= MAX_MISSED_MASS else 0.0


def _wide(sheets: Sequence[RidgeMap], u: Array, weights: Array) -> Mixture:
    """Return a mixture with a component for each sheet, wider than weighted draws `u (N, D)`."""
    means, roots = [], []
    for sheet, sheet_weights in zip(sheets, weights, strict=True):
        tight = u.shape[1] - sheet.n_loose
        middle, root = moments(sheet.frame.split(u)[0], sheet_weights + NEGLIGIBLE_WEIGHT)
        means.append(np.append(middle, np.zeros(tight)))
        roots.append(scipy.linalg.block_diag(WIDTH_ALONG * root, WIDTH_ACROSS * np.eye(tight)))
    return independence.mixture(sheets, range(len(sheets)), weights.sum(axis=1), means, roots)


def _ridge_draws(
    surface: LogDensity, mixture: Mixture, n: int, random: Random
) -> tuple[WeightedDraws, Array]:
    """Draw about `n` points of nonzero density on Newton ridges; return component fractions too."""
    ridges = tuple(newton_ridge(sheet, surface.approximate_model) for sheet in mixture.sheets)
    mixture = replace(mixture, sheets=ridges)
    share_inside = surface.in_support(mixture.draw(n, random).u).mean()
    drawn = mixture.draw(int(n / max(float(share_inside), 1.0 / MAX_TRIES_PER_DRAW)), random)
    value = surface.value(drawn.u)
    good = np.isfinite(value)
    valid = drawn.select(good)
    shares, log_q = mixture.component_fractions(*mixture.coordinates(valid))
    return WeightedDraws(valid.u, value[good] - log_q, np.zeros(len(log_q))), shares
