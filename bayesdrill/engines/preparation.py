"""What comes before the first step: a proposal that is learnt, and walkers to begin with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayesdrill.basics import seeds
from bayesdrill.basics.progress import SILENT, Reporter
from bayesdrill.engines.climb import climb
from bayesdrill.engines.learning.learn import AGAIN, Learnt, Nowhere, learn
from bayesdrill.engines.learning.settled import bound
from bayesdrill.engines.maxima import NEAR
from bayesdrill.engines.samplers.ensemble import State
from bayesdrill.engines.samplers.independence import Proposal
from bayesdrill.engines.workers import Crew
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.residual_checks import FAR_TOO_LARGE
from bayesdrill.inference.surface import Expansion, PosteriorSurface, joined

Array = NDArray[np.float64]

UPWARD = 25  # steps from a maximum over the unknowns to one over the coordinates
MOST_SLOPES = 20_000  # of a point, of records with samples of their own
SHARED = 64  # points that one process expands at a time
START_SPREAD = 1.5  # ensembles start wider than the proposal, so that R-hat can tell
START_TRIES = 20  # of drawing points to start at, wider or not, and of mirroring others
DEEP = 50.0  # of the log density below the highest start: far off a bent ridge is no place to start


def prepare(
    crew: Crew, posterior: Posterior, maxima: Array, seed: int, report: Reporter = SILENT
) -> Learnt:
    """The proposal, the same whatever the number of processes."""

    def expand(u: Array, directions: Array) -> Expansion:
        if len(u) <= SHARED:
            return expanded(posterior, u, directions)
        parts = [u[k : k + SHARED] for k in range(0, len(u), SHARED)]
        tasks = [crew.submit(expanded, part, directions) for part in parts]
        return joined([task.result() for task in tasks])

    report.update(0.0, "learning the proposal")
    random = np.random.RandomState(seeds.bits(seed, "learn", 0))
    z = posterior.coordinates.from_physical(maxima)
    again, tops = (AGAIN, z) if fits(posterior, maxima) else (0, z[:1])
    surface = PosteriorSurface(posterior)
    with threadpool_limits(1):
        rng = seeds.stream(seed, "learn", 1)
        # Where the density over the coordinates is highest, most of the posterior is near.
        central, settle = list(_central(surface, tops)), not dear(posterior)
        return learn(surface, expand, central, random, rng, again, report, settle=settle)


def _central(surface: PosteriorSurface, tops: Array) -> Array:
    """Maxima `(M, D)` over the coordinates instead; one is not moved to where another is."""
    found = climb(surface, tops, UPWARD).u
    for k in range(1, len(tops)):
        near = np.abs(found[:k] - found[k]) < NEAR * surface.spread
        if near.all(axis=1).any():
            found[k] = tops[k]
    return found


def fits(posterior: Posterior, maxima: Array) -> bool:
    """Whether the best fit leaves about the noise.

    If it leaves far more it is not believed, however well it is sampled, and little is spent on it.
    """
    left = float(posterior.likelihood.per_number(maxima[:1])[0])
    return left < FAR_TOO_LARGE**2


def rubs(posterior: Posterior) -> bool:
    """Whether slopes jump where friction lets go: no way home along them."""
    return any(one.response.model.frictions for one in posterior.likelihood.observations)


def dear(posterior: Posterior) -> bool:
    """Whether slopes are no way home, or so many that a walk along settled ridges, of some 1e5 points,
    takes minutes: where each sample has its own, and not sums alone.
    """
    each = [one for one in posterior.likelihood.observations if not one.response.exact]
    numbers = sum(len(one.experiment.t) for one in each) * len(posterior.space.free)
    return rubs(posterior) or numbers > MOST_SLOPES


def expanded(posterior: Posterior, u: Array, directions: Array) -> Expansion:
    """See `surface.Surface.expand`."""
    return PosteriorSurface(posterior).expand(u, directions)


def begin(posterior: Posterior, proposal: Proposal, n: int, seed: int, ensemble: int) -> State:
    """Walkers around all maxima alike, wider than the proposal: shares are for the moves to find.

    But none starts where the proposal would hardly ever lead it away: where it is not found wider, it
    is drawn from the proposal itself.  Where hardly a draw is inside the prior, those outside are
    mirrored at its ends, nearer and nearer to the first maximum.
    """
    random = np.random.RandomState(seeds.bits(seed, "start", ensemble))
    proposal = bound(proposal, posterior).widest
    mixture = proposal.mixture
    centre, wide = mixture.sheets[0].frame.centre, mixture.widened(START_SPREAD)
    z, log_p = np.empty((n, len(centre))), np.full(n, -np.inf)
    missing = np.ones(n, dtype=bool)
    for attempt in range(3 * START_TRIES):
        wanted, mirrored = int(missing.sum()), attempt - 2 * START_TRIES
        if attempt < START_TRIES:
            fresh = wide.draw(wanted, random).u
        elif mirrored < 0:
            fresh = proposal.draw(wanted, posterior.supports, random)[0]
        else:
            nearer = centre + 0.25**mirrored * (wide.draw(wanted, random).u - centre)
            fresh = _mirrored(posterior, nearer)
        z[missing], log_p[missing] = fresh, posterior(fresh)
        missing = ~(log_p > log_p.max() - DEEP)
        if mirrored < 0:
            missing |= log_p > proposal.high(mixture.log_density(z))
        if not missing.any():
            return State(z, log_p, seeds.legacy_state(seed, "walk", ensemble))
    raise Nowhere("no point of finite posterior was found around the maximum")


def _mirrored(posterior: Posterior, z: Array) -> Array:
    """At the ends of the priors, where `z (n, D)` lie beyond them."""
    surface = PosteriorSurface(posterior)
    z = np.where(z < surface.low, 2.0 * surface.low - z, z)
    return np.where(z > surface.high, 2.0 * surface.high - z, z)
