"""The independence proposal, learnt from the log density before any walker takes a step.

Each maximum gets its ridge.  Then draws from what is known so far are weighted with the density,
and a Gaussian mixture over the ridges' coordinates is fitted to them, again and again, until it
gets no better.  The last draws say without any chain what the posterior's means are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.sampling.proposal.missed_mass import look
from bayesdrill.sampling.proposal.ridge_tracing import (
    ASTRAY,
    Expand,
    Traced,
    beside,
    distances,
    moments,
    trace,
)
from bayesdrill.sampling.samplers import independence
from bayesdrill.sampling.samplers.independence import (
    LONG,
    Mixture,
    Proposal,
    Weighed,
    effective,
    normalised,
)

Random = np.random.RandomState
Component = tuple[int, float, Array, Array]  # sheet, weight, mean, root

DRAWS = 2400  # of one round, ...
WIDER, WIDER_DRAWS = 1.5, 800  # ... and so many that are as many times wider
MANY = 6  # ridges: for each so many more draws
REPEATED = 50  # times as many at most, where hardly any is inside the prior
ROUNDS = 12
WORTH = 1.04  # a round that improves the effective share of the draws by less is the last
ENOUGH = 0.3  # of effective draws; with less it goes on
LEAST_SHARE = 0.1  # of effective draws: below it the density is flattened until there are as many
REDRAWN = 0.4  # of a density: what a draw costs that falls outside the prior
AGAIN = 4  # times that a ridge is added, ...
FEW, ALONE = 5, 2.0  # rounds after which so few effective draws are no beginning
GOOD = 0.3  # ... unless as many draws are effective
LIKELY = 0.9  # quantile of the weights: a new centre is a draw above it
STRAYS = 0.01  # of the posterior: more than that beyond the ridges is not left there
COMPONENTS, ALL_COMPONENTS = 4, 32  # of a ridge, and of all
DEAR = 20.0  # what it costs to leave some of the posterior where walkers wait long
TRAPPED = 0.005  # of the posterior, where the proposal is far too thin: with more it goes on
EXPECTATIONS = (12, 6)  # of the fit, in the first round and later
# Wider than all draws, to hold the tails: weight, and how many times, along the ridge and across it.
WIDE = ((0.08, 2.0, 1.05), (0.04, 1.2, 1.5))
NARROWED = 0.7  # several components are narrower than one, to begin with
FIRST_FIBRE = 1.2  # standard deviations of the tight directions, to begin with
LOST = 1e-6  # of the posterior: a ridge with less is left out
HELD = 1e-3  # of the posterior: a maximum with less is not looked at again


class Nowhere(ValueError):
    """No draw has a density."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Learnt:
    """`proposal`; of its draws `u (N, D)` with normalised `weights (N,)`: the effective `share`.

    `off`: how far each ridge is from its polynomial, in standard deviations; `origin`: which of the
    maxima it belongs to.
    """

    proposal: Proposal
    u: Array
    weights: Array
    share: float
    acceptance: float
    off: tuple[float, ...]
    origin: tuple[int, ...]

    def shares(self, u: Array, n_maxima: int) -> Array:
        """How many of draws `u (N, D)` each maximum holds: `(n_maxima,)`, their sum 1."""
        equal = np.full(len(u), 1.0 / len(u))
        own = responsibilities(self.proposal.mixture, u, equal)[1].sum(axis=1)
        held = np.zeros(n_maxima)
        np.add.at(held, np.array(self.origin)[self.proposal.mixture.sheet], own)
        return held


def learn(
    surface: LogDensity,
    expand: Expand,
    maxima: Sequence[Array],
    seed: Random,
    rng: np.random.Generator,
    again: int = AGAIN,
    report: Reporter = SILENT,
    *,
    settle: bool = True,
) -> Learnt:
    """From the `maxima` (each `(D,)`); raises `Nowhere` where no draw has a density.

    `again`: how many ridges are added at most.  `settle`: whether to look along settled ridges for
    what the proposal leaves out.
    """
    parts = [(origin, trace(surface, expand, at, rng)) for origin, at in enumerate(maxima)]
    try:
        best = last = _fitted(surface, parts, seed, again, report)
    except Nowhere:  # the posterior is narrower than all that its curvature foresees
        parts = [(0, beside(surface, maxima[0], rng))]
        best = last = _fitted(surface, parts, seed, again, report)
    for _ in range(again):
        if best.good:
            break
        # One more ridge where draws weigh most: there the posterior is, and the proposal is not.
        # Or the same, followed as far as draws have been seen.
        found = [(k, trace(surface, expand, at, rng, seen)) for k, at, seen in _midst(last)]
        kept = [part for part in parts if part[1].off < ASTRAY]
        parts = found if last.strays > STRAYS else kept + found
        try:
            last = _fitted(surface, parts, seed, again, report)
        except Nowhere:  # at ends of priors ridges may lead out of them
            break
        best, last = _compared(best, last)
        best = max(best, last, key=lambda one: one.worth / (1.0 + DEAR * one.strays))
    looked = None
    if again > 0 and settle:
        report.update(0.0, "looking for what the proposal leaves out")
        looked = look(surface, expand, best.proposal, *_heaviest(best), seed, rng, report)
    draws = looked.draws if looked else best.draws
    return Learnt(
        proposal=replace(best.proposal, settled=looked.proposal if looked else None),
        u=draws.u,
        weights=draws.weights,
        share=draws.share,
        acceptance=draws.acceptance,
        off=best.off,
        origin=best.origin,
    )


def _heaviest(found: _Round) -> tuple[list[int], tuple[Array, Array]]:
    """The ridge of each maximum that holds most of its own; and draws, with their weights for each."""
    u, weights = found.seen
    mixture, origin = found.proposal.mixture, np.array(found.origin)
    shares = responsibilities(mixture, u, weights)[1]
    sheets = []
    for one in sorted(set(found.origin)):
        own = [s for s in range(len(origin)) if origin[s] == one]
        held = [float(shares[mixture.sheet == s].sum()) for s in own]
        if sum(held) > HELD:
            sheets.append(own[int(np.argmax(held))])
    each = [shares[origin[mixture.sheet] == origin[s]].sum(axis=0) for s in sheets]
    return sheets, (u, np.array(each))


def _fitted(
    surface: LogDensity,
    parts: Sequence[tuple[int, Traced]],
    seed: Random,
    again: int,
    report: Reporter,
) -> _Round:
    """The best of several rounds of drawing, weighing and fitting."""
    origin, traced = zip(*parts, strict=True)
    narrow = found = _begin(traced)
    off = tuple(one.off for one in traced)
    rounds: list[_Round] = []
    for _ in range(ROUNDS if again else ROUNDS // 3):
        done = _draw(found, off, origin, surface, seed)
        settled = bool(rounds) and done.share < WORTH * rounds[-1].share
        rounds.append(done)
        said = f"learning the proposal, round {len(rounds)}: {done.share:.0%} of its draws count"
        report.update(len(rounds) / (ROUNDS + 1), said)
        good = done.share > ENOUGH and done.draws.trapped < TRAPPED
        hopeless = done.draws.effective < ALONE  # one draw outweighs all others
        if (settled and good) or (len(rounds) > FEW and hopeless):
            break
        u, weights = done.seen
        first = len(rounds) == 1
        begin = _several(narrow, u, weights, seed) if first else narrow
        expectations = EXPECTATIONS[0 if first else 1]
        narrow = independence.fitted(begin, u, weights, surface.inside, expectations, seed)
        found = _with_tails(narrow, u, weights)
    return _best(rounds)


def _best(rounds: Sequence[_Round]) -> _Round:
    """The worthiest; the last of them has seen most, and one that has not is held against it."""
    *left, last = rounds
    while left:
        k = int(np.argmax([one.worth for one in left]))
        one, last = _compared(left.pop(k), last)
        if one.worth > max([last.worth, *(other.worth for other in left)]):
            return one
        if last.worth >= max((other.worth for other in left), default=0.0):
            break
    return last


def _compared(one: _Round, other: _Round) -> tuple[_Round, _Round]:
    """Both, with what each leaves out of the posterior that the draws of either have seen.

    Draws of one maximum say that a proposal which draws there alone is perfect.
    """
    pair = (one, other)
    kept = [of.draws.those_with_a_density() for of in pair]
    u = np.concatenate([draws.u for draws in kept])
    log_every, log_q = zip(
        *(_densities(of.proposal.mixture, of.counts, u) for of in pair), strict=True
    )
    own = np.split(np.stack(log_q), [len(kept[0].u)], axis=1)
    log_p = np.concatenate([kept[k].log_w + own[k][k] for k in range(2)])
    weights = normalised(log_p - np.logaddexp(*log_every))
    thin = [log_p > q + of.draws.usual + LONG for q, of in zip(log_q, pair, strict=True)]
    first, second = (
        replace(of, missed=max(of.missed, float(weights[where].sum())))
        for of, where in zip(pair, thin, strict=True)
    )
    return first, second


def _midst(found: _Round) -> list[tuple[int, Array, tuple[Array, Array]]]:
    """For each maximum that holds something: a draw near the middle of its own, and those draws."""
    u, weights = found.seen
    shares = responsibilities(found.proposal.mixture, u, weights)[1]
    owner = np.array(found.origin)[found.proposal.mixture.sheet]
    middles = []
    for origin in dict.fromkeys(found.origin):
        own = shares[owner == origin].sum(axis=0)
        if own.sum() < LOST:
            continue
        far = distances(u, own)
        likely = np.flatnonzero(own >= np.quantile(own, LIKELY))  # of few draws, all
        middles.append((origin, u[likely[np.argmin(far[likely])]], (u, own)))
    return middles


@dataclass(frozen=True, slots=True)
class _Round:
    proposal: Proposal
    off: tuple[float, ...]
    origin: tuple[int, ...]
    draws: Weighed
    counts: tuple[int, int]
    missed: float = 0.0

    @property
    def trapped(self) -> float:
        return max(self.draws.trapped, self.missed)

    @property
    def share(self) -> float:
        return self.draws.share

    @property
    def seen(self) -> tuple[Array, Array]:
        """Draws `(N, D)` that have a density, and their weights, flattened where they must be."""
        kept = self.draws.those_with_a_density()
        return kept.u, kept.tempered(LEAST_SHARE * len(kept.u))

    @property
    def strays(self) -> float:
        """How much of the posterior lies beyond where its ridges were followed."""
        kept, mixture = self.draws.those_with_a_density(), self.proposal.mixture
        y, shares = responsibilities(mixture, kept.u, kept.weights)
        beyond = 0.0
        for s, sheet in enumerate(mixture.sheets):
            if sheet.frame.tight.shape[1] == 0:
                continue  # it has no ridge that could lead astray
            own = shares[mixture.sheet == s].sum(axis=0)
            beyond += float(own @ ~sheet.within(y[s, :, : sheet.n_loose]))
        return beyond

    @property
    def good(self) -> bool:
        return self.share > GOOD and self.strays < STRAYS and self.trapped < 2.0 * TRAPPED

    @property
    def worth(self) -> float:
        """Effective draws for what they cost: one outside the prior costs less than the model."""
        cost = (1.0 + REDRAWN / self.proposal.share) * (1.0 + DEAR * self.trapped)
        return self.share / cost


def _draw(
    found: Mixture,
    off: tuple[float, ...],
    origin: tuple[int, ...],
    surface: LogDensity,
    seed: Random,
) -> _Round:
    """Each draw is weighed with the density of all of them (the balance heuristic)."""
    wide = found.widened(WIDER)
    times = max(1, len(found.sheets) // MANY)
    own, n_own = _inside(found, times * DRAWS, surface, seed)
    others, n_others = _inside(wide, times * WIDER_DRAWS, surface, seed)
    u = np.concatenate([own, others])
    log_every, log_q = _densities(found, (n_own, n_others), u)
    log_w = surface.value(u) - log_q
    if not np.isfinite(log_w).any():
        raise Nowhere("no point of finite posterior was found around the maximum")
    draws = Weighed(u, log_w, log_q - log_every)
    proposal = Proposal(found, max(len(own) / n_own, 1.0 / n_own), draws.usual)
    return _Round(proposal, off, origin, draws, (n_own, n_others))


def _densities(mixture: Mixture, counts: tuple[int, int], u: Array) -> tuple[Array, Array]:
    """Logs at `u (N, D)` of how densely it was drawn there, by `counts` of a mixture and of a wider one,
    and of the mixture itself.
    """
    y, jacobian = mixture.straightened(u)
    log_q = mixture.log_density_at(y, jacobian)
    log_wide = mixture.widened(WIDER).log_density_at(y, jacobian)
    return np.logaddexp(np.log(counts[0]) + log_q, np.log(counts[1]) + log_wide), log_q


def _inside(found: Mixture, n: int, surface: LogDensity, seed: Random) -> tuple[Array, int]:
    """About `n` draws inside the prior `(N, D)`, and of how many they are those inside."""
    first = found.draw(n, seed).u
    kept = first[surface.inside(first)]
    more = n * (n - len(kept)) // max(len(kept), n // REPEATED)
    if more == 0:
        return kept, n
    rest = found.draw(more, seed).u
    return np.concatenate([kept, rest[surface.inside(rest)]]), n + more


def _begin(traced: Sequence[Traced]) -> Mixture:
    """One component for each ridge, as wide as record and priors let it be."""
    means, roots = [], []
    for one in traced:
        n_loose, d = len(one.psi), len(one.ridge.frame.centre)
        root = FIRST_FIBRE * np.eye(d)
        root[:n_loose, :n_loose] = one.spread
        means.append(np.concatenate([one.psi, np.zeros(d - n_loose)]))
        roots.append(root)
    ridges = [one.ridge for one in traced]
    count = len(traced)
    equal = np.full(count, 1.0 / count)
    return independence.mixture(ridges, range(count), equal, np.array(means), np.array(roots))


def _several(found: Mixture, u: Array, weights: Array, seed: Random) -> Mixture:
    """Several components for each ridge, begun at some of its own draws, picked by weight."""
    y, jacobian = found.straightened(u)
    owner = found.sheet[np.argmax(found.log_parts(y, jacobian), axis=0)]
    parts: list[Component] = []
    most = max(1, min(COMPONENTS, ALL_COMPONENTS // len(found.sheets)))
    for s in range(len(found.sheets)):
        mine = np.flatnonzero(owner == s)
        own = weights[mine]
        count = int(np.clip(effective(own) / (5 * u.shape[1]), 0, most)) if own.any() else 0
        if count == 0:  # too little is known of it yet
            share = max(float(own.sum()), LOST)
            of_sheet = np.flatnonzero(found.sheet == s)
            parts += [(s, share, found.means[k], found.roots[k]) for k in of_sheet]
            continue
        points = y[s, mine]
        centre, root = moments(points, own)
        picked = points[seed.choice(len(mine), size=count, p=own / own.sum())]
        means = [centre] if count == 1 else list(picked)
        wide = root if count == 1 else NARROWED * root
        parts += [(s, float(own.sum()) / count, mean, wide) for mean in means]
    return _joined(found, parts)


def _with_tails(narrow: Mixture, u: Array, weights: Array) -> Mixture:
    """With a wide component on each ridge beside those that were fitted."""
    y, shares = responsibilities(narrow, u, weights)
    every = (narrow.sheet, narrow.weights, narrow.means, narrow.roots)
    parts: list[Component] = list(zip(*every, strict=True))
    for s in range(len(narrow.sheets)):
        mine = narrow.sheet == s
        own = shares[mine].sum(axis=0)
        if own.any() and effective(own) > 2 * u.shape[1]:
            centre, root = moments(y[s], own)
            known = float(narrow.weights[mine].sum())
            for weight, along, across in WIDE:
                wider = np.full(u.shape[1], across)
                wider[: narrow.sheets[s].n_loose] = along
                parts.append((s, weight * known, centre, wider[:, None] * root))
    return _joined(narrow, parts)


def _joined(found: Mixture, parts: Sequence[Component]) -> Mixture:
    sheet, weights, means, roots = (list(column) for column in zip(*parts, strict=True))
    return independence.mixture(
        found.sheets, sheet, np.array(weights), np.array(means), np.array(roots)
    )


def responsibilities(found: Mixture, u: Array, weights: Array) -> tuple[Array, Array]:
    """Coordinates `(S, N, D)`, and how much of each weight every component stands for `(K, N)`."""
    y, jacobian = found.straightened(u)
    parts = found.log_parts(y, jacobian)
    shares = np.exp(parts - parts.max(axis=0))
    return y, shares * (weights / shares.sum(axis=0))
