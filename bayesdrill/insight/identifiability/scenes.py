"""Exact sensitivities of what is measured, in these experiments and in ones that might be made.

A scene is the experiments as they are, or with further channels, or with inputs changed half-way.
What is unknown of sensors and starts is taken out of the sensitivities: what is left of them is what
the record says of the rig, whatever these are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayesdrill.inference.laplace import natural_spread
from bayesdrill.inference.likelihood import Likelihood, Observation
from bayesdrill.inference.unknowns import MOVES
from bayesdrill.record.experiment import of_states

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """`extra`: states that are measured too, each with its sigma; `late`: what is added to inputs in the
    second half of each record; `times`: what inputs are multiplied with throughout.
    """

    extra: Mapping[str, float] = field(default_factory=dict)
    late: Mapping[str, float] = field(default_factory=dict)
    times: Mapping[str, float] = field(default_factory=dict)


AS_IT_IS = Scene()


class Scenery:
    """Sensitivities of a likelihood's rig at physical points `theta`, in any scene."""

    def __init__(self, likelihood: Likelihood) -> None:
        self.likelihood = likelihood
        self._stages = tuple(_Stage(one) for one in likelihood.observations)
        model = likelihood.observations[0].response.model
        self.states, self.inputs = model.states, model.inputs
        space = likelihood.space
        moving = [space.unknowns[k] for k in space.columns(*MOVES)]
        self.unknowns = tuple(u.name for u in moving if u.role in ("rig", "quantity"))
        self.nuisances = tuple(u.name for u in moving if u.role not in ("rig", "quantity"))
        self.prior_spreads = np.array([natural_spread(u) for u in moving])
        self._known = 1.0 / self.prior_spreads[len(self.unknowns) :]

    def usual_input(self, name: str) -> float:
        """The mean of an input over the records."""
        means = [stage.usual_input(name) for stage in self._stages]
        return float(np.mean(means))

    def sensitivities(self, theta: Array, scene: Scene = AS_IT_IS) -> Array:
        """d channel / d log unknown over sigma at `theta (D,)`: `(n, m)`, of the m unknowns of the rig.

        What nuisances explain of them, as freely as their priors allow, is taken away.  Not finite
        where the response overflows.
        """
        return self._of_rig(self.every(theta, scene))

    def repeated(self, theta: Array, scene: Scene) -> Array:
        """`sensitivities` of all records, and of as many others of the same sensors in a scene."""
        return self._of_rig(np.vstack([self.every(theta), self.every(theta, scene)]))

    def alone(self, rows: Array, rest: Array) -> tuple[Array, Array]:
        """`R (m, m)` and `b (m,)` of rows `(n, m + k)`, and what is left over the noise, `rest (n,)`.

        These rows alone know the rig's unknowns as `R' R`, and would move them by `R^-1 b`, whatever the
        nuisances are.
        """
        m = len(self.unknowns)
        matrix = self._with_priors(np.insert(rows, m, rest, axis=1), m + 1)
        found = without(matrix, m + 1)
        return found[:m, :m], found[:m, m]

    def _of_rig(self, rows: Array) -> Array:
        m = len(self.unknowns)
        if not self.nuisances or not np.isfinite(rows).all():
            return rows[:, :m]
        return without(self._with_priors(rows, m), m)

    def _with_priors(self, rows: Array, before: int) -> Array:
        """Of nuisances, which stand in the columns from `before` on."""
        held = np.hstack([np.zeros((len(self._known), before)), np.diag(self._known)])
        return np.vstack([rows, held])

    def every(self, theta: Array, scene: Scene = AS_IT_IS) -> Array:
        """`(n, m + k)`: of nuisances as well, on their natural scale."""
        parts = self.each(theta, scene)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def each(self, theta: Array, scene: Scene = AS_IT_IS) -> list[Array]:
        """`every` of each experiment by itself."""
        space = self.likelihood.space
        full, along = space.full(theta[None]), space.slopes(theta[None])
        return [stage.whitened(full, along, theta, scene) for stage in self._stages]

    def motions(self, theta: Array, scene: Scene = AS_IT_IS) -> list[Array]:
        """The states of each experiment, `(T, X)`."""
        space = self.likelihood.space
        full, along = space.full(theta[None]), space.slopes(theta[None])
        return [stage.states(full, along, scene) for stage in self._stages]

    def swing(self, theta: Array, motion: Array, which: int) -> float:
        """Of the channels of one experiment: their spread over the noise, the median."""
        one = self.likelihood.observations[which]
        sigma = one.scales(theta[None])[0]
        return float(
            np.median((motion @ one.experiment.weights(self.states).T).std(axis=0) / sigma)
        )


def without(rows: Array, m: int) -> Array:
    """The first m columns of `rows (n, m + k)`, without what the others explain of them: `(m, m)`."""
    k = rows.shape[1] - m
    turned = np.linalg.qr(np.hstack([rows[:, m:], rows[:, :m]]), mode="r")
    left = turned[k:, k:]
    return np.asarray(np.vstack([left, np.zeros((m - len(left), m))]) if len(left) < m else left)


class _Stage:
    """One experiment with its states for further channels, whose inputs can all be changed."""

    def __init__(self, one: Observation) -> None:
        model, experiment = one.response.model, one.experiment
        self._one, self._states, self._k = one, model.states, len(experiment.channels)
        n = len(experiment.t)
        self._base = {name: experiment.series.get(name, np.zeros(n)) for name in model.inputs}
        self._late = (np.arange(n) >= n // 2).astype(float)
        every = of_states(model.states)
        shown = dataclasses.replace(
            experiment,
            y=np.zeros((n, self._k + len(every))),
            channels=(*experiment.channels, *every),
            series=self._base,
        )
        self._response = one.response.of(shown)

    def usual_input(self, name: str) -> float:
        return float(self._one.experiment.constant.get(name, 0.0) + self._base[name].mean())

    def whitened(self, full: Array, along: Array, theta: Array, scene: Scene) -> Array:
        """Rows over the noise, zero where nothing was measured: `(n, m + k)`."""
        slopes = self._run(full, along, scene)[1]
        rows = self._one.informed(slopes[:, :, : self._k], theta)
        places = [self._states.index(name) for name in scene.extra]
        more = slopes[:, :, [self._k + place for place in places]]
        if places:
            rows = np.concatenate([rows, more / np.array([*scene.extra.values()])], axis=2)
        return np.asarray(rows.reshape(len(rows), -1).T)

    def _pushed(self, name: str, scene: Scene) -> Array:
        u, constant = self._base[name], self._one.experiment.constant.get(name, 0.0)
        more = (scene.times.get(name, 1.0) - 1.0) * (u + constant)
        return np.asarray(u + more + scene.late.get(name, 0.0) * self._late)

    def states(self, full: Array, along: Array, scene: Scene) -> Array:
        return self._run(full, along, scene)[0][:, self._k :]

    def _run(self, full: Array, along: Array, scene: Scene) -> tuple[Array, Array]:
        """Signals `(T, K + X)` and slopes `(q, T, K + X)`."""
        response = self._response
        if scene.late or scene.times:
            response = response.with_series({n: self._pushed(n, scene) for n in self._base})
        signals, slopes = response.course(self._one.told(full), self._one.told(along))
        return signals[0], slopes[0]
