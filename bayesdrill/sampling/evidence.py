"""Estimate the evidence Z, the integral of likelihood times prior, by bridge sampling.

The proposal of the ensembles is a normalised density q near the posterior p.  Z follows from p/q at
draws of p and at draws of q, with few further evaluations of the model (Meng and Wong 1996).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from bayesdrill.basics import seeds
from bayesdrill.basics.arrays import Array
from bayesdrill.inference.posterior import Posterior
from bayesdrill.sampling.samplers.independence import Mixture, Proposal, Random

MAX_DRAWS = 40_000  # largest number of draws from the chain, and from the proposal inside the prior
MAX_TRIES_PER_DRAW = 50  # largest number of draws of the proposal for each draw inside the prior
BATCH_DRAWS = 4000  # draws that are evaluated at a time, which limits the memory
MAX_DISAGREEMENT = 3.0  # in standard errors: two estimates that differ by less may do so by chance
MAX_LOG_RATIO = 500.0  # log (p/q) is clipped at its median +- this; the effect is negligible
MAX_ITERATIONS, RELATIVE_TOLERANCE = 1000, 1e-10  # limits of the fixed-point iteration


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """The log evidence of a posterior is estimated with a standard error.

    `log_z` is the natural log of the marginal density of the record in SI.  `overlap` is 0 if
    posterior and proposal are disjoint, and 1 if they are equal.  `log_z` includes `steps`, a
    correction for finite time steps if there are any, with the standard error `steps_error`.
    """

    log_z: float
    error: float
    overlap: float
    steps: float = 0.0
    steps_error: float = 0.0

    def in_finer_steps(self, added: float, error: float) -> Evidence:
        """Return a copy corrected by `added` for finite time steps, with its standard `error`."""
        log_z, total_error = self.log_z + added, math.hypot(self.error, error)
        return replace(self, log_z=log_z, error=total_error, steps=added, steps_error=error)


def evidence(
    posterior: Posterior, proposal: Proposal, z: Array, log_p: Array, seed: int
) -> Evidence | None:
    """Estimate the evidence from chains `z (E, S, W, D)`, `log_p (E, S, W)` and new proposal draws.

    The new draws have their own random stream.  Returns None if the posterior density is zero at
    all new draws.
    """
    random = Random(seeds.bits(seed, "evidence"))
    mixture = proposal.mixture
    thin = max(1, -(-log_p.size // MAX_DRAWS))
    z, log_p = z[:, ::thin], log_p[:, ::thin]
    log_q = log_density(mixture, z.reshape(-1, z.shape[-1]))
    on_chain = log_p - log_q.reshape(log_p.shape)
    tried = math.ceil(min(log_p.size / proposal.share_inside, MAX_TRIES_PER_DRAW * log_p.size))
    drawn = _draw(posterior, mixture, tried, random)
    return bridge(on_chain, drawn, tried)


def log_density(mixture: Mixture, u: Array) -> Array:
    """Return the log density of a mixture at `u (N, D)`, computed in batches: `(N,)`."""
    begins = range(0, len(u), BATCH_DRAWS)
    return np.concatenate([mixture.log_density(u[k : k + BATCH_DRAWS]) for k in begins])


def _draw(posterior: Posterior, mixture: Mixture, n: int, random: Random) -> Array:
    """Draw `n` points from the mixture, and return log (p/q) of those inside the prior."""
    log_ratios = []
    for begin in range(0, n, BATCH_DRAWS):
        u = mixture.draw(min(BATCH_DRAWS, n - begin), random).u
        u = u[posterior.supports(u)]
        if len(u) > 0:
            log_ratios.append(posterior(u) - log_density(mixture, u))
    return np.concatenate(log_ratios) if log_ratios else np.empty(0)


def bridge(on_chain: Array, drawn: Array, n_tries: int) -> Evidence | None:
    """Solve the bridge equation for the evidence (Meng and Wong 1996).

    `on_chain (E, S, W)` and `drawn (n,)` are log (p/q) at N steps of walkers and at n of `n_tries`
    draws of q; p = 0 at the other draws.  Let w = p/q, s = N / (N + n_tries) and t = 1 - s.  Then
    `Z = E_q[w / (s w + t Z)] / E_p[1 / (s w + t Z)]`.  The terms of both means are bounded.
    """
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) == 0:
        return None
    median = float(np.median(on_chain))
    p, q = (np.exp(np.clip(x - median, -MAX_LOG_RATIO, MAX_LOG_RATIO)) for x in (on_chain, drawn))
    s = on_chain.size / (on_chain.size + n_tries)
    t = 1.0 - s
    z, before = 1.0, 0.0
    for _ in range(MAX_ITERATIONS):
        of_q, of_p = q / (s * q + t * z), z / (s * p + t * z)  # both are bounded, however small z
        before, z = z, z * float(of_q.sum() / n_tries / of_p.mean())
        if abs(z - before) < RELATIVE_TOLERANCE * z:
            break
    # Steps of one walker are correlated, so the error comes from the means of the walkers.
    walkers = of_p.mean(axis=1).ravel()
    mean_q = float(of_q.sum() / n_tries)
    spread_q = float((of_q**2).sum() / n_tries) / mean_q**2 - 1.0
    spread_p = float((walkers / walkers.mean()).var(ddof=1))  # squares of tiny numbers underflow
    chance = math.sqrt(spread_q / n_tries + spread_p / len(walkers))
    error = math.hypot(chance, _disagreement(q, n_tries, z))
    return Evidence(log_z=median + math.log(z), error=error, overlap=min(mean_q, 1.0))


def _disagreement(w: Array, n_tries: int, z: float) -> float:
    """Return the distance of log `z` from the importance sampling estimate, 0 if it may be chance.

    `w (n,)` are the weights p/q of draws of q.  The estimates differ if walkers do not cross
    between maxima, because the fraction of walkers at a maximum is then not its mass.
    """
    largest = float(w.max())  # the squares of very small weights would underflow
    scaled = w / largest
    log_z = math.log(largest) + math.log(float(scaled.sum()) / n_tries)
    chance = math.sqrt(max(0.0, float((scaled**2).sum() / scaled.sum() ** 2) - 1.0 / n_tries))
    distance = abs(math.log(z) - log_z)
    return distance if distance > MAX_DISAGREEMENT * chance else 0.0
