"""Define an experiment: a checked record in SI, with its inputs and its initial state."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesdrill.basics.arrays import PART, Array, Flags, Indices
from bayesdrill.basics.entries import SMALLEST
from bayesdrill.basics.errors import InputError, Issue, count_noun
from bayesdrill.basics.symbols import INPUTS, Symbol
from bayesdrill.basics.units import SECOND, Unit

EARLIEST_DAY, LATEST_DAY = 20_000, 800_000  # range of Excel's and MATLAB's numbers for recent days
MAX_REPEATED_TIMES = 0.1  # fraction of zero steps above which times have too few digits
MAX_VALUE = 1e40  # allows 9.91e37, SCPI's NaN, which may be masked as a glitch
STEP_TOLERANCE = 1e-3  # largest deviation of a step, or of a time from its grid, in median steps


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """A channel is a measured linear combination of states; `unit` is SI, `latex` without dollars.

    `column` is the unit of the column in the file, if known; `factor` converts this unit to SI.
    """

    name: str
    weights: Mapping[str, float]
    unit: str
    latex: str
    latex_unit: str
    column: Unit | None = None
    factor: float = 1.0

    @property
    def display_unit(self) -> Unit:
        """Return the unit in which the channel is displayed."""
        return self.column or Unit(self.unit, 1.0, self.latex_unit)


@dataclass(frozen=True, slots=True)
class Written:
    """A record is read from `files`; `time` and `inputs` hold the units for display."""

    files: tuple[str, ...] = ()
    time: Unit = SECOND
    inputs: Mapping[str, Unit] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Anomaly:
    """An anomaly has a `text`, the `positions` of its samples, and an `advice`."""

    text: str
    positions: tuple[str, ...]
    advice: str = ""

    def in_words(self, max_positions: int) -> str:
        """Return a description that lists at most `max_positions` positions."""
        if not self.positions:
            return f"{self.text}{self.advice}"
        more_places = len(self.positions) - max_positions
        more = f" and {more_places} more" if more_places > 0 else ""
        return f"{self.text}: {'; '.join(self.positions[:max_positions])}{more}{self.advice}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Experiment:
    """An experiment holds a record in SI, its inputs and its start.

    Times `t (T,)` are the increasing times of all clocks. Signals `y (T, K)` have a column for each
    channel, with NaN if a sample is missing. Inputs are `constant`, or a measured `series (T,)`
    with a first- or zero-order hold. `start` has states at `t_start <= t[0]`; all others are zero.
    `notes` lists changes that were made to numbers of the files. Samples in
    `held_out (T, K)`, which is NaN elsewhere, do not enter the likelihood. `input_steps` has the
    median step [s] of each series; the default is `dt`.
    """

    t: Array
    y: Array
    channels: tuple[Channel, ...]
    constant: Mapping[str, float]
    series: Mapping[str, Array]
    first_order: bool
    start: Mapping[str, float]
    t_start: float
    notes: tuple[str, ...] = ()
    anomalies: tuple[Anomaly, ...] = ()
    held_out: Array | None = None
    input_steps: Mapping[str, float] = field(default_factory=dict)
    written: Written = field(default_factory=Written)
    input_symbols: Mapping[str, Symbol] = field(default_factory=lambda: dict(INPUTS))

    @property
    def dt(self) -> float:
        """Return the time step [s]; the median step if steps differ."""
        if self.uniform:
            return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))
        return float(np.median(np.diff(self.t)))

    @property
    def lead(self) -> float:
        """Return the time [s] from the initial state to the first sample."""
        return float(self.t[0] - self.t_start)

    @property
    def uniform(self) -> bool:
        """Return whether all steps are equal within `STEP_TOLERANCE` steps."""
        return is_even(self.t)

    def first(self, samples: int) -> Experiment:
        """Return the experiment with only its first `samples` times."""
        here = slice(0, samples)
        return dataclasses.replace(
            self,
            t=frozen(self.t[here]),
            y=frozen(self.y[here]),
            series={name: frozen(u[here]) for name, u in self.series.items()},
            held_out=None if self.held_out is None else frozen(self.held_out[here]),
        )

    @property
    def is_measured(self) -> Flags:
        """Return a mask `(T, K)` of the samples that were measured."""
        return ~np.isnan(self.y)

    def weights(self, states: Sequence[str]) -> Array:
        """Return the weights `(K, X)` of `states` in each channel."""
        rows = [[c.weights.get(name, 0.0) for name in states] for c in self.channels]
        return np.array(rows, dtype=np.float64)

    @property
    def counts(self) -> tuple[int, ...]:
        """Return the number of samples of each channel."""
        return tuple(int(n) for n in self.is_measured.sum(axis=0))

    def unit_of_input(self, name: str) -> Unit:
        """Return the unit in which an input is displayed."""
        known, symbol = self.written.inputs.get(name), self.input_symbols[name]
        return known or Unit(symbol.unit, 1.0, symbol.latex_unit)

    @property
    def drives(self) -> frozenset[str]:
        """Return the names of inputs without which a rig would stand still."""
        return frozenset(name for name, symbol in self.input_symbols.items() if symbol.drives)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the channels."""
        return tuple(channel.name for channel in self.channels)


def is_even(t: Array) -> bool:
    """Return whether `t (T,)` has equal steps or is on a grid, within `STEP_TOLERANCE` steps."""
    if len(t) < 3:
        return True
    step = (t[-1] - t[0]) / (len(t) - 1)
    median = float(np.median(np.diff(t), overwrite_input=True))
    uneven = adrift = False
    for first in range(0, len(t), PART):
        part = t[first : first + PART + 1]
        here = np.arange(first, first + len(part))
        uneven |= bool((np.abs(np.diff(part) - median) > STEP_TOLERANCE * median).any())
        adrift |= bool((np.abs(part - (t[0] + here * step)) > STEP_TOLERANCE * median).any())
    return not (uneven and adrift)


def with_states(
    experiment: Experiment, states: Sequence[str], *, alone: bool = False
) -> Experiment:
    """Return the experiment with a zero channel per state, after its own channels or `alone`."""
    shown = tuple(
        Channel(name=f"state {name}", weights={name: 1.0}, unit="", latex="", latex_unit="")
        for name in states
    )
    channels = shown if alone else (*experiment.channels, *shown)
    return dataclasses.replace(
        experiment, channels=channels, y=np.zeros((len(experiment.t), len(channels)))
    )


def channels_first(experiment: Experiment, states: Sequence[str], rig_states: Array) -> Array:
    """Return error-free channels, computed from `rig_states (..., X)`, and then the states.

    A kernel that computes only states thus serves all channels.
    """
    with np.errstate(all="ignore"):  # a state may overflow
        channels = rig_states @ experiment.weights(tuple(states)).T
    return np.concatenate([channels, rig_states], axis=-1)


def frozen(values: Array) -> Array:
    """Return a contiguous read-only copy."""
    copy = np.array(values, dtype=np.float64, order="C")
    copy.setflags(write=False)
    return copy


def times(duration: float, rate: float) -> Array:
    """Return times from 0 to `duration` [s], including both ends, at `rate` [Hz]."""
    return np.arange(round(duration * rate) + 1) / rate


def check_series(
    location: str,
    label: str,
    values: Array,
    position_of: Callable[[int], str],
    *,
    varying: bool,
    missing: bool = False,
    instead: str = "",
) -> list[Issue]:
    """Check that numbers are present and not too large, and that they vary if `varying` is true.

    NaN is allowed if `missing`. The limit `MAX_VALUE` keeps fourth powers finite.
    Messages begin with `label`; `instead` is an alternative to their advice.
    """
    bad = np.flatnonzero(np.isinf(values) if missing else ~np.isfinite(values))
    beyond = np.flatnonzero(np.abs(values) > MAX_VALUE)
    numbers = values[~np.isnan(values)]
    width = float(np.ptp(numbers)) if len(numbers) and not len(bad) else 0.0
    if len(bad):
        count = f"{count_noun(len(bad), 'value')} without a number, {_rows(bad, position_of)}"
        message = f"{label} has {count}; correct or cut these rows{instead}"
        if missing:
            count = f"{count_noun(len(bad), 'infinite value')}, {_rows(bad, position_of)}"
            message = f"{label} has {count}; correct, mask or cut these rows"
    elif varying and len(values) and not len(numbers):
        message = f"{label} has no number that is used; check missing samples, masks and windows"
    elif len(beyond):
        count = f"{count_noun(len(beyond), 'number')} beyond {MAX_VALUE:g}, {_rows(beyond, position_of)}"
        message = f"{label} has {count}; correct or cut these rows"
    elif 0 < width < SMALLEST:
        message = f"{label} varies by only {width:.3g}; check the column"
    elif varying and len(numbers) > 1 and width == 0:
        flat = f"{label} is {numbers[0]:g} in every row: a constant channel carries no information"
        message = f"{flat}; check the column, or leave the channel out"
    else:
        return []
    return [Issue(location, message)]


def check_time(location: str, t: Array, position_of: Callable[[int], str]) -> list[Issue]:
    """Check that times increase; steps need not be equal."""
    problems = check_series(location, "time", t, position_of, varying=False)
    if problems or len(t) < 2:
        return problems
    steps = np.diff(t)
    back = np.flatnonzero(steps <= 0)
    if len(back):
        first = back[0] + 1
        pair = f"{t[first - 1]:.10g} s is followed by {t[first]:.10g} s; {_why_back(t, steps)}"
        return [Issue(location, f"time does not increase, {_rows(back + 1, position_of)}: {pair}")]
    if steps.min() < SMALLEST:
        message = f"time has steps of {steps.min():.3g} s; check the column and its unit"
        return [Issue(location, message)]
    if not is_even(t) and calendar_hint(t):
        return [Issue(location, f"time steps are not equal{calendar_hint(t)}")]
    return []


def _why_back(t: Array, steps: Array) -> str:
    back = steps <= 0
    if np.mean(steps == 0) > MAX_REPEATED_TIMES:
        way_out = "write time: {rate: ...} instead of the column, or export more digits"
        why = "many times are repeated, so they seem to be rounded to too few digits"
        return f"{why}: {way_out}{calendar_hint(t)}"
    if np.all(steps < 0):
        return "each row is earlier than the one before: turn the rows around, or check the column"
    if np.sum(back) == 1 and t[np.argmax(back) + 1] <= t[0]:
        return "a second recording seems to begin there: cut it off by `record.rows`, or remove it"
    return "sort the rows, remove repeated ones, or check the column and unit"


def calendar_hint(t: Array) -> str:
    """Return a hint if times may be days of a calendar, else an empty text."""
    if EARLIEST_DAY < t[0] < LATEST_DAY and t[-1] - t[0] < 1:
        days = f"numbers like {t[0]:.6g} may be days of a calendar (Excel, MATLAB's datenum)"
        return f"; {days}: save seconds since the start, or give time: {{rate: ...}}"
    return ""


def check_length(location: str, counts: Sequence[int], n_unknown: int) -> list[Issue]:
    """Check that there are more samples than unknowns, and that some channel has two samples."""
    if max(counts) >= 2 and sum(counts) > n_unknown:
        return []
    length = f"{count_noun(max(counts), 'sample')} of {count_noun(len(counts), 'channel')}"
    message = f"{length} cannot determine {count_noun(n_unknown, 'unknown')}"
    return [Issue(location, f"{message}; use a longer record or fix parameters")]


def raise_if_any(problems: list[Issue]) -> None:
    """Raise an `InputError` with all problems, if there are any."""
    if problems:
        raise InputError(problems)


def _rows(indices: Indices, position_of: Callable[[int], str]) -> str:
    named = ", ".join(position_of(int(index)) for index in indices[:5])
    more = f" and {len(indices) - 5} more" if len(indices) > 5 else ""
    return f"at {named}{more}"


def typical_inputs(experiment: Experiment) -> dict[str, float]:
    """Return typical inputs in SI: the root mean square of driving inputs, the mean of others."""
    sizes, drives = dict(experiment.constant), experiment.drives
    for name, series in experiment.series.items():
        size = np.sqrt(np.mean(series**2)) if name in drives else np.mean(series)
        sizes[name] = float(size)
    return sizes | {name: abs(sizes[name]) or 1.0 for name in drives if name in sizes}
