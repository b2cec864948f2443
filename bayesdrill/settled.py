"""Where polynomials are no match for a ridge: Gauss and Newton bring every point of it home.

That costs some twenty times as much as a response.  So the ridge is first looked at in this way,
and only where the proposal leaves out some of the posterior is a part of the steps made so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesdrill.directions import Expand
from bayesdrill.ridges import led_back, moments
from bayesdrill.samplers import mixture, ridge
from bayesdrill.samplers.independence import Proposal
from bayesdrill.samplers.mixture import Mixture
from bayesdrill.samplers.ridge import Frame, Sheet
from bayesdrill.samplers.weighing import Weighed
from bayesdrill.surface import Surface

Array = NDArray[np.float64]
Random = np.random.RandomState

DRAWS = (400, 400, 1600)  # of each round: the first sees whether anything was left out
LEFT_OUT = 0.01  # of the posterior, where p over q is e^FAR times what is usual
FAR, FEW = 3.0, 3  # ... and no chance: so many of the draws at least
LEAST = 0.02  # of effective draws: with less nothing is seen
ENOUGH = 0.1  # of effective draws: below it the density is flattened until there are as many
HARDLY = 1e-9  # of the posterior: where a sheet has none of the draws
FURTHER, ACROSS = 1.3, 1.05  # times as wide as what is known, along the ridge and across it


@dataclass(frozen=True, slots=True)
class Settled:
    """`ridge`, from whose place and root each point is brought to where the ridge is.

    A function of psi alone, whether or not it arrives.
    """

    ridge: Sheet
    expand: Expand

    @property
    def frame(self) -> Frame:
        return self.ridge.frame

    @property
    def n_loose(self) -> int:
        return self.ridge.n_loose

    def along(self, psi: Array) -> tuple[Array, Array, Array]:
        place, root, log_det = self.ridge.along(psi)
        found, roots, _, arrived = led_back(self.expand, self.frame, psi, place)
        row = np.arange(place.shape[1])
        place = np.where(arrived[:, None], found, place)
        root[:, :, arrived] = np.moveaxis(roots[arrived], 0, 2)
        log_det[arrived] = np.log(root[row, row][:, arrived]).sum(axis=0)
        return place, root, log_det

    def within(self, psi: Array) -> NDArray[np.bool_]:
        return self.ridge.within(psi)

    def bend(self, y: Array) -> tuple[Array, Array]:
        return ridge.bend(self, y)

    def straighten(self, u: Array) -> tuple[Array, Array]:
        return ridge.straighten(self, u)


def bound(proposal: Proposal, expand: Expand) -> Proposal:
    """With the ridges of its `settled` part brought home by `expand`."""
    if proposal.settled is None:
        return proposal
    own = proposal.settled
    return replace(proposal, settled=replace(own, mixture=_settled(own.mixture, expand)))


def _settled(found: Mixture, expand: Expand) -> Mixture:
    return replace(found, sheets=tuple(Settled(sheet, expand) for sheet in found.sheets))


@dataclass(frozen=True, slots=True)
class Look:
    """Along settled ridges: `proposal` of its own, whose `draws` all have a density."""

    proposal: Proposal
    draws: Weighed


def look(
    surface: Surface,
    expand: Expand,
    proposal: Proposal,
    sheets: Sequence[int],
    seen: tuple[Array, Array],
    seed: Random,
) -> Look | None:
    """None where `proposal` leaves nothing out, or where nothing can be seen.

    `sheets`: those of the proposal that are looked along.  `seen`: draws of the posterior `(N, D)`,
    and their weights for each of those sheets `(S, N)`.
    """
    chosen = [proposal.mixture.sheets[s] for s in sheets]
    if all(sheet.n_loose in (0, len(sheet.frame.centre)) for sheet in chosen):
        return None
    for k, n in enumerate(DRAWS):
        found = _wide(chosen, *seen)
        draws, shares, inside = _drawn(surface, _settled(found, expand), n, seed)
        if len(draws.u) == 0 or draws.effective < LEAST * len(draws.u):
            return None
        if k == 0 and _left_out(proposal, draws, surface) < LEFT_OUT:
            return None
        seen = draws.u, shares * draws.tempered(ENOUGH * len(draws.u))
    return Look(Proposal(found, inside, draws.usual, alone=1.0), draws)


def _wide(sheets: Sequence[Sheet], u: Array, weights: Array) -> Mixture:
    """A component for each sheet, wider than draws `u (N, D)` of `weights (S, N)` along it."""
    means, roots = [], []
    for sheet, own in zip(sheets, weights, strict=True):
        n, d = sheet.n_loose, u.shape[1]
        middle, root = moments(sheet.frame.split(u)[0], own + HARDLY)
        means.append(np.concatenate([middle, np.zeros(d - n)]))
        roots.append(ACROSS * np.eye(d))
        roots[-1][:n, :n] = FURTHER * root
    held = weights.sum(axis=1)
    return mixture.mixture(sheets, range(len(sheets)), held, np.array(means), np.array(roots))


def _drawn(surface: Surface, found: Mixture, n: int, seed: Random) -> tuple[Weighed, Array, float]:
    """Of `n` draws those with a density, each sheet's shares of them `(S, N)`, and how many are
    inside the prior.
    """
    every = found.draw(n, seed)
    value = surface.value(every.u)
    kept = every.those(np.isfinite(value))
    y, jacobian = found.coordinates(kept)
    parts = found.log_parts(y, jacobian)
    log_q = found.log_density_at(y, jacobian)
    draws = Weighed(kept.u, value[np.isfinite(value)] - log_q, np.zeros(len(log_q)))
    return draws, np.exp(parts - log_q), float(surface.inside(every.u).mean())


def _left_out(proposal: Proposal, draws: Weighed, surface: Surface) -> float:
    """How much of the posterior is where the proposal hardly ever goes."""
    ratio = surface.value(draws.u) - proposal.mixture.log_density(draws.u)
    high = ratio > proposal.usual + FAR
    return float(draws.weights[high].sum()) if high.sum() >= FEW else 0.0
