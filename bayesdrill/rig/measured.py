"""The exact response as sensors show it: late, scaled, shifted, from an unknown start, at any times.

`Sensing` says which numbers that takes beside the rig's parameters.  Everything is linear in the
states, so that sensors are rows of weights, and their derivatives other rows (`Dense` runs both).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from bayesdrill.record.experiment import Experiment, frozen
from bayesdrill.rig.dense import Dense
from bayesdrill.rig.kernels.tally import INTERVALS, LOGS, NEIGHBOURS
from bayesdrill.rig.models.linear import Model
from bayesdrill.rig.models.tangent import Tangent
from bayesdrill.rig.sensing import Sensing
from bayesdrill.rig.stepped import Unstepped
from bayesdrill.rig.sums import interval_sums, log_sums, normal
from bayesdrill.rig.walkers import Numbers, Walkers

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measured(Unstepped):
    """See `simulator.Simulator`; parameters are the model's, then those that `sensing` names."""

    model: Model
    experiment: Experiment
    sensing: Sensing

    exact: ClassVar[bool] = False
    record: ClassVar[None] = None

    @property
    def parameters(self) -> tuple[str, ...]:
        return (*self.model.parameters, *self.sensing.names)

    def of(self, experiment: Experiment) -> Measured:
        return Measured(self.model, experiment, self.sensing)

    def with_record(self, y: Array) -> Measured:
        """What was not measured stays so."""
        if y.shape != self.experiment.y.shape:
            raise ValueError(f"the record has shape {self.experiment.y.shape}, not {y.shape}")
        kept = frozen(np.where(self.experiment.seen, y, np.nan))
        made = self.of(dataclasses.replace(self.experiment, y=kept))
        for name in ("_dense", "_tangent"):  # which no record has a part in
            if name in self.__dict__:
                made.__dict__[name] = self.__dict__[name]
        return made

    def with_series(self, series: Mapping[str, Array]) -> Measured:
        if set(series) != set(self.experiment.series):
            raise ValueError(f"series of {sorted(self.experiment.series)} are wanted")
        ordered = {name: series[name] for name in self.experiment.series}
        return self.of(dataclasses.replace(self.experiment, series=ordered))

    def signals(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._walkers.cut(self._dense.signals(*self._settings(full)))

    def squares(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._dense.squares(*self._settings(full), self._walkers.padded)

    def neighbours(self, full: Array) -> Array:
        with np.errstate(all="ignore"):
            return self._dense.tallied(self._settings(full), self._walkers.padded, NEIGHBOURS)

    def logs(self, full: Array, weights: Array) -> Array:
        with np.errstate(all="ignore"):
            settings = self._settings(full)
            return log_sums(self._dense.tallied(settings, self._walkers.padded, LOGS, weights))

    def intervals(self, full: Array, over: Array, half: Array) -> Array:
        own = np.stack([over, half], axis=-1).reshape(len(full), -1)
        with np.errstate(all="ignore"):
            settings = self._settings(full)
            found = self._dense.tallied(settings, self._walkers.padded, INTERVALS, own)
            return interval_sums(found)

    def sensitivities(self, full: Array, along: Array) -> Array:
        n, q, _ = along.shape
        points = np.repeat(full, q, axis=0)
        with np.errstate(all="ignore"):
            found = self._slopes(points, along.reshape(n * q, -1))
        return found.reshape(n, q, *self.experiment.y.shape)

    def course(self, full: Array, along: Array) -> tuple[Array, Array]:
        return self.signals(full), self.sensitivities(full, along)

    def normal(self, full: Array, along: Array, scales: Array) -> tuple[Array, Array, Array]:
        return normal(self, full, along, scales)

    # What `Dense` is told.

    @cached_property
    def _walkers(self) -> Walkers:
        return Walkers(self.model, self.experiment, self.sensing)

    @cached_property
    def _dense(self) -> Dense:
        return self._made(self._walkers.wired)

    @cached_property
    def _tangent(self) -> Dense:
        return self._made(Tangent(self._walkers.wired))

    def _made(self, model: Model) -> Dense:
        t, series = self._walkers.knots
        return Dense(model, t, series, self.experiment.constant, self.experiment.first_order)

    def _settings(self, full: Array) -> tuple[Array, Array, Array, Array | None, Array]:
        w = self._walkers
        of = w.numbers(full)
        start = w.begin(of, full)
        before = w.before(of, start)
        rows = np.zeros(
            (len(full), len(self.experiment.channels), len(w.inputs) + start.shape[1] + 1)
        )
        rows[:, :, : start.shape[1]] = w.gains(full)[:, :, None] * w.weights
        rows[:, :, start.shape[1]] = w.of_channels(self.sensing.offsets, full)
        shift = w.later(full) if self.sensing.shifts else None
        return w.told(full), start, before, shift, rows

    def _slopes(self, full: Array, along: Array) -> Array:
        """d signal along `along (n, P)` at `full (n, P)`: `(n, T, K)`."""
        w = self._walkers
        told, start, before, shift, rows = self._settings(full)
        of, x = w.tangent_numbers(full, along), start.shape[1]
        matrix, by_input, forcing = of
        slopes = np.zeros((*rows.shape[:2], rows.shape[2] + x))
        gains, later = w.gains(full)[:, :, None], w.later(along)[:, :, None]
        slopes[:, :, :x] = w.of_channels(self.sensing.gains, along)[:, :, None] * w.weights
        slopes[:, :, x : 2 * x] = gains * w.weights
        slopes[:, :, 2 * x] = w.of_channels(self.sensing.offsets, along)
        ahead = later * gains * w.weights  # d signal / d lag = - gain c . x'
        slopes[:, :, :x] -= np.einsum("nkx,nxy->nky", ahead, matrix[:, :x, :x])
        slopes[:, :, 2 * x] -= np.einsum("nkx,nx->nk", ahead, forcing[:, :x])
        slopes[:, :, 2 * x + 1 :] -= np.einsum("nkx,nxs->nks", ahead, by_input[:, :x])
        begin = np.concatenate([start, w.begin_slope(of, along)], axis=1)
        earlier = np.concatenate([before, w.before_slope(of, begin)], axis=1)
        both = np.concatenate([told, w.told(along)], axis=1)
        found = w.cut(self._tangent.signals(both, begin, earlier, shift, slopes))
        if shift is not None:
            self._mend_before(found, shift, ahead, begin, earlier, of)
        return found

    def _mend_before(
        self,
        found: Array,
        shift: Array,
        ahead: Array,
        begin: Array,
        earlier: Array,
        of: Numbers,
    ) -> None:
        """Before the start the states go on straight, and not as the rig moves."""
        x = self._walkers.weights.shape[1]
        when = self.experiment.t[None, :, None] - shift[:, None, :] - self.experiment.t_start
        if not (early := when < 0).any():
            return
        matrix, by_input, forcing = (part[:, :x] for part in of)
        n, t, k = np.nonzero(early)
        here = begin[n, :x] + when[early][:, None] * earlier[n, :x]
        moved = np.einsum("axy,ay->ax", matrix[n][:, :, :x], here) + forcing[n]
        moved += np.einsum("axs,s->ax", by_input[n], self._walkers.first_inputs)
        found[n, t, k] += np.einsum("ax,ax->a", ahead[n, k], moved - earlier[n, :x])
