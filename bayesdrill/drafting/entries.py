"""Write the lines of a draft's `record:` and `inputs:`, with comments and reasons."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.basics.errors import printable
from bayesdrill.config.records import sources
from bayesdrill.drafting import roles, signals
from bayesdrill.drafting.columns import TWIST, FileColumn, grouped
from bayesdrill.drafting.record_files import RecordFile
from bayesdrill.drafting.record_start import StartGuess
from bayesdrill.drafting.roles import DraftChannel, LagHint
from bayesdrill.drafting.signals import Sensor, Timing
from bayesdrill.record import clocks

REVIEW = "REVIEW: "
LINE_LENGTH = 110
_PLAIN = re.compile(r"(?![-\d%/]|\.(?!\.?/))[\w./%°-]+(?: [\w./%°-]+)*", re.ASCII)
_FIXED_BLANK = "\x1f"  # stands for a blank in code, at which no line may break
_YAML_WORDS = {"yes", "no", "on", "off", "true", "false", "null", "y", "n"}
NOISE_PRIOR_FACTOR = 10.0  # sigma's prior extends from noise / factor to noise * factor
SUPPLY_SD = 0.02  # prior sd of a voltage's offset, relative to the largest voltage
MAX_NAMED_GLITCHES = 8  # largest number of glitches whose times a comment lists
HOUSE_INPUTS = ("v", "t_m", "w_2", "t_1")  # inputs of built-in rigs, in the order of a draft
ASKED_VOLTAGE = "  # v: 8.0"  # the user replaces this line


def scalar(value: str | int) -> str:
    """Write a text or a number as YAML, with quotes only if they are needed."""
    text = str(value)
    if isinstance(value, int) or (_PLAIN.fullmatch(text) and text.lower() not in _YAML_WORDS):
        return text
    return json.dumps(value, ensure_ascii=False)


def comment(text: str, indent: int = 0) -> list[str]:
    """Write a text as lines of comments; code in backticks stays on one line."""
    fixed = re.sub("`[^`]*`", lambda code: code[0].replace(" ", _FIXED_BLANK), printable(text))
    lead = " " * indent + "# "
    lines = textwrap.wrap(
        fixed, LINE_LENGTH, initial_indent=lead, subsequent_indent=lead, break_on_hyphens=False
    )
    return [line.replace(_FIXED_BLANK, " ") for line in lines]


def review(doubts: Iterable[str], indent: int) -> list[str]:
    """Write each doubt, unless it is empty, as a comment that asks for a review."""
    return [line for doubt in doubts if doubt for line in comment(REVIEW + doubt, indent)]


@dataclass(frozen=True, slots=True, eq=False)
class DraftContext:
    """A draft's context has all `records`; columns are identified in one of them, the `lead`."""

    records: tuple[RecordFile, ...]
    lead: RecordFile
    starts: Mapping[str, StartGuess]  # by label
    lag: LagHint | None
    voltage: float | None  # V, constant, if the user gives it
    folder: Path  # of the config

    @property
    def several_records(self) -> bool:
        """Return whether there are several experiments."""
        return len(self.records) > 1

    @property
    def channels(self) -> Sequence[DraftChannel]:
        """Return the channels of the lead."""
        return self.lead.roles.channels

    @property
    def has_measured_input(self) -> bool:
        """Return whether an input is a column, not a constant number."""
        inputs = [pair for record in self.records for pair in record.roles.inputs.items()]
        return any(name != "v" or (self.voltage is None and v.varies) for name, v in inputs)

    def sensors(self, channel: str) -> list[tuple[str, Sensor]]:
        """Return pairs of an experiment's label and its sensor of the channel."""
        pairs = [(r.label, c) for r in self.records for c in r.roles.channels]
        return [(label, c.sensor) for label, c in pairs if c.name == channel]

    def file_name(self, path: Path) -> str:
        """Return the path of a file as the config gives it, relative to the config's folder."""
        return sources.relative_name(self.folder, path)

    def file_entry(self, path: Path) -> str:
        """Return the entry `file:`."""
        return f"file: {scalar(self.file_name(path))}"


def record_lines(context: DraftContext) -> list[str]:
    """Write the section `record:`."""
    lead, lines = context.lead, ["record:"]
    if context.several_records:
        lines += _time(context)
    else:
        start = context.starts[lead.label]
        lines += [f"  {context.file_entry(lead.path)}", *_time(context)]
        lines += [f"  rows: {lead.rows}"] if lead.rows else []
        if start.window:
            lines += [*review([start.window_doubt], 2), f"  window: {start.window}    # s"]
    sensors = [s for channel in context.channels for _, s in context.sensors(channel.name)]
    if missing := dict.fromkeys(sensor.name for sensor in sensors if sensor.raw.n_missing):
        names = ", ".join(missing)
        doubt = f"missing samples of {names} are left out, each from its own channel only"
        lines += [*review([doubt], 2), "  missing: drop"]
    lines.append("  channels:")
    for channel in context.channels:
        lines += _channel(context, channel)
    if lead.unused:
        lines.append("  # Not used:")
    for names, why in grouped(lead.unused):
        lines += comment(f"- {names}: {why}", 2)
    return lines


def address(column: FileColumn) -> str:
    """Return the entries that select a column."""
    return ", ".join(f"{key}: {scalar(value)}" for key, value in column.address.items())


def sensor_comments(sensor: Sensor, indent: int) -> list[str]:
    """Write the comments above a sensor's entry: its reasons and its doubts."""
    known = [line for why in sensor.reasons for line in comment(why, indent)]
    return [*known, *review(sensor.doubts, indent)]


def time_entry(time: Timing) -> str:
    """Return the entry `time:`."""
    if time.column is None:
        return f"time: {{rate: {time.rate:.6g}}}"
    return f"time: {{{address(time.column)}, unit: {time.unit}}}"


def _time(context: DraftContext) -> list[str]:
    time = context.lead.time
    lines = [*review([time.doubt], 2), f"  {time_entry(time)}"]
    if time.column is None:
        return lines
    texts = [clocks.describe_times(clocks.on_grid(record.segment.t)) for record in context.records]
    uneven = [text for text in texts if "missing in" in text or "unequal" in text]
    text = f"{time.rate:.6g} samples a second" + (f", {time.reason}" if time.reason else "")
    if uneven:
        text = f"{uneven[0]}; these times are used without resampling"
    return [*comment(text, 2), *lines]


def _channel(context: DraftContext, channel: DraftChannel) -> list[str]:
    name, sensor, sensors = channel.name, channel.sensor, context.sensors(channel.name)
    entries, details, slow = _column_entries(context, sensor), [], []
    if channel.measures:
        entries.append(f"measures: {channel.measures}")
    doubts = [] if channel.derived else [_glitches(label, s) for label, s in sensors]
    if period := max(s.raw.wrap_period for _, s in sensors):
        doubts.append(f"it wraps after {period:.6g}, and is unwrapped")
        entries.append(f"wraps: {period:.10g}")
    if channel.derived:
        twice = "so a fit of both would count its samples twice"
        doubts.append(f"it was computed from differences of {channel.derived}, {twice}")
        entries.append(f"derived_from: {channel.derived}")
        sigma = "1}    # has no effect"
    else:
        hint = context.lag
        if hint is not None and hint.channel == name:
            ms = 1e3 * hint.samples * context.lead.segment.dt
            doubts.append(
                f"it seems to be {ms:.2g} ms late. With this delay the equation of rotor 1 leaves "
                f"{100 * hint.residual:.2g} % of the twist unexplained; without it, "
                f"{100 * hint.baseline:.2g} %. The delay is an unknown (damping in the shaft has "
                "a similar effect)"
            )
            details.append(f"lag: {_lag_prior(context, hint.samples)}")
        elif sensor.location == TWIST:
            text = "no delay is visible; if this sensor is slower than the others, add"
            slow = [*comment(text, 4), f"    #   lag: {_lag_prior(context, 0.0)}"]
        if zero := max(start.zero_sds.get(name, 0.0) for start in context.starts.values()):
            doubts.append("it is not zero at rest: its offset is an unknown")
            details.append(f"offset: {{prior: normal, mean: 0, sd: {zero:.2g}}}")
        noise = [s.noise for _, s in sensors]
        if sensor.kind == "speed" and (step := signals.coarse_step(sensor.raw.x)):
            steps = f"it moves in steps of {step:.5g} {sensor.unit}"
            doubts.append(f"{steps}, so it may be a difference of counts")
        least, most = min(noise), max(noise)
        spread = max(float(np.std(s.raw.x)) for _, s in sensors)
        size = " to ".join(dict.fromkeys((f"{least:.3g}", f"{most:.3g}")))
        doubts.append(
            f"the noise is not stated. Neighbouring samples differ by {size} {sensor.unit}, and the "
            f"sd of the channel is {spread:.3g}; sigma lies in between"
        )
        low, high = least / NOISE_PRIOR_FACTOR, max(most * NOISE_PRIOR_FACTOR, spread)
        sigma = f"{{prior: log_uniform, low: {low:.3g}, high: {high:.3g}}}}}"
    return [
        *sensor_comments(sensor, 4),
        *review(doubts, 4),
        *slow,
        f"    {name}: {{{', '.join(entries)},",
        *(f"      {detail}," for detail in details),
        f"      sigma: {sigma}",
    ]


def _glitches(label: str, sensor: Sensor) -> str:
    """Return a text on the times of glitches and on how to mask them; empty without glitches."""
    times = sensor.raw.glitches
    if not times:
        return ""
    at = ", ".join(f"[{begin:.9g}, {end:.9g}]" for begin, end in times[:MAX_NAMED_GLITCHES])
    entry, more = f"mask: {{times: [{at}]}}", ""
    if len(times) > MAX_NAMED_GLITCHES:
        entry, more = "mask: glitches", f" and {len(times) - MAX_NAMED_GLITCHES} more"
    where = f" in {label}" if label else ""
    return (
        f"looks like glitches{where}: {at} s{more}. The signal departs and returns, while no other "
        f"channel does. Nothing is masked; if this is an error of the sensor, add `{entry}`"
    )


def _lag_prior(context: DraftContext, samples: float) -> str:
    """Return a prior for a lag of about `samples`; its upper end is rounded up to two digits."""
    most = max(5.0, 2 * samples + 3) * context.lead.segment.dt
    scale = 10.0 ** (1 - math.floor(math.log10(most)))
    most = 1e3 * (math.ceil(most * scale) / scale)
    return f"{{prior: uniform, low: 0, high: {most:.6g}, unit: ms}}"


def input_lines(context: DraftContext) -> list[str]:
    """Write the section `inputs:`."""
    lines = ["inputs:"]
    house = [name for name in HOUSE_INPUTS if name in context.lead.roles.rig.inputs]
    for name in house if context.lead.roles.train is None else context.lead.roles.rig.inputs:
        lines += _voltage(context) if name == "v" else _input(context, name)
    if len(lines) == 1:  # the rig has no inputs
        return ["inputs: {}"]
    starts = context.starts.values()
    if not context.has_measured_input and any(start.is_moving for start in starts):
        return lines  # a constant voltage acted before the record, so no step has an unknown time
    # Take the longest sampling step of measured inputs, or if there are none, of records.
    pairs = [(record, s) for record in context.records for s in record.roles.inputs.values()]
    files = [record.file_of(sensor) for record, sensor in pairs] or context.records
    step = max(file.segment.dt for file in files)
    after = max(start.max_delay for start in starts) * step
    doubt = "the time at which inputs act is an unknown: it is known to one sample at best, and "
    doubt += "half a sample shifts inertias by many standard deviations"
    if dead := max(start.dead_samples for start in starts):
        doubt += f". The speed follows about {1e3 * dead * step:.3g} ms late. `bayesdrill map` "
        doubt += "says whether a delay and a time constant can be distinguished"
    entry = f"  t_0: {{prior: uniform, low: {-step:.4g}, high: {after:.4g}}}    # s"
    return [*lines, *review([doubt], 2), entry]


def constant_voltages(context: DraftContext) -> dict[str, str]:
    """Return the voltage's entry by label if each experiment has a constant voltage; else {}."""
    pairs = [(record.label, record.roles.v) for record in context.records]
    if context.voltage is not None or any(v is None or v.varies for _, v in pairs):
        return {}
    return {label: f"{{value: {v.raw.x[0]:.6g}, unit: {v.unit}}}" for label, v in pairs if v}


def _voltage(context: DraftContext) -> list[str]:
    v = context.lead.roles.v
    if context.voltage is not None:
        return [f"  v: {context.voltage:.6g}    # V, as given, constant from the start"]
    if v is None:
        doubt = (
            "no column is a voltage. Write the supply here, in V: a number if it was constant, else "
            "`{column: ..., unit: V, hold: zero}`; `bayesdrill check` asks for it. If the motion of the "
            "gearbox was imposed, use `--rig driven_shaft`; if a torque drives it, `--rig motor`"
        )
        return [*review([doubt], 2), ASKED_VOLTAGE]
    if known := constant_voltages(context):
        doubts = [f"{v.name} is the same in every row, and is taken as constant from the start"]
        entry = [f"  v: {known[context.lead.label]}"]
    else:
        voltages = [record.roles.v for record in context.records]
        largest = max(float(abs(other.raw.x).max()) for other in voltages if other)
        doubts = [
            "each value is held until the next sample; if the supply is smooth, use `hold: first`",
            "the voltage at the motor may differ: the offset is an unknown, with an sd of "
            f"{100 * SUPPLY_SD:g} % of the largest value",
        ]
        offset = f"      offset: {{prior: normal, mean: 0, sd: {SUPPLY_SD * largest:.2g}}}}}"
        entry = [f"{_opened_input(context, 'v', v)},", offset]
    return [*sensor_comments(v, 2), *review(doubts, 2), *entry]


def _input(context: DraftContext, name: str) -> list[str]:
    """Write the entry of a torque or an imposed motion: its column, or zero."""
    inputs = context.lead.roles.inputs
    for entry in roles.IMPOSED if name == "w_2" else (name,):
        if entry in inputs:
            sensor = inputs[entry]
            return [*sensor_comments(sensor, 2), f"{_opened_input(context, entry, sensor)}}}"]
    if name == "t_1":
        return ["  t_1: 0.0    # N m, load on rotor 1; no column measures it"]
    if context.lead.roles.train is not None:
        what = context.lead.roles.rig.symbols[name].meaning
    else:
        what = "torque at the motor [N m]" if name == "t_m" else "speed or angle of the upper end"
    doubt = f"no column is the {what}, so it is zero; give `--columns`, or write it here"
    return [*review([doubt], 2), f"  {name}: 0.0"]


def _opened_input(context: DraftContext, name: str, sensor: Sensor) -> str:
    """Return the entry of a measured input, without the closing brace."""
    entries = _column_entries(context, sensor)
    if sensor.kind != "angle" or name.startswith("goal_"):
        entries.append("hold: zero")
    if sensor.raw.wrap_period:
        entries.append(f"wraps: {sensor.raw.wrap_period:.10g}")
    if any(record.roles.inputs[name].raw.n_missing for record in context.records):
        entries.append("missing: hold")
    return f"  {name}: {{{', '.join(entries)}"


def _column_entries(context: DraftContext, sensor: Sensor) -> list[str]:
    """Return the entries for column and unit; for a column in another file, also file and time."""
    lead, entries = context.lead, [address(sensor.column), f"unit: {scalar(sensor.unit)}"]
    if not sensor.column.file:
        return entries
    file = lead.file_of(sensor)
    if (time := time_entry(file.time)) != time_entry(lead.time):
        entries.insert(0, time)
    return entries if context.several_records else [context.file_entry(file.path), *entries]
