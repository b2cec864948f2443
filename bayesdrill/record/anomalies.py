"""Find errors of sensors: spikes, stuck or clipped values, wraps, and speeds that are differences.

In a spike, a signal departs and returns within a few samples, with similar slopes. Spikes of up to
three samples are compared with the chord between their neighbours, and longer spikes with a running
median, which keeps steps and follows ramps. A spike has to be far higher than other departures
around it, unlike regular pulses, peaks of a swing or steps of quantised speeds. A departure right
after a jump of an input is no spike, but motion of the rig.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view

from bayesdrill.basics.arrays import Array, Flags, Indices
from bayesdrill.record.regression import linear_fit

MAX_SHORT_SPIKE = 3  # longest spike, in samples, that is compared with a chord
MAX_LONG_SPIKES = (6, 20)  # longest spikes, in samples, for two running medians

# Thresholds beyond which a departure is a spike.
MIN_SPIKE_SDS = 2.0  # least height of a short spike, in sds of the channel
SWING_WINDOW = 6  # half width of the window searched for a swing / longest length of the spike
MIN_DEPARTURE = 5.0  # least ratio of a short spike's height to departures around it
AROUND_SPIKE = 60  # samples on either side whose departures are compared with a spike
AROUND_QUANTILE = 0.95  # quantile of these departures; their maximum may be another spike
MIN_LONG_DEPARTURE = 6.0  # least ratio of a long spike's height to the typical departure
TYPICAL_QUANTILE = 0.9  # quantile of departures that is called typical
MAX_SLOPE_RATIO = 3.0  # largest ratio of the slopes on the way out and back
MAX_SWING = 0.3  # largest (height of the opposite peak / height of a spike), else an oscillation
MAX_RETURN_ERROR = 0.35  # largest ratio of (value after - value before) to a spike's height
INPUT_JUMP = 0.2  # least (change in one step / range) of an input that counts as a jump
MAX_JUMP_SHARE = 0.1  # fraction of samples with jumps above which jumps explain no spike
MIN_SAMPLES = 60  # fewer samples are not searched for spikes
MIN_STUCK_RUN = 10  # least number of equal samples
MAX_ZERO_STEPS = 0.05  # largest fraction of zero steps in a channel that has noise
MIN_CLIPPED_RUN = 3  # least number of samples of a run at the largest or smallest value
MIN_CLIPPED_SAMPLES = 10  # least number of samples of all such runs
MIN_CLIPPED_STEP = 2.5  # least step before a run / resolution; steps near a smooth peak are smaller
WRAP_MARGIN = 0.1  # in periods: a jump this near to half a period has no clear direction
FILTER_REACH = 3  # samples on either side that a differentiating filter may use
STRETCH = 1 << 20  # number of samples in a part that is searched at once
OVERLAP = 4096  # number of additional samples on either side of such a part
MAX_NUMPY_MEDIAN = 10_000  # for fewer samples NumPy is faster than importing SciPy's median


@dataclass(frozen=True, slots=True)
class Spans:
    """Each span is a run of samples of a column, from `first[j]` to `last[j]` inclusive."""

    first: Indices
    last: Indices

    def __len__(self) -> int:
        return len(self.first)

    @property
    def count(self) -> int:
        """Return the number of samples in all runs."""
        return int(np.sum(self.last - self.first + 1))

    def mask(self, n: int) -> Flags:
        """Return a mask `(n,)` of the samples that are in a run."""
        edges = np.zeros(n + 1, dtype=np.intp)
        np.add.at(edges, self.first, 1)
        np.add.at(edges, self.last + 1, -1)
        return np.cumsum(edges)[:n] > 0


def spans(mask: Flags) -> Spans:
    """Return the runs of true values in `mask (T,)`."""
    padded = np.concatenate([[False], mask, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return Spans(edges[::2], edges[1::2] - 1)


def spikes(
    x: Array, caused: Flags | None = None, *, wide: bool = True, inert: bool = False
) -> Spans:
    """Find spikes in finite `x (T,)`; `caused (T,)` marks samples at which an input has just jumped.

    With `wide`, spikes of more than two samples count; in an input, such pulses may be intended.
    With `inert`, jumps of inputs explain no spike of up to `MAX_SHORT_SPIKE` samples.
    """
    mask = np.zeros(len(x), dtype=np.bool_)
    if len(x) < MIN_SAMPLES:
        return spans(mask)
    if caused is None or np.mean(caused) > MAX_JUMP_SHARE:
        caused = np.zeros(len(x), dtype=np.bool_)
    for first in range(0, len(x), STRETCH):
        begin, last = max(0, first - OVERLAP), first + STRETCH
        here = slice(begin, last + OVERLAP)
        part = _spike_mask(x[here], caused[here], wide=wide, inert=inert)
        mask[first:last] = part[first - begin :][: len(mask[first:last])]
    return spans(mask)


def _spike_mask(x: Array, caused: Flags, *, wide: bool, inert: bool) -> Flags:
    """Return a mask `(T,)` of the samples of a part `x (T,)` that are in spikes."""
    mask = np.zeros(len(x), dtype=np.bool_)
    for width in range(1, MAX_SHORT_SPIKE + 1 if wide else MAX_SHORT_SPIKE):
        mask |= _short_spikes(x, width, caused & (not inert))
    for longest in MAX_LONG_SPIKES if wide else ():
        mask |= _spikes(x, longest, caused)
    return mask


def jumps(x: Array) -> Indices:
    """Return the samples right after jumps of an input `x (T,)`; gaps are skipped."""
    known = np.flatnonzero(np.isfinite(x))
    steps = np.abs(np.diff(x[known]))
    return known[1:][steps > INPUT_JUMP * np.ptp(x[known])]


def stuck(x: Array) -> Spans:
    """Find the longest run of one value in `x (T,)`, if noise makes other samples differ.

    A run at the beginning does not count, as a rig that is switched off stands still.
    """
    same = np.diff(x) == 0
    runs = spans(same)
    if not len(runs):
        return runs
    at = int(np.argmax(runs.last - runs.first))
    first, last = runs.first[at : at + 1], runs.last[at : at + 1] + 1
    steps = int(last[0] - first[0])
    zeros, others = np.sum(same) - steps, len(same) - steps
    long = steps + 1 >= MIN_STUCK_RUN and first[0] > 0
    if not long or zeros > MAX_ZERO_STEPS * others:
        return spans(np.zeros(0, dtype=np.bool_))
    return Spans(first, last)


def saturated(x: Array) -> Spans:
    """Find runs of `x (T,)` at its largest or smallest value that begin with a steep step."""
    mask = np.zeros(len(x), dtype=np.bool_)
    steps = np.abs(np.diff(x))
    if not np.any(steps):
        return spans(mask)
    digit = float(steps[steps > 0].min())
    for end in (float(x.max()), float(x.min())):
        runs = spans(x == end)
        keep = runs.last - runs.first + 1 >= MIN_CLIPPED_RUN
        first, last = runs.first[keep], runs.last[keep]
        inner = first[first >= 2]
        steep = np.abs(x[inner - 1] - x[inner - 2]) > MIN_CLIPPED_STEP * digit
        enough = len(first) >= 2 and int(np.sum(last - first + 1)) >= MIN_CLIPPED_SAMPLES
        if end != 0.0 and enough and len(inner) and np.mean(steep) > 0.5:
            mask |= Spans(first, last).mask(len(x))
    return spans(mask)


def _running_median(x: Array, size: int) -> Array:
    """Return the running median `(T,)` of `size` samples; the ends of `x (T,)` are repeated."""
    if len(x) > MAX_NUMPY_MEDIAN:
        return np.asarray(scipy.ndimage.median_filter(x, size, mode="nearest"))
    around = sliding_window_view(np.pad(x, size // 2, mode="edge"), size)
    return np.partition(around, size // 2, axis=-1)[:, size // 2]


def _short_spikes(x: Array, width: int, caused: Flags) -> Flags:
    """Mark runs `(T,)` of `width` samples far above or far below the chord of their neighbours."""
    departure = _chord_departure(x, width)
    height = np.maximum(np.maximum(departure.min(axis=0), -departure.max(axis=0)), 0.0)
    min_height = max(MIN_SPIKE_SDS * float(np.std(x)), MIN_DEPARTURE * _median_step(x))
    returns = np.abs(x[width + 1 :] - x[: -width - 1]) < MAX_RETURN_ERROR * height
    mask = np.zeros(len(x), dtype=np.bool_)
    for at in np.flatnonzero(returns & (height > min_height)).tolist():
        first = at + 1
        high = height[at] > MIN_DEPARTURE * _typical_around(height, at, at + 1, width)
        if high and not caused[first - 1 : first + 1].any():
            mask[first : first + width] = True
    return mask


def _median_step(x: Array) -> float:
    """Return the median size of non-zero steps; 0 if there are none."""
    steps = np.abs(np.diff(x))
    return float(np.median(steps[steps > 0])) if steps.any() else 0.0


def _chord_departure(x: Array, width: int) -> Array:
    """Return the departures `(width, T - width - 1)` of samples from the chord of their neighbours."""
    fraction = np.arange(1, width + 1)[:, None] / (width + 1)
    window = sliding_window_view(x, width + 2).T
    return np.asarray(window[1:-1] - window[:1] * (1 - fraction) - window[-1:] * fraction)


def leaves_chord(x: Array, first: int, last: int) -> float:
    """Return the distance of samples `first` to `last` from their chord / the typical distance."""
    if first < 1 or last > len(x) - 2:
        return 0.0
    departure = np.abs(_chord_departure(x, last - first + 1)).max(axis=0)
    typical = float(np.quantile(departure, TYPICAL_QUANTILE))
    return float(departure[first - 1]) / typical if typical > 0 else 0.0


def _typical_around(height: Array, begin: int, end: int, margin: int) -> float:
    """Return the typical `height` before and after the samples from `begin` to `end`."""
    before = height[max(0, begin - AROUND_SPIKE) : max(0, begin - margin)]
    after = height[end + margin : end + AROUND_SPIKE]
    return float(np.quantile(np.r_[before, after], AROUND_QUANTILE))


def _spikes(x: Array, longest: int, caused: Flags) -> Flags:
    away = x - _running_median(x, 4 * longest + 1)
    typical = float(np.quantile(np.abs(away), TYPICAL_QUANTILE))
    typical = max(typical, _median_step(x))
    mask = np.zeros(len(x), dtype=np.bool_)
    if typical == 0.0:
        return mask
    for sign in (1.0, -1.0):
        height = sign * away
        high = spans(height > MIN_LONG_DEPARTURE * typical)
        for first, last in zip(high.first.tolist(), high.last.tolist(), strict=True):
            peak = first + int(np.argmax(height[first : last + 1]))
            begin, end = _foot(height, peak, typical, longest)
            uncaused = not caused[max(0, begin - longest) : peak + 1].any()
            if uncaused and _is_spike(sign * x, height, (begin, peak, end), longest):
                mask[begin : end + 1] = True
    return mask


def _foot(away: Array, peak: int, typical: float, longest: int) -> tuple[int, int]:
    """Return first and last sample of the run around `peak` with departures above `typical`."""
    begin = end = peak
    while begin > 0 and away[begin - 1] > typical and peak - begin <= 2 * longest:
        begin -= 1
    while end < len(away) - 1 and away[end + 1] > typical and end - peak <= 2 * longest:
        end += 1
    return begin, end


def _is_spike(x: Array, away: Array, at: tuple[int, int, int], longest: int) -> bool:
    begin, peak, end = at
    if begin < 1 or end > len(x) - 2:
        return False
    height = away[peak]
    wide = int(np.sum(away[begin : end + 1] > height / 2))
    up = float(np.max(np.diff(x[begin - 1 : peak + 1])))
    down = float(-np.min(np.diff(x[peak : end + 2])))
    around = away[max(0, begin - SWING_WINDOW * longest) : end + SWING_WINDOW * longest + 1]
    return (
        wide <= longest
        and end - begin < 2 * longest
        and down < MAX_SLOPE_RATIO * up
        and up < MAX_SLOPE_RATIO * down
        and -float(np.min(around)) < MAX_SWING * height
        and abs(x[end + 1] - x[begin - 1]) < MAX_RETURN_ERROR * height
    )


MAX_NOISE_RATIO = 0.02  # largest ratio of residual sds of a speed: fit with / without angle steps
MIN_DIFFERENCED_SAMPLES = 50  # least number of samples for comparisons with differences
MAX_FILTER_POLE = 0.95  # largest weight of a filter's last value; 1 would be an integrator


def ambiguous(x: Array, period: float) -> Indices:
    """Return the samples after jumps of nearly half a period, whose direction is unknown."""
    jumps = np.abs(np.diff(x)) / period
    return np.flatnonzero(np.abs(jumps - np.round(jumps)) > 0.5 - WRAP_MARGIN) + 1


def unwrap(x: Array, period: float) -> tuple[Array, int]:
    """Unwrap `x (T,)`: undo each jump of more than half a period, and count the jumps."""
    turns = np.round(np.diff(x) / period)
    return x - period * np.concatenate([[0.0], np.cumsum(turns)]), int(np.sum(turns != 0))


def held_speeds(x: Array, t: Array) -> Array:
    """Return the speeds `(T,)` of an angle that is linear between samples; the last is repeated."""
    speeds = np.diff(x) / np.diff(t)
    return np.append(speeds, speeds[-1:] if len(speeds) else 0.0)


def integrate_speeds(w: Array, t: Array, begin: float) -> Array:
    """Return the angle `(T,)`, from `begin`, of speeds `w (T,)` that are held after each sample."""
    return np.concatenate([[begin], begin + np.cumsum(w[:-1] * np.diff(t))])


def quotients(x: Array, t: Array) -> dict[str, Array]:
    """Return difference quotients `(T - 2,)` of `x (T,)`, at all samples but the first and the last."""
    slopes = np.diff(x) / np.diff(t)
    central = (x[2:] - x[:-2]) / (t[2:] - t[:-2])
    return {"backward": slopes[:-1], "forward": slopes[1:], "central": central}


def nearest_quotient(x: Array, w: Array, t: Array) -> tuple[str, float]:
    """Return name and relative distance of the difference quotient of `x` nearest to `w (T,)`."""
    middle = w[1:-1]
    size = float(np.sqrt(np.mean(middle**2))) or 1.0
    mismatch = {
        kind: float(np.sqrt(np.mean((middle - quotient) ** 2))) / size
        for kind, quotient in quotients(x, t).items()
    }
    kind = min(mismatch, key=lambda name: mismatch[name])
    return kind, mismatch[kind]


def differenced(x: Array, w: Array, dt: float) -> bool:
    """Return whether `w (T,)` consists of (filtered) differences of `x` and was not measured.

    A measured `w`, predicted from its past, has a residual that nearby steps of `x` do not explain.
    """
    if len(x) < MIN_DIFFERENCED_SAMPLES or not np.any(np.diff(w)):
        return False
    step, n, reach = np.diff(x, prepend=x[0]) / dt, len(w), FILTER_REACH

    def lagged(y: Array, lags: range) -> list[Array]:
        return [y[reach - k : n - reach - k] for k in lags]

    (now,) = lagged(w, range(1))
    past = lagged(w, range(1, reach + 1))
    _, alone = linear_fit(now, past)
    factors, both = linear_fit(now, past[:1] + lagged(step, range(-reach, reach + 1)))
    rough = alone > (1e-9 * float(np.ptp(w))) ** 2  # a smaller residual is a rounding error
    return rough and both < MAX_NOISE_RATIO**2 * alone and float(factors[0]) < MAX_FILTER_POLE
