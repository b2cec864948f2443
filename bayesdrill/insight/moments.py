"""What the moment at which a step is given has to do with the unknowns: half a sample of it.

A step that is given between two samples leaves a fit that looks like noise, and moves what is inferred.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Observation
from bayesdrill.insight.identifiability.information import root_of
from bayesdrill.insight.identifiability.scenes import Scenery
from bayesdrill.record.clocks import usual_step
from bayesdrill.record.experiment import Experiment
from bayesdrill.rig.models.linear import driven, dynamics

Array = NDArray[np.float64]

MATTERS = 0.5  # sds, of a shift that is worth a word


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """By how many of its sds each unknown of the rig would move, if the inputs came `seconds` later."""

    seconds: float
    shifts: tuple[tuple[str, float], ...]

    @property
    def worst(self) -> tuple[str, float]:
        return max(self.shifts, key=lambda one: abs(one[1]))

    @property
    def matters(self) -> bool:
        return abs(self.worst[1]) > MATTERS


def half_a_sample(scenery: Scenery, theta: Array) -> Moment | None:
    """At `theta (D,)`; None where the moment is unknown, or all channels have lags of their own."""
    every = scenery.likelihood.observations
    if not scenery.unknowns or any(_told(one) for one in every):
        return None
    half = 0.5 * min(_step(one.experiment) for one in every)
    motions = scenery.motions(theta)
    pairs = zip(every, motions, strict=True)
    late = np.concatenate([_later(one, scenery, theta, motion).ravel() for one, motion in pairs])
    rows = scenery.every(theta)
    if not (np.isfinite(half) and np.isfinite(rows).all() and np.isfinite(late).all()):
        return None
    matrix = np.vstack([rows, np.diag(1.0 / scenery.prior_spreads)])
    target = np.append(half * late, np.zeros(rows.shape[1]))
    moved = np.linalg.lstsq(matrix, target, rcond=None)[0]
    sds = np.linalg.norm(np.linalg.inv(root_of(matrix)), axis=1)
    m = len(scenery.unknowns)
    ratio = (moved / sds)[:m]
    return Moment(seconds=half, shifts=tuple(zip(scenery.unknowns, map(float, ratio), strict=True)))


def _step(experiment: Experiment) -> float:
    """The usual one between two samples of an input or, where all are constant, of a channel."""
    if experiment.series:
        return min(experiment.input_steps.get(name, experiment.dt) for name in experiment.series)
    return min(usual_step(experiment.t[seen]) for seen in experiment.seen.T)


def _told(one: Observation) -> bool:
    sensing = one.response.sensing
    every_input = bool(sensing.input_lags) and len(sensing.input_lags) == len(one.experiment.series)
    every_channel = len(sensing.lags) == len(one.experiment.channels)
    return sensing.delay is not None or every_input or every_channel


def _later(one: Observation, scenery: Scenery, theta: Array, motion: Array) -> Array:
    """d signal / d delay over the noise, where it was measured: minus how fast each channel changes."""
    experiment, model = one.experiment, one.response.model
    told = one.told(scenery.likelihood.space.full(theta[None]))[0]
    named = dict(zip(model.parameters, told[: len(model.parameters)], strict=True))
    linear, n = model.linear(named), len(experiment.t)
    given = {
        name: experiment.constant.get(name, 0.0) + experiment.series.get(name, 0.0)
        for name in model.inputs
    }
    change = motion @ dynamics(linear, model.states, 1)[0].T
    change = change + driven(linear, model.states, n, given)
    return one.informed(-change[None] @ experiment.weights(model.states).T, theta)
