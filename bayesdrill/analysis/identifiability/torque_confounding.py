"""What a missing torque can stand in for: parameters that a record would show without it, and what
helps.

The Fisher information of all unknowns together, of mean and covariance, as the curvature that a
record drawn at the point has (Gauss and Newton), with what the priors know; beside it that of the
same record, had the rig no missing torque.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.analysis.identifiability.structure import Exponents
from bayesdrill.basics.arrays import Array, Counts
from bayesdrill.inference.laplace import PosteriorLogDensity
from bayesdrill.inference.likelihood import Observation
from bayesdrill.inference.posterior import Posterior
from bayesdrill.record.experiment import Channel, frozen
from bayesdrill.rig import models
from bayesdrill.rig.models.latent_torque import SIZE, At, pushes

FALLS = 3.0  # times: how much worse an sd is with the torque, for a parameter that is named
KNOWN = 0.5  # of the prior's sd: with no more left a parameter is known, torque or not
HELPS = 2.0  # times: by how much better, for what is proposed
SENSOR = 0.01  # of its spread: noise of a sensor that is proposed
NOTHING = 1e-9  # times its size: a torque that is none
DRAWN = 2  # records, over which curvatures are averaged
MOST = 3  # proposals


@dataclass(frozen=True, slots=True, kw_only=True)
class Help:
    """`kind` hold: a parameter by name; measure: a state.  `shrink`: times by which the sd would
    fall.
    """

    kind: str
    name: str
    shrink: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StandIn:
    """The sd of a log with the torque, without it, and before the record."""

    name: str
    at: At
    sd: float
    alone: float
    before: float
    helps: tuple[Help, ...]


def stand_ins(
    posterior: Posterior, theta: Array, before: Array, rng: np.random.Generator
) -> tuple[StandIn, ...]:
    """Of the rig's parameters at `theta (D,)`; `before (D,)`: sds of logs under the priors."""
    every = posterior.likelihood.observations
    torques = [one.torque for one in every if one.torque]
    if not torques:
        return ()
    seeds = rng.integers(2**32, size=DRAWN)

    def information(some: Posterior, at: Array) -> Array:
        return _information(some, at, before, seeds)

    known = information(posterior, theta)
    if not np.isfinite(known).all():
        return ()
    names = posterior.space.free
    rig = [k for k, one in enumerate(posterior.space.unknowns) if one.role in ("rig", "quantity")]
    sds = np.sqrt(np.diag(np.linalg.inv(known)))
    without = posterior.edit(
        each=lambda one: one.torque.scale_torque(NOTHING) if one.torque else one
    )
    nothing = theta.copy()
    nothing[[k for k, name in enumerate(names) if name.startswith(SIZE)]] *= NOTHING
    alone = np.sqrt(np.diag(np.linalg.inv(information(without, nothing))))
    worse = [k for k in rig if sds[k] > FALLS * alone[k] and sds[k] > KNOWN * before[k]]
    if not worse:
        return ()
    # States that no channel shows by itself.
    first = posterior.likelihood.observations[0]
    shown = {name for c in first.experiment.channels for name in c.weights if len(c.weights) == 1}
    unseen = [name for name in first.response.model.states if name not in shown]
    more = {state: information(_showing(posterior, theta, state), theta) for state in unseen}

    def helps(k: int) -> tuple[Help, ...]:
        found = []
        for j in (j for j in rig if j != k):
            rest = [i for i in range(len(sds)) if i != j]
            held = np.linalg.inv(known[np.ix_(rest, rest)])
            sd = float(np.sqrt(held[rest.index(k), rest.index(k)]))
            found.append(Help(kind="hold", name=names[j], shrink=float(sds[k]) / sd))
        for state, wider in more.items():
            sd = float(np.sqrt(np.linalg.inv(wider)[k, k]))
            found.append(Help(kind="measure", name=state, shrink=float(sds[k]) / sd))
        good = sorted((one for one in found if one.shrink > HELPS), key=lambda one: -one.shrink)
        return tuple(good[:MOST])

    return tuple(
        StandIn(
            name=names[k],
            at=torques[0].kalman_filter.torque.at,
            sd=float(sds[k]),
            alone=float(alone[k]),
            before=float(before[k]),
            helps=helps(k),
        )
        for k in worse
    )


def scaled(posterior: Posterior, symmetries: Sequence[Exponents]) -> tuple[tuple[str, ...], ...]:
    """Of each symmetry that changes the inertia on which a torque acts: what goes with it, the
    size of the torque among it.
    """
    for one in posterior.likelihood.observations:
        if one.torque:
            rig, torque = one.torque.kalman_filter.model, one.torque.kalman_filter.torque
            names = posterior.space.free
            size = next((name for name in names if name.startswith(SIZE)), SIZE)
            found = []
            for exponents in symmetries:
                powers = dict(zip(names, exponents, strict=False))
                p = {name: 2.0 ** powers.get(name, 0) for name in rig.parameters}
                ones = dict.fromkeys(rig.parameters, 1.0)
                push = pushes(rig, torque, p, rig.linear(p))
                if push != pushes(rig, torque, ones, rig.linear(ones)):
                    found.append((*(n for n, e in powers.items() if e), size))
            return tuple(found)
    return ()


def _information(posterior: Posterior, theta: Array, before: Array, seeds: Counts) -> Array:
    """Information in logs `(D, D)`, priors included."""
    full, total = posterior.space.full(theta[None]), np.diag(1.0 / before**2)
    coordinates = posterior.coordinates
    steps = coordinates.natural(theta[None])[0] / coordinates.slopes(theta[None])[0]
    for seed in seeds:
        rng = np.random.default_rng(seed)
        drawn = [
            one.draw(one.signals(full), theta[None], rng)[0]
            for one in posterior.likelihood.observations
        ]
        surface = PosteriorLogDensity(posterior.edit(records=drawn))
        curvature = surface.record_slopes(theta[None], np.diag(steps))[1][0]
        total = total + curvature / len(seeds)
    return np.asarray(total)


def _showing(posterior: Posterior, theta: Array, state: str) -> Posterior:
    """With every record showing this state too."""
    full, unit = posterior.space.full(theta[None]), models.STATES[state].unit
    name = f"state {state}"
    channel = Channel(name=name, weights={state: 1.0}, unit=unit, latex="", latex_unit="")

    def showing(one: Observation) -> Observation:
        if one.torque is None:
            return one
        experiment = dataclasses.replace(
            one.experiment,
            channels=(*one.experiment.channels, channel),
            y=frozen(np.column_stack([one.experiment.y, np.zeros(len(one.experiment.t))])),
        )
        response = one.response.of(experiment)
        spread = float(response.signals(one.simulator_parameters(full))[0, :, -1].std())
        return one.torque.with_extra_channel(response, SENSOR * spread or 1.0)

    return posterior.edit(each=showing)
