"""Read the columns of a file, and find kind, location and unit in headers of many languages."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.output_files import MOST_GUESSED
from bayesdrill.record.formats.table import RecordTable

MAX_LETTERS = 200  # largest length of a header or a unit; a longer text is not interpreted
ROTOR, GEARBOX, MOTOR, TWIST = "rotor 1", "gearbox", "motor", "twist"

# Lower-case spellings of units in headers, by kind and unit; the first unit of a kind is in SI.
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
        "ns": "ns nsec nanos nanoseconds nanosec",
    },
    "torque": {"N*m": "nm n*m n·m n.m n-m", "mN*m": "mnm"},
    "force": {"N": "n newton"},
    "position": {"m": "m meter", "mm": "mm", "cm": "cm"},  # linear motion
    "velocity": {"m/s": "m/s", "mm/s": "mm/s"},
}

MOTIONS = ("angle", "speed", "position", "velocity")  # kinds of columns that show a motion
DRIVES = ("voltage", "current", "torque", "force")  # kinds of columns that may drive a rig

SI = {kind: next(iter(spellings)) for kind, spellings in _UNITS_OF_KIND.items()}

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
_COUNTS_PER = re.compile(r"(\d[\d.]*) ?counts? ?(?:per|/) ?(\w+)")
_LETTERS = {"t": "time", "w": "speed", "n": "speed", "u": "voltage", "v": "voltage", "i": "current"}
_LOCATIONS = {
    ROTOR: "rotor bit load last disc disk scheibe bottom lower meissel carga broca trepan end 1",
    GEARBOX: "gear gearbox top table shaft output getriebe abtrieb welle upper eixo arbre redutor 2",
    MOTOR: "motor mot m antrieb moteur engine",
    TWIST: "twist torsion verdrehung verdrillung deflection torcao torsione alpha windup",
}
_REFERENCE_WORDS = (
    "ref reference soll set setpoint cmd command desired target sollwert goal demand action"
)


def _group_by_word(groups: dict[str, str]) -> dict[str, str]:
    return {word: group for group, words in groups.items() for word in words.split()}


_KIND_OF = {unit: kind for kind, spellings in _UNITS_OF_KIND.items() for unit in spellings}
_UNIT_OF = {word: u for kind in _UNITS_OF_KIND.values() for word, u in _group_by_word(kind).items()}
_KIND_WORDS, _LOCATION_WORDS = _group_by_word(_KINDS), _group_by_word(_LOCATIONS)
_GREEK = str.maketrans({"θ": "theta ", "φ": "phi ", "ϕ": "phi ", "ω": "omega ", "\u03b1": "alpha "})


@dataclass(frozen=True, slots=True)
class Meaning:
    """The meaning of a column is read from its header; a field that it does not give is empty."""

    kind: str = ""
    location: str = ""
    unit: str = ""
    is_setpoint: bool = False  # a controller's set point, not a measurement
    unknown_unit: str = ""  # text in the position of a unit, if no such unit is known
    symbol: str = ""  # symbol of a state or input, if the header is one
    kind_word: str = ""  # the word that shows the kind
    is_reversed: bool = False  # the column is the state times -1
    is_given: bool = False  # stated by the user in `--columns`, not read from the header


_ALIKE = {"position": "angle", "velocity": "speed", "force": "torque"}  # kinds with the same words


def contradiction(meaning: Meaning) -> str:
    """Return a text if the name of a column contradicts its unit; empty if both agree."""
    by_name = _KIND_WORDS.get(meaning.kind_word, "") if len(meaning.kind_word) > 1 else ""
    kind = kind_of(meaning.unit) if meaning.unit and not meaning.is_given else ""
    if not by_name or not kind or _ALIKE.get(by_name, by_name) == _ALIKE.get(kind, kind):
        return ""
    article = "an" if kind == "angle" else "a"
    names = f"its name says {by_name}, and its unit {meaning.unit} is that of {article} {kind}"
    return f"{names}: the unit is used, but name or unit is wrong"


STATES = {
    "theta_1": ("angle", ROTOR),
    "theta_2": ("angle", GEARBOX),
    "w_1": ("speed", ROTOR),
    "w_2": ("speed", GEARBOX),
    "i": ("current", ""),
}


def parse_head(head: str, unit_below: str = "") -> Meaning:
    """Return the meaning of a header, with the unit in the row below; empty for a long header."""
    if max(len(head), len(unit_below)) > MAX_LETTERS:
        return Meaning()
    base, unit, unknown_unit = _split_unit(head)
    if unit_below and not unit:
        bare = re.sub(r"^\s*[\[(](.*)[\])]\s*$", r"\1", unit_below)
        unit = parse_unit(bare)
        unknown_unit = "" if unit else bare
    tokens = _tokens(base)
    if base in STATES and not unknown_unit:
        kind, location = STATES[base]
        if not unit or kind_of(unit) == kind:
            return Meaning(kind, location, unit, symbol=base, kind_word=base)
    if not unit and not unknown_unit:
        tokens, unit = _split_last_unit(tokens)
    kind, word = _kind(tokens)
    if unit:
        kind = kind_of(unit)
    locations = [_LOCATION_WORDS[token] for token in tokens if token in _LOCATION_WORDS]
    location = TWIST if TWIST in locations else next(iter(locations), "")
    if location == TWIST:
        kind = kind or "angle"
    is_setpoint = any(token in _REFERENCE_WORDS.split() for token in tokens)
    return Meaning(kind, location, unit, is_setpoint, unknown_unit, kind_word=word)


def parse_unit(text: str) -> str:
    """Return the unit as it is written in configs; empty if no quantity of a rig has this unit."""
    if counts := _COUNTS_PER.fullmatch(text.strip()):
        turn = _UNIT_OF.get(counts[2]) == "revolution"
        text = f"count/{counts[1]}" if turn else f"count/({counts[1]}/{counts[2]})"
    elif not text.startswith(("count", "%")):
        text = text.strip().strip("[]()").replace(" ", "")
    known = _UNIT_OF.get(text) or _UNIT_OF.get(text.lower(), "")
    return known or (text if text and kind_of(text) else "")


def kind_of(unit: str) -> str:
    """Return the kind of quantity that has this unit; empty for an unknown unit."""
    if unit in _KIND_OF:
        return _KIND_OF[unit]
    for kind, si in SI.items():
        with contextlib.suppress(ValueError):
            units.factor(unit, si)
            return kind
    return ""


def _split_unit(head: str) -> tuple[str, str, str]:
    """Split `n [rpm]`, `w (rad/s)`, `n / rpm` or `n in rpm` into name, unit and unknown unit."""
    text = head.strip()
    match = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", text)
    match = match or re.fullmatch(r"(.*?\S)(?:\s+/\s+|\s+in\s+)(\S+)", text)
    if match is None:
        return text, "", ""
    base, written = match[1], match[2]
    if unit := parse_unit(written):
        return base, unit, ""
    if any(token in _LOCATION_WORDS or token in _KIND_WORDS for token in _tokens(written)):
        return f"{base} {written}", "", ""
    return base, "", written


def _tokens(text: str) -> list[str]:
    letters = unicodedata.normalize("NFKD", text.translate(_GREEK)).replace("ß", "ss")
    plain = "".join(letter for letter in letters if not unicodedata.combining(letter))
    return [t.lower() for t in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|°", plain)]


def _split_last_unit(tokens: list[str]) -> tuple[list[str], str]:
    """Split a unit from `phi_deg`, `w_rad_s` or `U_V`; a unit of one letter must fit the kind."""
    if len(tokens) < 2:
        return tokens, ""
    *others, last = tokens
    if len(tokens) > 2 and last in ("s", "sec", "min") and others[-1] in _UNIT_OF:
        pair = f"{others[-1]}/{last}"
        if pair in _UNIT_OF:
            return others[:-1], _UNIT_OF[pair]
    unit = _UNIT_OF.get(last, "")
    if not unit or (len(last) == 1 and _kind(others)[0] != _KIND_OF[unit]):
        return tokens, ""
    return others, unit


def _kind(tokens: list[str]) -> tuple[str, str]:
    """Return the kind and the word that shows it; a single letter counts only as the first word."""
    named = [(_KIND_WORDS[token], token) for token in tokens if token in _KIND_WORDS]
    turns = any(kind == "angle" for kind, _ in named)
    if turns and (tokens[0] == "d" or {"dot", "dt", "rate"} & {*tokens}):
        return "speed", f"{named[0][1]} dot"
    if named:  # the last word names the quantity: `Position velocity` is a speed
        return named[-1]
    letter = tokens[0] if tokens and tokens[0] in _LETTERS else ""
    return _LETTERS.get(letter, ""), letter


MIN_SAMPLES = 20  # columns with fewer samples are not used
MAX_NUMBER = 1e12  # larger numbers are not plausible
EVEN_STEPS = 1.02  # limit of largest step / smallest step in a column that may be a time


@dataclass(frozen=True, slots=True, eq=False)
class FileColumn:
    """A file column has `values (T,)`; `address` holds the entries that select it in a config."""

    name: str
    address: Mapping[str, str | int]
    values: Array
    meaning: Meaning
    file: int = 0  # index among the files of one record; 0 is the main file

    @property
    def key(self) -> tuple[object, ...]:
        """Return a key that is the same for this column in all records with the same columns."""
        return self.file, *self.address.items()

    @property
    def command(self) -> str:
        """Return the text before the `=` that selects the column in `--columns`."""
        return ":".join(map(str, self.address.values()))

    @property
    def steps(self) -> Array:
        """Return the differences `(T - 1,)` of successive rows; NaN if a row has no number."""
        with np.errstate(all="ignore"):
            return np.diff(self.values)

    @property
    def counts_rows(self) -> bool:
        """Return whether the column grows by one per row, and is neither a time nor a motion."""
        unnamed = not self.meaning.unit and self.meaning.kind not in ("time", "angle", "position")
        return unnamed and bool(np.all(self.steps == 1))

    @property
    def is_even(self) -> bool:
        """Return whether the column grows in equal steps, as a time does, and is no row number."""
        least, most = self.steps.min(initial=np.inf), self.steps.max(initial=0.0)
        even = 1 / MAX_NUMBER < least <= most < min(MAX_NUMBER, EVEN_STEPS * least)
        return bool(even) and not self.counts_rows

    @property
    def range_text(self) -> str:
        """Return the range of the column in words."""
        numbers = self.values[np.isfinite(self.values)]
        return f"{numbers.min():.4g} to {numbers.max():.4g}" if len(numbers) else "no numbers"


_QUANTITY = re.compile(r"(-?)([^\W\d][\w ]*?)\s*(?:\[([^\[\]]+)\]|\((.+)\))?")
_WORDS = {*_KIND_WORDS, *_LOCATION_WORDS, *_LETTERS, *_UNIT_OF, *_REFERENCE_WORDS.split(), "dot"}
_NAMES = {**STATES, "v": ("voltage", ""), "t_1": ("torque", ROTOR), "t_m": ("torque", MOTOR)} | {
    "t": ("time", ""),
    "twist": ("angle", TWIST),
}


# A symbol of a train has a letter for the quantity and the name of a part.
_TRAIN_SYMBOL = re.compile(r"(theta|goal|supply|w|x|v|i|u|t|f)_([A-Za-z][A-Za-z0-9_]{0,29})")
KIND_OF_LETTER = {
    "goal": "angle",  # set point of a servo; a measured angle is called theta
    "theta": "angle",
    "w": "speed",
    "x": "position",
    "v": "velocity",
    "i": "current",
    "supply": "voltage",  # supply of a servo
    "u": "voltage",
    "t": "torque",
    "f": "force",
}


def train_symbol(text: str) -> re.Match[str] | None:
    """Match a train's symbol, such as `w_load`: letter and part; None for other rigs' symbols."""
    return None if text in _NAMES else _TRAIN_SYMBOL.fullmatch(text)


@dataclass(frozen=True, slots=True)
class NamedColumn:
    """A named column is an entry of `--columns`; a matrix `variable` has a `column`, from 1."""

    text: str
    file: str
    variable: str
    column: int | None
    meaning: Meaning


def named_column(text: str, files: Collection[str]) -> NamedColumn:
    """Parse `data:3=theta_2 [deg]`, or `a.mat:data:3=...` for a file; raises `InputError`."""
    place, _, description = text.rpartition("=")
    file = next((name for name in files if place.startswith(f"{name}:")), "")
    match = re.fullmatch(r"(.+?)(?::(\d+))?", place.removeprefix(f"{file}:").strip())
    quantity = _QUANTITY.fullmatch(description.strip())
    sign, symbol, *given_units = quantity.groups("") if quantity else ("", "")
    meaning, written = parse_head(symbol), "".join(given_units)
    if (train := train_symbol(symbol)) or symbol in _NAMES:
        kind, location = (KIND_OF_LETTER[train[1]], "") if train else _NAMES[symbol]
        meaning = Meaning(kind, location, symbol=symbol, kind_word=symbol)
    unit = parse_unit(written) if written else meaning.unit
    if train and train[1] == "goal" and kind_of(unit) == "position":  # of a motion along a line
        meaning = dataclasses.replace(meaning, kind="position")
    understood = meaning.symbol or {*_tokens(symbol)} <= _WORDS
    fits = understood and meaning.kind and (not (unit or written) or kind_of(unit) == meaning.kind)
    if match is None or not fits:
        why = "names no known quantity, or its unit is wrong" if match else "names no column"
        known = f"`data:3=theta_2 [deg]`. Known quantities are {', '.join(_NAMES)}, in trains "
        known += "also theta_load, i_motor, x_cart and the like. Encoders count in count/2800 or "
        known += "count/(560/cm)"
        raise InputError.at("--columns", f"'{text}' {why}. Write for example {known}")
    meaning = dataclasses.replace(meaning, unit=unit, is_reversed=bool(sign), is_given=True)
    return NamedColumn(text, file, match[1], int(match[2]) if match[2] else None, meaning)


def read_columns(
    table: RecordTable, named_columns: Sequence[NamedColumn] = ()
) -> tuple[list[FileColumn], dict[str, str]]:
    """Return the columns of the most frequent length, and why other columns are not used.

    With `named_columns`, only these and the time are returned, with the given meanings. Raises
    `InputError` if a named column does not exist, or if the file holds several records.
    """
    columns, unused = _all_columns(table), dict(table.ignored)
    if named_columns:
        picked = _pick(table, columns, named_columns)
        names = {column.name for column in picked}
        others = [c for c in columns if c.name not in names and len(c.values) >= MIN_SAMPLES]
        unused = {column.name: "is not named in --columns" for column in others}
        columns = picked
    _refuse_stillness(table, columns)
    if not named_columns:
        _refuse_several_records(table, columns)
        columns = _named_by_file(table, columns)
    lengths = Counter(len(c.values) for c in columns if len(c.values) >= MIN_SAMPLES)
    length = max(lengths, key=lambda length: (lengths[length], length), default=MIN_SAMPLES)
    for column in columns:
        if (n := len(column.values)) != length:
            count = "one value" if n == 1 else f"{n} values"
            other = f"but the others have {length}" if lengths else f"and {length} are needed"
            unused[column.name] = f"has {count}, {other}"
    return [column for column in columns if len(column.values) == length], unused


def _all_columns(table: RecordTable) -> list[FileColumn]:
    """Return all columns; an increasing first column of a matrix with two columns is the time."""
    columns = []
    for position, (name, values) in enumerate(table.variables.items(), start=1):
        if values.ndim == 1:
            number = _column_number(table, name, position)
            address: dict[str, str | int] = {"column": number or name}
            head = table.labels.get(name, "" if number else name)
            meaning = _meaning(head, table.units.get(name, ""))
            columns.append(FileColumn(name, address, values, meaning))
            continue
        pair = values.shape[1] == 2 and bool(np.all(np.diff(values[:, 0]) > 0))
        meanings = [Meaning("time"), _meaning(name, "")] if pair else [Meaning()] * values.shape[1]
        for k, (x, meaning) in enumerate(zip(values.T, meanings, strict=True), start=1):
            address = {"variable": name, "column": k}
            columns.append(FileColumn(f"{name}, column {k}", address, x, meaning))
    return columns


def _pick(
    table: RecordTable, columns: Sequence[FileColumn], named_columns: Sequence[NamedColumn]
) -> list[FileColumn]:
    """Return the time of the named columns, then these columns with their given meanings."""
    picked = []
    for name in named_columns:
        number = table.lines is not None and name.variable.isdecimal()
        column = name.column or (int(name.variable) if number else name.variable)
        variable = name.variable if name.column else None
        values = table.pick(column, variable, location=f"--columns '{name.text}'")
        address: dict[str, str | int] = {} if variable is None else {"variable": variable}
        title = name.variable if name.column is None else f"{name.variable}, column {name.column}"
        picked.append(FileColumn(title, {**address, "column": column}, values, name.meaning))
    if any(column.meaning.kind == "time" for column in picked):
        return picked
    names, length = {column.name for column in picked}, len(picked[0].values)
    others = [c for c in columns if c.name not in names and len(c.values) == length]
    times = [c for c in others if c.meaning.kind == "time"]
    times = times or [c for c in others if not c.meaning.kind and c.is_even]
    nearest = [time for time in times if _structure(time) == _structure(picked[0])] or times
    return [*nearest[:1], *picked]


def _structure(column: FileColumn) -> str:
    """Return the name of the structure that contains a signal."""
    return column.name.rpartition(".")[0].partition(".signals")[0]


def _refuse_stillness(table: RecordTable, columns: Sequence[FileColumn]) -> None:
    """Raise `InputError` if there are angles or speeds and all of them are constant."""
    moving = [c for c in columns if c.meaning.kind in MOTIONS and not c.meaning.is_setpoint]
    moving = [c for c in moving if MIN_SAMPLES <= np.isfinite(c.values).sum() <= MOST_GUESSED]
    known = [c.values[np.isfinite(c.values)] for c in moving]
    if moving and not any((np.abs(np.diff(x)) > 1 / MAX_NUMBER).any() for x in known):
        names = ", ".join([column.name for column in moving[:4]] + ["..."] * (len(moving) > 4))
        message = f"nothing moved: every row has the same {names}; repair the sensor, and "
        raise InputError.at(str(table.path), message + "record again, or name another column")


def _refuse_several_records(table: RecordTable, columns: Sequence[FileColumn]) -> None:
    """Raise `InputError` if several structures are records: with a time, and not named like a signal."""
    columns = [column for column in columns if len(column.values) >= MIN_SAMPLES]
    times = dict.fromkeys(_structure(c) for c in columns if c.meaning.kind == "time")
    records = [name for name in times if name and parse_head(name).kind in ("", "time")]
    if len(records) > 1:
        signals = [c for c in columns if c.meaning.kind != "time" and _structure(c) in records]
        first = [*_motions_first(signals), *columns][0]
        raise InputError.at(
            str(table.path),
            f"holds {len(records)} records: {', '.join(records)}. Name the columns of one record: "
            f"{_columns_option([first])} ({first.name} goes from {first.range_text})",
        )


def _named_by_file(table: RecordTable, columns: list[FileColumn]) -> list[FileColumn]:
    """Return the columns; the file's name gives the meaning of a single signal of unknown kind."""
    signals = [c for c in columns if c.meaning.kind != "time" and len(c.values) >= MIN_SAMPLES]
    if len(signals) == 2 == len(columns) and not signals[0].meaning.kind:  # one may be the time
        signals = [column for column in signals if not column.is_even]
    named = parse_head(table.path.stem)
    if len(signals) != 1 or signals[0].meaning.kind or not named.kind:
        return columns
    meaning = dataclasses.replace(named, unit=signals[0].meaning.unit or named.unit)
    return [dataclasses.replace(c, meaning=meaning) if c is signals[0] else c for c in columns]


# Descriptions of columns by kind, for examples of `--columns`; motions come first.
_EXAMPLES = {
    "speed": "w_2 [rpm]",
    "angle": "theta_2 [deg]",
    "": "theta_2 [deg]",
    "voltage": "v [V]",
    "current": "i [A]",
    "torque": "t_1 [N*m]",
    "time": "t [s]",
}


def _motions_first(columns: Iterable[FileColumn]) -> list[FileColumn]:
    """Return the columns that can be examples, measured motions first and set points last."""
    order = [*_EXAMPLES]
    known = (column for column in columns if column.meaning.kind in order)
    return sorted(known, key=lambda c: (c.meaning.is_setpoint, order.index(c.meaning.kind)))


def _columns_option(columns: Sequence[FileColumn]) -> str:
    """Return an example of `--columns`: a time and another column, if possible a motion."""
    times = [column for column in columns if column.is_even][:1]
    others = _motions_first(column for column in columns if column not in times)
    typed = [(column, "t [s]") for column in times]
    typed += [(column, _EXAMPLES[column.meaning.kind]) for column in others[:1]]
    return " ".join(f'--columns "{column.command}={what}"' for column, what in typed)


def grouped(unused: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return pairs of column names and their common reason, the largest group last."""
    whys = dict.fromkeys(unused.values())
    pairs = [([name for name, reason in unused.items() if reason == why], why) for why in whys]
    return [("; ".join(names), why) for names, why in sorted(pairs, key=lambda pair: len(pair[0]))]


def unusable(
    record: Path, unused: dict[str, str], why: str, columns: Sequence[FileColumn] = ()
) -> InputError:
    """Return the error for a file without usable columns, with an example of what to type."""
    reasons = [Issue(str(record), f"column {names} {text}") for names, text in grouped(unused)]
    typed = _columns_option(columns) or '--columns "speed=w_2 [rpm]"'
    message = f"{why}. Say what the columns are, for example {typed}, or write a config by hand"
    return InputError([Issue(str(record), message), *reasons])


def _meaning(name: str, unit_below: str) -> Meaning:
    """Return the meaning of a dotted name: that of its last part, completed by the whole name."""
    last = re.split(r"\.(?=[^\W\d])", name)[-1]
    meaning, whole = parse_head(last, unit_below), parse_head(name, unit_below)
    if last == name or meaning.unknown_unit:
        return meaning
    return dataclasses.replace(
        meaning,
        kind=meaning.kind or (whole.kind if len(whole.kind_word) > 1 else ""),  # `T1` is no time
        location=meaning.location or whole.location,
        is_setpoint=meaning.is_setpoint or whole.is_setpoint,
        kind_word=meaning.kind_word or whole.kind_word,
    )


def _column_number(table: RecordTable, name: str, position: int) -> int | None:
    """Return a column's number if a text table has no unique header for the column; else None."""
    if table.lines is None:
        return None
    if match := re.fullmatch(r"\(column (\d+)\)", name):
        return int(match[1])
    return position if name == str(position) else None
