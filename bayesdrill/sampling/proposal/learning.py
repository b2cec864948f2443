"""Learn the independence proposal from the log density, before any walker takes a step.

The ridge of each maximum is traced, and defines a sheet: coordinates along and across the ridge.
Then draws of the proposal q get the weights p/q for the posterior p, and a new mixture of Gaussians
on sheets is fitted to the draws.  This adaptive importance sampling ends when q does not improve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.proposal.missed_mass import LOOKING, missed_mass
from bayesdrill.sampling.proposal.ridge_tracing import (
    USELESS_ERROR,
    TracedRidge,
    distances,
    moments,
    trace,
    trace_box,
)
from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.independence import (
    LONG_LOG_RATIO,
    Mixture,
    Proposal,
    Random,
    WeightedDraws,
    effective_count,
    normalised,
)

Component = tuple[int, float, Array, Array]  # index of a sheet, weight, mean, root of covariance

DRAWS_PER_ROUND = 2400  # draws of the proposal in a round
WIDE_FACTOR, WIDE_DRAWS = 1.5, 800  # relative width of the wider proposal, and its draws per round
RIDGES_PER_BATCH = 6  # a round has a batch of draws for every six ridges
MAX_TRIES_PER_DRAW = 50  # largest number of tries for each draw inside the prior
MAX_ROUNDS = 12  # largest number of rounds of drawing and fitting
FEW_ROUNDS, HOPELESS_DRAWS = 5, 2.0  # a later round with fewer effective draws ends the learning
MIN_IMPROVEMENT = 1.04  # q has settled if the effective fraction grows by a smaller factor
MIN_EFFECTIVE_SHARE = 0.3  # the learning goes on while a smaller fraction of the draws is effective
MIN_TEMPERED_SHARE = 0.1  # the weights are tempered until this fraction of the draws is effective
REDRAW_COST = 0.4  # cost of a draw outside the prior, in evaluations of the density
MAX_ADDED_RIDGES = 4  # largest number of rounds that add ridges
GOOD_EFFECTIVE_SHARE = 0.3  # no ridge is added if this fraction of the draws is effective
CENTRE_QUANTILE = 0.9  # new ridges start at draws with weights above this quantile
MAX_STRAY_MASS = 0.01  # with more posterior mass beyond the ends of ridges, the ridges are replaced
TRAPPING_PENALTY = 20.0  # penalty for posterior mass where p/q is so large that walkers are trapped
MAX_TRAPPED_MASS = 0.005  # posterior mass in such regions, above which the learning goes on
COMPONENT_SCALE = 0.7  # initial width of each of several components, relative to a single one
INITIAL_TIGHT_SDS = 1.2  # initial width in the tight directions, in standard deviations
NEGLIGIBLE_RIDGE = 1e-6  # posterior mass below which a ridge is left out
NEGLIGIBLE_MAXIMUM = 1e-3  # posterior mass below which a maximum is not checked for missed mass
MAX_COMPONENTS_OF_RIDGE, MAX_COMPONENTS = 4, 32  # largest numbers, per ridge and in total
EM_ROUNDS = (12, 6)  # expectation-maximisation iterations in the first round and in later ones
# Wide components for the tails: weight, and factors on the width along the ridge and across it.
TAIL_COMPONENTS = ((0.08, 2.0, 1.05), (0.04, 1.2, 1.5))


class NoSupportError(ValueError):
    """The posterior density is zero at all draws."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedProposal:
    """A learnt proposal has its test `draws`; `origin` is the index of each ridge's maximum.

    `missed` estimates the posterior mass that q hardly ever reaches.
    """

    proposal: Proposal
    draws: WeightedDraws
    origin: tuple[int, ...]
    missed: float = 0.0

    def mode_fractions(self, u: Array, n_maxima: int) -> Array:
        """Return the fraction of draws `u (N, D)` at each maximum: `(n_maxima,)`, sum 1."""
        equal = np.full(len(u), 1.0 / len(u))
        component_shares = responsibilities(self.proposal.mixture, u, equal)[1].sum(axis=1)
        mode_shares = np.zeros(n_maxima)
        np.add.at(mode_shares, np.array(self.origin)[self.proposal.mixture.sheet], component_shares)
        return mode_shares


def learn(
    surface: LogDensity,
    maxima: Sequence[Array],
    random: Random,
    rng: np.random.Generator,
    max_added_ridges: int = MAX_ADDED_RIDGES,
    report: Reporter = SILENT,
    *,
    check: bool = True,
) -> LearnedProposal:
    """Learn a proposal from the `maxima` (each `(D,)`).

    At most `max_added_ridges` ridges are added where the proposal is poor.  With `check`, posterior
    mass that the proposal misses is estimated.  Raises `NoSupportError` if all densities are zero.
    """
    parts = [(origin, trace(surface, maximum, rng)) for origin, maximum in enumerate(maxima)]
    try:
        best = last = _best_mixture(surface, parts, random, max_added_ridges, report)
    except NoSupportError:  # the posterior is narrower than its curvature suggests
        parts = [(0, trace_box(surface, maxima[0], rng))]
        best = last = _best_mixture(surface, parts, random, max_added_ridges, report)
    for _ in range(max_added_ridges):
        if best.good:
            break
        # A new ridge is traced from a draw of high weight, where p/q is large, as far as draws
        # reach. This ridge replaces the others if they ended too early.
        new_parts = [(k, trace(surface, u, rng, draws)) for k, u, draws in _central_draws(last)]
        good_parts = [part for part in parts if part[1].error < USELESS_ERROR]
        parts = new_parts if last.strays > MAX_STRAY_MASS else good_parts + new_parts
        try:
            last = _best_mixture(surface, parts, random, max_added_ridges, report)
        except NoSupportError:  # near an end of a prior, a ridge may leave the prior
            break
        best, last = _compared(best, last)
        best = max(best, last, key=lambda r: r.efficiency / (1.0 + TRAPPING_PENALTY * r.strays))
    missed = 0.0
    if max_added_ridges > 0 and check:
        report.update(0.0, LOOKING)
        missed = missed_mass(surface, best.proposal, *_heaviest(best), random)
    return LearnedProposal(
        proposal=best.proposal, draws=best.draws, origin=best.origin, missed=missed
    )


def _heaviest(learning_round: _Round) -> tuple[list[int], tuple[Array, Array]]:
    """Return the heaviest ridge of each maximum, and draws with weights for each such ridge."""
    u, weights = learning_round.weighted_draws
    mixture, origin = learning_round.proposal.mixture, np.array(learning_round.origin)
    shares = responsibilities(mixture, u, weights)[1]
    sheets = []
    for maximum in sorted(set(learning_round.origin)):
        ridges = [s for s in range(len(origin)) if origin[s] == maximum]
        masses = [float(shares[mixture.sheet == s].sum()) for s in ridges]
        if sum(masses) > NEGLIGIBLE_MAXIMUM:
            sheets.append(ridges[int(np.argmax(masses))])
    sheet_weights = [shares[origin[mixture.sheet] == origin[s]].sum(axis=0) for s in sheets]
    return sheets, (u, np.array(sheet_weights))


def _best_mixture(
    surface: LogDensity,
    parts: Sequence[tuple[int, TracedRidge]],
    random: Random,
    max_added_ridges: int,
    report: Reporter,
) -> _Round:
    """Draw, weight and fit in several rounds, and return the best round."""
    origin, traced = zip(*parts, strict=True)
    narrow = mixture = _initial_mixture(traced)
    rounds: list[_Round] = []
    for _ in range(MAX_ROUNDS if max_added_ridges else MAX_ROUNDS // 3):
        round_ = _draw(mixture, origin, surface, random)
        share = round_.draws.effective_share
        settled = bool(rounds) and share < MIN_IMPROVEMENT * rounds[-1].draws.effective_share
        rounds.append(round_)
        text = f"learning the proposal, round {len(rounds)}: {share:.0%} of its draws are effective"
        report.update(len(rounds) / (MAX_ROUNDS + 1), text)
        good = share > MIN_EFFECTIVE_SHARE and round_.draws.trapped < MAX_TRAPPED_MASS
        hopeless = round_.draws.effective < HOPELESS_DRAWS  # one draw outweighs all others
        if (settled and good) or (len(rounds) > FEW_ROUNDS and hopeless):
            break
        u, weights = round_.weighted_draws
        first = len(rounds) == 1
        start = _several_components(narrow, u, weights, random) if first else narrow
        iterations = EM_ROUNDS[0 if first else 1]
        narrow = independence.fit_mixture(start, u, weights, surface.in_support, iterations, random)
        mixture = _with_tails(narrow, u, weights)
    return _most_efficient(rounds)


def _most_efficient(rounds: Sequence[_Round]) -> _Round:
    """Compare rounds with the last round, whose draws reach furthest; return the most efficient."""
    *candidates, last = rounds
    while candidates:
        k = int(np.argmax([candidate.efficiency for candidate in candidates]))
        candidate, last = _compared(candidates.pop(k), last)
        others = [other.efficiency for other in candidates]
        if candidate.efficiency > max([last.efficiency, *others]):
            return candidate
        if last.efficiency >= max(others, default=0.0):
            break
    return last


def _compared(candidate: _Round, other: _Round) -> tuple[_Round, _Round]:
    """Return both rounds, each with the posterior mass that it misses, estimated from draws of both.

    The draws of a proposal cannot show that it misses a maximum.
    """
    pair = (candidate, other)
    with_density = [round_.draws.supported() for round_ in pair]
    u = np.concatenate([draws.u for draws in with_density])
    log_every, log_q = zip(
        *(_densities(round_.proposal.mixture, round_.counts, u) for round_ in pair), strict=True
    )
    log_q_at = np.split(np.stack(log_q), [len(with_density[0].u)], axis=1)
    log_p = np.concatenate([with_density[k].log_w + log_q_at[k][k] for k in range(2)])
    weights = normalised(log_p - np.logaddexp(*log_every))
    trapped = [
        log_p > q + round_.draws.typical_log_ratio + LONG_LOG_RATIO
        for q, round_ in zip(log_q, pair, strict=True)
    ]
    first, second = (
        replace(round_, missed=max(round_.missed, float(weights[flags].sum())))
        for round_, flags in zip(pair, trapped, strict=True)
    )
    return first, second


def _central_draws(learning_round: _Round) -> list[tuple[int, Array, tuple[Array, Array]]]:
    """Return index, most central draw of high weight, and weighted draws, for each maximum."""
    u, weights = learning_round.weighted_draws
    shares = responsibilities(learning_round.proposal.mixture, u, weights)[1]
    owner = np.array(learning_round.origin)[learning_round.proposal.mixture.sheet]
    middles = []
    for origin in dict.fromkeys(learning_round.origin):
        mode_shares = shares[owner == origin].sum(axis=0)
        if mode_shares.sum() < NEGLIGIBLE_RIDGE:
            continue
        sds = distances(u, mode_shares)
        least = np.quantile(mode_shares, CENTRE_QUANTILE)
        likely = np.flatnonzero(mode_shares >= least)  # all, if so few have a weight that least = 0
        middles.append((origin, u[likely[np.argmin(sds[likely])]], (u, mode_shares)))
    return middles


@dataclass(frozen=True, slots=True)
class _Round:
    """A round tests a proposal by draws; `counts` are tries with its mixture and with a wider one."""

    proposal: Proposal
    origin: tuple[int, ...]
    draws: WeightedDraws
    counts: tuple[int, int]
    missed: float = 0.0

    @property
    def trapped(self) -> float:
        return max(self.draws.trapped, self.missed)

    @property
    def weighted_draws(self) -> tuple[Array, Array]:
        """Return draws `(N, D)` of nonzero density, and weights, tempered if few are effective."""
        draws = self.draws.supported()
        return draws.u, draws.tempered(MIN_TEMPERED_SHARE * len(draws.u))

    @property
    def strays(self) -> float:
        """Return the posterior mass beyond the ends of the traced ridges."""
        draws, mixture = self.draws.supported(), self.proposal.mixture
        y, shares = responsibilities(mixture, draws.u, draws.weights)
        beyond = 0.0
        for s, sheet in enumerate(mixture.sheets):
            if sheet.frame.tight.shape[1] == 0:
                continue  # without tight directions, there is no ridge that could end
            sheet_shares = shares[mixture.sheet == s].sum(axis=0)
            beyond += float(sheet_shares @ ~sheet.is_covered(y[s, :, : sheet.n_loose]))
        return beyond

    @property
    def good(self) -> bool:
        return (
            self.draws.effective_share > GOOD_EFFECTIVE_SHARE
            and self.strays < MAX_STRAY_MASS
            and self.trapped < 2.0 * MAX_TRAPPED_MASS
        )

    @property
    def efficiency(self) -> float:
        """Return effective fraction / cost of the draws, with a penalty for trapped mass."""
        cost = 1.0 + REDRAW_COST / self.proposal.share_inside
        return self.draws.effective_share / (cost * (1.0 + TRAPPING_PENALTY * self.trapped))


def _draw(mixture: Mixture, origin: tuple[int, ...], surface: LogDensity, random: Random) -> _Round:
    """Draw from `mixture` and a wider one; weight by the density of both (the balance heuristic)."""
    wide = mixture.with_width(WIDE_FACTOR)
    times = max(1, len(mixture.sheets) // RIDGES_PER_BATCH)
    narrow_draws, n_narrow = _draws_in_support(mixture, times * DRAWS_PER_ROUND, surface, random)
    wide_draws, n_wide = _draws_in_support(wide, times * WIDE_DRAWS, surface, random)
    u = np.concatenate([narrow_draws, wide_draws])
    log_every, log_q = _densities(mixture, (n_narrow, n_wide), u)
    log_w = surface.value(u) - log_q
    if not np.isfinite(log_w).any():
        raise NoSupportError("no point of finite posterior was found around the maximum")
    draws = WeightedDraws(u, log_w, log_q - log_every)
    share_inside = max(len(narrow_draws) / n_narrow, 1.0 / n_narrow)
    proposal = Proposal(mixture, share_inside, draws.typical_log_ratio)
    return _Round(proposal, origin, draws, (n_narrow, n_wide))


def _densities(mixture: Mixture, counts: tuple[int, int], u: Array) -> tuple[Array, Array]:
    """Return the logs of n q(u) + n_wide q_wide(u) and of q(u), at `u (N, D)`.

    `counts` are n and n_wide, the numbers of draws from the mixture q and from the wider mixture.
    """
    y, jacobian = mixture.straightened(u)
    log_q = mixture.log_density_at(y, jacobian)
    log_wide = mixture.with_width(WIDE_FACTOR).log_density_at(y, jacobian)
    return np.logaddexp(np.log(counts[0]) + log_q, np.log(counts[1]) + log_wide), log_q


def _draws_in_support(
    mixture: Mixture, n: int, surface: LogDensity, random: Random
) -> tuple[Array, int]:
    """Return about `n` draws inside the prior, `(N, D)`, and the number of all draws made for them."""
    first = mixture.draw(n, random).u
    inside = first[surface.in_support(first)]
    more = n * (n - len(inside)) // max(len(inside), n // MAX_TRIES_PER_DRAW)
    if more == 0:
        return inside, n
    more_draws = mixture.draw(more, random).u
    return np.concatenate([inside, more_draws[surface.in_support(more_draws)]]), n + more


def _initial_mixture(traced: Sequence[TracedRidge]) -> Mixture:
    """Return a mixture with a component for each ridge, at the ridge's initial mean and spread."""
    means, roots = [], []
    for part in traced:
        tight = part.ridge.frame.tight.shape[1]
        means.append(np.append(part.psi, np.zeros(tight)))
        roots.append(scipy.linalg.block_diag(part.psi_root, INITIAL_TIGHT_SDS * np.eye(tight)))
    ridges, equal = [part.ridge for part in traced], np.full(len(traced), 1.0 / len(traced))
    return independence.mixture(ridges, range(len(traced)), equal, means, roots)


def _several_components(mixture: Mixture, u: Array, weights: Array, random: Random) -> Mixture:
    """Return a mixture with several components per ridge, centred at draws selected by weight."""
    y, jacobian = mixture.straightened(u)
    owner = mixture.sheet[np.argmax(mixture.log_parts(y, jacobian), axis=0)]
    parts: list[Component] = []
    most = max(1, min(MAX_COMPONENTS_OF_RIDGE, MAX_COMPONENTS // len(mixture.sheets)))
    for s in range(len(mixture.sheets)):
        mine = np.flatnonzero(owner == s)
        sheet_weights = weights[mine]
        known = effective_count(sheet_weights) / (5 * u.shape[1]) if sheet_weights.any() else 0
        count = int(np.clip(known, 0, most))
        if count == 0:  # too few effective draws: the component stays
            mass = max(float(sheet_weights.sum()), NEGLIGIBLE_RIDGE)
            components = np.flatnonzero(mixture.sheet == s)
            parts += [(s, mass, mixture.means[k], mixture.roots[k]) for k in components]
            continue
        points = y[s, mine]
        centre, root = moments(points, sheet_weights)
        drawn = points[random.choice(len(mine), size=count, p=sheet_weights / sheet_weights.sum())]
        means = [centre] if count == 1 else list(drawn)
        root = root if count == 1 else COMPONENT_SCALE * root
        parts += [(s, float(sheet_weights.sum()) / count, mean, root) for mean in means]
    return independence.mixture(mixture.sheets, *zip(*parts, strict=True))


def _with_tails(narrow: Mixture, u: Array, weights: Array) -> Mixture:
    """Add wide components for the tails to each ridge."""
    y, shares = responsibilities(narrow, u, weights)
    columns = (narrow.sheet, narrow.weights, narrow.means, narrow.roots)
    parts: list[Component] = list(zip(*columns, strict=True))
    for s in range(len(narrow.sheets)):
        mine = narrow.sheet == s
        sheet_shares = shares[mine].sum(axis=0)
        if sheet_shares.any() and effective_count(sheet_shares) > 2 * u.shape[1]:
            centre, root = moments(y[s], sheet_shares)
            sheet_weight = float(narrow.weights[mine].sum())
            for weight, along, across in TAIL_COMPONENTS:
                factors = np.full(u.shape[1], across)
                factors[: narrow.sheets[s].n_loose] = along
                parts.append((s, weight * sheet_weight, centre, factors[:, None] * root))
    return independence.mixture(narrow.sheets, *zip(*parts, strict=True))


def responsibilities(mixture: Mixture, u: Array, weights: Array) -> tuple[Array, Array]:
    """Return `u (N, D)` on each sheet, `(S, N, D)`, and `weights` split by component, `(K, N)`."""
    y, jacobian = mixture.straightened(u)
    return y, mixture.responsibilities(y, jacobian, weights)
