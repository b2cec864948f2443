"""Independence proposals made by hand: unlike their target, since exactness asks for no likeness."""

from collections.abc import Mapping
from functools import cache

import numpy as np
from support.known_targets import Target

from bayesdrill.sampling.proposal.ridge_tracing import moments
from bayesdrill.sampling.samplers.ensemble import ChainSegment, State, advance
from bayesdrill.sampling.samplers.independence import Mixture, Proposal, mixture

SHAPES = ((0.5, 0.8, 0.3), (0.2, 1.2, -0.4))  # weight, width and shift of a mode's two components


@cache
def rough(target: Target, d: int, n_ridges: int = 1) -> Proposal:
    """Return a proposal over one ridge of `target` or two, with components of unequal weights."""
    proposal = over(target, d, n_ridges)
    drawn = proposal.draw(4000, np.random.RandomState(1)).u
    draws = target.draw(2000, d, np.random.default_rng(8))
    typical = float(np.median(target.log_density(draws) - proposal.log_density(draws)))
    return Proposal(proposal, float(target.in_support(drawn).mean()), typical)


def over(target: Target, d: int, n_ridges: int) -> Mixture:
    """Return the mixture of `rough`."""
    draws = target.draw(2000, d, np.random.default_rng(9))
    mode, ridges = target.mode(draws), target.ridges(d)[:n_ridges]
    ridge_a_mode = mode.any() and n_ridges > 1
    sheet, weights, means, roots = [], [], [], []
    for s, ridge in enumerate(ridges):
        for m in [s] if ridge_a_mode else range(mode.max() + 1):
            y, _ = ridge.to_ridge_coordinates(draws[mode == m])
            mean, root = moments(y, np.ones(len(y)))
            for weight, width, shift in SHAPES:
                sheet.append(s)
                weights.append(weight * (1 + s + m))
                means.append(mean + shift * np.diag(root) / np.sqrt(d))
                roots.append(width * root)
    return mixture(ridges, sheet, np.array(weights), np.array(means), np.array(roots))


def advance_draws(
    target: Target, d: int, moves: Mapping[str, float], proposal: Proposal | None, steps: int
) -> ChainSegment:
    """Advance 4000 walkers that begin as independent draws of `target` in `d` dimensions."""
    z = target.draw(4000, d, np.random.default_rng(100 + d))
    state = State(z, target.log_density(z), np.random.RandomState(100 + d).get_state())
    evaluate = lambda z: (target.log_density(z), 0)  # noqa: E731
    return advance(evaluate, state, steps, moves, proposal, target.in_support)
