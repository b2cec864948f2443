"""Describe the source of the coming experiment: its waveform is a vector of held levels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import Issue
from bayesdrill.record.experiment import raise_if_any, times

MAX_LEVELS = 200  # largest number of levels of a waveform; memory grows with its square
LEAST_MOTION = 0.05  # fraction of its range that a source must be able to cross within the record
MAX_SAMPLES = 20_000  # largest number of samples, which bounds the memory of sensitivities


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceLimits:
    """A source drives `input` between `low` and `high` (SI), and holds each level for `hold` [s].

    The record lasts `duration` [s] at `rate` [Hz].  Levels change by at most `slew` times the hold
    time, also from zero to the first level.
    """

    input: str
    low: float
    high: float
    hold: float
    duration: float
    rate: float
    slew: float = math.inf

    @property
    def samples_of_level(self) -> int:
        """Return the number of samples for which a level is held."""
        return max(1, round(self.hold * self.rate))

    @property
    def interval(self) -> float:
        """Return the time for which a level is held [s], a whole number of samples."""
        return self.samples_of_level / self.rate

    @property
    def count(self) -> int:
        """Return the number of levels."""
        return max(1, round(self.duration * self.rate / self.samples_of_level))

    @property
    def t(self) -> Array:
        """Return the times of the record, `(T,)`."""
        return times(self.count * self.interval, self.rate)

    def series(self, levels: Array) -> Array:
        """Return the input `(..., T)` with `levels (..., S)` at the times of the record."""
        held = np.arange(self.count * self.samples_of_level + 1) // self.samples_of_level
        return np.asarray(levels[..., np.minimum(held, self.count - 1)])

    def nearest_levels(self, levels: Array) -> Array:
        """Return the nearest levels that the source can reach, each from the level before."""
        step, before, out = self.slew * self.interval, 0.0, np.clip(levels, self.low, self.high)
        if step < math.inf:
            for k, level in enumerate(out):
                before = out[k] = np.clip(level, before - step, before + step)
        return np.clip(out, self.low, self.high)

    def check(self) -> None:
        """Raise `InputError` with all contradictions between the numbers of the source."""
        levels_of = {"--low": self.low, "--high": self.high}
        positive = {"--duration": self.duration, "--rate": self.rate, "--slew": self.slew}
        if 0 < self.duration < math.inf:  # the default hold time depends on the duration
            positive["--hold"] = self.hold
        wrong = [
            Issue(option, f"levels must be finite, not {level:g}; give a number in SI")
            for option, level in levels_of.items()
            if not math.isfinite(level)
        ]
        wrong += [
            Issue(option, f"must be positive and finite, not {number:g}")
            for option, number in positive.items()
            if not 0 < number < math.inf and (option, number) != ("--slew", math.inf)
        ]
        raise_if_any(wrong)
        levels, samples = self.count, self.count * self.samples_of_level
        moved, width = self.slew * self.duration, self.high - self.low
        rules = [
            (
                "--low",
                width <= 0,
                f"{self.low:g} is not below --high {self.high:g}; give a wider range",
            ),
            (
                "--hold",
                2 * self.hold > self.duration,
                f"a source that holds each level for {self.hold:g} s cannot change within "
                f"{self.duration:g} s; shorten it, or give a longer --duration",
            ),
            (
                "--hold",
                self.hold * self.rate < 1 - 1e-9,
                f"{self.hold:g} s are shorter than a sample at {self.rate:g} Hz; hold longer",
            ),
            (
                "--slew",
                moved < max(LEAST_MOTION * width, self.low, -self.high),
                f"the source is too slow: it only moves by {moved:g} in {self.duration:g} s",
            ),
            ("--hold", levels > MAX_LEVELS, f"{levels} levels exceed {MAX_LEVELS}; hold longer"),
            ("--rate", samples > MAX_SAMPLES, f"{samples} samples exceed {MAX_SAMPLES}; lower it"),
        ]
        raise_if_any([Issue(option, message) for option, broken, message in rules if broken])
