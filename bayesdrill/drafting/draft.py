"""Draft a config from the files of records, or report why none can be made."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bayesdrill import output_files
from bayesdrill.analysis.record_findings import findings_of_record
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.basics.findings import Finding
from bayesdrill.basics.symbols import Symbol
from bayesdrill.config import loading
from bayesdrill.config.job import assemble
from bayesdrill.config.yaml_source import Source, parse
from bayesdrill.drafting import entries, record_files, roles, trains
from bayesdrill.drafting.columns import MOTIONS, MOTOR, ROTOR, TWIST, grouped
from bayesdrill.drafting.entries import REVIEW, DraftContext, comment, review, scalar
from bayesdrill.drafting.record_files import GivenFacts, RecordFile
from bayesdrill.drafting.record_start import StartGuess, guess_start
from bayesdrill.drafting.signals import Sensor
from bayesdrill.inference.posterior import Problem
from bayesdrill.rig.models.linear import Model, with_named
from bayesdrill.rig.models.roles import GEAR_POWERS
from bayesdrill.rig.models.train import LINEAR

SAME_CONSTANT = 0.02  # largest relative difference of two constants that count as equal
SHEET_SD = 1.0  # prior sd of the logarithm of a parameter in a data sheet
MAX_UNUSED = 20  # largest number of lines on unused columns in the terminal


def config_text(
    context: DraftContext,
    name: str,
    sheet: Mapping[str, Any],
    findings: Sequence[str] = (),
    tied: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return a config called `name`; `sheet` has the entries of `nominal:` from a data sheet.

    `findings` are sentences on the record that the user has to review.  `tied` maps a parameter to
    the parameter to which it is equal.
    """
    assigned, start, nominal = context.lead.roles, context.starts[context.lead.label], []
    files = [file for record in context.records for file in (record, *record.companions)]
    names = ", ".join(context.file_name(file.path) for file in files)
    if assigned.train is not None:
        model = [*review([assigned.gear_doubt], 0), *trains.model_lines(assigned.train)]
    elif assigned.rig.geared:
        why = f"gear {assigned.gear:.6g}:1, {assigned.gear_reason}" if assigned.gear_reason else ""
        model = [*review([assigned.gear_doubt], 0), *comment(why)]
        model.append(f"model: {{name: {assigned.rig.name}, i_m: {1 / assigned.gear:.6g}}}")
    else:
        model = [f"model: {{name: {assigned.rig.name}}}"]
    if sheet:
        rows = [f"  {name}: {json.dumps(x)}" for name, x in {"tolerance": 0.2, **sheet}.items()]
        head = comment("Values of the data sheet; `tolerance` is their largest relative error.")
        nominal = [*head, "nominal:", *rows, ""]
    lines = [
        *comment(
            f"A first config of {names}, by `bayesdrill init`. A line with REVIEW and its reason stands "
            "above each guess: check it, correct it if necessary, and delete the line."
        ),
        "",
        f"name: {scalar(name)}",
        "seed: 1                 # any whole number; the same seed gives the same result",
        "",
        *review(findings, 0),
        *entries.record_lines(context),
        "",
        *entries.input_lines(context),
        "",
        *(_experiments(context) if context.several_records else _initial(start)),
        "",
        *model,
        "",
        *nominal,
        *_parameters(context, sheet, tied),
    ]
    return "\n".join(lines) + "\n"


def _initial(start: StartGuess) -> list[str]:
    end = start.rest_end
    still = [] if math.isnan(end) else comment(f"Nothing moves before {end:.6g} s.")
    if start.initial:
        return [*still, *review(start.doubts, 0), f"initial: {start.initial}"]
    where = " where the window begins" if start.window else ""
    what = "At rest" if start.zero_sds else "At rest, at angle zero"
    return [*still, *comment(f"{what}{where}, so `initial:` is not needed")]


def _experiments(context: DraftContext) -> list[str]:
    lines = comment("Each experiment has its file and its own entries; other entries are as above.")
    lines.append("experiments:")
    for record in context.records:
        lines += _experiment(context, record)
    doubt = "the experiments share sensors, with one noise, one offset and one lag"
    doubt += "; remove a name if each experiment has its own"
    # Unknowns of the sensors are shared; times of manual steps differ.
    shared = ["t_0"] if context.has_measured_input else []
    if context.voltage is None and context.lead.roles.v and not entries.constant_voltages(context):
        shared.append("offset_v")
    if context.lag is not None:
        shared.append(f"lag_{context.lag.channel}")
    shared += [f"sigma_{channel.name}" for channel in context.channels if not channel.derived]
    return [*lines, "", *review([doubt], 0), f"shared: [{', '.join(shared)}]"]


def _experiment(context: DraftContext, record: RecordFile) -> list[str]:
    def other_files(sensors: Mapping[str, Sensor]) -> dict[str, str]:
        others = {name: record.file_of(s) for name, s in sensors.items() if s.column.file}
        return {name: f"{{{context.file_entry(file.path)}}}" for name, file in others.items()}

    start, voltages = context.starts[record.label], entries.constant_voltages(context)
    channels = other_files({c.name: c.sensor for c in record.roles.channels})
    inputs = other_files(record.roles.inputs)
    if len({*voltages.values()}) > 1:
        inputs["v"] = voltages[record.label]
    window, initial = start.window and f"window: {start.window}", start.initial
    rows = f"rows: {record.rows}" if record.rows else ""
    file = [context.file_entry(record.path), rows, window, _flow("channels", channels)]
    sections = [f"record: {{{', '.join(filter(None, file))}}}", _flow("inputs", inputs)]
    sections = [*filter(None, [*sections, initial and f"initial: {initial}"])]
    doubts = [start.window_doubt if window else "", *start.doubts]
    head, line = review(doubts, 2), f"  {scalar(record.label)}: {{{', '.join(sections)}}}"
    if len(line) <= entries.LINE_LENGTH:
        return [*head, line]
    return [*head, f"  {scalar(record.label)}:", *(f"    {section}" for section in sections)]


def _flow(section: str, items: Mapping[str, str]) -> str:
    pairs = ", ".join(f"{name}: {entry}" for name, entry in items.items())
    return f"{section}: {{{pairs}}}" if pairs else ""


def _parameters(
    context: DraftContext, sheet: Mapping[str, Any], tied: Mapping[str, str]
) -> list[str]:
    """Write priors relative to the data sheet, or with bounds from the magnitudes in the record."""
    both_ways = any(roles.turns_both_ways(record.roles) for record in context.records)
    (scales, why), gear = _prior_scales(context), context.lead.roles.gear
    rig = with_named(context.lead.roles.rig, sheet)
    which = "priors of parameters that the sheet does not give are wide: they"
    why = f"{which if sheet else 'there is no data sheet, so priors are wide: they'} {why}"
    if sheet:
        why += f". `relative` priors are about a factor of {math.exp(SHEET_SD):.2g} wide"
    driven = [inertia for inertia in rig.roles.inertias if rig.roles.motor(inertia.name)]
    rubbing, held = driven, dict[str, str]()
    if context.lead.roles.train is not None:
        rubbing = [*rig.roles.inertias]
        held = trains.held_scales(rig, context.lead.sensors)
    lines = [*review([why], 0), "parameters:"]
    for name in rig.parameters:
        symbol = rig.symbols[name]
        if name in held:
            lines += [*review([held[name]], 2), f"  {name}: 1.0"]
        elif both_ways and name in {inertia.friction for inertia in driven}:
            doubt = "this friction never changes sign, but the rig turns both ways: held at zero"
            doubt += ", and c_m stands for all friction"
            lines += [*review([doubt], 2), f"  {name}: 0.0"]
        elif name in tied:
            doubt = f"{name} and {tied[name]} are equal in the sheet (in SI), so they are tied"
            lines += [*review([doubt], 2), f"  {name}: {{tie: {tied[name]}}}"]
        elif name in sheet and math.isinf(symbol.at_most):
            prior = f"{{prior: log_normal, median: 1, sd_log: {SHEET_SD:g}, relative: true}}"
            lines.append(f"  {name}: {prior}")
        else:
            low, high = _prior_ends(scales, rig, symbol, gear)
            prior = f"{{prior: log_uniform, low: {low:.1e}, high: {high:.1e}}}"
            lines.append(_with_meaning(f"  {name}: {prior}", 60, symbol))
    further = [s.damping for s in rig.roles.shafts if s.stiffness in rig.parameters]
    further += [inertia.sliding for inertia in rubbing if both_ways]
    further = [name for name in further if name in rig.offers and name not in rig.parameters]
    text = "For further physics (docs/rigs.md), remove the # before a parameter:"
    lines += comment(text if further else "", 2)
    for name in further:
        _, high = _prior_ends(scales, rig, rig.symbols[name], gear)
        entry = f"  # {name}: {{prior: half_normal, scale: {high / 3:.1e}}}"
        lines.append(_with_meaning(entry, 48, rig.symbols[name]))
    return lines


PriorEnds = Mapping[str, tuple[float, float]]
DEFAULT_VOLTAGE, DEFAULT_SPEED, DEFAULT_RESISTANCE = 12.0, 100.0, 2.0  # V, rad/s at the motor, ohm
WIDENING = 10.0  # factor that widens priors at both ends if no torque is known


def _prior_scales(context: DraftContext) -> tuple[PriorEnds, str]:
    """Return the ends of priors for each unit, in SI and at the motor, and the reason as a text.

    From the largest voltage, speed and current, k_e is about voltage / speed, and the resistance is
    about voltage / current. Torques reach k_e times the stall current. An inertia is about torque *
    time / speed, where the time is between one step and the whole record.
    """
    gear, train = context.lead.roles.gear, context.lead.roles.train
    dt, duration = context.lead.segment.dt, float(np.ptp(context.lead.segment.t))

    def largest(kind: str) -> float:
        sensors = [s for record in context.records for s in record.sensors if s.kind == kind]
        scaled = [s.si / (gear if kind == "torque" and s.location == ROTOR else 1) for s in sensors]
        return max((float(np.quantile(np.abs(x), 0.99)) for x in scaled), default=0.0)

    voltage = abs(context.voltage or 0.0) or largest("voltage")
    speed = max(_largest_speed(record, gear) for record in context.records)
    current, torque, force = largest("current"), largest("torque"), largest("force")
    sizes = {"V": voltage, "rad/s at the motor": speed, "A": current, "N m at the motor": torque}
    if train is not None:  # motor constants are held at one, so a current acts as a torque
        unit = "m/s" if train.motion == "linear" else "rad/s"
        sizes = {"V": voltage, unit: speed, "A": current, "N m": torque, "N": force}
        torque = max(torque, force, current, voltage) or 1.0
    known = ", ".join(f"{value:.3g} {unit}" for unit, value in sizes.items() if value)
    v, w = voltage or DEFAULT_VOLTAGE, speed or DEFAULT_SPEED
    r, k = v / current if current else DEFAULT_RESISTANCE, v / w
    widening = 1.0 if train is None and (torque or (voltage and current)) else WIDENING
    wider = f", and {WIDENING:g} times more for resistances, torques and inertias"
    more = wider if widening > 1 else ""
    torque = torque or k * v / r
    j = torque / w
    ends = {
        "V*s/rad": (0.01 * k, 3 * k),
        "N*m/A": (0.01 * k, 10 * k),
        "ohm": (0.03 * r / widening, 3 * r * widening),
        "H": (1e-5 * r / widening, 0.03 * r * widening),  # time constants L/R [s]
        "N*m": (1e-4 * torque / widening, torque * widening),
        "N*m*s/rad": (1e-5 * j / widening, 3 * j * widening),
        "N*m/rad": (0.03 * torque / widening, 1e3 * torque * widening),
        "kg*m**2": (0.1 * j * dt / widening, j * duration * widening),
        "rad/s": (1e-3 * w, w),
        "V": (1e-3 * v, v),
    }
    if train is not None:  # periods from about one step to the whole record
        ends["N*m/rad"] = (1e-2 * j / duration**2, widening * j / dt**2)
    ends |= {LINEAR[unit]: pair for unit, pair in ends.items() if unit in LINEAR}
    return ends, (
        f"reach as far as the largest values of the record allow ({known}){more}. "
        "Write a number for a parameter that you have weighed or measured"
    )


def _prior_ends(ends: PriorEnds, rig: Model, symbol: Symbol, gear: float) -> tuple[float, float]:
    """Return the ends of a parameter's prior, in SI, for the side of the gear where it acts."""
    low, high = ends.get(symbol.unit, (1e-3, 1.0))
    at_load = symbol.unit in GEAR_POWERS and rig.roles.side(symbol.name) == "load"
    factor = gear ** GEAR_POWERS[symbol.unit] if at_load else 1.0
    return factor * low, min(factor * high, symbol.at_most)


def _largest_speed(record: RecordFile, gear: float) -> float:
    """Return the largest measured speed, converted to the motor's side of the gear [rad/s]."""
    speeds, dt = [0.0], record.segment.dt
    for sensor in record.sensors:
        if sensor.kind in MOTIONS and sensor.location != TWIST:
            x = sensor.si * (1.0 if sensor.location == MOTOR else gear)
            if sensor.kind in ("angle", "position"):
                stride = max(1, len(x) // 200)
                x = (x[stride:] - x[:-stride]) / (stride * dt)
            speeds.append(float(np.quantile(np.abs(x), 0.99)))
    return max(speeds)


def _with_meaning(entry: str, width: int, symbol: Symbol) -> str:
    """Return the entry of a parameter with its unit and meaning as a comment."""
    return f"{entry:<{width - 1}} # {symbol.plain_unit}, {symbol.meaning}"


@dataclass(frozen=True, slots=True)
class Guess:
    """A guess is a config `text` for `path`; only the user can solve its `open_issues`."""

    path: Path
    text: str
    channels: tuple[str, ...]
    experiments: tuple[str, ...]
    columns: tuple[str, ...]
    open_issues: tuple[Issue, ...]

    @property
    def reviews(self) -> int:
        """Return the number of guesses that are marked for review."""
        return self.text.count(f"# {REVIEW}")

    def __str__(self) -> str:
        marked = "1 line" if self.reviews == 1 else f"{self.reviews} lines"
        labels = f"experiments {', '.join(self.experiments)}; " if self.experiments else ""
        lines = [
            f"{self.path}: {labels}channels {', '.join(self.channels)}; {marked} marked REVIEW",
            *(f"  {line}" for line in self.columns),
            *(f"still to do: {issue}" for issue in self.open_issues),
        ]
        return "\n".join([*lines, f"then: bayesdrill check {self.path}"])

    __repr__ = __str__


def guess(
    paths: Sequence[Path],
    target: Path,
    facts: GivenFacts,
    sheet: Source | None = None,
    describe: Callable[[Iterable[Finding]], Sequence[str]] = lambda findings: (),
) -> Guess:
    """Guess a config, to be saved at `target`, for record files; raises `InputError`.

    `sheet` is a data sheet, and `describe` turns findings on the record into sentences.
    """
    records, lead = record_files.read_records(paths, facts)
    pairs = [(record.roles, record.segment.dt) for record in records]
    hints = [hint for pair in pairs for hint in roles.find_lags(*pair)]
    clearest = min(hints, key=lambda lag: lag.residual / lag.baseline, default=None)
    starts = {record.label: _start(record, facts.voltage) for record in records}
    context = DraftContext(records, lead, starts, clearest, facts.voltage, target.parent)
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", target.stem).lstrip("_.-")[:100] or "my_rig"
    values: Mapping[str, Any] = {} if sheet is None else sheet.data
    text = config_text(context, name, values)
    asks, problem = _asks(text, target, paths[0], sheet)
    voltage = () if facts.voltage is None else ("v",)
    findings = _findings(problem, describe, {"", *lead.roles.inputs, *voltage})
    tied = _same_constants(problem, values)
    if findings or tied:
        text = config_text(context, name, values, findings, tied)
    channels = tuple(channel.name for channel in context.channels)
    labels = tuple(record.label for record in records if record.label)
    columns = (*_how_read(lead), *(f"REVIEW: {finding}" for finding in findings))
    return Guess(target, text, channels, labels, columns, asks)


def _same_constants(problem: Problem, sheet: Mapping[str, Any]) -> dict[str, str]:
    """Map each back-emf constant to its torque constant if both are equal in the sheet."""
    pairs, si = (
        [(m.back_emf, m.torque_constant) for m in problem.model.roles.motors],
        problem.nominal,
    )
    given = {k_e: k_T for k_e, k_T in pairs if {k_e, k_T} <= {*sheet}}
    same = (k_e for k_e in given if math.isclose(si[k_e], si[given[k_e]], rel_tol=SAME_CONSTANT))
    return {k_e: given[k_e] for k_e in same}


def _findings(
    problem: Problem,
    describe: Callable[[Iterable[Finding]], Sequence[str]],
    inputs: Collection[str],
) -> tuple[str, ...]:
    """Return the findings on records that need no fit, as sentences that name the experiments.

    Findings on an input that is not among `inputs` are skipped, as the draft sets it to a number.
    """
    said: dict[str, list[str]] = {}
    for observation in problem.observations:
        free = problem.posterior.space.free
        findings = findings_of_record(observation.experiment, problem.model, free)
        for sentence in describe([f for f in findings if f.names.get("input", "") in inputs]):
            said.setdefault(sentence, []).append(observation.label)
    return tuple(f"{', '.join(labels)}, {s}" if labels[0] else s for s, labels in said.items())


def _how_read(record: RecordFile) -> Iterator[str]:
    """Yield how each column of a record was read, or why it is not used."""
    time, mark = record.time, ", REVIEW" if record.time.doubt else ""
    name = f"{time.rate:.6g} samples a second" if time.column is None else time.column.name
    yield f"{name}: the time [{time.unit}]{mark}"
    named = [*((c.name, c.sensor) for c in record.roles.channels), *record.roles.inputs.items()]
    yield from (f"{s.name}: {n} [{s.unit}]{', REVIEW' if s.doubts else ''}" for n, s in named)
    unused = [f"not used: {names}: {why}" for names, why in grouped(record.unused)]
    yield from unused[:MAX_UNUSED]
    yield from ["not used: more columns, see the config"] if len(unused) > MAX_UNUSED else []


def check_draft_path(path: Path, read: Sequence[Path], *, force: bool) -> None:
    """Raise `InputError` if `path` is no .yaml, is in `read`, or exists without `force`."""
    output_files.refuse_other_than_file(path)
    output_files.refuse_replacing(read, [path])
    if path.suffix.lower() not in (".yaml", ".yml"):
        message = "cannot be written: it is not the name of a config. Give another --output that"
        raise InputError.at(str(path), f"{message} ends in .yaml")
    output_files.refuse_existing(path, force=force)


def _start(record: RecordFile, voltage: float | None) -> StartGuess:
    v = None if voltage is not None else record.roles.v
    inputs = [s for name, s in record.roles.inputs.items() if name != "v" or s is v]
    begin = max((s.raw.t[0] for s in inputs if len(s.raw.t)), default=None)
    measured = any(sensor is not v or sensor.varies for sensor in inputs)
    return guess_start(record.roles, record.segment, measured=measured, inputs_begin=begin)


def _asks(
    text: str, target: Path, record: Path, sheet: Source | None
) -> tuple[tuple[Issue, ...], Problem]:
    """Return an issue if no voltage is known, and the problem; other issues are raised."""
    asked = entries.ASKED_VOLTAGE
    whole = parse(target, text.replace(asked, asked.replace("# ", "")))
    try:
        problem = assemble(loading.validate(whole)).problem
    except InputError as error:
        if sheet is not None:
            entries_of_sheet = ("nominal", *(f"parameters.{name}" for name in sheet.data))
            keys = [(issue.place.rpartition(": ")[2], issue.message) for issue in error.problems]
            if wrong := [
                Issue(f"{sheet.path}: {key.partition('.')[2]}", message)
                for key, message in keys
                if key.startswith(entries_of_sheet)
            ]:
                raise InputError(wrong) from None
        message = "no valid config can be made of this record, for the reasons below"
        first = Issue(str(record), f"{message}. Correct the file, or write a config by hand")
        raise InputError([first, *error.problems]) from None
    try:
        loading.validate(parse(target, text))
    except InputError as error:
        return error.problems, problem
    return (), problem
