"""The config as text: every guess under a mark to be reviewed, with its reason."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence

from bayesdrill.basics import symbols
from bayesdrill.setup.guessing.roles import WIDE, Channel, Roles
from bayesdrill.setup.guessing.sensors import Sensor
from bayesdrill.setup.guessing.start import Start
from bayesdrill.setup.guessing.timing import Timing

REVIEW = "REVIEW: "
WIDTH = 110
SPREAD = 1.0  # of the logarithm of a parameter: nobody has said anything of this rig
_PLAIN = re.compile(r"(?![-\d%/]|\.(?!\.?/))[\w./%°-]+(?: [\w./%°-]+)*", re.ASCII)
_KEPT = "\x1f"  # a blank in code, at which no line is broken
_WORDS = {"yes", "no", "on", "off", "true", "false", "null", "y", "n"}


def page(
    record: str,
    name: str,
    time: Timing,
    found: Roles,
    start: Start,
    left_out: Mapping[str, str],
    *,
    voltage: float | None,
    turns_back: bool,
) -> str:
    """`record`: its path as the config has it; `turns_back`: driven in both directions."""
    lines = [
        *comment(
            f"A first config of {record}, by `bayesdrill init`. What was guessed stands below a line "
            "with REVIEW and its reason: look at each, mend it or not, and take the line away."
        ),
        "",
        f"name: {name}",
        "seed: 1                 # any whole number; the same seed gives the same result",
        "",
        "record:",
        f"  file: {scalar(record)}",
        *_time(time),
        *_window(start),
        "  channels:",
        *(line for one in found.channels for line in _channel(one)),
        *_left_out(left_out),
        "",
        "inputs:",
        *_voltage(found.v, voltage),
        *_load(found.t_1),
        *_initial(start),
        "",
        *review([found.gear_doubt], 0),
        *(comment(f"gear {found.gear:.6g}:1, {found.gear_why}") if found.gear_why else ()),
        f"model: {{name: motor_shaft, i_m: {1 / found.gear:.6g}}}",
        "",
        *_parameters(turns_back=turns_back),
    ]
    return "\n".join(lines) + "\n"


def scalar(value: str | int | float) -> str:
    if not isinstance(value, str):
        return f"{value:.6g}" if isinstance(value, float) else str(value)
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return json.dumps(value, ensure_ascii=False)


def comment(text: str, indent: int = 0) -> list[str]:
    text = "".join(letter if letter.isprintable() else " " for letter in text)
    whole = re.sub("`[^`]*`", lambda code: code[0].replace(" ", _KEPT), text)
    lead = " " * indent + "# "
    lines = textwrap.wrap(
        whole, WIDTH, initial_indent=lead, subsequent_indent=lead, break_on_hyphens=False
    )
    return [line.replace(_KEPT, " ") for line in lines]


def review(doubts: Iterable[str], indent: int) -> list[str]:
    return [line for one in doubts if one for line in comment(REVIEW + one, indent)]


def _address(sensor: Sensor) -> str:
    return ", ".join(f"{key}: {scalar(value)}" for key, value in sensor.seen.address.items())


def _time(time: Timing) -> list[str]:
    rate = f"{time.rate:.6g} samples a second"
    if time.column is None:
        return [*review([time.doubt], 2), f"  time: {{rate: {time.rate:.6g}}}"]
    address = ", ".join(f"{key}: {scalar(value)}" for key, value in time.column.address.items())
    said = f"{rate}, {time.why}" if time.why else rate
    return [
        *comment(said, 2),
        *review([time.doubt], 2),
        f"  time: {{{address}, unit: {time.unit}}}",
    ]


def _window(start: Start) -> list[str]:
    if start.window is None:
        return []
    low, high = (f"{one:.12g}" for one in start.window)
    return [*review(start.doubts[:1], 2), f"  window: [{low}, {high}]    # s"]


def _channel(one: Channel) -> list[str]:
    sensor, noise = one.sensor, one.noise
    low, high = f"{noise / WIDE:.3g}", f"{noise * WIDE:.3g}"
    entries = [_address(sensor), f"unit: {scalar(sensor.unit)}"]
    if one.measures:
        entries.append(f"measures: {one.measures}")
    prior = f"sigma: {{prior: log_uniform, low: {low}, high: {high}}}"
    return [
        *(line for why in sensor.why for line in comment(why, 4)),
        *review(sensor.doubts, 4),
        *review(
            [f"the noise is not said; {noise:.3g} {sensor.unit} differ from sample to sample"], 4
        ),
        f"    {one.name}: {{{', '.join(entries)},",
        f"      {prior}}}",
    ]


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


def _voltage(v: Sensor | None, given: float | None) -> list[str]:
    if given is not None:
        return [f"  v: {given:.6g}    # V, as it was given, constant from the start on"]
    if v is None:
        doubt = (
            "no column is a voltage. Write the supply here, in V: a number if it was constant, else "
            "`{column: ..., unit: V, hold: zero}`; `bayesdrill check` asks for it"
        )
        return [*review([doubt], 2), "  # v: 8.0"]
    head = [*(line for why in v.why for line in comment(why, 2)), *review(v.doubts, 2)]
    if v.values.min() == v.values.max():
        doubt = f"{v.name} is the same in every row, taken as there from the start on"
        return [*head, *review([doubt], 2), f"  v: {{value: {v.values[0]:.6g}, unit: {v.unit}}}"]
    hold = (
        "between samples it is taken as it was (zero); a supply that moves smoothly needs `first`"
    )
    entry = f"  v: {{{_address(v)}, unit: {v.unit}, hold: zero}}"
    return [*head, *review([hold], 2), entry]


def _load(t_1: Sensor | None) -> list[str]:
    if t_1 is None:
        return ["  t_1: 0.0    # N m, load on rotor 1: no column is one"]
    head = [*(line for why in t_1.why for line in comment(why, 2)), *review(t_1.doubts, 2)]
    return [*head, f"  t_1: {{{_address(t_1)}, unit: {scalar(t_1.unit)}, hold: zero}}"]


def _initial(start: Start) -> list[str]:
    doubts = start.doubts[1:] if start.window is not None else start.doubts
    entries = [] if start.time is None else [f"time: {start.time:.12g}"]
    entries += [f"{name}: {value:.6g}" for name, value in start.state.items()]
    if not entries:
        where = "" if start.window is None else " where the window begins"
        return ["", *comment(f"At rest{where}, at angle zero: nothing to say in `initial:`")]
    return ["", *review(doubts, 0), f"initial: {{{', '.join(entries)}}}    # SI"]


def _parameters(*, turns_back: bool) -> list[str]:
    table = symbols.NOMINAL[symbols.DEFAULT_NOMINAL].values
    rows: Sequence[tuple[str, str]] = [
        (f"  {name}: {value:.4g}", f"{symbols.PARAMETERS[name].plain_unit}, {_meaning(name)}")
        for name, value in table.items()
    ]
    lines = [
        *review(
            ["this is the paper's rig; write what your data sheets say, and how far it may be off"],
            0,
        ),
        "nominal:",
        f"  table: {symbols.DEFAULT_NOMINAL}",
        "  tolerance: 0.2",
        *(f"{entry:<16}# {said}" for entry, said in rows),
        "",
        *comment("A prior, a number that holds it, or `nominal`. Factors of the nominal value:"),
        *review(
            [
                "wide, as nothing is known: one standard deviation is a factor of "
                f"{2.718281828**SPREAD:.2g}. Hold what you have weighed or measured"
            ],
            0,
        ),
        "parameters:",
    ]
    for name in table:
        if name == "t_f" and turns_back:
            doubt = (
                "it keeps its sign, and this rig turns both ways: held at zero, and c_m stands for all "
                "friction"
            )
            lines += [*review([doubt], 2), "  t_f: 0.0"]
        else:
            prior = f"{{prior: log_normal, median: 1, sd_log: {SPREAD:g}, relative: true}}"
            lines.append(f"  {name}: {prior}")
    return lines


def _meaning(name: str) -> str:
    return symbols.PARAMETERS[name].meaning
