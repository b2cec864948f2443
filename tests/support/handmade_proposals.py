"""Independence proposals made by hand: unlike their target, since exactness asks for no likeness."""

from __future__ import annotations

from functools import cache

import numpy as np
from support.known_targets import Target

from bayesdrill.sampling.proposal.ridge_tracing import moments
from bayesdrill.sampling.samplers.independence import Mixture, Proposal, mixture

SHAPES = ((0.5, 0.8, 0.3), (0.2, 1.2, -0.4))  # weight, width and shift of a hump's two components


@cache
def rough(target: Target, d: int, n_sheets: int = 1) -> Proposal:
    """Over one ridge of `target` or over two, with components of unequal weights."""
    components = over(target, d, n_sheets)
    drawn = components.draw(4000, np.random.RandomState(1)).u
    own = target.draw(2000, d, np.random.default_rng(8))
    usual = float(np.median(target.log_density(own) - components.log_density(own)))
    return Proposal(components, float(target.inside(drawn).mean()), usual)


def over(target: Target, d: int, n_sheets: int) -> Mixture:
    draws = target.draw(2000, d, np.random.default_rng(9))
    hump, sheets = target.hump(draws), target.ridges(d)[:n_sheets]
    one_each = hump.any() and n_sheets > 1
    sheet, weights, means, roots = [], [], [], []
    for s, ridge in enumerate(sheets):
        for h in [s] if one_each else range(hump.max() + 1):
            y, _ = ridge.to_ridge_coordinates(draws[hump == h])
            mean, root = moments(y, np.ones(len(y)))
            for weight, width, shift in SHAPES:
                sheet.append(s)
                weights.append(weight * (1 + s + h))
                means.append(mean + shift * np.diag(root) / np.sqrt(d))
                roots.append(width * root)
    return mixture(sheets, sheet, np.array(weights), np.array(means), np.array(roots))
