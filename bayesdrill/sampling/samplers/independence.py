"""Fit an independence proposal to weighted draws: a Gaussian mixture over ridge coordinates.

The draws come from an earlier q and from a wider density, which shows where q is too small.

A sheet is a ridge with its own coordinates; each component of the mixture is Gaussian on one sheet.
The sum of all components is a density over u, normalised before the prior truncates it.

The proposal is learnt before the first step and never changes, so detailed balance holds exactly:
u' drawn from q is accepted with probability min(1, p(u') q(u) / (p(u) q(u'))).  Draws outside the
prior are drawn again without an evaluation of the model: the factor that normalises q cancels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.sampling.samplers.ridge import RidgeMap

Random = np.random.RandomState

LONG_LOG_RATIO = 2.0  # a walker is trapped if log (p/q) is this much above its typical value


@dataclass(frozen=True, slots=True)
class WeightedDraws:
    """Draws `u (N, D)` have two log weights `(N,)`: `log_w` = log (p/q), and `log_q`.

    `log_q` is log (q / density of the draws).  Densities need not be normalised; p may be 0.
    """

    u: Array
    log_w: Array
    log_q: Array

    @property
    def weights(self) -> Array:
        """Return the normalised importance weights of p, `(N,)`."""
        return normalised(self.log_q + self.log_w)

    @property
    def effective(self) -> float:
        """Return the effective number of these draws for p."""
        return effective_count(self.weights)

    @property
    def effective_share(self) -> float:
        """Return the fraction of draws from q alone that would be effective for p."""
        ratio, q = np.exp(self.log_w - self.log_w.max()), normalised(self.log_q)
        return float((q @ ratio) ** 2 / (q @ ratio**2))

    @property
    def acceptance(self) -> float:
        """Return the expected acceptance of independence proposals, E min(1, w(y) / w(x)).

        Here x is drawn from p and y from q.  It equals E min(w, w') / E w for two draws of q.
        """
        order = np.argsort(-self.log_w)
        ratio = np.exp(self.log_w[order] - self.log_w[order[0]])
        q = normalised(self.log_q)[order]
        larger = np.cumsum(q) - 0.5 * q  # mass of q at larger weights, plus half of this draw
        return float(2.0 * (q * ratio) @ larger / (q @ ratio))

    @property
    def trapped(self) -> float:
        """Return the mass of p in regions where p/q is so large that a walker would be trapped."""
        return float(self.weights[self.log_w > self.typical_log_ratio + LONG_LOG_RATIO].sum())

    @property
    def typical_log_ratio(self) -> float:
        """Return the median of log (p/q) for draws of p."""
        order = np.argsort(self.log_w)
        middle = int(np.searchsorted(np.cumsum(self.weights[order]), 0.5))
        return float(self.log_w[order[min(middle, len(order) - 1)]])

    def tempered(self, min_draws: float) -> Array:
        """Return weights of p^b q^(1 - b), with the largest b <= 1 for `min_draws` effective draws."""

        def flat(power: float) -> Array:
            with np.errstate(invalid="ignore"):
                return normalised(np.where(finite, self.log_q + power * self.log_w, -np.inf))

        finite = np.isfinite(self.log_w)
        if effective_count(flat(1.0)) >= min_draws:
            return flat(1.0)
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (
                (middle, high) if effective_count(flat(middle)) >= min_draws else (low, middle)
            )
        return flat(low)

    def supported(self) -> WeightedDraws:
        """Return the draws at which p is not zero."""
        finite = np.isfinite(self.log_w)
        return WeightedDraws(self.u[finite], self.log_w[finite], self.log_q[finite])


def normalised(log_w: Array) -> Array:
    """Return the weights with logs `log_w (N,)`, scaled to the sum 1."""
    weights = np.exp(log_w - log_w.max())
    return np.asarray(weights / weights.sum())


def effective_count(weights: Array) -> float:
    """Return the effective number of draws with `weights (N,)`, by Kish's formula."""
    largest = float(weights.max())
    if largest == 0.0:
        return 0.0
    scaled = weights / largest
    return float(scaled.sum() ** 2 / (scaled**2).sum())


Inside = Callable[[Array], Flags]

# Weight of draws outside the prior; at a corner of the prior, 1 would put 9 of 10 draws outside.
CUT_OFF_FILL = 0.8
VARIANCE_FLOOR = 1e-4  # fraction of a sheet's variance, added to that of each component
LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True)
class MixtureDraws:
    """Draws `u (n, D)` have log |du / dy| `(n,)`, and coordinates `y (n, D)` on their `sheet (n,)`."""

    u: Array
    jacobian: Array
    y: Array
    sheet: Indices

    def select(self, good: Flags | Indices) -> MixtureDraws:
        """Return the draws with these flags or indices."""
        return MixtureDraws(self.u[good], self.jacobian[good], self.y[good], self.sheet[good])


@dataclass(frozen=True, slots=True)
class Mixture:
    """A Gaussian mixture has its components on sheets of coordinates.

    Component k has the index `sheet (K,)` of its sheet and `weights (K,)` with sum 1.  Its `means
    (K, D)` and lower Cholesky factors `roots (K, D, D)` are in the coordinates of its sheet.
    `inverses` are the inverse roots; `constants (K,)` the log weighted densities at the means.
    """

    sheets: tuple[RidgeMap, ...]
    sheet: Indices
    weights: Array
    means: Array
    roots: Array
    inverses: Array
    constants: Array

    def draw(self, n: int, random: Random) -> MixtureDraws:
        """Draw `n` points, which may be outside the prior."""
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
        """Return the same as `straightened`, but reuse the coordinates of draws on their own sheets."""
        y = np.repeat(drawn.y[None], len(self.sheets), axis=0)
        jacobian = np.repeat(drawn.jacobian[None], len(self.sheets), axis=0)
        for s, sheet in enumerate(self.sheets):
            others = np.flatnonzero(drawn.sheet != s)
            if len(others) > 0:
                y[s, others], jacobian[s, others] = sheet.to_ridge_coordinates(drawn.u[others])
        return y, jacobian

    def with_width(self, factor: float) -> Mixture:
        """Return a mixture with components `factor` times as wide, and equal weights of the sheets."""
        sheet_weights = np.array([self.weights[self.sheet == s].sum() for s in self.sheet])
        weights = self.weights / sheet_weights
        return mixture(self.sheets, self.sheet, weights, self.means, factor * self.roots)

    def log_density(self, u: Array) -> Array:
        """Return the log density over u, `(W, D) -> (W,)`."""
        return self.log_density_at(*self.straightened(u))

    def log_density_at(self, y: Array, jacobian: Array) -> Array:
        """Return the log density over u of `straightened` points: `(W,)`."""
        return _summed(self.log_parts(y, jacobian))

    def component_fractions(self, y: Array, jacobian: Array) -> tuple[Array, Array]:
        """Return fractions q_k / q of the components in the density, `(K, W)`, and log q `(W,)`."""
        parts = self.log_parts(y, jacobian)
        log_q = _summed(parts)
        return np.exp(parts - log_q), log_q

    def responsibilities(self, y: Array, jacobian: Array, weights: Array) -> Array:
        """Return `weights (W,)` times q_k / q, the fraction of each component in q: `(K, W)`."""
        parts = self.log_parts(y, jacobian)
        shares = np.exp(parts - parts.max(axis=0))
        return np.asarray(shares * (weights / shares.sum(axis=0)))

    def straightened(self, u: Array) -> tuple[Array, Array]:
        """Return coordinates `y (S, W, D)` of `u (W, D)` on each sheet, and log |du / dy| `(S, W)`."""
        y, jacobian = zip(*(sheet.to_ridge_coordinates(u) for sheet in self.sheets), strict=True)
        return np.array(y), np.array(jacobian)

    def log_parts(self, y: Array, jacobian: Array) -> Array:
        """Return the log density over u of each component, with its weight: `(K, W)`."""
        standard = (y[self.sheet] - self.means[:, None, :]) @ self.inverses.transpose(0, 2, 1)
        squares = np.einsum("kwd,kwd->kw", standard, standard)
        return np.asarray(self.constants[:, None] - jacobian[self.sheet] - 0.5 * squares)


def _summed(parts: Array) -> Array:
    """Return the log of the sum of densities with logs `(K, W)`: `(W,)`."""
    highest = parts.max(axis=0)
    return np.asarray(highest + np.log(np.exp(parts - highest).sum(axis=0)))


def mixture(
    sheets: Sequence[RidgeMap],
    sheet: Sequence[int] | Indices,
    weights: Sequence[float] | Array,
    means: Sequence[Array] | Array,
    roots: Sequence[Array] | Array,
) -> Mixture:
    """Build a `Mixture`, whose `weights (K,)` need not be normalised."""
    weights, means, roots = np.array(weights), np.array(means), np.array(roots)
    weights = weights / weights.sum()
    log_det = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    with np.errstate(divide="ignore"):
        constants = np.log(weights) - log_det - 0.5 * means.shape[1] * LOG_2PI
    inverses = np.linalg.inv(roots)
    which = np.array(sheet, dtype=np.intp)
    return Mixture(tuple(sheets), which, weights, means, roots, inverses, constants)


def fit_mixture(
    start: Mixture, u: Array, weights: Array, in_support: Inside, rounds: int, random: Random
) -> Mixture:
    """Fit a mixture to draws `u (N, D)` with `weights (N,)` by expectation-maximisation from `start`.

    In each round, draws of the mixture itself outside the prior are added to `u`.  Without them,
    the mixture would be too low at ends of priors where the posterior density is not zero.
    """
    current = start
    y, jacobian = start.straightened(u)
    sheet_weights = _weights_of_sheets(start, y, jacobian, weights)
    floors = [_floor(*pair) for pair in zip(y, sheet_weights, strict=True)]
    for _ in range(rounds):
        drawn = current.draw(len(u), random).u
        out = ~in_support(drawn)
        share_inside = max(1.0 - float(out.mean()), 1.0 / len(u))
        y_out, jacobian_out = current.straightened(drawn[out])
        fill = np.full(int(out.sum()), CUT_OFF_FILL / (share_inside * len(u)))
        all_weights = np.concatenate([weights, fill])
        points = np.concatenate([y, y_out], axis=1)
        jacobians = np.concatenate([jacobian, jacobian_out], axis=1)
        current = improved(current, points, jacobians, all_weights, floors)
    return current


def improved(
    current: Mixture, y: Array, jacobian: Array, weights: Array, floors: list[Array]
) -> Mixture:
    """Return the mixture after a step of expectation maximisation, with `straightened` draws.

    The covariance of each component is increased by the floor `(D, D)` of its sheet.
    """
    shares = current.responsibilities(y, jacobian, weights)
    totals = shares.sum(axis=1)
    means, roots = current.means.copy(), current.roots.copy()
    dimension = means.shape[1]
    for k, total in enumerate(totals):
        if total < 1e-12 or effective_count(shares[k]) < 2 * dimension:
            continue  # there are too few draws for a new mean and covariance
        points = y[current.sheet[k]]
        means[k] = shares[k] @ points / total
        deviations = points - means[k]
        covariance = (deviations * shares[k][:, None]).T @ deviations / total
        with suppress(np.linalg.LinAlgError):  # singular if one draw outweighs all others
            roots[k] = np.linalg.cholesky(covariance + floors[current.sheet[k]])
    return mixture(current.sheets, current.sheet, np.maximum(totals, 1e-12), means, roots)


def _weights_of_sheets(current: Mixture, y: Array, jacobian: Array, weights: Array) -> list[Array]:
    """Return `weights (N,)` times the fraction of each sheet in q: `(N,)` each."""
    if len(current.sheets) == 1:
        return [weights]
    shares, _ = current.component_fractions(y, jacobian)
    return [weights * shares[current.sheet == s].sum(axis=0) for s in range(len(current.sheets))]


def _floor(y: Array, weights: Array) -> Array:
    total = max(float(weights.sum()), 1e-300)
    mean = weights @ y / total
    spread = weights @ (y - mean) ** 2 / total
    return np.diag(VARIANCE_FLOOR * spread + 1e-12)


MAX_REDRAWS = 8  # largest number of rounds; each replaces draws outside the prior
MAX_DRAWS_PER_WANTED = 10  # largest number of draws in a round / number of wanted draws


@dataclass(frozen=True, slots=True)
class Proposal:
    """A proposal draws steps from a mixture, inside the prior.

    `share_inside` is the approximate fraction of the mixture's draws inside the prior, and
    `typical_log_ratio` the median of log (p/q) for draws of p.
    """

    mixture: Mixture
    share_inside: float
    typical_log_ratio: float

    def trapping_log_p(self, log_q: Array) -> Array:
        """Return the log p above which a walker is trapped, for its `log_q (W,)`."""
        return self.typical_log_ratio + LONG_LOG_RATIO + log_q

    def draw(self, n: int, in_support: Inside, random: Random) -> tuple[Array, Array]:
        """Draw `n` points `(n, D)` inside the prior; return them and their log q `(n,)`.

        Points may remain outside after `MAX_REDRAWS` rounds; such points are never accepted.  Their
        number does not depend on the walkers, so the chain stays exact.
        """
        have = 0
        batches: list[tuple[Array, Array]] = []
        for attempt in range(MAX_REDRAWS):
            wanted = min(1.2 * (n - have) / self.share_inside, MAX_DRAWS_PER_WANTED * n)
            drawn = self.mixture.draw(int(wanted) + 8, random)
            if attempt < MAX_REDRAWS - 1:
                drawn = drawn.select(np.flatnonzero(in_support(drawn.u))[: n - have])
            log_q = self.mixture.log_density_at(*self.mixture.coordinates(drawn))
            batches.append((drawn.u, log_q))
            have += len(drawn.u)
            if have >= n:
                break
        return tuple(np.concatenate(parts)[:n] for parts in zip(*batches, strict=True))  # type: ignore[return-value]


class CachedLogDensity:
    """A cache keeps the log density of a mixture at the walkers, and recomputes it if they move."""

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
        """Store `log_q (W,)` of the points `u (W, D)` for the next step."""
        self._u, self._log_q = u.copy(), log_q
