"""The columns of a file, and what their heads say in some languages: kind, location and unit."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesdrill.basics import units
from bayesdrill.basics.arrays import Array
from bayesdrill.basics.errors import InputError, Issue
from bayesdrill.output_files import MOST_GUESSED
from bayesdrill.record.formats.table import RecordTable

MAX_LETTERS = 200  # of a head, or of a unit, that is read
ROTOR, GEARBOX, MOTOR, TWIST = "rotor 1", "gearbox", "motor", "twist"

# By kind and unit, as heads write it without blanks and in small letters; the first unit is the SI one.
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
    "position": {"m": "m meter", "mm": "mm", "cm": "cm"},  # of what moves along a line
    "velocity": {"m/s": "m/s", "mm/s": "mm/s"},
}

MOTIONS = ("angle", "speed", "position", "velocity")  # kinds
DRIVES = ("voltage", "current", "torque", "force")  # kinds

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
_REFERENCE_WORDS = "ref reference soll set setpoint cmd command desired target sollwert goal demand"


def _group_by_word(groups: dict[str, str]) -> dict[str, str]:
    return {word: group for group, words in groups.items() for word in words.split()}


_KIND_OF = {unit: kind for kind, spellings in _UNITS_OF_KIND.items() for unit in spellings}
_UNIT_OF = {word: u for kind in _UNITS_OF_KIND.values() for word, u in _group_by_word(kind).items()}
_KIND_WORDS, _LOCATION_WORDS = _group_by_word(_KINDS), _group_by_word(_LOCATIONS)
_GREEK = str.maketrans({"θ": "theta ", "φ": "phi ", "ϕ": "phi ", "ω": "omega ", "\u03b1": "alpha "})


@dataclass(frozen=True, slots=True)
class Meaning:
    """What the head of a column says: `kind`, `location` and `unit` are empty where it is silent."""

    kind: str = ""
    location: str = ""
    unit: str = ""
    reference: bool = False  # a controller asked for it, it did not happen
    unknown_unit: str = ""  # what stands where a unit would
    symbol: str = ""  # of a state
    word: str = ""  # that says the kind
    backwards: bool = False  # against the state
    typed: bool = False  # the user has said it, and not the head


STATES = {
    "theta_1": ("angle", ROTOR),
    "theta_2": ("angle", GEARBOX),
    "w_1": ("speed", ROTOR),
    "w_2": ("speed", GEARBOX),
    "i": ("current", ""),
}


def parse_head(head: str, unit_below: str = "") -> Meaning:
    """Read the head of a column and what a row of units has below it; a long one says nothing."""
    if max(len(head), len(unit_below)) > MAX_LETTERS:
        return Meaning()
    base, unit, unknown_unit = _split_unit(head)
    if unit_below and not unit:
        unit = parse_unit(unit_below)
        unknown_unit = "" if unit else unit_below
    tokens = _tokens(base)
    if base in STATES and not unknown_unit:
        kind, location = STATES[base]
        if not unit or kind_of(unit) == kind:
            return Meaning(kind, location, unit, symbol=base, word=base)
    if not unit and not unknown_unit:
        tokens, unit = _split_last_unit(tokens)
    kind, word = _kind(tokens)
    if unit:
        kind = kind_of(unit)
    locations = [_LOCATION_WORDS[token] for token in tokens if token in _LOCATION_WORDS]
    location = TWIST if TWIST in locations else next(iter(locations), "")
    if location == TWIST:
        kind = kind or "angle"
    reference = any(token in _REFERENCE_WORDS.split() for token in tokens)
    return Meaning(kind, location, unit, reference, unknown_unit, word=word)


def parse_unit(text: str) -> str:
    """Return the unit as configs write it; empty where no rig has it."""
    if counts := _COUNTS_PER.fullmatch(text.strip()):
        turn = _UNIT_OF.get(counts[2]) == "revolution"
        text = f"count/{counts[1]}" if turn else f"count/({counts[1]}/{counts[2]})"
    elif not text.startswith(("count", "%")):
        text = text.strip().strip("[]()").replace(" ", "")
    known = _UNIT_OF.get(text) or _UNIT_OF.get(text.lower(), "")
    return known or (text if text and kind_of(text) else "")


def kind_of(unit: str) -> str:
    """Return the kind of quantity that has this unit; empty for a unit of none of them."""
    if unit in _KIND_OF:
        return _KIND_OF[unit]
    for kind, si in SI.items():
        with contextlib.suppress(ValueError):
            units.factor(unit, si)
            return kind
    return ""


def _split_unit(head: str) -> tuple[str, str, str]:
    """Name, unit and what stands where a unit would: `n [rpm]`, `w (rad/s)`, `n / rpm`, `n in rpm`."""
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
    """`phi_deg`, `w_rad_s`, `U_V`: a letter alone only if it is of the kind that the others name."""
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
    """The kind, and the word that says it; a letter alone says it at the beginning only."""
    named = [(_KIND_WORDS[token], token) for token in tokens if token in _KIND_WORDS]
    turns = any(kind == "angle" for kind, _ in named)
    if turns and (tokens[0] == "d" or {"dot", "dt", "rate"} & {*tokens}):
        return "speed", f"{named[0][1]} dot"
    if named:  # `angular speed`, `Position velocity`: the later kind is what is measured
        return named[-1]
    letter = tokens[0] if tokens and tokens[0] in _LETTERS else ""
    return _LETTERS.get(letter, ""), letter


MIN_SAMPLES = 20  # with fewer nothing is guessed
MAX_NUMBER = 1e12  # of a size that is believed
EVEN_STEPS = 1.02  # times the least step, of a column that may be a time


@dataclass(frozen=True, slots=True, eq=False)
class FileColumn:
    """One column `values (T,)` of a file; `address`: the entries of a config that name it."""

    name: str
    address: Mapping[str, str | int]
    values: Array
    meaning: Meaning
    file: int = 0  # among the files that make one record, 0 for that of the channels

    @property
    def key(self) -> tuple[object, ...]:
        """What the same column has in common in all records of one kind."""
        return self.file, *self.address.items()

    @property
    def command(self) -> str:
        """The text that stands for the column in `--columns`, before the `=`."""
        return ":".join(map(str, self.address.values()))

    @property
    def steps(self) -> Array:
        """From each row to the next, `(T - 1,)`; NaN where that is no number."""
        with np.errstate(all="ignore"):
            return np.diff(self.values)

    @property
    def counts_rows(self) -> bool:
        """Whether the column grows by one a row and is called neither a time nor a motion."""
        unsaid = not self.meaning.unit and self.meaning.kind not in ("time", "angle", "position")
        return unsaid and bool(np.all(self.steps == 1))

    @property
    def is_even(self) -> bool:
        """Whether the column grows in equal steps, as a time does, and is no row number."""
        least, most = self.steps.min(initial=np.inf), self.steps.max(initial=0.0)
        even = 1 / MAX_NUMBER < least <= most < min(MAX_NUMBER, EVEN_STEPS * least)
        return bool(even) and not self.counts_rows

    @property
    def range_text(self) -> str:
        """From which least value to which largest the column goes."""
        numbers = self.values[np.isfinite(self.values)]
        return f"{numbers.min():.4g} to {numbers.max():.4g}" if len(numbers) else "no numbers"


_QUANTITY = re.compile(r"(-?)([^\W\d][\w ]*?)\s*(?:\[([^\[\]]+)\]|\((.+)\))?")
_WORDS = {*_KIND_WORDS, *_LOCATION_WORDS, *_LETTERS, *_UNIT_OF, *_REFERENCE_WORDS.split(), "dot"}
_NAMES = {**STATES, "v": ("voltage", ""), "t_1": ("torque", ROTOR), "t_m": ("torque", MOTOR)} | {
    "t": ("time", ""),
    "twist": ("angle", TWIST),
}


# Of a train, by what is measured, and of which part.
_TRAIN_SYMBOL = re.compile(r"(theta|w|x|v|i|u|t|f)_([A-Za-z][A-Za-z0-9_]{0,29})")
KIND_OF_LETTER = {
    "theta": "angle",
    "w": "speed",
    "x": "position",
    "v": "velocity",
    "i": "current",
    "u": "voltage",
    "t": "torque",
    "f": "force",
}


def train_symbol(text: str) -> re.Match[str] | None:
    """Match a symbol of a train: its letter, and its part; None for one of the other rigs."""
    return None if text in _NAMES else _TRAIN_SYMBOL.fullmatch(text)


@dataclass(frozen=True, slots=True)
class NamedColumn:
    """What a user says of a column: `variable` or head, and of a matrix the `column` from 1."""

    text: str
    file: str
    variable: str
    column: int | None
    meaning: Meaning


def named_column(text: str, files: Collection[str]) -> NamedColumn:
    """Read `data:3=theta_2 [deg]`, perhaps behind one of `files` and a colon; raises `InputError`."""
    where, _, what = text.rpartition("=")
    file = next((name for name in files if where.startswith(f"{name}:")), "")
    match = re.fullmatch(r"(.+?)(?::(\d+))?", where.removeprefix(f"{file}:").strip())
    said = _QUANTITY.fullmatch(what.strip())
    sign, symbol, *units_said = said.groups("") if said else ("", "")
    meaning, written = parse_head(symbol), "".join(units_said)
    if (train := train_symbol(symbol)) or symbol in _NAMES:
        kind, location = (KIND_OF_LETTER[train[1]], "") if train else _NAMES[symbol]
        meaning = Meaning(kind, location, symbol=symbol, word=symbol)
    unit = parse_unit(written) if written else meaning.unit
    understood = meaning.symbol or {*_tokens(symbol)} <= _WORDS
    fits = understood and meaning.kind and (not (unit or written) or kind_of(unit) == meaning.kind)
    if match is None or not fits:
        why = "names no known quantity with a unit of it" if match else "names no column"
        known = f"`data:3=theta_2 [deg]`. Known quantities are {', '.join(_NAMES)}, of trains such "
        known += "as theta_load, i_motor, x_cart. Encoders count in count/2800 or count/(560/cm)"
        raise InputError.at("--columns", f"'{text}' {why}. Write for example {known}")
    meaning = dataclasses.replace(meaning, unit=unit, backwards=bool(sign), typed=True)
    return NamedColumn(text, file, match[1], int(match[2]) if match[2] else None, meaning)


def read_columns(
    table: RecordTable, named: Sequence[NamedColumn] = ()
) -> tuple[list[FileColumn], dict[str, str]]:
    """Return the columns of the length that most have, and why others are left out.

    Of `named` ones these alone, as they are said to be, and the time.  Raises `InputError` where one
    is not there, or where there are several records.
    """
    columns, left_out = _all_columns(table), dict(table.ignored)
    if named:
        picked = _pick(table, columns, named)
        names = {column.name for column in picked}
        others = [c for c in columns if c.name not in names and len(c.values) >= MIN_SAMPLES]
        left_out = {column.name: "is not named in --columns" for column in others}
        columns = picked
    _refuse_stillness(table, columns)
    if not named:
        _refuse_several_records(table, columns)
        columns = _named_by_file(table, columns)
    lengths = Counter(len(c.values) for c in columns if len(c.values) >= MIN_SAMPLES)
    length = max(lengths, key=lambda length: (lengths[length], length), default=MIN_SAMPLES)
    for column in columns:
        if (n := len(column.values)) != length:
            count = "one value" if n == 1 else f"{n} values"
            other = f"but the others have {length}" if lengths else f"and {length} are wanted"
            left_out[column.name] = f"has {count}, {other}"
    return [column for column in columns if len(column.values) == length], left_out


def _all_columns(table: RecordTable) -> list[FileColumn]:
    """Every column of the file; of a matrix of two of which the first grows, that is the time."""
    columns = []
    for position, (name, values) in enumerate(table.variables.items(), start=1):
        if values.ndim == 1:
            number = _number(table, name, position)
            address: dict[str, str | int] = {"column": number or name}
            head = table.labels.get(name, "" if number else name)
            meaning = _meaning(head, table.units.get(name, ""))
            columns.append(FileColumn(name, address, values, meaning))
            continue
        pair = values.shape[1] == 2 and bool(np.all(np.diff(values[:, 0]) > 0))
        says = [Meaning("time"), _meaning(name, "")] if pair else [Meaning()] * values.shape[1]
        for k, (x, meaning) in enumerate(zip(values.T, says, strict=True), start=1):
            address = {"variable": name, "column": k}
            columns.append(FileColumn(f"{name}, column {k}", address, x, meaning))
    return columns


def _pick(
    table: RecordTable, columns: Sequence[FileColumn], named: Sequence[NamedColumn]
) -> list[FileColumn]:
    """Those that are named, with what is said of them, and the time that stands beside them."""
    picked = []
    for name in named:
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
    """The name of the structure in which a signal stands."""
    return column.name.rpartition(".")[0].partition(".signals")[0]


def _refuse_stillness(table: RecordTable, columns: Sequence[FileColumn]) -> None:
    """A record in which no angle and no speed changes is none of a rig that moved."""
    moving = [c for c in columns if c.meaning.kind in MOTIONS and not c.meaning.reference]
    moving = [c for c in moving if MIN_SAMPLES <= np.isfinite(c.values).sum() <= MOST_GUESSED]
    if moving and not any((np.abs(c.steps) > 1 / MAX_NUMBER).any() for c in moving):
        names = ", ".join([column.name for column in moving[:4]] + ["..."] * (len(moving) > 4))
        message = f"nothing moved: {names} are the same in every row; mend the sensor, and "
        raise InputError.at(str(table.path), message + "record again, or name another column")


def _refuse_several_records(table: RecordTable, columns: Sequence[FileColumn]) -> None:
    """Structures that each have a time of their own, and are not called after a signal, are records."""
    columns = [column for column in columns if len(column.values) >= MIN_SAMPLES]
    times = dict.fromkeys(_structure(c) for c in columns if c.meaning.kind == "time")
    records = [name for name in times if name and parse_head(name).kind in ("", "time")]
    if len(records) > 1:
        signals = [c for c in columns if c.meaning.kind != "time" and _structure(c) in records]
        first = (signals or columns)[0]
        raise InputError.at(
            str(table.path),
            f"holds {len(records)} records: {', '.join(records)}. Name the columns of one, for example "
            f"{_columns_option([first])} ({first.name} goes from {first.range_text})",
        )


def _named_by_file(table: RecordTable, columns: list[FileColumn]) -> list[FileColumn]:
    """Where a single column beside the time says nothing, it is what the file is called."""
    signals = [c for c in columns if c.meaning.kind != "time" and len(c.values) >= MIN_SAMPLES]
    if len(signals) == 2 == len(columns) and not signals[0].meaning.kind:  # a time without a head
        signals = [column for column in signals if not column.is_even]
    named = parse_head(table.path.stem)
    if len(signals) != 1 or signals[0].meaning.kind or not named.kind:
        return columns
    meaning = dataclasses.replace(named, unit=signals[0].meaning.unit or named.unit)
    return [dataclasses.replace(c, meaning=meaning) if c is signals[0] else c for c in columns]


def _columns_option(columns: Sequence[FileColumn]) -> str:
    """Say what to type for columns of unknown meaning: a time, if one increases, and an angle."""
    times = [column for column in columns if column.is_even][:1]
    others = [column for column in columns if column not in times][:1]
    typed = [(column, "t [s]") for column in times]
    typed += [(c, "w_2 [rpm]" if c.meaning.kind else "theta_2 [deg]") for c in others]
    return " ".join(f'--columns "{column.command}={what}"' for column, what in typed)


def grouped(left_out: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return names of columns that are not used, and why, those with most in common last."""
    whys = dict.fromkeys(left_out.values())
    pairs = [([name for name, reason in left_out.items() if reason == why], why) for why in whys]
    return [("; ".join(names), why) for names, why in sorted(pairs, key=lambda pair: len(pair[0]))]


def unusable(
    record: Path, left_out: dict[str, str], why: str, columns: Sequence[FileColumn] = ()
) -> InputError:
    """Say why nothing can be made of a file, and what to type for `columns` of unknown meaning."""
    reasons = [Issue(str(record), f"column {names} {text}") for names, text in grouped(left_out)]
    typed = _columns_option(columns) or '--columns "speed=w_2 [rpm]"'
    message = f"{why}. Say what the columns are, for example {typed}, or write a config by hand"
    return InputError([Issue(str(record), message), *reasons])


def _meaning(name: str, unit_below: str) -> Meaning:
    """Of `rig.rotor.w`, the last part first; what that leaves open the whole may say."""
    last = re.split(r"\.(?=[^\W\d])", name)[-1]
    meaning, whole = parse_head(last, unit_below), parse_head(name, unit_below)
    if last == name or meaning.unknown_unit:
        return meaning
    return dataclasses.replace(
        meaning,
        kind=meaning.kind or (whole.kind if len(whole.word) > 1 else ""),  # `T1.x` is no time
        location=meaning.location or whole.location,
        word=meaning.word or whole.word,
    )


def _number(table: RecordTable, name: str, position: int) -> int | None:
    """Of a column of a text without a header, or with an empty or repeated head."""
    if table.lines is None:
        return None
    if match := re.fullmatch(r"\(column (\d+)\)", name):
        return int(match[1])
    return position if name == str(position) else None
