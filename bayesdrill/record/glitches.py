"""Samples that the sensor made, not the rig: spikes, stuck counts, ends of a range.

A spike leaves the signal and comes back to it within `LONGEST` samples, about as fast as it left.  It is
judged against a running median, which keeps steps and follows ramps, and against the largest tenth of
what the signal itself leaves of that median: fast oscillations, quantised speeds, trains of pulses are
their own yardstick.  What only follows a jump of an input is the rig's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LONGEST = (2, 6, 20)  # samples of a spike, by the width of the median it is judged against
HIGH = 6.0  # times the usual departure
USUAL = 0.9  # quantile of departures that is usual
AS_FAST = 3.0  # times: the way back against the way there
SWING = 0.5  # of the height, to the other side: an oscillation, not a spike
BACK = 0.35  # of the height: how near the signal is afterwards to where it was
JUMP = 0.2  # of an input's range within one step
FEWEST = 60  # samples, to judge anything

LONG = 10  # samples of a run of one value, at least
RARE = 0.05  # share of steps that may be zero in a channel that has noise
CLIPPED = 3  # samples of a run at an end of the range, at least
MANY = 10  # of all such samples, at least
STEEP = 2.5  # last digits in a step: so fast no signal turns round


@dataclass(frozen=True, slots=True)
class Spans:
    """Samples `first[j]` to `last[j]`, both ends, of a column."""

    first: NDArray[np.intp]
    last: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.first)

    @property
    def count(self) -> int:
        """Of samples."""
        return int(np.sum(self.last - self.first + 1))

    def mask(self, n: int) -> Mask:
        """`(n,)`."""
        edges = np.zeros(n + 1, dtype=np.intp)
        np.add.at(edges, self.first, 1)
        np.add.at(edges, self.last + 1, -1)
        return np.cumsum(edges)[:n] > 0


def spans(mask: Mask) -> Spans:
    """Runs of what is true."""
    padded = np.concatenate([[False], mask, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    return Spans(edges[::2], edges[1::2] - 1)


def spikes(x: Array, caused: Mask | None = None, *, wide: bool = True) -> Spans:
    """In `x (T,)`, numbers all; `caused (T,)`: samples at which an input has just jumped.

    `wide`: also spikes of more than two samples, which in an input may be meant.
    """
    if len(x) < FEWEST:
        return spans(np.zeros(len(x), dtype=np.bool_))
    found = np.zeros(len(x), dtype=np.bool_)
    for longest in LONGEST if wide else LONGEST[:1]:
        found |= _spikes(x, longest, caused)
    return spans(found)


def stuck(x: Array) -> Spans:
    """The longest run of one value in `x (T,)`, where noise else makes no two samples the same.

    Not where the record begins: there a rig may stand still, switched off.
    """
    same = np.diff(x) == 0
    runs = spans(same)
    lengths = runs.last - runs.first + 1
    if not len(runs):
        return runs
    at = int(np.argmax(lengths))
    first, length = int(runs.first[at]), int(lengths[at]) + 1
    others = len(same) - length + 1
    if length < LONG or first == 0 or np.sum(same) - length + 1 > RARE * others:
        return spans(np.zeros(0, dtype=np.bool_))
    return Spans(np.array([first]), np.array([first + length - 1]))


def saturated(x: Array) -> Spans:
    """Runs of `x (T,)` at exactly its largest or its least value, which it ran into without turning."""
    found = np.zeros(len(x), dtype=np.bool_)
    steps = np.abs(np.diff(x))
    if not np.any(steps):
        return spans(found)
    digit = float(steps[steps > 0].min())
    for end in (float(x.max()), float(x.min())):
        runs = spans(x == end)
        keep = runs.last - runs.first + 1 >= CLIPPED
        first, last = runs.first[keep], runs.last[keep]
        inner = first[first >= 2]
        steep = np.abs(x[inner - 1] - x[inner - 2]) > STEEP * digit
        enough = len(first) >= 2 and int(np.sum(last - first + 1)) >= MANY
        if end != 0.0 and enough and len(inner) and np.mean(steep) > 0.5:
            found |= Spans(first, last).mask(len(x))
    return spans(found)


def _spikes(x: Array, longest: int, caused: Mask | None) -> Mask:
    from scipy.ndimage import median_filter

    away = x - median_filter(x, 4 * longest + 1, mode="nearest")
    steps = np.abs(np.diff(x))
    moved = steps[steps > 0]
    usual = max(
        float(np.quantile(np.abs(away), USUAL)), float(np.median(moved)) if len(moved) else 0.0
    )
    mask = np.zeros(len(x), dtype=np.bool_)
    if usual == 0.0:
        return mask
    for sign in (1.0, -1.0):
        one = sign * away
        high = spans(one > HIGH * usual)
        for first, last in zip(high.first.tolist(), high.last.tolist(), strict=True):
            peak = first + int(np.argmax(one[first : last + 1]))
            begin, end = _foot(one, peak, usual, longest)
            if _is_spike(sign * x, one, (begin, peak, end), longest) and not (
                caused is not None and caused[max(0, begin - longest) : peak + 1].any()
            ):
                mask[begin : end + 1] = True
    return mask


def _foot(away: Array, peak: int, usual: float, longest: int) -> tuple[int, int]:
    """The samples around `peak` that are unusually far out."""
    begin = end = peak
    while begin > 0 and away[begin - 1] > usual and peak - begin <= 2 * longest:
        begin -= 1
    while end < len(away) - 1 and away[end + 1] > usual and end - peak <= 2 * longest:
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
    around = away[max(0, begin - longest) : end + longest + 1]
    return (
        wide <= longest
        and end - begin < 2 * longest
        and 1 / AS_FAST < down / up < AS_FAST
        and -float(np.min(around)) < SWING * height
        and abs(x[end + 1] - x[begin - 1]) < BACK * height
    )
