"""Lines of a draft's `record:` and `inputs:`, with the numbers of sensors, their comments and
reasons.
"""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import printable
from bayesdrill.drafting import roles
from bayesdrill.drafting.columns import TWIST, Seen
from bayesdrill.drafting.record_files import Experiment
from bayesdrill.drafting.roles import WIDE, Channel, Lag, Start
from bayesdrill.drafting.signals import Sensor, Timing
from bayesdrill.record import clocks

REVIEW = "REVIEW: "
WIDTH = 110
_PLAIN = re.compile(r"(?![-\d%/]|\.(?!\.?/))[\w./%°-]+(?: [\w./%°-]+)*", re.ASCII)
_KEPT = "\x1f"  # a blank in code, at which no line is broken
_WORDS = {"yes", "no", "on", "off", "true", "false", "null", "y", "n"}


def scalar(value: str | int | float) -> str:
    if not isinstance(value, str):
        return f"{value:.6g}" if isinstance(value, float) else str(value)
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return json.dumps(value, ensure_ascii=False)


def comment(text: str, indent: int = 0) -> list[str]:
    whole = re.sub("`[^`]*`", lambda code: code[0].replace(" ", _KEPT), printable(text))
    lead = " " * indent + "# "
    lines = textwrap.wrap(
        whole, WIDTH, initial_indent=lead, subsequent_indent=lead, break_on_hyphens=False
    )
    return [line.replace(_KEPT, " ") for line in lines]


def review(doubts: Iterable[str], indent: int) -> list[str]:
    return [line for one in doubts if one for line in comment(REVIEW + one, indent)]


SUPPLY = 0.02  # of its largest value, that a measured voltage may be off by: sd


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """All that a config says: `every` experiment, each understood as `lead` is, `starts` by label;
    `name`: of a file, as the config has it.
    """

    every: tuple[Experiment, ...]
    lead: Experiment
    starts: Mapping[str, Start]
    lag: Lag | None
    voltage: float | None
    name: Callable[[Path], str]

    @property
    def several(self) -> bool:
        return len(self.every) > 1

    @property
    def channels(self) -> Sequence[Channel]:
        return self.lead.of.found.channels

    @property
    def dt(self) -> float:
        """The longest step, s: of measured inputs, or where there are none of channels."""
        inputs = [(one.of, s) for one in self.every for s in one.of.found.inputs.values()]
        files = [of.file_of(sensor) for of, sensor in inputs] or [one.of for one in self.every]
        return max(file.part.dt for file in files)

    @property
    def measured(self) -> bool:
        """Whether an input varies: a column, and not a number."""
        inputs = [pair for one in self.every for pair in one.of.found.inputs.items()]
        return any(name != "v" or (self.voltage is None and one.varies) for name, one in inputs)

    def of(self, name: str) -> list[tuple[str, Sensor]]:
        """The sensors of one channel, with the experiments' names."""
        return [
            (one.label, c.sensor)
            for one in self.every
            for c in one.of.found.channels
            if c.name == name
        ]


def record_entries(found: Found) -> list[str]:
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


def address(column: Seen) -> str:
    return ", ".join(f"{key}: {scalar(value)}" for key, value in column.address.items())


def reasons(sensor: Sensor, indent: int) -> list[str]:
    """Comments above its entry: what is known of it, and what is to be looked at."""
    known = [line for why in sensor.why for line in comment(why, indent)]
    return [*known, *review(sensor.doubts, indent)]


def time_entry(time: Timing) -> str:
    if time.column is None:
        return f"time: {{rate: {time.rate:.6g}}}"
    return f"time: {{{address(time.column)}, unit: {time.unit}}}"


def _time(found: Found) -> list[str]:
    time, doubts = found.lead.of.time, [found.lead.of.time.doubt]
    if time.column is None:
        return [*review(doubts, 2), f"  {time_entry(time)}"]
    every = [_uneven(one.of.part.t) for one in found.every]
    even = ", ".join(one for one in (f"{time.rate:.6g} samples a second", time.why) if one)
    said = next((uneven for uneven in every if uneven), even)
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
    entries = [*file_entries(found, sensor), address(sensor.seen), f"unit: {scalar(sensor.unit)}"]
    if one.measures:
        entries.append(f"measures: {one.measures}")
    doubts, more = _as_it_came(every, counted=not one.derived)
    late_doubt, late = _lag(found, one)
    zero_doubt, zero = _zero(found, one)
    head = reasons(sensor, 4)
    if one.derived:
        doubt = (
            f"it is made of differences of {one.derived}, and would count the same numbers twice"
        )
        more = [*more, f"derived_from: {one.derived}"]
        return [
            *head,
            *review([*doubts, doubt], 4),
            f"    {one.name}: {{{', '.join([*entries, *more])},",
            "      sigma: 1}    # means nothing here",
        ]
    spread = max(float(np.std(other.raw.x)) for _, other in every)
    low, high = f"{min(noise) / WIDE:.3g}", f"{max(max(noise) * WIDE, spread):.3g}"
    least, most = f"{min(noise):.3g}", f"{max(noise):.3g}"
    size = least if least == most else f"{least} to {most}"
    told = (
        f"the noise is not said; {size} {sensor.unit} differ from sample to sample, and the channel "
        f"spreads by {spread:.3g}: what the model leaves is in between"
    )
    return [
        *head,
        *review([*doubts, late_doubt, zero_doubt, told], 4),
        *_slow(found, one, late),
        f"    {one.name}: {{{', '.join([*entries, *more])},",
        *(f"      {entry}," for entry in (late, zero) if entry),
        f"      sigma: {{prior: log_uniform, low: {low}, high: {high}}}}}",
    ]


def _as_it_came(
    every: Sequence[tuple[str, Sensor]], *, counted: bool
) -> tuple[list[str], list[str]]:
    """What looks like glitches, and what turns it needs: doubts and entries."""
    doubts, entries = [], []
    if counted:
        doubts += [text for label, one in every if (text := _glitches(label, one))]
    period = max(one.raw.wraps for _, one in every)
    if period:
        doubts.append(f"it begins again after {period:.6g}, and is unwrapped")
        entries.append(f"wraps: {period:.10g}")
    return doubts, entries


MOST = 8  # glitches that are named


def _glitches(label: str, one: Sensor) -> str:
    """Where they are, and how they are masked; nothing is by itself."""
    times = one.raw.glitches
    if not times:
        return ""
    spans_ = ", ".join(f"[{begin:.9g}, {end:.9g}]" for begin, end in times[:MOST])
    more = len(times) - MOST
    entry = f"mask: {{times: [{spans_}]}}" if more <= 0 else "mask: glitches"
    at = f"{spans_} s" + (f" and {more} more" if more > 0 else "")
    where = f" in {label}" if label else ""
    return (
        f"looks like glitches{where}: {at}. The signal leaves its course and comes back, and no other "
        f"channel goes with it. Nothing is masked; if it is the sensor's, add `{entry}`"
    )


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
    most = 1e3 * roles.wide(samples, found.lead.of.part.dt)
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


UNKNOWN = "  # v: 8.0"  # to be written by the user


def input_entries(found: Found) -> list[str]:
    rig = found.lead.of.found.rig
    lines = _voltage(found) if "v" in rig.inputs else []
    for name in ("t_m", "w_2"):
        lines += _drive(found, name) if name in rig.inputs else []
    lines += _load(found) if "t_1" in rig.inputs else []
    return ["inputs:", *lines, *_moment(found)]


def constant_input(found: Found) -> dict[str, str]:
    """The voltage of each experiment that has a constant one of its own."""
    every = {one.label: one.of.found.v for one in found.every}
    if found.voltage is not None or any(v is None or v.varies for v in every.values()):
        return {}
    return {
        label: f"{{value: {v.raw.x[0]:.6g}, unit: {v.unit}}}"
        for label, v in every.items()
        if v is not None
    }


def _voltage(found: Found) -> list[str]:
    v = found.lead.of.found.v
    if found.voltage is not None:
        return [f"  v: {found.voltage:.6g}    # V, as it was given, constant from the start on"]
    if v is None:
        doubt = (
            "no column is a voltage. Write the supply here, in V: a number if it was constant, else "
            "`{column: ..., unit: V, hold: zero}`; `bayesdrill check` asks for it. If the motion of the "
            "gearbox was imposed, say `--rig driven_shaft`; if a torque drives it, `--rig motor`"
        )
        return [*review([doubt], 2), UNKNOWN]
    head = reasons(v, 2)
    if known := constant_input(found):
        doubt = f"{v.name} is the same in every row, taken as there from the start on"
        return [*head, *review([doubt], 2), f"  v: {known[found.lead.label]}"]
    hold = (
        "between samples it is taken as it was (zero); a supply that moves smoothly needs `first`"
    )
    largest = max(
        float(abs(one.of.found.v.raw.x).max()) for one in found.every if one.of.found.v is not None
    )
    off = f"what the motor gets may differ from it: an unknown, {100 * SUPPLY:g} % of its largest value"
    return [
        *head,
        *review([hold, off], 2),
        *_column(found, "v", v),
        f"      offset: {{prior: normal, mean: 0, sd: {SUPPLY * largest:.2g}}}}}",
    ]


def _drive(found: Found, name: str) -> list[str]:
    """What moves a rig without a voltage: a torque at the motor, or a motion that is imposed."""
    inputs = found.lead.of.found.inputs
    entries = roles.IMPOSED if name == "w_2" else (name,)
    of = next((one for one in entries if one in inputs), "")
    if of:
        return [*reasons(inputs[of], 2), *_closed(_column(found, of, inputs[of]))]
    what = "torque at the motor [N m]" if name == "t_m" else "speed or angle of the upper end"
    doubt = f"no column is the {what}: taken as zero; name it by `--columns`, or write it here"
    return [*review([doubt], 2), f"  {name}: 0.0"]


def _load(found: Found) -> list[str]:
    t_1 = found.lead.of.found.inputs.get("t_1")
    if t_1 is None:
        return ["  t_1: 0.0    # N m, load on rotor 1: no column is one"]
    return [*reasons(t_1, 2), *_closed(_column(found, "t_1", t_1))]


def _closed(lines: list[str]) -> list[str]:
    return [f"{line.removesuffix(',')}}}" for line in lines]


def _column(found: Found, name: str, like: Sensor) -> list[str]:
    """Without its end."""
    entries = [*file_entries(found, like), address(like.seen), f"unit: {scalar(like.unit)}"]
    if like.kind != "angle":
        entries.append("hold: zero")
    if like.raw.wraps:
        entries.append(f"wraps: {like.raw.wraps:.10g}")
    if any(one.of.found.inputs[name].raw.missing for one in found.every):
        entries.append("missing: hold")
    return [f"  {name}: {{{', '.join(entries)},"]


def file_entries(found: Found, sensor: Sensor) -> list[str]:
    """Of a column that stands in another file than the others."""
    lead = found.lead.of
    if not sensor.seen.file:
        return []
    file = lead.file_of(sensor)
    time = time_entry(file.time)
    path = [] if found.several else [f"file: {scalar(found.name(file.path))}"]
    return [*path, *([time] if time != time_entry(lead.time) else [])]


def _moment(found: Found) -> list[str]:
    """Unknown within a sample; of a constant voltage that was there before, there is none."""
    starts: Sequence[Start] = list(found.starts.values())
    if not found.measured and any(one.state for one in starts):
        return []
    before, after = (max(one.switched[k] for one in starts) * found.dt for k in (0, 1))
    doubt = (
        "when it acts is known to one sample at best, and an error of half a one shifts j_m by many "
        "standard deviations: an unknown"
    )
    entry = f"  t_0: {{prior: uniform, low: {-before:.4g}, high: {after:.4g}}}    # s"
    return [*review([doubt], 2), entry]
