"""Exact log-sensitivities of what is measured, in this experiment and in ones that might be made.

A scene is the experiment as it is, or with other channels, or with its inputs pushed.  One tangent
model (`models.tangent`) with all states for channels and all inputs sampled serves every scene.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.likelihood import Likelihood
from bayesdrill.inference.noise.contract import Noise
from bayesdrill.record.experiment import Channel
from bayesdrill.rig.models.tangent import DOT
from bayesdrill.rig.response import slopes_of

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """`weights (K, X)`: channels as sums of states; `sigma (K,)`; `push`: added to inputs `(T,)`.

    `inform`: of the noise of the record's own channels, where that is not white: see `Noise`.
    """

    weights: Array
    sigma: Array
    inform: Callable[[Array], Array] | None = None
    push: Mapping[str, Array] = field(default_factory=dict)


def _informed(noise: Noise, own: Array, shifts: Array) -> Array:
    """`shifts (m, T, K)` of the signals, over the noise."""
    return noise.inform(shifts, np.repeat(own, len(shifts), axis=0))


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
        space = self.likelihood.space
        return tuple(space.free[k] for k in space.columns("rig", "quantity"))

    def usual_input(self, name: str) -> float:
        """The mean of an input over the record."""
        constant = self.likelihood.response.experiment.constant.get(name, 0.0)
        return float(constant + self._base[name].mean())

    def as_it_is(self, theta: Array) -> Scene:
        """The experiment of the record itself; unknown sigmas are those of `theta (D,)`."""
        experiment = self.likelihood.response.experiment
        weights = [[c.weights.get(name, 0.0) for name in self.states] for c in experiment.channels]
        sigma, noise = self.likelihood.sigmas(theta[None])[0], self.likelihood.noise
        if noise.white:
            return Scene(weights=np.array(weights), sigma=sigma)
        inform = partial(_informed, noise, self.likelihood.own(theta[None]))
        return Scene(weights=np.array(weights), sigma=sigma, inform=inform)

    def sensitivities(self, theta: Array, scene: Scene) -> Array:
        """d channel / d log unknown over sigma at `theta (D,)`: `(T K, m)`.

        Of the m unknowns that are not noise levels.  Not finite where the response overflows.
        """
        slopes = self._run(theta, scene)[:, :, : len(self.states)]
        measured = slopes @ (scene.weights / scene.sigma[:, None]).T
        if scene.inform is not None:
            own = len(self.likelihood.response.experiment.channels)
            measured[:, :, :own] = scene.inform(slopes @ scene.weights[:own].T)
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
