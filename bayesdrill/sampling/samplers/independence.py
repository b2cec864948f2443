"""Fit an independence proposal to weighted draws: a Gaussian mixture over ridge coordinates.

Draws come from the proposal q and from a wider density too, so that what q hardly ever proposes is
seen as well: a proposal that looks only where it goes takes itself for perfect.

A sheet is a ridge with coordinates of its own; every component belongs to one.  Together they are
one normalised density over u (up to what the prior cuts off, which is the same for all of it).

The proposal is learnt before the first step, and depends on nothing that the chain does, so that
detailed balance holds exactly: u' drawn from q is accepted with min(1, p(u') q(u) / (p(u) q(u'))).

Draws outside the prior are drawn again, which costs no response of the model; what the cut does to
the norm of q cancels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.sampling.samplers.ridge import RidgeMap

Random = np.random.RandomState

LONG_LOG_RATIO = 2.0  # of the log of p over q above the usual: e^2 times as long as usual


@dataclass(frozen=True, slots=True)
class WeightedDraws:
    """Draws `u (N, D)`, logs of p over q `(N,)`, and of how much of q each of them stands for `(N,)`.

    Neither p nor q need be normalised; p may be zero.
    """

    u: Array
    log_w: Array
    log_q: Array

    @property
    def weights(self) -> Array:
        """Normalised weights `(N,)`: with them the draws are those of p."""
        return normalised(self.log_q + self.log_w)

    @property
    def effective(self) -> float:
        """The effective number of these draws."""
        return effective_count(self.weights)

    @property
    def share(self) -> float:
        """How many of draws from q alone would be effective."""
        ratio, q = np.exp(self.log_w - self.log_w.max()), normalised(self.log_q)
        return float((q @ ratio) ** 2 / (q @ ratio**2))

    @property
    def acceptance(self) -> float:
        """The acceptance of independent proposals in the long run.

        A move from x to y is accepted with min(1, w(y) / w(x)), x from p and y from q: the mean of
        the smaller of two weights, over the mean weight.
        """
        order = np.argsort(-self.log_w)
        ratio = np.exp(self.log_w[order] - self.log_w[order[0]])
        q = normalised(self.log_q)[order]
        larger = np.cumsum(q) - 0.5 * q  # of q where the weight is larger, itself half
        return float(2.0 * (q * ratio) @ larger / (q @ ratio))

    @property
    def trapped(self) -> float:
        """How much of p is where q is so thin that a walker would wait long for another point."""
        return float(self.weights[self.log_w > self.typical_log_ratio + LONG_LOG_RATIO].sum())

    @property
    def typical_log_ratio(self) -> float:
        """The log of p over q where most of p is: its median over p."""
        order = np.argsort(self.log_w)
        middle = int(np.searchsorted(np.cumsum(self.weights[order]), 0.5))
        return float(self.log_w[order[min(middle, len(order) - 1)]])

    def tempered(self, least: float) -> Array:
        """Return weights of p^b q^(1 - b), with the largest b up to 1 for `least` effective draws."""

        def flat(power: float) -> Array:
            with np.errstate(invalid="ignore"):
                return normalised(np.where(finite, self.log_q + power * self.log_w, -np.inf))

        finite = np.isfinite(self.log_w)
        if effective_count(flat(1.0)) >= least:
            return flat(1.0)
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if effective_count(flat(middle)) >= least else (low, middle)
        return flat(low)

    def supported(self) -> WeightedDraws:
        """Return the draws where p is not zero."""
        finite = np.isfinite(self.log_w)
        return WeightedDraws(self.u[finite], self.log_w[finite], self.log_q[finite])


def normalised(log_w: Array) -> Array:
    """Return weights with sum 1 of their logs `(N,)`."""
    weights = np.exp(log_w - log_w.max())
    return np.asarray(weights / weights.sum())


def effective_count(weights: Array) -> float:
    """Return the effective number of draws with these `weights (N,)` (Kish)."""
    largest = float(weights.max())
    if largest == 0.0:
        return 0.0
    scaled = weights / largest
    return float(scaled.sum() ** 2 / (scaled**2).sum())


Inside = Callable[[Array], Flags]

# Of what the prior cuts off: with all of it, nine of ten draws would be cut off in a corner.
CUT_OFF_FILL = 0.8
VARIANCE_FLOOR = 1e-4  # of the variance of all draws of a sheet, added to that of its components
LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True)
class MixtureDraws:
    """Draws `u (n, D)`, log |du / dy| `(n,)` and `y (n, D)`, each on the sheet it was drawn on."""

    u: Array
    jacobian: Array
    y: Array
    sheet: Indices

    def select(self, good: Flags | Indices) -> MixtureDraws:
        """Return those draws that are `good`."""
        return MixtureDraws(self.u[good], self.jacobian[good], self.y[good], self.sheet[good])


@dataclass(frozen=True, slots=True)
class Mixture:
    """A Gaussian mixture over sheets of coordinates.

    `sheet (K,)`: which of `sheets` a component lives on; `weights (K,)` sum to 1; `means (K, D)` and
    lower Cholesky factors `roots (K, D, D)` in the sheet's coordinates.
    """

    sheets: tuple[RidgeMap, ...]
    sheet: Indices
    weights: Array
    means: Array
    roots: Array
    inverses: Array
    constants: Array

    def draw(self, n: int, random: Random) -> MixtureDraws:
        """Draw `n` points, inside the prior or not."""
        component = np.searchsorted(np.cumsum(self.weights)[:-1], random.random_sample(n))
        normal = random.standard_normal((n, self.means.shape[1]))
        y, u, jacobian = np.empty_like(normal), np.empty_like(normal), np.empty(n)
        for k, (mean, root) in enumerate(zip(self.means, self.roots, strict=True)):
            mine = np.flatnonzero(component == k)
            y[mine] = mean + normal[mine] @ root.T
        for s, sheet in enumerate(self.sheets):
            mine = np.flatnonzero(self.sheet[component] == s)
            u[mine], jacobian[mine] = sheet.from_ridge_coordinates(y[mine])
        return MixtureDraws(u, jacobian, y, self.sheet[component])

    def coordinates(self, drawn: MixtureDraws) -> tuple[Array, Array]:
        """Return `straightened` of draws of its own, known already on the sheet they come from."""
        y = np.repeat(drawn.y[None], len(self.sheets), axis=0)
        jacobian = np.repeat(drawn.jacobian[None], len(self.sheets), axis=0)
        for s, sheet in enumerate(self.sheets):
            others = np.flatnonzero(drawn.sheet != s)
            if len(others) > 0:
                y[s, others], jacobian[s, others] = sheet.to_ridge_coordinates(drawn.u[others])
        return y, jacobian

    def with_width(self, factor: float) -> Mixture:
        """Return a mixture with components `factor` times as wide, and equal shares for the sheets."""
        each = np.array([self.weights[self.sheet == s].sum() for s in self.sheet])
        weights = self.weights / each
        return mixture(self.sheets, self.sheet, weights, self.means, factor * self.roots)

    def log_density(self, u: Array) -> Array:
        """Return the log density over u, `(W, D) -> (W,)`."""
        return self.log_density_at(*self.straightened(u))

    def log_density_at(self, y: Array, jacobian: Array) -> Array:
        """Return the log density over u of `straightened` points: `(W,)`."""
        return _summed(self.log_parts(y, jacobian))

    def shares(self, y: Array, jacobian: Array) -> tuple[Array, Array]:
        """Return the share of each component in the density, `(K, W)`, and the log of that `(W,)`."""
        parts = self.log_parts(y, jacobian)
        log_q = _summed(parts)
        return np.exp(parts - log_q), log_q

    def responsibilities(self, y: Array, jacobian: Array, weights: Array) -> Array:
        """Return each component's part of each of `weights (W,)`: `(K, W)`."""
        parts = self.log_parts(y, jacobian)
        shares = np.exp(parts - parts.max(axis=0))
        return np.asarray(shares * (weights / shares.sum(axis=0)))

    def straightened(self, u: Array) -> tuple[Array, Array]:
        """Return `y (S, W, D)` on each sheet and log |du / dy| `(S, W)`."""
        y, jacobian = zip(*(sheet.to_ridge_coordinates(u) for sheet in self.sheets), strict=True)
        return np.array(y), np.array(jacobian)

    def log_parts(self, y: Array, jacobian: Array) -> Array:
        """Return the log density over u of each component, its weight included: `(K, W)`."""
        standard = (y[self.sheet] - self.means[:, None, :]) @ self.inverses.transpose(0, 2, 1)
        squares = np.einsum("kwd,kwd->kw", standard, standard)
        return np.asarray(self.constants[:, None] - jacobian[self.sheet] - 0.5 * squares)


def _summed(parts: Array) -> Array:
    """Log of the sum of densities whose logs are `(K, W)`: `(W,)`."""
    highest = parts.max(axis=0)
    return np.asarray(highest + np.log(np.exp(parts - highest).sum(axis=0)))


def mixture(
    sheets: Sequence[RidgeMap],
    sheet: Sequence[int] | Indices,
    weights: Sequence[float] | Array,
    means: Sequence[Array] | Array,
    roots: Sequence[Array] | Array,
) -> Mixture:
    """Build a mixture of components on `sheets`; `weights (K,)` need not be normalised."""
    weights, means, roots = np.array(weights), np.array(means), np.array(roots)
    weights = weights / weights.sum()
    log_det = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    with np.errstate(divide="ignore"):
        constants = np.log(weights) - log_det - 0.5 * means.shape[1] * LOG_2PI
    inverses = np.linalg.inv(roots)
    which = np.array(sheet, dtype=np.intp)
    return Mixture(tuple(sheets), which, weights, means, roots, inverses, constants)


def fit_mixture(
    start: Mixture, u: Array, weights: Array, inside: Inside, rounds: int, random: Random
) -> Mixture:
    """Fit by expectation and maximisation from `start`, for draws `u (N, D)` of `weights (N,)`.

    What the mixture puts outside the prior is added to the draws in each round, so that it is free
    to be anything there: a density that ends at a wall is met by components that reach beyond.
    """
    current = start
    y, jacobian = start.straightened(u)
    sheet_weights = _weights_of_sheets(start, y, jacobian, weights)
    floors = [_floor(*pair) for pair in zip(y, sheet_weights, strict=True)]
    for _ in range(rounds):
        drawn = current.draw(len(u), random).u
        out = ~inside(drawn)
        share = max(1.0 - float(out.mean()), 1.0 / len(u))
        y_out, jacobian_out = current.straightened(drawn[out])
        fill = np.full(int(out.sum()), CUT_OFF_FILL / (share * len(u)))
        all_weights = np.concatenate([weights, fill])
        points = np.concatenate([y, y_out], axis=1)
        jacobians = np.concatenate([jacobian, jacobian_out], axis=1)
        current = _step(current, points, jacobians, all_weights, floors)
    return current


def _step(
    current: Mixture, y: Array, jacobian: Array, weights: Array, floors: list[Array]
) -> Mixture:
    shares = current.responsibilities(y, jacobian, weights)
    totals = shares.sum(axis=1)
    means, roots = current.means.copy(), current.roots.copy()
    dimension = means.shape[1]
    for k, total in enumerate(totals):
        if total < 1e-12 or effective_count(shares[k]) < 2 * dimension:
            continue  # too few draws to move it
        points = y[current.sheet[k]]
        means[k] = shares[k] @ points / total
        off = points - means[k]
        covariance = (off * shares[k][:, None]).T @ off / total
        with suppress(np.linalg.LinAlgError):  # of one draw that outweighs all others
            roots[k] = np.linalg.cholesky(covariance + floors[current.sheet[k]])
    return mixture(current.sheets, current.sheet, np.maximum(totals, 1e-12), means, roots)


def _weights_of_sheets(current: Mixture, y: Array, jacobian: Array, weights: Array) -> list[Array]:
    """How much of each weight every sheet stands for: `(N,)` each."""
    if len(current.sheets) == 1:
        return [weights]
    shares, _ = current.shares(y, jacobian)
    return [weights * shares[current.sheet == s].sum(axis=0) for s in range(len(current.sheets))]


def _floor(y: Array, weights: Array) -> Array:
    total = max(float(weights.sum()), 1e-300)
    mean = weights @ y / total
    spread = weights @ (y - mean) ** 2 / total
    return np.diag(VARIANCE_FLOOR * spread + 1e-12)


MAX_REDRAWS = 8
MAX_DRAWS_PER_WANTED = 10  # draws for each that is wanted: in a corner of the prior few are inside


@dataclass(frozen=True, slots=True)
class Proposal:
    """A mixture from which steps are drawn inside the prior.

    `share`: of the mixture's draws that are inside the prior, about.  `typical_log_ratio`: log p -
    log q where most of p is.
    """

    mixture: Mixture
    share: float
    typical_log_ratio: float

    def high(self, log_q: Array) -> Array:
        """Return the log p above which a walker would wait long, where q is `log_q (W,)`."""
        return self.typical_log_ratio + LONG_LOG_RATIO + log_q

    def draw(self, n: int, inside: Inside, random: Random) -> tuple[Array, Array]:
        """Draw `n` points `(n, D)` inside the prior, and return their log q `(n,)` too.

        After `MAX_REDRAWS` some may be outside, where they are never accepted: that depends on no
        walker, so the chain stays exact.
        """
        have = 0
        batches: list[tuple[Array, Array]] = []
        for attempt in range(MAX_REDRAWS):
            wanted = min(1.2 * (n - have) / self.share, MAX_DRAWS_PER_WANTED * n)
            drawn = self.mixture.draw(int(wanted) + 8, random)
            if attempt < MAX_REDRAWS - 1:
                drawn = drawn.select(np.flatnonzero(inside(drawn.u))[: n - have])
            log_q = self.mixture.log_density_at(*self.mixture.coordinates(drawn))
            batches.append((drawn.u, log_q))
            have += len(drawn.u)
            if have >= n:
                break
        return tuple(np.concatenate(parts)[:n] for parts in zip(*batches, strict=True))  # type: ignore[return-value]


class CachedLogDensity:
    """Log q of one mixture where walkers stand; it is computed again where they have moved."""

    def __init__(self, mixture: Mixture) -> None:
        self.mixture = mixture
        self._u = np.empty((0, 0))
        self._log_q = np.empty(0)

    def at(self, u: Array) -> Array:
        """Return log q at `u (W, D)`: `(W,)`."""
        if self._u.shape != u.shape:
            self.keep(u, self.mixture.log_density(u))
        moved = np.flatnonzero((self._u != u).any(axis=1))
        if len(moved) > 0:
            log_q = self._log_q.copy()
            log_q[moved] = self.mixture.log_density(u[moved])
            self.keep(u, log_q)
        return self._log_q

    def keep(self, u: Array, log_q: Array) -> None:
        """Keep log q of these points for the next step."""
        self._u, self._log_q = u.copy(), log_q
