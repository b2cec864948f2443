"""The columns of a file, and what a head says in some languages: what it measures, where, and in
which unit.
"""

from __future__ import annotations

import dataclasses
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError
from bayesdrill.record.formats.table import Table

LONGEST = 200  # letters of a head, or of a unit
ROTOR, GEARBOX, MOTOR, TWIST = "rotor 1", "gearbox", "motor", "twist"

SI = {
    "time": "s",
    "angle": "rad",
    "speed": "rad/s",
    "voltage": "V",
    "current": "A",
    "torque": "N*m",
    "force": "N",
}

# As heads of columns write them, without blanks and in small letters.
_UNITS_OF_KIND = {
    "angle": {
        "rad": "rad radian radians",
        "deg": "deg degree degrees ° grad grados graus gradi degre degres",
        "revolution": "rev turn turns revolution revolutions umdrehungen",
    },
    "speed": {
        "rad/s": "rad/s rad/sec rads radps rads-1 rads^-1 rad*s^-1 rad.s-1 rads⁻¹",
        "deg/s": "deg/s °/s deg/sec degs dps grad/s degs-1 degs^-1",
        "rpm": "rpm 1/min u/min min-1 min^-1 min⁻¹ r/min rev/min upm tr/min giri/min",
        "revolution/s": "rev/s rps u/s tr/s",
    },
    "voltage": {"V": "v volt volts", "mV": "mv"},
    "current": {"A": "a amp amps ampere", "mA": "ma"},
    "time": {
        "s": "s sec secs second seconds sek sekunden segundos",
        "ms": "ms msec millis milliseconds millisekunden",
        "us": "us µs μs usec micros microseconds",
    },
    "torque": {"N*m": "nm n*m n·m n.m n-m", "mN*m": "mnm"},
    "force": {"N": "n newton"},
}

_KINDS = {
    "time": "time zeit temps tempo tiempo timestamp clock seconds",
    "angle": "angle theta phi winkel drehwinkel pos position angolo angulo posicao posicion th alpha",
    "speed": "speed omega drehzahl vel velocity rpm geschwindigkeit winkelgeschwindigkeit vitesse "
    "velocidad velocidade velocita rotacao spd thetadot phidot dtheta dphi w1 w2 wm gyro dps",
    "voltage": "volt volts voltage spannung tensao voltaje tensione supply ua um uin vin vm",
    "current": "current strom corrente corriente courant amp amps ia im",
    "torque": "torque moment drehmoment couple coppia torsionmoment",
    "force": "force kraft wob forca fuerza weight",
}
_LETTERS = {"t": "time", "w": "speed", "n": "speed", "u": "voltage", "v": "voltage", "i": "current"}
_PLACES = {
    ROTOR: "rotor bit load last disc disk scheibe bottom lower meissel carga broca trepan end 1",
    GEARBOX: "gear gearbox top table shaft output getriebe abtrieb welle upper eixo arbre redutor 2",
    MOTOR: "motor mot m antrieb moteur engine",
    TWIST: "twist torsion verdrehung verdrillung deflection torcao torsione alpha windup",
}
_WANTED = "ref reference soll set setpoint cmd command desired target sollwert"


def _group_of(groups: dict[str, str]) -> dict[str, str]:
    """By word."""
    return {word: group for group, words in groups.items() for word in words.split()}


_KIND_OF = {unit: kind for kind, spelled in _UNITS_OF_KIND.items() for unit in spelled}
_UNIT_OF = {word: u for kind in _UNITS_OF_KIND.values() for word, u in _group_of(kind).items()}
_KIND_WORDS, _PLACE_WORDS = _group_of(_KINDS), _group_of(_PLACES)
_GREEK = str.maketrans({"θ": "theta ", "φ": "phi ", "ϕ": "phi ", "ω": "omega ", "\u03b1": "alpha "})


@dataclass(frozen=True, slots=True)
class Meaning:
    """`kind` and `place` are empty where the head does not say; `unit` as a config has it.

    `wanted`: what a controller asked for, not what happened; `strange`: a unit that is none;
    `symbol`: of the state that the head names as a config does; `backwards`: it counts against it.
    """

    kind: str = ""
    place: str = ""
    unit: str = ""
    wanted: bool = False
    strange: str = ""
    symbol: str = ""
    word: str = ""
    backwards: bool = False


STATES = {
    "theta_1": ("angle", ROTOR),
    "theta_2": ("angle", GEARBOX),
    "w_1": ("speed", ROTOR),
    "w_2": ("speed", GEARBOX),
    "i": ("current", ""),
}


def meaning(head: str, unit_below: str = "") -> Meaning:
    """Of the head of a column, and of what a row of units below it has; a long one says nothing."""
    if max(len(head), len(unit_below)) > LONGEST:
        return Meaning()
    base, unit, strange = _apart(head)
    if unit_below and not unit:
        unit = unit_of(unit_below)
        strange = "" if unit else unit_below
    tokens = _tokens(base)
    if base in STATES and not strange:
        kind, place = STATES[base]
        if not unit or kind_of(unit) == kind:
            return Meaning(kind, place, unit, symbol=base, word=base)
    if not unit and not strange:
        tokens, unit = _unit_at_the_end(tokens)
    kind, word = _kind(tokens)
    if unit:
        kind = kind_of(unit)
    place = next((_PLACE_WORDS[t] for t in tokens if t in _PLACE_WORDS), "")
    if any(_PLACE_WORDS.get(t) == TWIST for t in tokens):
        place, kind = TWIST, kind or "angle"
    wanted = any(t in _WANTED.split() for t in tokens)
    return Meaning(kind, place, unit, wanted, strange, word=word)


def unit_of(written: str) -> str:
    """As configs write it; empty where no rig has it."""
    plain = written.strip().strip("[]()").replace(" ", "")
    known = _UNIT_OF.get(plain) or _UNIT_OF.get(plain.lower(), "")
    if known or not plain:
        return known
    return plain if kind_of(plain) else ""


def kind_of(unit: str) -> str:
    if unit in _KIND_OF:
        return _KIND_OF[unit]
    for kind, si in SI.items():
        try:
            units.factor(unit, si)
        except ValueError:
            continue
        return kind
    return ""


def _apart(head: str) -> tuple[str, str, str]:
    """Name, unit and what stands where a unit would: `n [rpm]`, `w (rad/s)`, `n / rpm`, `n in rpm`."""
    text = head.strip()
    found = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", text)
    found = found or re.fullmatch(r"(.*?\S)(?:\s+/\s+|\s+in\s+)(\S+)", text)
    if found is None:
        return text, "", ""
    base, written = found[1], found[2]
    unit = unit_of(written)
    if unit:
        return base, unit, ""
    if any(token in _PLACE_WORDS or token in _KIND_WORDS for token in _tokens(written)):
        return f"{base} {written}", "", ""
    return base, "", written


def _tokens(text: str) -> list[str]:
    spelled = unicodedata.normalize("NFKD", text.translate(_GREEK))
    spelled = "".join(letter for letter in spelled if not unicodedata.combining(letter))
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|°", spelled.replace("ß", "ss"))
    return [part.lower() for part in parts]


def _unit_at_the_end(tokens: list[str]) -> tuple[list[str], str]:
    """`phi_deg`, `w_rad_s`, `U_V`: a letter alone only where it is of the kind that the rest names."""
    if len(tokens) < 2:
        return tokens, ""
    if len(tokens) > 2 and tokens[-1] in ("s", "sec", "min") and tokens[-2] in _UNIT_OF:
        pair = f"{tokens[-2]}/{tokens[-1]}"
        if pair in _UNIT_OF:
            return tokens[:-2], _UNIT_OF[pair]
    last = tokens[-1]
    unit = _UNIT_OF.get(last, "")
    if len(last) == 1 and unit and _kind(tokens[:-1])[0] != _KIND_OF[unit]:
        return tokens, ""
    return (tokens[:-1], unit) if unit else (tokens, "")


def _kind(tokens: list[str]) -> tuple[str, str]:
    """The kind, and the word that says it; a letter alone says it at the beginning only."""
    found = [(t, _KIND_WORDS[t]) for t in tokens if t in _KIND_WORDS]
    turns = any(kind == "angle" for _, kind in found)
    if turns and (tokens[0] == "d" or {"dot", "dt", "rate"} & {*tokens}):
        return "speed", f"{found[0][0]} dot"
    # `angular speed`, `Position velocity`: the later kind is what is measured.
    if found:
        return found[-1][1], found[-1][0]
    if tokens and tokens[0] in _LETTERS:
        return _LETTERS[tokens[0]], tokens[0]
    return "", ""


LEAST = 20  # samples, below which nothing is guessed
LARGEST = 1e12  # number that is believed


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One column `(T,)`; `address`: the entries of a config that name it; `file`: the place of its file
    among those that make one record, 0 for that of the channels.
    """

    name: str
    address: Mapping[str, str | int]
    values: Array
    says: Meaning
    file: int = 0

    @property
    def key(self) -> tuple[object, ...]:
        """By which the same column is known in a record of the same kind."""
        return self.file, *self.address.items()


_NAMES = {**STATES, "v": ("voltage", ""), "t_1": ("torque", ROTOR), "t_m": ("torque", MOTOR)} | {
    "t": ("time", ""),
    "twist": ("angle", TWIST),
}


@dataclass(frozen=True, slots=True)
class NamedColumn:
    """What a user says of a column: `variable` or head, and of a matrix the `column` from 1."""

    text: str
    file: str
    variable: str
    column: int | None
    says: Meaning


def named_column(text: str, files: Collection[str]) -> NamedColumn:
    """Read `data:3=theta_2 [deg]`; before it may stand the name of one of the `files`, and a colon.

    Raises `InputError` where it says neither a column nor what it measures.
    """
    where, _, what = text.rpartition("=")
    file = next((name for name in files if where.startswith(f"{name}:")), "")
    found = re.fullmatch(r"(.+?)(?::(\d+))?", where.removeprefix(f"{file}:").strip())
    what, backwards = what.strip().removeprefix("-"), what.strip().startswith("-")
    says, why = meaning(what), ""
    base = _apart(what)[0]
    if base in _NAMES:
        kind, place = _NAMES[base]
        why = (
            ""
            if says.unit in ("", *_UNITS_OF_KIND[kind]) or kind_of(says.unit) == kind
            else "wrong"
        )
        says = dataclasses.replace(says, kind=kind, place=place, symbol=base)
    if found is None or says.strange or why or not says.kind:
        why = "names no column" if found is None else "names no quantity with a unit of it"
        known = f"`data:3=theta_2 [deg]`; known are {', '.join(_NAMES)}"
        raise InputError.one("--columns", f"'{text}' {why}; write for example {known}")
    says = dataclasses.replace(says, backwards=backwards)
    return NamedColumn(text, file, found[1], int(found[2]) if found[2] else None, says)


def look(table: Table, named: Sequence[NamedColumn] = ()) -> tuple[list[Seen], dict[str, str]]:
    """Columns of one length, most of the file's, and why others are left out.

    Of `named` ones these alone, as they are said to be, and the time.  Raises `InputError` where one
    is not there, or where there are several records.
    """
    seen, left_out = [], dict(table.ignored)
    heads = _units_below(table)
    for position, (name, values) in enumerate(table.variables.items(), start=1):
        if values.ndim == 1:
            number = _number(table, name, position)
            column = name if number is None else number
            head = table.labels.get(name, name if number is None else "")
            seen.append(Seen(name, {"column": column}, values, _says(head, heads.get(name, ""))))
        else:
            seen += _matrix(name, values)
    chosen = _chosen(table, seen, named)
    if named:
        used = {one.name for one in chosen}
        left_out = {
            one.name: "is not named in --columns"
            for one in seen
            if one.name not in used and len(one.values) >= LEAST
        }
        seen = chosen
    else:
        _refuse_several(table, seen)
        seen = _by_file_name(table, seen)
    lengths = Counter(len(one.values) for one in seen if len(one.values) >= LEAST)
    usual = max(lengths, key=lambda length: (lengths[length], length), default=LEAST)
    for one in seen:
        if len(one.values) != usual:
            left_out[one.name] = f"has {_values(len(one.values))}, not {usual}"
    return [one for one in seen if len(one.values) == usual], left_out


def _matrix(name: str, values: Array) -> list[Seen]:
    """Its columns; of two of which the first grows, the second is what the matrix is called."""
    pair = values.shape[1] == 2 and bool(np.all(np.diff(values[:, 0]) > 0))
    says = [Meaning("time"), _says(name, "")] if pair else [Meaning()] * values.shape[1]
    return [
        Seen(f"{name}, column {k}", {"variable": name, "column": k}, one, said)
        for k, (one, said) in enumerate(zip(values.T, says, strict=True), start=1)
    ]


def _chosen(table: Table, seen: Sequence[Seen], named: Sequence[NamedColumn]) -> list[Seen]:
    """Those that are named, with what is said of them, and the time that stands beside them."""
    found = []
    for one in named:
        number = table.lines is not None and one.variable.isdecimal()
        column = one.column or (int(one.variable) if number else one.variable)
        variable = one.variable if one.column else None
        values = table.pick(column, variable, place=f"--columns '{one.text}'")
        address = (
            {"column": column} if variable is None else {"variable": variable, "column": column}
        )
        name = one.variable if one.column is None else f"{one.variable}, column {one.column}"
        found.append(Seen(name, address, values, one.says))
    if not found or any(one.says.kind == "time" for one in found):
        return found
    times = [
        one
        for one in seen
        if one.says.kind == "time"
        and one.name not in [other.name for other in found]
        and len(one.values) == len(found[0].values)
    ]
    nearest = [one for one in times if _structure(one) == _structure(found[0])] or times
    return [*nearest[:1], *found]


def _structure(one: Seen) -> str:
    """In which a signal stands."""
    return one.name.rpartition(".")[0].partition(".signals")[0]


def _refuse_several(table: Table, seen: Sequence[Seen]) -> None:
    """Structures that each have a time of their own, and are not called after a signal, are records."""
    seen = [one for one in seen if len(one.values) >= LEAST]
    times = [_structure(one) for one in seen if one.says.kind == "time"]
    records = [name for name in dict.fromkeys(times) if name and meaning(name).kind in ("", "time")]
    if len(records) > 1:
        those = [o for o in seen if o.says.kind != "time" and _structure(o) in records] or [*seen]
        raise InputError.one(
            str(table.path),
            f"holds {len(records)} records: {', '.join(records)}; name columns of one, for example "
            f"{way_out(those[:1])} ({those[0].name} goes from {span_of(those[0])})",
        )


def _by_file_name(table: Table, seen: list[Seen]) -> list[Seen]:
    """Where a single column beside the time says nothing, it is what the file is called."""
    signals = [one for one in seen if one.says.kind != "time" and len(one.values) >= LEAST]
    if len(signals) == 2 == len(seen) and not signals[0].says.kind:  # a time without a head
        signals = [one for one in signals if not np.all(np.diff(one.values) > 0)]
    named = meaning(table.path.stem)
    if len(signals) != 1 or signals[0].says.kind or not named.kind:
        return seen
    unit = signals[0].says.unit or named.unit
    says = dataclasses.replace(named, unit=unit)
    return [dataclasses.replace(one, says=says) if one is signals[0] else one for one in seen]


def span_of(one: Seen) -> str:
    """From its least value to its largest."""
    numbers = one.values[np.isfinite(one.values)]
    return f"{numbers.min():.4g} to {numbers.max():.4g}" if len(numbers) else "no numbers"


def way_out(those: Sequence[Seen]) -> str:
    """What to type for columns of which nothing is known: a time, if one grows, and an angle."""
    times = [one for one in those if bool(np.all(np.diff(one.values) > 0))][:1]
    others = [one for one in those if one not in times][:1]
    said = [*((one, "t [s]") for one in times), *((one, "theta_2 [deg]") for one in others)]
    return " ".join(
        f'--columns "{":".join(map(str, one.address.values()))}={what}"' for one, what in said
    )


def believable(values: Array) -> bool:
    """Squares of it can be computed with."""
    largest = float(np.abs(values).max())
    return largest == 0 or 1 / LARGEST < largest < LARGEST


def _says(name: str, unit_below: str) -> Meaning:
    """Of `rig.rotor.w`, the last part first; what that leaves open the whole may say."""
    last = re.split(r"\.(?=[^\W\d])", name)[-1]
    says, whole = meaning(last, unit_below), meaning(name, unit_below)
    if last == name or says.strange:
        return says
    return dataclasses.replace(
        says,
        kind=says.kind or (whole.kind if len(whole.word) > 1 else ""),  # `T1.x` is no time
        place=says.place or whole.place,
        word=says.word or whole.word,
    )


def _number(table: Table, name: str, position: int) -> int | None:
    """Of a column of a text without a header, or with an empty or repeated head."""
    if table.lines is None:
        return None
    if found := re.fullmatch(r"\(column (\d+)\)", name):
        return int(found[1])
    return position if name == str(position) else None


def _values(count: int) -> str:
    return "one value" if count == 1 else f"{count} values"


def _units_below(table: Table) -> dict[str, str]:
    """By name, what stands in a row of units between the head of a text and its first row."""
    if table.lines is None or not len(table.lines) or table.lines[0] < 3:
        return {}
    with table.path.open(encoding="utf-8", errors="replace") as file:
        lines = [file.readline().strip() for _ in range(int(table.lines[0]) - 1)]
    for mark in ";\t,|":
        head, below = ([c.strip(' "') for c in line.split(mark)] for line in lines[-2:])
        if len(below) == len(head) == len(table.variables) > 1 and head[0] in table.variables:
            return dict(zip(table.variables, below, strict=True))
    return {}
