"""Estimate the evidence Z, the integral of likelihood times prior, by bridge sampling.

The proposal that ensembles draw from is a normalised density q near the posterior, so that draws of
both, each weighed with both densities, give Z with hardly any further response (Meng and Wong
1996).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.samplers.independence import Mixture, Proposal, Random

MAX_DRAWS = 40_000  # of the chain at most, and as many of the proposal inside the prior
MAX_TRIES_PER_DRAW = 50  # times as many at most, where hardly any is inside the prior
BATCH_DRAWS = 4000  # draws
MAX_DISAGREEMENT = 3.0  # standard errors that two estimates of the evidence may be apart
MAX_LOG_RATIO = 500.0  # of a log of p over q, over the usual: the rest makes no difference
MAX_ITERATIONS, RELATIVE_TOLERANCE = 1000, 1e-10  # of the equation whose solution the evidence is


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """The log evidence of a posterior, with its standard error.

    `log_z`: of densities that are all normalised, the record's in SI; `overlap`: the share of what
    posterior and proposal have in common, from 0 to 1.  `steps`: what finer steps of a rig that is
    stepped have added to `log_z`, and `steps_error` what they have to `error`.
    """

    log_z: float
    error: float
    overlap: float
    steps: float = 0.0
    steps_error: float = 0.0

    def in_finer_steps(self, added: float, error: float) -> Evidence:
        """Return a copy with what finer steps add, and the standard error of that."""
        log_z, both = self.log_z + added, math.hypot(self.error, error)
        return replace(self, log_z=log_z, error=both, steps=added, steps_error=error)


def evidence(
    posterior: Posterior, proposal: Proposal, z: Array, log_p: Array, seed: int
) -> Evidence | None:
    """Estimate the evidence from steps `z (E, S, W, D)`, the log density there, and fresh draws.

    They come from a stream of their own, so that no chain depends on them.  None where posterior and
    proposal have nothing in common that was seen.
    """
    random = Random(seeds.bits(seed, "evidence"))
    mixture = proposal.mixture
    thin = max(1, -(-log_p.size // MAX_DRAWS))
    thinned, there = z[:, ::thin], log_p[:, ::thin]
    log_q = log_density(mixture, thinned.reshape(-1, z.shape[-1]))
    on_chain = there - log_q.reshape(there.shape)
    tried = math.ceil(min(there.size / proposal.share, MAX_TRIES_PER_DRAW * there.size))
    drawn = _draw(posterior, mixture, tried, random)
    return bridge(on_chain, drawn, tried)


def log_density(mixture: Mixture, u: Array) -> Array:
    """Return the log density of a mixture at `u (N, D)`, in batches: `(N,)`."""
    begins = range(0, len(u), BATCH_DRAWS)
    return np.concatenate([mixture.log_density(u[k : k + BATCH_DRAWS]) for k in begins])


def _draw(posterior: Posterior, mixture: Mixture, n: int, random: Random) -> Array:
    """Logs of p over q at those of `n` draws that are inside the prior; elsewhere p is zero."""
    log_ratios = []
    for begin in range(0, n, BATCH_DRAWS):
        u = mixture.draw(min(BATCH_DRAWS, n - begin), random).u
        u = u[posterior.supports(u)]
        if len(u) > 0:
            log_ratios.append(posterior(u) - log_density(mixture, u))
    return np.concatenate(log_ratios) if log_ratios else np.empty(0)


def bridge(on_chain: Array, drawn: Array, tried: int) -> Evidence | None:
    """Solve the bridge equation for the evidence (Meng and Wong 1996).

    From logs of p over q: at steps `(E, S, W)` of walkers over p, and at those of the `tried` draws
    of q where p is not zero.  With shares s, t of the two kinds of draws and w = p / q, Z solves
    Z = E_q[w / (s w + t Z)] / E_p[1 / (s w + t Z)]: means of what is bounded, whatever the weights.
    """
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) == 0:
        return None
    median = float(np.median(on_chain))
    p, q = (np.exp(np.clip(x - median, -MAX_LOG_RATIO, MAX_LOG_RATIO)) for x in (on_chain, drawn))
    s = on_chain.size / (on_chain.size + tried)
    t = 1.0 - s
    z, before = 1.0, 0.0
    for _ in range(MAX_ITERATIONS):
        of_q, of_p = q / (s * q + t * z), 1.0 / (s * p + t * z)
        before, z = z, float(of_q.sum() / tried / of_p.mean())
        if abs(z - before) < RELATIVE_TOLERANCE * z:
            break
    # What a walker remembers from step to step stays within its own mean.
    walkers = of_p.mean(axis=1).ravel()
    mean_q = float(of_q.sum() / tried)
    spread_q = float((of_q**2).sum() / tried) / mean_q**2 - 1.0
    spread_p = float(walkers.var(ddof=1) / walkers.mean() ** 2)
    chance = math.sqrt(spread_q / tried + spread_p / len(walkers))
    error = math.hypot(chance, _disagreement(q, tried, z))
    return Evidence(log_z=median + math.log(z), error=error, overlap=min(mean_q, 1.0))


def _disagreement(w: Array, tried: int, z: float) -> float:
    """Return how far the log of `z` is from what draws of q say by themselves.

    `w`: their weights; 0 where that is chance. Walkers that do not pass between maxima hold shares
    that are not the posterior's.
    """
    largest = float(w.max())  # squares of weights far from the chain's are too small for numbers
    shares = w / largest
    alone = math.log(largest) + math.log(float(shares.sum()) / tried)
    chance = math.sqrt(max(0.0, float((shares**2).sum() / shares.sum() ** 2) - 1.0 / tried))
    far = abs(math.log(z) - alone)
    return far if far > MAX_DISAGREEMENT * chance else 0.0
