"""An independence proposal: it is learnt before the first step, and depends on nothing that the
chain does, so that detailed balance holds exactly: u' drawn from the density q is accepted with
min(1, p(u') q(u) / (p(u) q(u'))).

Draws outside the prior are drawn again, which costs no response of the model where no ridge is
settled; what the cut does to the norm of q cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.engines.samplers.mixture import Inside, Mixture
from bayesdrill.engines.samplers.weighing import LONG

Array = NDArray[np.float64]
Random = np.random.RandomState

SETTLED = 0.5  # of the steps, where there is such a proposal
ALONE = 0.2  # of the steps: the model is as dear for one walker as for thirty, ...
SETTLED_ALONE = 0.5  # ... and of those along settled ridges: there more are left waiting
MOST_REDRAWS = 8
MOST_AT_ONCE = 10  # draws for each that is wanted: in a corner of the prior few are inside


@dataclass(frozen=True, slots=True)
class Proposal:
    """`share`: of the mixture's draws that are inside the prior, about.

    `usual`: log p - log q where most of p is.  `alone`: after which share of its steps walkers that
    would wait step by themselves.  `settled`: another, which costs far more and goes where this one
    hardly ever does.
    """

    mixture: Mixture
    share: float
    usual: float
    alone: float = ALONE
    settled: Proposal | None = None

    def one_of(self, random: Random) -> Proposal:
        """What a step draws from: mostly this."""
        if self.settled is None or random.random_sample() > SETTLED:
            return self
        return self.settled

    @property
    def widest(self) -> Proposal:
        """What leaves least of the posterior out."""
        return self.settled or self

    def high(self, log_q: Array) -> Array:
        """Above which log p a walker where q is `log_q (W,)` would wait long."""
        return self.usual + LONG + log_q

    def draw(self, n: int, inside: Inside, random: Random) -> tuple[Array, Array]:
        """`n` draws `(n, D)` inside the prior, and their log q `(n,)`.

        After `MOST_REDRAWS` some may be outside, where they are never accepted: that depends on
        no walker, so the chain stays exact.
        """
        have = 0
        found: list[tuple[Array, Array]] = []
        for attempt in range(MOST_REDRAWS):
            wanted = min(1.2 * (n - have) / self.share, MOST_AT_ONCE * n)
            drawn = self.mixture.draw(int(wanted) + 8, random)
            if attempt < MOST_REDRAWS - 1:
                drawn = drawn.those(np.flatnonzero(inside(drawn.u))[: n - have])
            found.append((drawn.u, self.mixture.log_density_of(drawn)))
            have += len(drawn.u)
            if have >= n:
                break
        return tuple(np.concatenate(parts)[:n] for parts in zip(*found, strict=True))  # type: ignore[return-value]


class Remembered:
    """Log q where walkers stand, of one mixture: asked for again where they have moved."""

    def __init__(self, mixture: Mixture) -> None:
        self.mixture = mixture
        self._u = np.empty((0, 0))
        self._log_q = np.empty(0)

    def at(self, u: Array) -> Array:
        """`(W, D)` to `(W,)`."""
        if self._u.shape != u.shape:
            self.keep(u, self.mixture.log_density(u))
        moved = np.flatnonzero((self._u != u).any(axis=1))
        if len(moved) > 0:
            log_q = self._log_q.copy()
            log_q[moved] = self.mixture.log_density(u[moved])
            self.keep(u, log_q)
        return self._log_q

    def keep(self, u: Array, log_q: Array) -> None:
        """For the next time."""
        self._u, self._log_q = u.copy(), log_q
