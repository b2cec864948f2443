"""An independence proposal: it is learnt before the first step, and depends on nothing that the
chain does, so that detailed balance holds exactly: u' drawn from the density q is accepted with
min(1, p(u') q(u) / (p(u) q(u'))).

Now and then a whole step is drawn from the same density made wider: a walker in a tail that the
proposal hardly reaches would wait there for thousands of steps.

Draws outside the prior are drawn again, which costs no response of the model; what the cut does to
the norm of q cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.samplers.mixture import Inside, Mixture

Array = NDArray[np.float64]
Random = np.random.RandomState

WIDER, WIDELY = 1.5, 0.05  # how much wider, and in which share of the steps
MOST_REDRAWS = 8
MOST_AT_ONCE = 20  # draws for each that is wanted: in a corner of the prior few are inside


@dataclass(frozen=True, slots=True)
class Proposal:
    """`share`: of the mixture's draws that are inside the prior, about."""

    mixture: Mixture
    share: float

    def propose(self, u: Array, inside: Inside, random: Random) -> tuple[Array, Array]:
        """New points, and log q(old) - log q(new), for walkers at `u (W, D)`."""
        one = self.widened() if random.random_sample() < WIDELY else self
        fresh, log_q = one.draw(len(u), inside, random)
        return fresh, one.mixture.log_density(u) - log_q

    def widened(self) -> Proposal:
        return Proposal(self.mixture.widened(WIDER), self.share)

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
                drawn = drawn.those(inside(drawn.u))
            found.append((drawn.u, self.mixture.log_density_of(drawn)))
            have += len(drawn.u)
            if have >= n:
                break
        return tuple(np.concatenate(parts)[:n] for parts in zip(*found, strict=True))  # type: ignore[return-value]
