"""An independence proposal learnt from a pilot run, then frozen.

Frozen, it depends on nothing that the chain does, so that detailed balance holds exactly: a
proposal z' drawn from the density q is accepted with min(1, p(z') q(z) / (p(z) q(z'))).

q is a Gaussian mixture in coordinates that take a bend out of the posterior, cut off where the
prior ends: draws outside are drawn again, which costs no response of the model, and what the cut
does to the norm of q cancels.  A posterior that fills the corners of a box is met so without
components for every corner.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.samplers import shear
from bayesdrill.samplers.shear import Shear

Array = NDArray[np.float64]
Inside = Callable[[Array], NDArray[np.bool_]]
Random = np.random.RandomState

COMPONENTS = 4
DRAWS_PER_COMPONENT = 20  # times the dimension: fewer draws get fewer components
MOST_DRAWS = 5000
FLOOR = 1e-4  # added to the variances of whitened draws, so that no component collapses
ROUNDS = 8  # of filling up what the prior cuts off, and fitting again
WIDE_WEIGHT, WIDE_SCALE = 0.05, 1.5  # a component that is wider than all draws: it holds the tails
MOST_REDRAWS = 20


@dataclass(frozen=True, slots=True)
class Mixture:
    """`weights (K,)`, `means (K, D)`, lower Cholesky factors `roots (K, D, D)`."""

    weights: Array
    means: Array
    roots: Array
    inverses: Array
    constants: Array

    def draw(self, n: int, random: Random) -> Array:
        """`(n, D)`."""
        chosen = np.searchsorted(np.cumsum(self.weights)[:-1], random.random_sample(n))
        normal = random.standard_normal((n, self.means.shape[1]))
        drawn = np.empty_like(normal)
        for k, (mean, root) in enumerate(zip(self.means, self.roots, strict=True)):
            mine = chosen == k
            drawn[mine] = mean + normal[mine] @ root.T
        return drawn

    def log_density(self, y: Array) -> Array:
        """`(W, D) -> (W,)`, normalised."""
        standard = (y - self.means[:, None, :]) @ self.inverses.transpose(0, 2, 1)
        parts = self.constants[:, None] - 0.5 * np.einsum("kwd,kwd->kw", standard, standard)
        highest = parts.max(axis=0)
        return np.asarray(highest + np.log(np.exp(parts - highest).sum(axis=0)))


def mixture(weights: Array, means: Array, roots: Array) -> Mixture:
    log_det = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    constants = np.log(weights) - log_det - 0.5 * means.shape[1] * np.log(2 * np.pi)
    return Mixture(weights, means, roots, np.linalg.inv(roots), constants)


@dataclass(frozen=True, slots=True)
class Proposal:
    """`share`: of the mixture's draws that are inside the prior."""

    straight: Shear
    mixture: Mixture
    share: float

    def propose(self, z: Array, inside: Inside, random: Random) -> tuple[Array, Array]:
        """New points, and log q(old) - log q(new), for walkers at `z (W, D)`."""
        fresh, y = self._draw(len(z), inside, random)
        old = self.mixture.log_density(self.straight.straighten(z))
        return fresh, old - self.mixture.log_density(y)

    def _draw(self, n: int, inside: Inside, random: Random) -> tuple[Array, Array]:
        """`n` draws in both coordinates.

        After `MOST_REDRAWS` some may be outside, where they are never accepted: that depends on
        no walker, so the chain stays exact.
        """
        have = 0
        found: list[Array] = []
        for attempt in range(MOST_REDRAWS):
            y = self.mixture.draw(int(1.2 * (n - have) / self.share) + 8, random)
            if attempt < MOST_REDRAWS - 1:
                y = y[inside(self.straight.bend(y))]
            found.append(y)
            have += len(y)
            if have >= n:
                break
        y = np.concatenate(found)[:n]
        return self.straight.bend(y), y


def learn(draws: Array, inside: Inside, random: Random) -> Proposal:
    """A proposal for `draws (N, D)` of a pilot run, for points that are `inside` the prior.

    Expectation and maximisation for a mixture that is cut off: what the present mixture puts
    outside is added to the draws, and the mixture is fitted again.
    """
    from sklearn.mixture import GaussianMixture  # late: only runs that learn a proposal need it

    draws = draws[:: -(-len(draws) // MOST_DRAWS)]
    straight = shear.fit(draws)
    n, d = draws.shape
    y = straight.straighten(draws)
    root = np.linalg.cholesky(np.cov(y.T).reshape(d, d))
    white = np.linalg.solve(root, y.T).T
    components = int(np.clip(n // (DRAWS_PER_COMPONENT * d), 1, COMPONENTS))
    model: Any = GaussianMixture(
        components, reg_covar=FLOOR, max_iter=30, warm_start=True, random_state=random
    )
    outside = white[:0]
    share = 1.0
    for _ in range(1 + ROUNDS):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a fit that is not finished is a good proposal too
            model.fit(np.concatenate([white, outside]))
        fitted = mixture(model.weights_, model.means_, np.linalg.cholesky(model.covariances_))
        drawn = fitted.draw(min(int(n / share), 4 * n), random)
        out = ~inside(straight.bend(drawn @ root.T))
        share = max(1.0 - out.mean(), 1.0 / len(drawn))
        outside = drawn[out]
        model.set_params(max_iter=5)
    wide = np.zeros((1, d)), WIDE_SCALE * np.eye(d)[None]
    final = mixture(
        np.append((1.0 - WIDE_WEIGHT) * fitted.weights, WIDE_WEIGHT),
        np.concatenate([fitted.means, wide[0]]) @ root.T,
        root @ np.concatenate([fitted.roots, wide[1]]),
    )
    return Proposal(straight, final, share)


def expected_acceptance(
    proposal: Proposal,
    target: Callable[[Array], Array],
    inside: Inside,
    draws: Array,
    log_p: Array,
    random: Random,
) -> float:
    """Share of proposals that would be accepted from `draws (N, D)` with densities `log_p (N,)`."""
    fresh, factor = proposal.propose(draws, inside, random)
    ratio = target(fresh) - log_p + factor
    return float(np.mean(np.exp(np.minimum(ratio, 0.0))))
