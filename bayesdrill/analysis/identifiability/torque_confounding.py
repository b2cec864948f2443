"""Find parameters that a missing torque can replace, and propose remedies.

The Fisher information of all unknowns, with the priors, is compared with that of a rig without a
missing torque.  Information is the mean Gauss-Newton curvature of records simulated at the point.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.basics.arrays import Array, Counts
from bayesdrill.inference.laplace import LogDensity
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.noise.mixed import ChannelNoise, Mixed
from bayesdrill.inference.noise.white import White
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import frozen, with_states
from bayesdrill.rig.models.latent_torque import SIZE, TorqueLocation, torque_gain

MIN_LOSS = 3.0  # the torque increases the sd of a confounded parameter at least by this factor
KNOWN_SHARE = 0.5  # sd divided by prior sd, below which a parameter is known despite the torque
MIN_HELPFUL_FALL = 2.0  # smallest factor by which a proposed remedy reduces an sd
SENSOR_NOISE = 0.01  # noise of a proposed sensor, relative to the spread of its signal
NO_TORQUE = 1e-9  # factor by which the torque's size is multiplied to make the torque negligible
DRAWN_RECORDS = 2  # number of drawn records over which curvatures are averaged
MAX_REMEDIES = 3  # largest number of remedies that are proposed


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueRemedy:
    """A remedy helps to distinguish a parameter from the missing torque.

    To "hold" another parameter `name`, or "measure" a state `name`, divides the sd by `shrink`.
    """

    kind: str
    name: str
    shrink: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TorqueConfounding:
    """A missing torque can replace the parameter `name`.

    Its log has the sd `sd` with the torque, `alone` without it, and `before` under the prior.
    """

    name: str
    at: TorqueLocation
    sd: float
    alone: float
    before: float
    helps: tuple[TorqueRemedy, ...]


def find_confounded(
    posterior: Posterior, theta: Array, prior_sds: Array, rng: np.random.Generator
) -> tuple[TorqueConfounding, ...]:
    """Find parameters that a missing torque can replace at `theta (D,)`, with prior sds `prior_sds`."""
    observations = posterior.likelihood.observations
    torques = [observation.torque for observation in observations if observation.torque]
    if not torques:
        return ()
    seeds = rng.integers(2**32, size=DRAWN_RECORDS)
    known = _information(posterior, theta, prior_sds, seeds)
    if not np.isfinite(known).all():
        return ()
    names, rig = posterior.space.free, posterior.space.columns("rig", "quantity")
    sds = np.sqrt(np.diag(np.linalg.inv(known)))
    without = posterior.edit(convert=lambda o: o.torque.scale_torque(NO_TORQUE) if o.torque else o)
    theta_without = theta.copy()
    theta_without[[k for k, name in enumerate(names) if name.startswith(SIZE)]] *= NO_TORQUE
    alone = np.sqrt(np.diag(np.linalg.inv(_information(without, theta_without, prior_sds, seeds))))
    worse = [k for k in rig if sds[k] > MIN_LOSS * alone[k] and sds[k] > KNOWN_SHARE * prior_sds[k]]
    if not worse:
        return ()
    # A further sensor could measure a state if no channel shows this state alone.
    first = posterior.likelihood.observations[0]
    shown = {name for c in first.experiment.channels for name in c.weights if len(c.weights) == 1}
    unseen = [name for name in first.response.model.states if name not in shown]
    measured = {
        state: _information(_measuring(posterior, theta, unseen, state), theta, prior_sds, seeds)
        for state in unseen
    }

    def tried(k: int) -> Iterator[TorqueRemedy]:
        for j in (j for j in rig if j != k):
            others = [i for i in range(len(sds)) if i != j]
            covariance = np.linalg.inv(known[np.ix_(others, others)])
            sd = np.sqrt(covariance[others.index(k), others.index(k)])
            yield TorqueRemedy(kind="hold", name=names[j], shrink=float(sds[k] / sd))
        for state, information in measured.items():
            sd = np.sqrt(np.linalg.inv(information)[k, k])
            yield TorqueRemedy(kind="measure", name=state, shrink=float(sds[k] / sd))

    def helps(k: int) -> tuple[TorqueRemedy, ...]:
        good = [remedy for remedy in tried(k) if remedy.shrink > MIN_HELPFUL_FALL]
        return tuple(sorted(good, key=lambda remedy: -remedy.shrink)[:MAX_REMEDIES])

    return tuple(
        TorqueConfounding(
            name=names[k],
            at=torques[0].kalman_filter.torque.at,
            sd=float(sds[k]),
            alone=float(alone[k]),
            before=float(prior_sds[k]),
            helps=helps(k),
        )
        for k in worse
    )


def scaled_with_torque(
    posterior: Posterior, symmetries: Sequence[Exponents]
) -> tuple[tuple[str, ...], ...]:
    """Return names of unknowns that a symmetry scales together with the size of the torque."""
    torques = [each.torque for each in posterior.likelihood.observations if each.torque]
    if not torques:
        return ()
    rig, torque = torques[0].kalman_filter.model, torques[0].kalman_filter.torque
    names = posterior.space.free
    size = next((name for name in names if name.startswith(SIZE)), SIZE)

    def gain(p: Mapping[str, float]) -> Any:
        return torque_gain(rig, torque, p, rig.linear(p))

    scalings = []
    for exponents in symmetries:
        powers = dict(zip(names, exponents, strict=False))
        scaled = {name: 2.0 ** powers.get(name, 0) for name in rig.parameters}
        if gain(scaled) != gain(dict.fromkeys(rig.parameters, 1.0)):
            scalings.append((*(n for n, e in powers.items() if e), size))
    return tuple(scalings)


def _information(posterior: Posterior, theta: Array, prior_sds: Array, seeds: Counts) -> Array:
    """Return the Fisher information `(D, D)` of the logs of the unknowns, with the priors."""
    full, total = posterior.space.full(theta[None]), np.diag(1.0 / prior_sds**2)
    steps = posterior.coordinates.slopes_by_natural(theta[None])[0]
    for seed in seeds:
        rng = np.random.default_rng(seed)
        drawn = [
            observation.draw(observation.signals(full), theta[None], rng)[0]
            for observation in posterior.likelihood.observations
        ]
        surface = LogDensity(posterior.edit(records=drawn))
        curvature = surface.record_slopes(theta[None], np.diag(steps))[1][0]
        total = total + curvature / len(seeds)
    return np.asarray(total)


def _measuring(
    posterior: Posterior, theta: Array, states: Sequence[str], measured: str
) -> Posterior:
    """Return the posterior with a further channel for each of `states`; only `measured` has samples.

    Channels without samples change no density, so the same compiled kernels serve all `states`.
    """
    full, n_states = posterior.space.full(theta[None]), len(states)

    def convert(observation: Observation) -> Observation:
        if observation.torque is None:
            return observation
        before, n = observation.experiment, len(observation.experiment.t)
        seen = np.where(np.array(states) == measured, 0.0, np.nan)
        y, k = np.column_stack([before.y, np.tile(seen, (n, 1))]), len(before.channels)
        shown = dataclasses.replace(with_states(before, states), y=frozen(y))
        response = observation.response.of(shown)
        spreads = response.signals(observation.simulator_parameters(full))[0, :, k:].std(axis=0)
        known = {j: SENSOR_NOISE * float(spread) or 1.0 for j, spread in enumerate(spreads)}
        extra, noise = White(n_samples=n, known=known, n_channels=n_states), observation.noise
        new = tuple(range(k, k + n_states))
        both = Mixed((ChannelNoise(noise, tuple(range(k))), ChannelNoise(extra, new)))
        wider = dataclasses.replace(observation, noise=both)
        return wider.with_simulator(response, observation.parameters)

    return posterior.edit(convert=convert)
