"""Exact log-sensitivities of what is measured, in this experiment and in ones that might be made.

A scene is the experiment as it is, or with other channels, or with its inputs pushed.  One tangent
model (`models.tangent`) with all states for channels and all inputs sampled serves every scene.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Likelihood
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.tangent import DOT
from bayesdrill.rig.response import slopes_of

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """`weights (K, X)`: channels as sums of states; `sigma (K,)`; `push`: added to inputs `(T,)`."""

    weights: Array
    sigma: Array
    push: Mapping[str, Array] = field(default_factory=dict)


class Scenery:
    """Sensitivities of a likelihood's rig at physical points `theta`, in any scene."""

    def __init__(self, likelihood: Likelihood) -> None:
        response = likelihood.response
        rig, experiment = response.model, response.experiment
        self.likelihood = likelihood
        self.n_samples = len(experiment.t)
        self.states = rig.states
        self.inputs = rig.inputs
        self._base = {
            name: experiment.series.get(name, np.zeros(self.n_samples)) for name in rig.inputs
        }
        every = tuple(
            Channel(name=name, weights={name: 1.0}, unit="", latex="", latex_unit="")
            for name in (*(name + DOT for name in rig.states), *rig.states)
        )
        tangent = dataclasses.replace(
            experiment,
            y=np.zeros((self.n_samples, len(every))),
            channels=every,
            series=self._base,
        )
        self._tangent = slopes_of(rig, tangent)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Those that are not noise levels, of which sensitivities are taken."""
        free = self.likelihood.space.free
        return free[: len(free) - len(self.likelihood.noise.unknown)]

    def usual_input(self, name: str) -> float:
        """The mean of an input over the record."""
        constant = self.likelihood.response.experiment.constant.get(name, 0.0)
        return float(constant + self._base[name].mean())

    def as_it_is(self, theta: Array) -> Scene:
        """The experiment of the record itself; unknown sigmas are those of `theta (D,)`."""
        experiment = self.likelihood.response.experiment
        weights = [[c.weights.get(name, 0.0) for name in self.states] for c in experiment.channels]
        sigma = self.likelihood.sigmas(theta[None])[0]
        return Scene(weights=np.array(weights), sigma=sigma)

    def sensitivities(self, theta: Array, scene: Scene) -> Array:
        """d channel / d log unknown over sigma at `theta (D,)`: `(T K, m)`.

        Of the m unknowns that are not noise levels.  Not finite where the response overflows.
        """
        slopes = self._run(theta, scene)[:, :, : len(self.states)]
        measured = slopes @ (scene.weights / scene.sigma[:, None]).T
        return np.asarray(measured.reshape(len(measured), -1).T)

    def states_over_time(self, theta: Array, scene: Scene) -> Array:
        """`(T, X)`."""
        return self._run(theta, scene)[0, :, len(self.states) :]

    def _run(self, theta: Array, scene: Scene) -> Array:
        space = self.likelihood.space
        slopes = space.slopes(theta[None])[0]
        points = np.broadcast_to(space.full(theta[None]), slopes.shape)
        series = {name: u + scene.push.get(name, 0.0) for name, u in self._base.items()}
        return self._tangent.with_series(series).signals(np.concatenate([points, slopes], axis=1))
