"""What a proposal leaves out of the posterior, looked for along settled ridges.

A proposal is judged by its own draws, which never go where it does not lead.  So points are brought
to the ridge by Gauss and Newton, wherever its loose directions go; and only where some of the
posterior was left out is a part of the steps made in this dearer way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.proposal.ridge_tracing import Expand, distances, moments, settled, trace
from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.ensemble import State, advance
from bayesdrill.sampling.samplers.independence import (
    LONG,
    SETTLED_ALONE,
    Mixture,
    Proposal,
    Weighed,
)
from bayesdrill.sampling.samplers.ridge import Sheet

Random = np.random.RandomState

DRAWS, LAST_DRAWS = 400, 1600  # of a round; the last ones judge once more
ROUNDS = 2
LEFT_OUT = 0.01  # of the posterior, where p over q is e^FAR times what is usual
FAR = 3.0
LEAST = 0.02  # of effective draws: with less nothing is seen, and one looks on
REPEATED = 10  # times as many at most, where few are inside the prior
ENOUGH = 0.1  # of effective draws: below it the density is flattened until there are as many
HARDLY = 1e-9  # of the posterior: where a sheet has none of the draws
ALONG, ACROSS = 1.3, 1.05  # times as wide as what is known, along the ridge and across it
MORE = 4  # times at most that a place which walkers get to, and draws do not, gets a ridge
WALKERS, STEPS, EVERY = 96, 90, 3  # that look for them; the last two thirds are seen
HELD_BACK = 0.01  # of the walkers, in places that are left too slowly
STILL_HELD_BACK = 0.02  # of them: with more, such a place gets another ridge


@dataclass(frozen=True, slots=True)
class Look:
    """Along settled ridges: `proposal` of its own, whose `draws` all have a density."""

    proposal: Proposal
    draws: Weighed


def look(
    surface: LogDensity,
    expand: Expand,
    proposal: Proposal,
    sheets: Sequence[int],
    seen: tuple[Array, Array],
    seed: Random,
    rng: np.random.Generator,
    report: Reporter = SILENT,
) -> Look | None:
    """None where `proposal` leaves nothing out, or where nothing can be seen.

    `sheets`: those of the proposal that are looked along.  `seen`: draws of the posterior `(N, D)`,
    and their weights for each of those sheets `(S, N)`.
    """
    chosen = [proposal.mixture.sheets[s] for s in sheets]
    if all(sheet.n_loose in (0, len(sheet.frame.centre)) for sheet in chosen):
        return None
    for k in range(ROUNDS):
        found = _wide(chosen, *seen)
        draws, shares, inside = _drawn(surface, settled(found, expand), DRAWS, seed)
        if len(draws.u) == 0 or (k == 0 and _nothing(surface, proposal, draws)):
            return None
        seen = draws.u, shares * draws.tempered(ENOUGH * len(draws.u))
    begin = draws.u[seed.choice(len(draws.u), size=WALKERS, p=draws.weights)]
    own = Proposal(_wide(chosen, *seen), inside, draws.usual, alone=1.0)
    found = _completed(surface, expand, own, begin, seed, rng, report)
    draws, _, inside = _drawn(surface, settled(found, expand), LAST_DRAWS, seed)
    if _nothing(surface, proposal, draws):
        return None  # a few draws of many looked like it by chance
    return Look(Proposal(found, inside, draws.usual, alone=SETTLED_ALONE), draws)


def _completed(
    surface: LogDensity,
    expand: Expand,
    own: Proposal,
    begin: Array,
    seed: Random,
    rng: np.random.Generator,
    report: Reporter,
) -> Mixture:
    """With a sheet more wherever walkers that `begin (W, D)` come to places that they hardly leave.

    Where one unknown takes over from another, what was tight is loose, and the ridge of the maximum
    leads to nothing but the edge of such a place.  Walkers that step by themselves go on into it.
    """
    state = State(begin, surface.value(begin), tuple(seed.get_state()))
    first = len(own.mixture.sheets)
    for k in range(MORE):
        report.update((k + 1) / (MORE + 1), "looking for what the proposal leaves out")
        # Into such a place walkers of all others have to step first: then those that are there go on.
        limit = -np.inf if k == 0 else own.usual
        walking = replace(own, mixture=settled(own.mixture, expand), usual=limit)
        evaluate = lambda u: (surface.value(u), 0)  # noqa: E731
        piece = advance(evaluate, state, STEPS, {"independence": 1.0}, walking, surface.inside)
        u, value = (
            some[STEPS // 3 :: EVERY].reshape(-1, *some.shape[2:])
            for some in (piece.z, piece.log_p)
        )
        shares, log_q = walking.mixture.shares(*walking.mixture.straightened(u))
        held = _held(value - log_q)
        if held.mean() < HELD_BACK:
            return _wide(own.mixture.sheets, u, shares / len(u))
        known = np.where(held, 0.0, shares)
        # The last ridge began at the edge of what is seen by now: once more from its middle.
        joint = [np.vstack([known[:-1], known[-1] + held])] if len(known) > first else []
        for every in [*joint, np.vstack([known, held])]:
            found, ratio = _ending(surface, expand, own.mixture, u, value, every, rng)
            if _held(ratio).mean() < STILL_HELD_BACK:
                break
        own = replace(own, mixture=found, usual=float(np.median(ratio)))
        state = piece.state
    return own.mixture


def _held(ratio: Array) -> NDArray[np.bool_]:
    """Which walkers wait long, of logs of p over q `(N,)`."""
    return np.asarray(ratio > np.median(ratio) + LONG)


def _ending(
    surface: LogDensity,
    expand: Expand,
    before: Mixture,
    u: Array,
    value: Array,
    shares: Array,
    rng: np.random.Generator,
) -> tuple[Mixture, Array]:
    """Sheets of `before`, and a last one traced from the middle of those `u (N, D)` of which it has
    the larger of the `shares (S, N)`; and the logs of p over q then `(N,)`.
    """
    mine = shares[-1] > 0.5
    some, weights = u[mine], shares[-1][mine] / shares[-1][mine].sum()
    centre = some[np.argmin(distances(some, weights))]
    last = trace(surface, expand, centre, rng, (some, weights)).ridge
    sheets = [*before.sheets[: len(shares) - 1], last]
    # The places begin where others end: which points belong to which, once more.
    whole = settled(_wide(sheets, u, shares / len(u)), expand)
    shares, log_q = whole.shares(*whole.straightened(u))
    return _wide(sheets, u, shares / len(u)), value - log_q


def _wide(sheets: Sequence[Sheet], u: Array, weights: Array) -> Mixture:
    """A component for each sheet, wider than draws `u (N, D)` of `weights (S, N)` along it."""
    means, roots = [], []
    for sheet, own in zip(sheets, weights, strict=True):
        n, d = sheet.n_loose, u.shape[1]
        middle, root = moments(sheet.frame.split(u)[0], own + HARDLY)
        means.append(np.concatenate([middle, np.zeros(d - n)]))
        roots.append(ACROSS * np.eye(d))
        roots[-1][:n, :n] = ALONG * root
    held = weights.sum(axis=1)
    return independence.mixture(sheets, range(len(sheets)), held, np.array(means), np.array(roots))


def _drawn(
    surface: LogDensity, found: Mixture, n: int, seed: Random
) -> tuple[Weighed, Array, float]:
    """Of `n` draws, or more where many are outside the prior, those with a density; each sheet's shares
    of them `(S, N)`; and how many of all are inside.
    """
    inside = surface.inside(found.draw(n, seed).u).mean()
    every = found.draw(int(n / max(float(inside), 1.0 / REPEATED)), seed)
    value = surface.value(every.u)
    good = np.isfinite(value)
    kept = every.those(good)
    shares, log_q = found.shares(*found.coordinates(kept))
    return Weighed(kept.u, value[good] - log_q, np.zeros(len(log_q))), shares, float(inside)


def _nothing(surface: LogDensity, proposal: Proposal, draws: Weighed) -> bool:
    """Whether hardly any of the posterior is where the proposal hardly ever goes, as far as one sees."""
    ratio = surface.value(draws.u) - proposal.mixture.log_density(draws.u)
    left_out = float(draws.weights[ratio > proposal.usual + FAR].sum())
    return left_out < LEFT_OUT and draws.effective > LEAST * len(draws.u)
