"""From the files of records to a config that runs, every guess with its reason, or to why none can
be made.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesdrill import output_files
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config import loading
from bayesdrill.config.job import assemble
from bayesdrill.config.records import sources
from bayesdrill.config.yaml_source import Source, parse
from bayesdrill.drafting import entries, record_files, roles, signals
from bayesdrill.drafting.columns import MOTOR, ROTOR, TWIST
from bayesdrill.drafting.entries import REVIEW, Found, comment, review, scalar
from bayesdrill.drafting.record_files import Examined, Experiment, Known
from bayesdrill.drafting.roles import Start
from bayesdrill.drafting.signals import Sensor
from bayesdrill.rig import models
from bayesdrill.rig.models.linear import GEAR_POWERS, Model, with_named

SPREAD = 1.0  # of the logarithm of a parameter of a data sheet


def page(found: Found, name: str, sheet: Mapping[str, Any]) -> str:
    lead = found.lead.of
    files = [file for one in found.every for file in (one.of, *one.of.beside)]
    every = [found.name(file.path) for file in files]
    gear = f", i_m: {1 / lead.found.gear:.6g}" if lead.found.rig.geared else ""
    lines = [
        *comment(
            f"A first config of {', '.join(every)}, by `bayesdrill init`. What was guessed stands below "
            "a line with REVIEW and its reason: look at each, mend it or not, and take the line away."
        ),
        "",
        f"name: {scalar(name)}",
        "seed: 1                 # any whole number; the same seed gives the same result",
        "",
        *entries.record_entries(found),
        "",
        *entries.input_entries(found),
        *(_experiments(found) if found.several else _initial(found.starts[found.lead.label])),
        "",
        *review([lead.found.gear_doubt] if gear else (), 0),
        *(
            comment(f"gear {lead.found.gear:.6g}:1, {lead.found.gear_why}")
            if gear and lead.found.gear_why
            else ()
        ),
        f"model: {{name: {lead.found.rig.name}{gear}}}",
        "",
        *_nominal(sheet),
        *_parameters(found, sheet),
    ]
    return "\n".join(lines) + "\n"


def _initial(start: Start) -> list[str]:
    entry = _state(start)
    if entry:
        return ["", *review(start.doubts, 0), f"initial: {entry}"]
    where = "" if start.window is None else " where the window begins"
    what = "At rest" if start.zeros else "At rest, at angle zero"
    return ["", *comment(f"{what}{where}: nothing to say in `initial:`")]


def _state(start: Start) -> str:
    """The entry `initial:`, empty where it has nothing to say."""
    time = [] if start.time is None else [f"time: {start.time:.12g}"]
    state = [f"state: {start.state}"] if start.state else []
    named = [*time, *state, *([start.angle] if start.angle else [])]
    if named == state:
        return start.state
    return f"{{{', '.join(named)}}}"


def _experiments(found: Found) -> list[str]:
    lines = ["", *comment("Each has its file, and what is its own; all else is as above.")]
    lines.append("experiments:")
    for one in found.every:
        lines += _experiment(found, one)
    doubt = (
        "the same sensors in each: one noise, one offset, one lag; take out what differs, and it is "
        "an unknown of each experiment"
    )
    return [*lines, "", *review([doubt], 0), f"shared: [{', '.join(_shared(found))}]"]


def _experiment(found: Found, one: Experiment) -> list[str]:
    start = found.starts[one.label]
    record = [f"file: {scalar(found.name(one.of.path))}"]
    doubts = [*([start.window_doubt] if start.window else []), *start.doubts]
    if start.window is not None:
        record.append(f"window: {entries.span(start)}")
    if files := _files(found, one, {c.name: c.sensor for c in one.of.found.channels}):
        record.append(f"channels: {{{_flow(files)}}}")
    sections = [f"record: {{{', '.join(record)}}}"]
    own, known = _files(found, one, one.of.found.inputs), entries.constant_input(found)
    if len({*known.values()}) > 1:
        own["v"] = known[one.label]
    if own:
        sections.append(f"inputs: {{{_flow(own)}}}")
    if entry := _state(start):
        sections.append(f"initial: {entry}")
    head, whole = review(doubts, 2), f"  {scalar(one.label)}: {{{', '.join(sections)}}}"
    if len(whole) <= 110:
        return [*head, whole]
    return [*head, f"  {scalar(one.label)}:", *(f"    {section}" for section in sections)]


def _files(found: Found, one: Experiment, sensors: Mapping[str, Sensor]) -> dict[str, str]:
    """Of those that stand in another file, by name, an entry with it."""
    return {
        name: f"{{file: {scalar(found.name(one.of.file_of(sensor).path))}}}"
        for name, sensor in sensors.items()
        if sensor.seen.file
    }


def _flow(entries_: Mapping[str, str]) -> str:
    return ", ".join(f"{name}: {entry}" for name, entry in entries_.items())


def _shared(found: Found) -> list[str]:
    """Unknowns of the sensors; moments of steps that are given by hand are not."""
    v = found.lead.of.found.v
    names = ["t_0"] if found.measured else []
    if found.voltage is None and v is not None and not entries.constant_input(found):
        names.append("offset_v")
    if found.lag is not None:
        names.append(f"lag_{found.lag.of}")
    return [*names, *(f"sigma_{one.name}" for one in found.channels if not one.derived)]


def _nominal(sheet: Mapping[str, Any]) -> list[str]:
    """The data sheet, as it was given."""
    if not sheet:
        return []
    lines = [f"  {name}: {json.dumps(x)}" for name, x in {"tolerance": 0.2, **sheet}.items()]
    said = comment("By the data sheet; `tolerance`: how far it may be off.")
    return [*said, "nominal:", *lines, ""]


def _parameters(found: Found, sheet: Mapping[str, Any]) -> list[str]:
    """Factors of the data sheet's values; without one, what the record's own scale leaves possible."""
    turns_back = any(roles.both_ways(one.of.found) for one in found.every)
    (scales, why), gear = _scales(found), found.lead.of.found.gear
    rig = with_named(found.lead.of.found.rig, sheet)
    if sheet:
        why += (
            f"; what is `relative` is a factor of the sheet's, with an sd of {math.exp(SPREAD):.2g}"
        )
    lines = [*review([why], 0), "parameters:"]
    for name in rig.parameters:
        if name == rig.roles.motor.friction and turns_back:
            doubt = (
                "it keeps its sign, and this rig turns both ways: held at zero, and c_m stands for all "
                "friction"
            )
            lines += [*review([doubt], 2), f"  {name}: 0.0"]
        elif name in sheet and math.isinf(models.PARAMETERS[name].at_most):
            prior = f"{{prior: log_normal, median: 1, sd_log: {SPREAD:g}, relative: true}}"
            lines.append(f"  {name}: {prior}")
        else:
            low, high = _ends(scales, rig, models.PARAMETERS[name], gear)
            prior = f"  {name}: {{prior: log_uniform, low: {low:.1e}, high: {high:.1e}}}"
            lines.append(_with_meaning(prior, 60, name))
    wanted = [rig.roles.shaft.damping, *([rig.roles.motor.sliding] if turns_back else [])]
    shown = [name for name in wanted if name in rig.offers and name not in rig.parameters]
    if shown:
        said = "Further physics is switched on by naming it, see docs/rigs.md; take the # away:"
        lines += comment(said, 2)
    for name in shown:
        _, high = _ends(scales, rig, models.PARAMETERS[name], gear)
        entry = f"  # {name}: {{prior: half_normal, scale: {high / 3:.1e}}}"
        lines.append(_with_meaning(entry, 48, name))
    return lines


Ends = Mapping[str, tuple[float, float]]
USUAL_VOLTAGE, USUAL_SPEED, USUAL_RESISTANCE = 12.0, 100.0, 2.0  # V, rad/s at the motor, ohm
UNSURE = 10.0  # times wider either way, where no torque, or no voltage and current, is measured


def _scales(found: Found) -> tuple[Ends, str]:
    """By unit, the ends of priors at the motor [SI], and by what they are so.

    No-load speed and stalled current bound a motor: k_e is about voltage over speed, the resistance
    voltage over current, and torques are up to k_e times the stalled current.  Inertias follow from
    torque, speed and times between a step and the whole record.
    """
    gear, t = found.lead.of.found.gear, found.lead.of.part.t

    def largest(kind: str) -> float:
        those = [s for one in found.every for s in one.of.sensors if s.kind == kind]
        at_motor = [s.si / gear if kind == "torque" and s.place == ROTOR else s.si for s in those]
        return max((float(np.quantile(np.abs(x), 0.99)) for x in at_motor), default=0.0)

    voltage = abs(found.voltage or 0.0) or largest("voltage")
    speed, current = max(_speed(one.of, gear) for one in found.every), largest("current")
    torque = largest("torque")
    units_ = {"V": voltage, "rad/s at the motor": speed, "A": current, "N m at the motor": torque}
    known = ", ".join(f"{value:.3g} {unit}" for unit, value in units_.items() if value)
    v, w = voltage or USUAL_VOLTAGE, speed or USUAL_SPEED
    r, k = v / current if current else USUAL_RESISTANCE, v / w
    far = 1.0 if torque or (voltage and current) else UNSURE
    more = "" if far == 1 else f"; resistances, torques and inertias {UNSURE:g} times further"
    torque = torque or k * v / r
    j = torque / w
    ends = {
        "V*s/rad": (0.01 * k, 3 * k),
        "N*m/A": (0.01 * k, 10 * k),
        "ohm": (0.03 * r / far, 3 * r * far),
        "H": (1e-5 * r / far, 0.03 * r * far),  # time constants in s
        "N*m": (1e-4 * torque / far, torque * far),
        "N*m*s/rad": (1e-5 * j / far, 3 * j * far),
        "N*m/rad": (0.03 * torque / far, 1e3 * torque * far),
        "kg*m**2": (0.1 * j * found.lead.of.part.dt / far, j * float(np.ptp(t)) * far),
        "rad/s": (1e-3 * w, w),
        "V": (1e-3 * v, v),
    }
    return ends, (
        f"nobody has said anything of this rig: priors go as far as its record allows, by the largest "
        f"{known}{more}. Hold what you have weighed or measured"
    )


def _ends(ends: Ends, rig: Model, symbol: Symbol, gear: float) -> tuple[float, float]:
    """Of the prior of a parameter, SI, at its own side of the gear."""
    low, high = ends.get(symbol.unit, (1e-3, 1.0))
    behind = symbol.unit in GEAR_POWERS and rig.roles.side(symbol.name) == "load"
    times = gear ** GEAR_POWERS[symbol.unit] if behind else 1.0
    return times * low, min(times * high, symbol.at_most)


def _speed(of: Examined, gear: float) -> float:
    """The largest at the motor, rad/s."""
    found = [0.0]
    for one in (s for s in of.sensors if s.kind in signals.TURNS and s.place != TWIST):
        turned = one.si * (1.0 if one.place == MOTOR else gear)
        if one.kind == "angle":
            apart = max(1, len(turned) // 200)
            turned = (turned[apart:] - turned[:-apart]) / (apart * of.part.dt)
        found.append(float(np.quantile(np.abs(turned), 0.99)))
    return max(found)


def _with_meaning(entry: str, width: int, name: str) -> str:
    """An entry for the parameter `name`, and what that is."""
    symbol = models.PARAMETERS[name]
    return f"{entry:<{width}}# {symbol.plain_unit}, {symbol.meaning}"


@dataclass(frozen=True, slots=True)
class Guess:
    """`text` of a config for the place `path`; `asks`: what of it `check` would refuse."""

    path: Path
    text: str
    channels: tuple[str, ...]
    experiments: tuple[str, ...]
    asks: tuple[Issue, ...]

    @property
    def reviews(self) -> int:
        return self.text.count(f"# {REVIEW}")

    def __str__(self) -> str:
        marks = "1 mark" if self.reviews == 1 else f"{self.reviews} marks"
        of = f"experiments {', '.join(self.experiments)}; " if self.experiments else ""
        lines = [
            f"{self.path}: {of}channels {', '.join(self.channels)}; {marks} REVIEW to look at",
            *(f"still to do: {one}" for one in self.asks),
        ]
        return "\n".join([*lines, f"then: bayesdrill check {self.path}"])

    __repr__ = __str__


def guess(
    records: Sequence[Path], target: Path, known: Known, sheet: Source | None = None
) -> Guess:
    """A config at `target` for the files; `sheet`: the entries of its `nominal:`.

    Raises `InputError` where nothing can be made of a file, or not of all together.
    """
    every, lead = record_files.experiments(records, known)
    lags = [roles.lag(one.of.found, one.of.part.dt) for one in every]
    hints = [lag for lag in lags if lag is not None]
    found = Found(
        every=every,
        lead=lead,
        starts={one.label: _start(one, known.voltage) for one in every},
        lag=max(hints, key=lambda lag: lag.clear, default=None),  # of the one that tells it best
        voltage=known.voltage,
        name=lambda path: sources.relative_name(target.parent, path),
    )
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", target.stem).lstrip("_.-")[:100] or "my_rig"
    text = page(found, name, {} if sheet is None else sheet.data)
    channels = tuple(one.name for one in found.channels)
    labels = tuple(one.label for one in every if one.label)
    return Guess(target, text, channels, labels, _asks(text, target, records[0], sheet))


def save_draft(made_: Guess, records: Sequence[Path], *, force: bool) -> None:
    """See `check_place`."""
    check_draft_place(made_.path, records, force=force)
    output_files.write_text(made_.path, made_.text)


def check_draft_place(path: Path, records: Sequence[Path], *, force: bool) -> None:
    """Never over a record, and over another file with `force` alone; raises `InputError`."""
    output_files.refuse_other_than_file(path)
    taken = {record.absolute() for record in records}
    if path.suffix.lower() not in (".yaml", ".yml") or path.absolute() in taken:
        message = "is no name of a config; give an --output that ends in .yaml"
        raise InputError.one(str(path), message)
    if path.exists() and not force:
        raise InputError.one(str(path), "exists already; give --force or another --output")
    if not path.parent.is_dir():
        raise InputError.one(str(path.parent), "there is no such folder; make it first")
    output_files.refuse_unwritable(path.parent)


def _start(one: Experiment, voltage: float | None) -> Start:
    found = one.of.found
    v = None if voltage is not None else found.v
    inputs = [one for name, one in found.inputs.items() if name != "v" or one is v]
    known = [one.raw.t[0] for one in inputs if len(one.raw.t)]
    measured = any(one is not v or one.varies for one in inputs)
    return roles.start(found, one.of.part, measured=measured, known=max(known, default=None))


def _asks(text: str, target: Path, record: Path, sheet: Source | None) -> tuple[Issue, ...]:
    """What is wrong as it stands: a voltage that nobody has told.

    Raises `InputError` where `check` would refuse it with one, too.
    """
    whole = parse(target, text.replace(entries.UNKNOWN, entries.UNKNOWN.replace("# ", "")))
    try:
        assemble(loading.validate(whole))
    except InputError as error:
        marks = ("nominal", *(() if sheet is None else (f"parameters.{n}" for n in sheet.data)))
        of_sheet = [
            one for one in error.problems if one.place.rpartition(": ")[2].startswith(marks)
        ]
        if sheet is not None and of_sheet:
            places = [one.place.rpartition(": ")[2].partition(".")[2] for one in of_sheet]
            raise InputError(
                [
                    Issue(f"{sheet.path}: {p}", o.message)
                    for p, o in zip(places, of_sheet, strict=True)
                ]
            ) from None
        message = "`check` would refuse what can be made of it; mend it, or write a config by hand"
        raise InputError([Issue(str(record), message), *error.problems]) from None
    try:
        loading.validate(parse(target, text))
    except InputError as error:
        return error.problems
    return ()
