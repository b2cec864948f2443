"""Check the limits of a rig, also between samples, and penalise waveforms that break limits."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesdrill.basics.arrays import Array, Flags
from bayesdrill.basics.duals import Dual
from bayesdrill.design.limits import RigLimit, excess
from bayesdrill.design.responses import ComingExperiment

KEPT_SHARE = 0.99  # smallest fraction of draws that must keep all limits
TOLERANCE = 1e-6  # largest excess that is allowed, relative to the quantity's largest value
HALVINGS = 8  # number of bisections between an allowed and a forbidden waveform
FINEST = 8000  # upper limit of the samples at which limits are checked, unless the record has more
CHANGED = 0.01  # a rate is fine enough if doubling it changes `sizes` by at most this fraction
SEARCH_TIMES = 250  # approximate number of instants of a record at which a search checks limits


@dataclass(frozen=True, slots=True)
class LimitCheck:
    """A check finds which of the draws `theta (W, D)` keep the limits of the rig.

    `coming` is the experiment, sampled so fast that peaks and integrals are resolved.
    """

    coming: ComingExperiment
    limits: tuple[RigLimit, ...]
    theta: Array

    @classmethod
    def between_samples(
        cls, coming: ComingExperiment, limits: tuple[RigLimit, ...], theta: Array
    ) -> LimitCheck:
        """Return a check at a rate that resolves peaks for alternating `low` and `high` levels."""
        check, source = cls(coming, limits, theta), coming.source
        levels = np.where(np.arange(source.count) % 2, source.low, source.high)
        sizes = check.sizes(theta[:4], levels)
        while limits and 2 * len(source.t) <= FINEST:
            source = dataclasses.replace(source, hold=source.interval, rate=2.0 * source.rate)
            check = cls(
                ComingExperiment.from_observation(coming.observation, source), limits, theta
            )
            before, sizes = sizes, check.sizes(theta[:4], levels)
            if (np.abs(sizes - before) <= CHANGED * sizes).all():
                break
        return check

    def sizes(self, theta: Array, levels: Array) -> Array:
        """Return the largest absolute values `(L,)` of the limited quantities at `theta (W, D)`."""
        return np.asarray(np.abs(self.limited(theta, levels)).max(axis=(0, 1), initial=1e-300))

    def limited(self, theta: Array, levels: Array) -> Array:
        """Return the limited quantities `(W, T, L)` at draws `theta (W, D)`."""
        states = self.coming.motion(theta, levels)[1]
        driven = self.coming.source.series(levels)[:, None]
        named = self.values_by_name(theta, states[..., None, :], driven[None])
        courses = [limit.course(*named, self.interval) for limit in self.limits]
        return np.concatenate([*courses, states[..., :0]], axis=-1)

    @property
    def interval(self) -> float:
        """Return the time between two samples [s]."""
        return 1.0 / self.coming.source.rate

    def values_by_name(
        self, theta: Array, states: Any, driven: Any
    ) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """Return the states `(..., X)`, the driven input, and constants `(W, 1, 1)` by name."""
        observation = self.coming.observation
        assert observation.space is not None
        named = observation.space.named(theta).items()
        constant = {name: np.reshape(x, (-1, 1, 1)) for name, x in named}
        moving = {n: states[..., k] for k, n in enumerate(observation.response.model.states)}
        inputs = {self.coming.source.input: driven}
        return moving, inputs, {**observation.experiment.constant, **constant}

    def kept_share(self, levels: Array) -> float:
        """Return the fraction of draws that keep all limits."""
        if not self.limits:
            return 1.0
        return float(np.mean(~self.broken(levels).any(axis=1)))

    def excess(self, levels: Array) -> float:
        """Return the mean of (excess / largest finite |bound|)^2; inf if a motion is not finite."""
        ends = np.array([[limit.low, limit.high] for limit in self.limits])
        sizes = np.abs(np.where(np.isfinite(ends), ends, 0.0)).max(axis=1)
        with np.errstate(all="ignore"):
            beyond = excess(self.limited(self.theta, levels), self.limits)
            total = float(np.mean((beyond / np.where(sizes > 0, sizes, 1.0)) ** 2))
        return total if np.isfinite(total) else np.inf

    def broken(self, levels: Array) -> Flags:
        """Return a mask `(W, L)` of the limits that each draw breaks."""
        limited = self.limited(self.theta, levels)
        finite = np.where(np.isfinite(limited), limited, 0.0)
        allowed = TOLERANCE * np.abs(finite).max(axis=(0, 1), initial=0.0)
        within = np.abs(excess(limited, self.limits)) <= allowed
        return np.asarray(~within.all(axis=1))

    def shorten(self, start: Array, end: Array) -> Array:
        """Return the allowed waveform nearest to `end` on the line from `start` to `end`."""
        if self.kept_share(end) >= KEPT_SHARE:
            return end
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            good = self.kept_share(start + middle * (end - start)) >= KEPT_SHARE
            low, high = (middle, high) if good else (low, middle)
        return np.asarray(start + low * (end - start))


class LimitPenalty:
    """The penalty of a linear rig sums squared excesses over limits at draws `theta (W, D)`.

    States are linear in the levels, so the integral of a power [W] is a quadratic form.  Limits
    without an integral are checked at some instants of each hold interval, mostly near its start.
    """

    def __init__(self, check: LimitCheck, theta: Array) -> None:
        self._check, self._theta = check, theta
        self.limits, self.source = check.limits, check.coming.source
        source = self.source
        per_level, count = source.samples_of_level, source.count
        many = max(4, SEARCH_TIMES // count)
        spaced = [space(1, per_level, many // 2) for space in (np.linspace, np.geomspace)]
        nodes = np.unique(np.concatenate(spaced).round().astype(int))
        times = (np.arange(count)[:, None] * per_level + nodes).ravel()
        self._pulses = np.insert(source.series(np.eye(count)).T, 0, 0.0, axis=1)  # (T, S + 1)
        states, forms = zip(
            *(self._draw(theta[[w]], times) for w in range(len(theta))), strict=True
        )
        self._states, self._forms, self._times = np.stack(states), np.stack(forms), times
        self._size = check.sizes(theta, np.full(count, max(source.low, source.high, key=abs)))

    def _draw(self, theta: Array, times: Array) -> tuple[Array, Array]:
        """Return states `(t, S + 1, X)` at `times`, and forms `(L, S + 1, S + 1)` for integrals."""
        check, count = self._check, self._check.coming.source.count
        still, *pulses = (check.coming.motion(theta, u)[1][0] for u in np.eye(count + 1)[:, 1:])
        states = np.stack([still, *(pulse - still for pulse in pulses)], axis=1)
        moving, driven, constant = check.values_by_name(theta, states, self._pulses)
        forms = np.zeros((len(check.limits), count + 1, count + 1))
        for limit, form in zip(check.limits, forms, strict=True):
            if limit.integral:
                form[:] = limit.quadratic_form(moving, driven, constant, check.interval)
        return states[times], forms

    def with_first(self, draws: int) -> LimitPenalty:
        """Return the penalty with only the first draws, which is faster."""
        fewer = copy.copy(self)
        fewer._theta, fewer._states = self._theta[:draws], self._states[:draws]
        fewer._forms = self._forms[:draws]
        return fewer

    def __call__(self, levels: Array) -> tuple[float, Array]:
        """Return the sum of squared relative excesses, and its gradient `(S,)`."""
        x, pulses = np.append(1.0, levels), self._pulses[self._times]
        motion = Dual((x @ self._states)[:, :, None], self._states[:, :, 1:])
        driven = Dual((pulses @ x)[None, :, None], pulses[None, :, 1:])
        named = self._check.values_by_name(self._theta, motion, driven)
        total, slope = 0.0, np.zeros(len(levels))
        for number, (limit, size) in enumerate(zip(self.limits, self._size, strict=True)):
            if limit.integral:
                along = self._forms[:, number] @ x
                value, slopes = along @ x, 2.0 * along[:, 1:]
            else:
                course = limit.course(*named, self._check.interval)
                value, slopes = course.value[..., 0], course.slope
            beyond = excess(value[..., None], (limit,))[..., 0] / size
            where = np.nonzero(beyond)
            total += float(beyond[where] @ beyond[where])
            slope += 2.0 * (beyond[where] @ slopes[where]) / size
        return total, slope
