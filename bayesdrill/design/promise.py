"""Predict standard deviations after a coming record, with exact instead of Gaussian priors.

In directions that a record does not determine, the posterior keeps the priors and their bounds.
Near a draw, the likelihood is approximated by a Gaussian on natural scales (logs of positive
unknowns; other unknowns / scale).  Its product with the priors is sampled by elliptical slices
(Murray, Adams and MacKay 2010).  A Gauss-Newton step moves some samples to the curved ridge of the
exact likelihood; the change of their spread corrects the sds.
"""

from __future__ import annotations

import numpy as np

from bayesdrill.analysis.identifiability.information import SensitivityStudy
from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.design.knowledge import PresentKnowledge
from bayesdrill.inference.posterior import Posterior
from bayesdrill.inference.unknowns import ParameterSpace
from bayesdrill.sampling.samplers.elliptical_slices import elliptical_slices

CHAINS = 1024  # number of chains, divided among the draws
WARM_STEPS, KEPT_STEPS = 40, 60  # number of steps of each chain, discarded and kept
SIMULATED = 256  # number of samples that are moved to the ridge, divided among the draws


def promise(
    posterior: Posterior, knowledge: PresentKnowledge, slopes: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return relative sds `(k,)` of targets after the record of `posterior`, as means over draws.

    `slopes (W, k, m)` are derivatives of k log targets by m unknowns, at each of W draws.  The means
    are geometric.  The second result is the information `(W, m, m)` of the record at each draw.
    """
    study, space, draws = SensitivityStudy(posterior.likelihood), posterior.space, knowledge.draws
    rows = [study.with_nuisances(theta) for theta in draws]
    gain = np.stack([each.T @ each for each in rows])
    path = sample_deviations(space, knowledge, gain, rng)
    sds = spreads(path, slopes)
    for w, theta in enumerate(draws):
        linear = path[-1, w, : max(2, SIMULATED // len(draws))]
        points = _displaced(space, np.repeat(theta[None], len(linear), axis=0), linear)
        beyond = study.changes(theta, points) - linear @ rows[w].T
        back = np.linalg.solve(gain[w] + knowledge.precision, rows[w].T @ beyond.T).T
        # All samples give an sd with little noise; simulated samples give its correction factor.
        sds[w] *= ((linear - back) @ slopes[w].T).std(axis=0) / (linear @ slopes[w].T).std(axis=0)
    return geometric_mean(sds), gain


def information(posterior: Posterior, draws: Array) -> Array:
    """Return the information `(W, m, m)` of the records of `posterior` at `draws (W, D)`."""
    study = SensitivityStudy(posterior.likelihood)
    rows = [study.with_nuisances(theta) for theta in draws]
    return np.stack([each.T @ each for each in rows])


def present_sds(
    space: ParameterSpace, knowledge: PresentKnowledge, slopes: Array, rng: np.random.Generator
) -> Array:
    """Return relative sds `(k,)` of targets with `slopes (W, k, m)` without a further record."""
    nothing = np.zeros((len(slopes), *knowledge.precision.shape))
    return geometric_mean(spreads(sample_deviations(space, knowledge, nothing, rng), slopes))


def spreads(path: Array, slopes: Array) -> Array:
    """Return sds `(W, k)` of targets with `slopes (W, k, m)` over samples `path (S, W, C, m)`."""
    return np.asarray(np.einsum("wkm,swcm->wksc", slopes, path).std(axis=(2, 3)))


def geometric_mean(sds: Array) -> Array:
    """Return the geometric means `(k,)` of sds `(W, k)` over draws."""
    return np.asarray(np.exp(np.log(sds).mean(axis=0)))


def sample_deviations(
    space: ParameterSpace, knowledge: PresentKnowledge, gain: Array, rng: np.random.Generator
) -> Array:
    """Return deviations `(S, W, C, m)` from draws on natural scales: S steps of C chains per draw.

    `gain (W, m, m)` is the information of a record at each draw.
    """
    draws, m, chains = (
        knowledge.draws,
        knowledge.precision.shape[0],
        max(2, CHAINS // len(knowledge.draws)),
    )
    # Inverting the Cholesky factor, not the matrix, is accurate in directions that are known well.
    roots = np.linalg.inv(np.linalg.cholesky(gain + knowledge.precision))
    bases, logs = draws.repeat(chains, axis=0), _logs(space, m)

    def log_weight(points: Array, here: Indices) -> Array:
        """Return log(priors / Gaussian approximation of the priors)."""
        if knowledge.gaussian:
            return np.zeros(len(points))
        gaussian = 0.5 * ((points @ knowledge.precision) * points).sum(axis=1)
        jacobian = points[:, logs].sum(axis=1)
        return np.asarray(
            space.log_prior(_displaced(space, bases[here], points)) + jacobian + gaussian
        )

    steps = WARM_STEPS + KEPT_STEPS
    path = elliptical_slices(roots.repeat(chains, axis=0), log_weight, steps, rng)[WARM_STEPS:]
    return path.reshape(KEPT_STEPS, len(draws), chains, m)


def _logs(space: ParameterSpace, m: int) -> Flags:
    return np.array([not unknown.signed for unknown in space.unknowns[:m]])


def _displaced(space: ParameterSpace, theta: Array, deviations: Array) -> Array:
    """Return unknowns `theta (N, D)`, moved by `deviations (N, m)` on natural scales."""
    m = deviations.shape[1]
    out, logs = theta.copy(), _logs(space, m)
    plain = theta[:, :m] + space.coordinates.natural(theta)[:, :m] * deviations
    with np.errstate(over="ignore"):
        out[:, :m] = np.where(logs, theta[:, :m] * np.exp(deviations), plain)
    return out
