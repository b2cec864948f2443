"""The independence proposal, learnt from the log density before any walker takes a step.

Each maximum gets its ridge.  Then draws from what is known so far are weighted with the density,
and a Gaussian mixture over the ridges' coordinates is fitted to them, again and again, until it
gets no better.  The last draws say without any chain what the posterior's means are.
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

Component = tuple[int, float, Array, Array]  # sheet, weight, mean, root

DRAWS_PER_ROUND = 2400  # of one round, ...
WIDE_FACTOR, WIDE_DRAWS = 1.5, 800  # ... and so many that are as many times wider
RIDGES_PER_BATCH = 6  # ridges: for each so many more draws
MAX_TRIES_PER_DRAW = 50  # times as many at most, where hardly any is inside the prior
MAX_ROUNDS = 12
FEW_ROUNDS, HOPELESS_DRAWS = 5, 2.0  # rounds after which so few effective draws are no beginning
MIN_IMPROVEMENT = 1.04  # a round that improves the effective share of the draws by less is the last
MIN_EFFECTIVE_SHARE = 0.3  # of effective draws; with less it goes on
MIN_TEMPERED_SHARE = 0.1  # of effective draws: the density is flattened until there are as many
REDRAW_COST = 0.4  # of a density: what a draw costs that falls outside the prior
MAX_ADDED_RIDGES = 4  # times that a ridge is added, ...
GOOD_EFFECTIVE_SHARE = 0.3  # ... unless as many draws are effective
CENTRE_QUANTILE = 0.9  # quantile of the weights: a new centre is a draw above it
MAX_STRAY_MASS = 0.01  # of the posterior: more than that beyond the ridges is not left there
TRAPPED_COST = 20.0  # what it costs to leave some of the posterior where walkers wait long
MAX_TRAPPED_MASS = 0.005  # of the posterior, where q is far too thin: with more it goes on
COMPONENT_SCALE = 0.7  # several components are narrower than one, to begin with
INITIAL_TIGHT_SDS = 1.2  # standard deviations of the tight directions, to begin with
NEGLIGIBLE_RIDGE = 1e-6  # of the posterior: a ridge with less is left out
NEGLIGIBLE_MAXIMUM = 1e-3  # of the posterior: a maximum with less is not looked at again
MAX_COMPONENTS_OF_RIDGE, MAX_COMPONENTS = 4, 32  # of a ridge, and of all
EM_ROUNDS = (12, 6)  # of the fit, in the first round and later
# Wider than all draws, to hold the tails: weight, and how many times, along the ridge and across it.
TAIL_COMPONENTS = ((0.08, 2.0, 1.05), (0.04, 1.2, 1.5))


class NoSupportError(ValueError):
    """Raised where no draw has a density."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedProposal:
    """A proposal, and the draws by which it was judged; `origin`: the maximum of each ridge.

    `missed`: about how much of the posterior it hardly ever reaches, 0 where none was found.
    """

    proposal: Proposal
    draws: WeightedDraws
    origin: tuple[int, ...]
    missed: float = 0.0

    def shares(self, u: Array, n_maxima: int) -> Array:
        """Return the share of draws `u (N, D)` that each maximum holds: `(n_maxima,)`, sum 1."""
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

    `max_added_ridges`: how many ridges are added at most.  `check`: whether to look for posterior
    mass that the proposal misses.  Raises `NoSupportError` where no draw has a density.
    """
    parts = [(origin, trace(surface, at, rng)) for origin, at in enumerate(maxima)]
    try:
        best = last = _best_mixture(surface, parts, random, max_added_ridges, report)
    except NoSupportError:  # the posterior is narrower than all that its curvature foresees
        parts = [(0, trace_box(surface, maxima[0], rng))]
        best = last = _best_mixture(surface, parts, random, max_added_ridges, report)
    for _ in range(max_added_ridges):
        if best.good:
            break
        # One more ridge where draws weigh most: there the posterior is, and the proposal is not.
        # Or the same, followed as far as draws have been seen.
        new_parts = [(k, trace(surface, at, rng, draws)) for k, at, draws in _central_draws(last)]
        good_parts = [part for part in parts if part[1].off < USELESS_ERROR]
        parts = new_parts if last.strays > MAX_STRAY_MASS else good_parts + new_parts
        try:
            last = _best_mixture(surface, parts, random, max_added_ridges, report)
        except NoSupportError:  # at ends of priors ridges may lead out of them
            break
        best, last = _compared(best, last)
        best = max(best, last, key=lambda done: done.worth / (1.0 + TRAPPED_COST * done.strays))
    missed = 0.0
    if max_added_ridges > 0 and check:
        report.update(0.0, LOOKING)
        missed = missed_mass(surface, best.proposal, *_heaviest(best), random)
    return LearnedProposal(
        proposal=best.proposal, draws=best.draws, origin=best.origin, missed=missed
    )


def _heaviest(learning_round: _Round) -> tuple[list[int], tuple[Array, Array]]:
    """The ridge of each maximum that holds most of its own; and draws, with their weights for each."""
    u, weights = learning_round.weighted_draws
    mixture, origin = learning_round.proposal.mixture, np.array(learning_round.origin)
    shares = responsibilities(mixture, u, weights)[1]
    sheets = []
    for maximum in sorted(set(learning_round.origin)):
        ridges = [s for s in range(len(origin)) if origin[s] == maximum]
        masses = [float(shares[mixture.sheet == s].sum()) for s in ridges]
        if sum(masses) > NEGLIGIBLE_MAXIMUM:
            sheets.append(ridges[int(np.argmax(masses))])
    each = [shares[origin[mixture.sheet] == origin[s]].sum(axis=0) for s in sheets]
    return sheets, (u, np.array(each))


def _best_mixture(
    surface: LogDensity,
    parts: Sequence[tuple[int, TracedRidge]],
    random: Random,
    max_added_ridges: int,
    report: Reporter,
) -> _Round:
    """The best of several rounds of drawing, weighing and fitting."""
    origin, traced = zip(*parts, strict=True)
    narrow = mixture = _begin(traced)
    rounds: list[_Round] = []
    for _ in range(MAX_ROUNDS if max_added_ridges else MAX_ROUNDS // 3):
        done = _draw(mixture, origin, surface, random)
        share = done.draws.share
        settled = bool(rounds) and share < MIN_IMPROVEMENT * rounds[-1].draws.share
        rounds.append(done)
        text = f"learning the proposal, round {len(rounds)}: {share:.0%} of its draws count"
        report.update(len(rounds) / (MAX_ROUNDS + 1), text)
        leaving = done.draws.trapped < MAX_TRAPPED_MASS
        good = share > MIN_EFFECTIVE_SHARE and leaving
        hopeless = done.draws.effective < HOPELESS_DRAWS  # one draw outweighs all others
        if (settled and good) or (len(rounds) > FEW_ROUNDS and hopeless):
            break
        u, weights = done.weighted_draws
        first = len(rounds) == 1
        begin = _several_components(narrow, u, weights, random) if first else narrow
        expectations = EM_ROUNDS[0 if first else 1]
        narrow = independence.fit_mixture(begin, u, weights, surface.inside, expectations, random)
        mixture = _with_tails(narrow, u, weights)
    return _best(rounds)


def _best(rounds: Sequence[_Round]) -> _Round:
    """The worthiest; the last of them has seen most, and one that has not is held against it."""
    *candidates, last = rounds
    while candidates:
        k = int(np.argmax([candidate.worth for candidate in candidates]))
        candidate, last = _compared(candidates.pop(k), last)
        if candidate.worth > max([last.worth, *(other.worth for other in candidates)]):
            return candidate
        if last.worth >= max((other.worth for other in candidates), default=0.0):
            break
    return last


def _compared(candidate: _Round, other: _Round) -> tuple[_Round, _Round]:
    """Both, with what each leaves out of the posterior that the draws of either have seen.

    Draws of one maximum say that a proposal which draws there alone is perfect.
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
    thin = [
        log_p > q + round_.draws.typical_log_ratio + LONG_LOG_RATIO
        for q, round_ in zip(log_q, pair, strict=True)
    ]
    first, second = (
        replace(round_, missed=max(round_.missed, float(weights[where].sum())))
        for round_, where in zip(pair, thin, strict=True)
    )
    return first, second


def _central_draws(learning_round: _Round) -> list[tuple[int, Array, tuple[Array, Array]]]:
    """For each maximum that holds something: a draw near the middle of its own, and those draws."""
    u, weights = learning_round.weighted_draws
    shares = responsibilities(learning_round.proposal.mixture, u, weights)[1]
    owner = np.array(learning_round.origin)[learning_round.proposal.mixture.sheet]
    middles = []
    for origin in dict.fromkeys(learning_round.origin):
        mode_shares = shares[owner == origin].sum(axis=0)
        if mode_shares.sum() < NEGLIGIBLE_RIDGE:
            continue
        far = distances(u, mode_shares)
        least = np.quantile(mode_shares, CENTRE_QUANTILE)
        likely = np.flatnonzero(mode_shares >= least)  # of few draws, all
        middles.append((origin, u[likely[np.argmin(far[likely])]], (u, mode_shares)))
    return middles


@dataclass(frozen=True, slots=True)
class _Round:
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
        """Draws `(N, D)` that have a density, and their weights, flattened where they must be."""
        draws = self.draws.supported()
        return draws.u, draws.tempered(MIN_TEMPERED_SHARE * len(draws.u))

    @property
    def strays(self) -> float:
        """How much of the posterior lies beyond where its ridges were followed."""
        draws, mixture = self.draws.supported(), self.proposal.mixture
        y, shares = responsibilities(mixture, draws.u, draws.weights)
        beyond = 0.0
        for s, sheet in enumerate(mixture.sheets):
            if sheet.frame.tight.shape[1] == 0:
                continue  # it has no ridge that could lead astray
            sheet_shares = shares[mixture.sheet == s].sum(axis=0)
            beyond += float(sheet_shares @ ~sheet.within(y[s, :, : sheet.n_loose]))
        return beyond

    @property
    def good(self) -> bool:
        return (
            self.draws.share > GOOD_EFFECTIVE_SHARE
            and self.strays < MAX_STRAY_MASS
            and self.trapped < 2.0 * MAX_TRAPPED_MASS
        )

    @property
    def worth(self) -> float:
        """Effective draws for what they cost: one outside the prior costs less than the model."""
        cost = 1.0 + REDRAW_COST / self.proposal.share
        return self.draws.share / (cost * (1.0 + TRAPPED_COST * self.trapped))


def _draw(mixture: Mixture, origin: tuple[int, ...], surface: LogDensity, random: Random) -> _Round:
    """Each draw is weighed with the density of all of them (the balance heuristic)."""
    wide = mixture.with_width(WIDE_FACTOR)
    times = max(1, len(mixture.sheets) // RIDGES_PER_BATCH)
    narrow_draws, n_narrow = _inside(mixture, times * DRAWS_PER_ROUND, surface, random)
    wide_draws, n_wide = _inside(wide, times * WIDE_DRAWS, surface, random)
    u = np.concatenate([narrow_draws, wide_draws])
    log_every, log_q = _densities(mixture, (n_narrow, n_wide), u)
    log_w = surface.value(u) - log_q
    if not np.isfinite(log_w).any():
        raise NoSupportError("no point of finite posterior was found around the maximum")
    draws = WeightedDraws(u, log_w, log_q - log_every)
    share = max(len(narrow_draws) / n_narrow, 1.0 / n_narrow)
    proposal = Proposal(mixture, share, draws.typical_log_ratio)
    return _Round(proposal, origin, draws, (n_narrow, n_wide))


def _densities(mixture: Mixture, counts: tuple[int, int], u: Array) -> tuple[Array, Array]:
    """Return logs at `u (N, D)` of how densely it was drawn there, and of the mixture itself.

    It was drawn by `counts` of the mixture and of a wider one.
    """
    y, jacobian = mixture.straightened(u)
    log_q = mixture.log_density_at(y, jacobian)
    log_wide = mixture.with_width(WIDE_FACTOR).log_density_at(y, jacobian)
    return np.logaddexp(np.log(counts[0]) + log_q, np.log(counts[1]) + log_wide), log_q


def _inside(mixture: Mixture, n: int, surface: LogDensity, random: Random) -> tuple[Array, int]:
    """About `n` draws inside the prior `(N, D)`, and of how many they are those inside."""
    first = mixture.draw(n, random).u
    inside = first[surface.inside(first)]
    more = n * (n - len(inside)) // max(len(inside), n // MAX_TRIES_PER_DRAW)
    if more == 0:
        return inside, n
    more_draws = mixture.draw(more, random).u
    return np.concatenate([inside, more_draws[surface.inside(more_draws)]]), n + more


def _begin(traced: Sequence[TracedRidge]) -> Mixture:
    """One component for each ridge, as wide as record and priors let it be."""
    means, roots = [], []
    for each in traced:
        tight = each.ridge.frame.tight.shape[1]
        means.append(np.append(each.psi, np.zeros(tight)))
        roots.append(scipy.linalg.block_diag(each.spread, INITIAL_TIGHT_SDS * np.eye(tight)))
    ridges, equal = [each.ridge for each in traced], np.full(len(traced), 1.0 / len(traced))
    return independence.mixture(ridges, range(len(traced)), equal, means, roots)


def _several_components(mixture: Mixture, u: Array, weights: Array, random: Random) -> Mixture:
    """Several components for each ridge, begun at some of its own draws, picked by weight."""
    y, jacobian = mixture.straightened(u)
    owner = mixture.sheet[np.argmax(mixture.log_parts(y, jacobian), axis=0)]
    parts: list[Component] = []
    most = max(1, min(MAX_COMPONENTS_OF_RIDGE, MAX_COMPONENTS // len(mixture.sheets)))
    for s in range(len(mixture.sheets)):
        mine = np.flatnonzero(owner == s)
        sheet_weights = weights[mine]
        known = effective_count(sheet_weights) / (5 * u.shape[1]) if sheet_weights.any() else 0
        count = int(np.clip(known, 0, most))
        if count == 0:  # too little is known of it yet
            share = max(float(sheet_weights.sum()), NEGLIGIBLE_RIDGE)
            of_sheet = np.flatnonzero(mixture.sheet == s)
            parts += [(s, share, mixture.means[k], mixture.roots[k]) for k in of_sheet]
            continue
        points = y[s, mine]
        centre, root = moments(points, sheet_weights)
        picked = points[random.choice(len(mine), size=count, p=sheet_weights / sheet_weights.sum())]
        means = [centre] if count == 1 else list(picked)
        wide = root if count == 1 else COMPONENT_SCALE * root
        parts += [(s, float(sheet_weights.sum()) / count, mean, wide) for mean in means]
    return independence.mixture(mixture.sheets, *zip(*parts, strict=True))


def _with_tails(narrow: Mixture, u: Array, weights: Array) -> Mixture:
    """With a wide component on each ridge beside those that were fitted."""
    y, shares = responsibilities(narrow, u, weights)
    columns = (narrow.sheet, narrow.weights, narrow.means, narrow.roots)
    parts: list[Component] = list(zip(*columns, strict=True))
    for s in range(len(narrow.sheets)):
        mine = narrow.sheet == s
        sheet_shares = shares[mine].sum(axis=0)
        if sheet_shares.any() and effective_count(sheet_shares) > 2 * u.shape[1]:
            centre, root = moments(y[s], sheet_shares)
            known = float(narrow.weights[mine].sum())
            for weight, along, across in TAIL_COMPONENTS:
                wider = np.full(u.shape[1], across)
                wider[: narrow.sheets[s].n_loose] = along
                parts.append((s, weight * known, centre, wider[:, None] * root))
    return independence.mixture(narrow.sheets, *zip(*parts, strict=True))


def responsibilities(mixture: Mixture, u: Array, weights: Array) -> tuple[Array, Array]:
    """Return coordinates `(S, N, D)` and each component's part of each weight, `(K, N)`."""
    y, jacobian = mixture.straightened(u)
    return y, mixture.responsibilities(y, jacobian, weights)
