"""Lines of `record:` and `inputs:`, with the numbers of sensors that nobody has told."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.record import clocks
from bayesdrill.setup.guessing import lags
from bayesdrill.setup.guessing.comments import comment, review, scalar
from bayesdrill.setup.guessing.drafts import Sensor
from bayesdrill.setup.guessing.lags import Lag
from bayesdrill.setup.guessing.names import TWIST
from bayesdrill.setup.guessing.roles import WIDE, Channel
from bayesdrill.setup.guessing.several import Experiment, Experiments
from bayesdrill.setup.guessing.start import Start
from bayesdrill.setup.guessing.timing import Timing

SUPPLY = 0.02  # of its largest value, that a measured voltage may be off by: sd


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """All that a config says: `starts` by experiment; `name`: of a file, as the config has it."""

    those: Experiments
    starts: Mapping[str, Start]
    lag: Lag | None
    voltage: float | None
    name: Callable[[Path], str]

    @property
    def several(self) -> bool:
        return len(self.those.every) > 1

    @property
    def lead(self) -> Experiment:
        return self.those.lead

    @property
    def channels(self) -> Sequence[Channel]:
        return self.lead.of.found.channels

    @property
    def dt(self) -> float:
        """The longest step, s."""
        return max(
            file.part.dt for one in self.those.every for file in (one.of, one.inputs) if file
        )

    @property
    def measured(self) -> bool:
        """Whether an input varies: a column, and not a number."""
        every = [one.of.found for one in self.those.every]
        v = self.voltage is None and any(one.v is not None and one.v.varies for one in every)
        return v or any(one.t_1 is not None for one in every)

    def of(self, name: str) -> list[tuple[str, Sensor]]:
        """The sensors of one channel, with the experiments' names."""
        return [
            (one.label, c.sensor)
            for one in self.those.every
            for c in one.of.found.channels
            if c.name == name
        ]


def record(found: Found) -> list[str]:
    missing = [one for c in found.channels for _, one in found.of(c.name) if one.raw.missing]
    start = found.starts[found.lead.label]
    alone = [] if found.several else [f"  file: {scalar(found.name(found.lead.of.path))}"]
    return [
        "record:",
        *alone,
        *_time(found),
        *([] if found.several else window(start)),
        *(_missing(missing) if missing else ()),
        "  channels:",
        *(line for one in found.channels for line in _channel(found, one)),
        *_left_out(found.lead.of.left_out),
    ]


def address(sensor: Sensor) -> str:
    return ", ".join(f"{key}: {scalar(value)}" for key, value in sensor.seen.address.items())


def time_entry(time: Timing) -> str:
    if time.column is None:
        return f"time: {{rate: {time.rate:.6g}}}"
    where = ", ".join(f"{key}: {scalar(value)}" for key, value in time.column.address.items())
    return f"time: {{{where}, unit: {time.unit}}}"


def _time(found: Found) -> list[str]:
    time, doubts = found.lead.of.time, [found.lead.of.time.doubt]
    if time.column is None:
        return [*review(doubts, 2), f"  {time_entry(time)}"]
    uneven = [_uneven(one.of.part.t) for one in found.those.every]
    rate = next((said for said in uneven if said), f"{time.rate:.6g} samples a second")
    said = f"{rate}, {time.why}" if time.why else rate
    return [*comment(said, 2), *review(doubts, 2), f"  {time_entry(time)}"]


def _uneven(t: np.ndarray) -> str:
    said = clocks.in_words(clocks.on_grid(t))
    odd = "missing in" in said or "unequal" in said
    return f"{said}; they are used as they are, and nothing is resampled" if odd else ""


def window(start: Start) -> list[str]:
    if start.window is None:
        return []
    return [*review([start.window_doubt], 2), f"  window: {span(start)}    # s"]


def span(start: Start) -> str:
    low, high = (f"{one:.12g}" for one in start.window or (0.0, 0.0))
    return f"[{low}, {high}]"


def _missing(those: Sequence[Sensor]) -> list[str]:
    names = ", ".join(dict.fromkeys(one.name for one in those))
    doubt = f"samples without a number, of {names}, are left out, each of its own channel alone"
    return [*review([doubt], 2), "  missing: drop"]


def _channel(found: Found, one: Channel) -> list[str]:
    sensor, every = one.sensor, found.of(one.name)
    noise = [other.noise for _, other in every]
    entries = [address(sensor), f"unit: {scalar(sensor.unit)}"]
    if one.measures:
        entries.append(f"measures: {one.measures}")
    doubts, more = _as_it_came(every, counted=not one.derived)
    late_doubt, late = _lag(found, one)
    zero_doubt, zero = _zero(found, one)
    head = [*(line for why in sensor.why for line in comment(why, 4)), *review(sensor.doubts, 4)]
    if one.derived:
        doubt = (
            f"it is made of differences of {one.derived}, and would count the same numbers twice"
        )
        more, last = [*more, f"derived_from: {one.derived}"], "sigma: 1    # means nothing here"
        return [
            *head,
            *review([*doubts, doubt], 4),
            f"    {one.name}: {{{', '.join([*entries, *more])},",
            f"      {last.partition('    ')[0]}}}{last.partition('sigma: 1')[2]}",
        ]
    low, high = f"{min(noise) / WIDE:.3g}", f"{max(noise) * WIDE:.3g}"
    told = f"the noise is not said; {_from_to(noise)} {sensor.unit} differ from sample to sample"
    return [
        *head,
        *review([*doubts, late_doubt, zero_doubt, told], 4),
        *_slow(found, one, late),
        f"    {one.name}: {{{', '.join([*entries, *more])},",
        *(f"      {entry}," for entry in (late, zero) if entry),
        f"      sigma: {{prior: log_uniform, low: {low}, high: {high}}}}}",
    ]


def _from_to(numbers: Sequence[float]) -> str:
    low, high = f"{min(numbers):.3g}", f"{max(numbers):.3g}"
    return low if low == high else f"{low} to {high}"


def _as_it_came(
    every: Sequence[tuple[str, Sensor]], *, counted: bool
) -> tuple[list[str], list[str]]:
    """What masks and turns it needs: doubts and entries."""
    doubts, entries = [], []
    spiky = [(label, one.raw.glitches) for label, one in every if one.raw.glitches]
    if spiky and counted:
        count = ", ".join(f"{n} in {label}" if label else f"{n}" for label, n in spiky)
        doubts.append(
            f"samples that leave its course and are back at once, {count}, look like the sensor's, and "
            "are not used; a real impact looks alike"
        )
        entries.append("mask: glitches")
    period = max(one.raw.wraps for _, one in every)
    if period:
        doubts.append(f"it begins again after {period:.6g}, and is unwrapped")
        entries.append(f"wraps: {period:.10g}")
    return doubts, entries


def _lag(found: Found, one: Channel) -> tuple[str, str]:
    """An unknown lag where columns hint at one."""
    hint = found.lag
    if hint is None or hint.of != one.name:
        return "", ""
    ms = 1e3 * hint.samples * found.lead.of.part.dt
    doubt = (
        f"it seems to be {ms:.2g} ms late: so rotor 1's own law leaves {100 * hint.left:.2g} % of the "
        f"twist unexplained, else {100 * hint.before:.2g} %; how late is an unknown (damping "
        "in the shaft looks alike)"
    )
    return doubt, f"lag: {_late(found, hint.samples)}"


def _late(found: Found, samples: float) -> str:
    most = 1e3 * lags.wide(samples, found.lead.of.part.dt)
    return f"{{prior: uniform, low: 0, high: {most:.6g}, unit: ms}}"


def _slow(found: Found, one: Channel, late: str) -> list[str]:
    """A lag to be thought of, where nothing hints at one."""
    if late or one.sensor.place != TWIST:
        return []
    said = "nothing hints at a delay; if its electronics is slower than that of the others, add"
    return [*comment(said, 4), f"    #   lag: {_late(found, 0.0)}"]


def _zero(found: Found, one: Channel) -> tuple[str, str]:
    every = [start.zeros.get(one.name, 0.0) for start in found.starts.values()]
    if not any(every):
        return "", ""
    doubt = "at rest, but not at zero: where it counts from is an unknown"
    return doubt, f"offset: {{prior: normal, mean: 0, sd: {max(every):.2g}}}"


def _left_out(left_out: Mapping[str, str]) -> list[str]:
    if not left_out:
        return []
    because: dict[str, list[str]] = {}
    for name, why in left_out.items():
        because.setdefault(why, []).append(name)
    rows = [
        line
        for why, names in because.items()
        for line in comment(f"- {'; '.join(names)}: {why}", 2)
    ]
    return ["  # Not used:", *rows]
