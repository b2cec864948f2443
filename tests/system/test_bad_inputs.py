"""What users get wrong: each mistake is named with value, line and a way out, and costs nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import systems
from scipy.io import savemat
from together import together

K_E = "k_e: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
J_1 = "j_1: {prior: uniform, low: 0.5, high: 1.5, relative: true}"
THETA_1 = "    theta_1: {column: theta_1, unit: rad, sigma: 0.05}\n"
W_1 = "    w_1: {column: w_1, unit: rad/s, sigma: 0.05}\n"
MEASURED = ("v: 8.0", "v: {column: v, unit: V}")
MAT = (
    ("file: small.csv", "file: small.mat"),
    ("{column: t,", "{variable: t,"),
    ("{column: theta_1", "{variable: theta_1"),
    ("{column: w_1", "{variable: w_1"),
)
TIMES = np.arange(101) * 0.05

type Change = tuple[str, str] | Callable[[Path], object]


@dataclass(frozen=True)
class Case:
    """`at`: text of the line that the error must name, or None for the file itself."""

    name: str
    changes: tuple[Change, ...]
    at: str | None
    says: tuple[str, ...]


def case(name: str, *changes: Change, at: str | None, says: tuple[str, ...] | str) -> Case:
    return Case(name, changes, at, (says,) if isinstance(says, str) else says)


def replaced(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "small.yaml").write_text(text, encoding="utf-8")


def config_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / "small.yaml").write_bytes(content)


def record_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / "small.csv").write_bytes(content)


def rows(change: Callable[[list[str]], list[str]]) -> Callable[[Path], object]:
    def apply(folder: Path) -> None:
        path = folder / "small.csv"
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")

    return apply


def cell(line: int, column: int, text: str) -> Callable[[Path], object]:
    """Another content of a cell; lines from 1 as an editor counts them, columns from 0."""

    def change(lines: list[str]) -> list[str]:
        cells = lines[line - 1].split(",")
        cells[column] = text
        return [*lines[: line - 1], ",".join(cells), *lines[line:]]

    return rows(change)


def with_column(head: str, value: Callable[[int], str]) -> Callable[[Path], object]:
    """A further column; `value` takes the line of the file."""
    return rows(
        lambda lines: [f"{text},{value(n) if n > 1 else head}" for n, text in enumerate(lines, 1)]
    )


def shifted(by: float) -> Callable[[Path], object]:
    def move(line: str) -> str:
        time, rest = line.split(",", 1)
        return f"{float(time) + by:.9g},{rest}"

    return rows(lambda lines: [lines[0], *map(move, lines[1:])])


def no_file(folder: Path) -> None:
    (folder / "small.yaml").unlink()


def folder_as_config(folder: Path) -> None:
    no_file(folder)
    (folder / "small.yaml").mkdir()


def no_record(folder: Path) -> None:
    (folder / "small.csv").unlink()


def folder_as_record(folder: Path) -> None:
    no_record(folder)
    (folder / "small.csv").mkdir()


def mat(**variables: object) -> Callable[[Path], object]:
    return lambda folder: savemat(folder / "small.mat", variables)


def mat_bytes(content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / "small.mat").write_bytes(content)


def prior(text: str) -> Change:
    return (K_E, f"k_e: {{{text}}}")


def on_w_1(text: str) -> Change:
    return (W_1, f"    w_1: {{{text}}}\n")


def before_map(text: str) -> Change:
    return ("map: {", f"{text}\nmap: {{")


GOOD_SINE = {"t": TIMES, "theta_1": np.sin(TIMES)}

NOT_A_CONFIG = [
    case(
        "missing config",
        no_file,
        at=None,
        says=("small.yaml", "there is no such file", "check the path"),
    ),
    case(
        "config is a folder",
        folder_as_config,
        at=None,
        says=("this is a folder", "name the .yaml file"),
    ),
    case("empty config", replaced(""), at=None, says=("a config is a mapping", "name: my_rig")),
    case("comments only", replaced("# nothing\n"), at=None, says="a config is a mapping"),
    case(
        "list at the top",
        replaced("- name: small\n- seed: 7\n"),
        at=None,
        says="a config is a mapping",
    ),
    case("text at the top", replaced("hello\n"), at=None, says="a config is a mapping"),
    case(
        "binary config",
        config_bytes(b"\x00\xff\xfe\x80" * 99),
        at=None,
        says="not a text file in UTF-8",
    ),
    case(
        "control character",
        ("seed: 7", "seed: \x01"),
        at="seed: \x01",
        says=("U+0001", "remove it"),
    ),
    case(
        "seed that no file can hold",
        ("seed: 7", f"seed: {2**64}"),
        at="seed: 18446744073709551616",
        says=("seed", "less than 18446744073709551616"),
    ),
    case(
        "tab in the indentation",
        ("  v: 8.0", "\tv: 8.0"),
        at="v: 8.0",
        says=("a tab", "wants spaces"),
    ),
    case(
        "list that is not closed",
        ("name: small", "name: [small"),
        at="seed: 7",
        says="this is not YAML",
    ),
    case(
        "two keys on a line",
        ("name: small", "name: small seed: 7"),
        at="name: small",
        says="each key on its own line",
    ),
    case("two documents", ("seed: 7", "seed: 7\n---"), at="---", says="another document"),
    case(
        "unknown tag",
        ("seed: 7", "seed: !!python/object:os.system 7"),
        at="seed: !!",
        says="this is not YAML",
    ),
    case("unknown alias", ("seed: 7", "seed: *x"), at="seed: *x", says="undefined alias 'x'"),
    case(
        "alias inside itself",
        ("seed: 7", "seed: &x [*x]"),
        at=None,
        says=("an alias", "write them out flat"),
    ),
    case(
        "nested too deeply",
        ("seed: 7", f"seed: {'[' * 600}{']' * 600}"),
        at=None,
        says="nested too deeply",
    ),
    case(
        "mapping as a key",
        ("seed: 7", "seed: 7\n? {a: 1}\n: 2"),
        at="? {a: 1}",
        says="write a word before the colon",
    ),
    case(
        "number as a key",
        ("seed: 7", "seed: 7\n1: 2"),
        at="1: 2",
        says=("1: unknown key", "known: "),
    ),
    case(
        "a number of 5000 digits",
        ("seed: 7", f"seed: {'9' * 5000}"),
        at="seed:",
        says=("a number of 5000 digits", "at most 40"),
    ),
]

KEYS = [
    case(
        "unknown section",
        ("seed: 7", "seed: 7\nsampelr: {walkers: 8}"),
        at="sampelr",
        says=("sampelr: unknown key", "did you mean sampler?"),
    ),
    case(
        "unknown key of record",
        ("  file:", "  delimter: ','\n  file:"),
        at="delimter",
        says=("record.delimter", "did you mean delimiter?"),
    ),
    case(
        "unknown key of time",
        ("time: {", "time: {hold: zero, "),
        at="hold: zero",
        says=("record.time.hold: unknown key", "known: column"),
    ),
    case(
        "unknown key of a channel",
        on_w_1("column: w_1, unit: rad/s, sgima: 1"),
        at="sgima",
        says=("record.channels.w_1.sgima", "did you mean sigma?"),
    ),
    case(
        "unknown key of a prior",
        prior("prior: uniform, lo: 0.5, high: 1.5"),
        at="lo: 0.5",
        says=("parameters.k_e.lo: unknown key", "did you mean low?"),
    ),
    case(
        "unknown input",
        ("  v: 8.0", "  v: 8.0\n  u: 3"),
        at="  u: 3",
        says=("inputs.u: unknown key", "known: t_0, t_1, t_m, theta_2, v, w_2"),
    ),
    case(
        "unknown state in initial",
        before_map("initial: {w_3: 1}"),
        at="initial:",
        says=("initial.w_3", "did you mean w_2?"),
    ),
    case(
        "unknown key of map",
        ("starts: 1", "start: 1"),
        at="map:",
        says=("map.start", "did you mean starts?"),
    ),
    case(
        "unknown key of sampler",
        ("walkers: 8", "walker: 8"),
        at="sampler:",
        says=("sampler.walker", "did you mean walkers?"),
    ),
    case(
        "unknown key of output",
        ("predictive_draws", "predictive"),
        at="output:",
        says=("output.predictive", "did you mean predictive_draws?"),
    ),
    case(
        "unknown size of figures",
        ("predictive_draws", "size: triple, predictive_draws"),
        at="output:",
        says=("output.size", "'triple' is not possible; known: single, double"),
    ),
    case(
        "unknown format of figures",
        ("predictive_draws", "formats: [pdf, jpg], predictive_draws"),
        at="output:",
        says=("output.formats.1", "'jpg' is not possible"),
    ),
    case(
        "no format of figures",
        ("predictive_draws", "formats: [], predictive_draws"),
        at="output:",
        says=("output.formats",),
    ),
    case(
        "pixels that nobody sees",
        ("predictive_draws", "dpi: 5, predictive_draws"),
        at="output:",
        says=("output.dpi", "50"),
    ),
    case(
        "a figure of what is no unknown",
        ("predictive_draws", "parameters: [k_a], predictive_draws"),
        at="output:",
        says=("output.parameters.0", "k_a is no unknown"),
    ),
    case(
        "unknown key of simulation",
        ("duration: 5", "durations: 5"),
        at="simulation:",
        says=("simulation.durations", "did you mean duration?"),
    ),
    case(
        "unknown key of model",
        before_map("model: {im: 0.125}"),
        at="model:",
        says=("model.im", "did you mean i_m?"),
    ),
    case(
        "unknown key of nominal",
        before_map("nominal: {k_t: 3}"),
        at="nominal: {",
        says=("nominal.k_t", "did you mean k_T?"),
    ),
    case(
        "misspelt symbol",
        ("k_T: nominal", "k_t: nominal"),
        at="k_t: nominal",
        says=("parameters.k_t: unknown symbol", "did you mean k_T?"),
    ),
    case(
        "duplicate key",
        ("seed: 7", "seed: 7\nseed: 8"),
        at="seed: 8",
        says=("seed: this key stands already in line 2", "keep one"),
    ),
    case(
        "duplicate parameter",
        ("k_T: nominal", "k_T: nominal\n  k_T: 3"),
        at="k_T: 3",
        says=("parameters.k_T", "already in line 15"),
    ),
]

TYPES = [
    case(
        "fraction",
        before_map("model: {i_m: 1/8}"),
        at="i_m",
        says=("model.i_m: '1/8' is not a number", "write for example 0.125"),
    ),
    case(
        "fraction of a parameter",
        ("k_T: nominal", "k_T: 1/8"),
        at="k_T",
        says=("parameters.k_T: '1/8'", "write for example 0.125"),
    ),
    case(
        "decimal comma",
        ("v: 8.0", "v: 8,0"),
        at="v: 8,0",
        says=("inputs.v: '8,0' is not a number", "the decimal sign is a point"),
    ),
    case(
        "decimal comma in braces",
        on_w_1("column: w_1, unit: rad/s, sigma: 0,05"),
        at="0,05",
        says=("record.channels.w_1.05", "decimal comma", "write a point"),
    ),
    case(
        "unit behind a number",
        ("v: 8.0", "v: 8 V"),
        at="v: 8 V",
        says=("inputs.v: '8 V' is not a number", "leave out the unit", "{value: ..., unit: ...}"),
    ),
    case(
        "yes as a number",
        ("v: 8.0", "v: yes"),
        at="v: yes",
        says=("inputs.v: 'yes' is not a number", "can stand here"),
    ),
    case(
        "true as a number",
        ("v: 8.0", "v: true"),
        at="v: true",
        says=("inputs.v: true is not a number", "write the value"),
    ),
    case(
        "yes as a switch",
        prior("prior: uniform, low: 0.5, high: 1.5, relative: yes"),
        at="relative: yes",
        says=("k_e.relative: 'yes'", "`true` nor `false`"),
    ),
    case(
        "nothing as a number",
        ("v: 8.0", "v:"),
        at="  v:",
        says=("inputs.v: nothing is not a number", "write the value"),
    ),
    case("infinite", ("v: 8.0", "v: .inf"), at="v: .inf", says=("inputs.v: inf", "finite number")),
    case(
        "not a number", ("v: 8.0", "v: .nan"), at="v: .nan", says=("inputs.v: nan", "finite number")
    ),
    case(
        "word for a parameter",
        ("k_T: nominal", "k_T: nomnal"),
        at="nomnal",
        says=("parameters.k_T: 'nomnal'", "`nominal`"),
    ),
    case(
        "negative parameter",
        ("k_T: nominal", "k_T: -1"),
        at="k_T: -1",
        says=("parameters.k_T: -1", "greater than 0"),
    ),
    case(
        "list for a parameter",
        ("k_T: nominal", "k_T: [1, 2]"),
        at="k_T: [",
        says="parameters.k_T: [1, 2] is not a number",
    ),
    case(
        "date as a seed",
        ("seed: 7", "seed: 2013-11-11"),
        at="seed",
        says="seed: 2013-11-11 is not a whole number",
    ),
    case(
        "negative seed",
        ("seed: 7", "seed: -7"),
        at="seed",
        says=("seed: -7", "greater than or equal to 0"),
    ),
    case(
        "path as a name",
        ("name: small", "name: ../small"),
        at="name",
        says=("name: '../small'", "may only have letters"),
    ),
    case(
        "number as a name",
        ("name: small", "name: 1"),
        at="name",
        says=("name: 1 is not text", "put it in quotes"),
    ),
    case(
        "walkers as a float",
        ("walkers: 8", "walkers: 8.0"),
        at="sampler",
        says="sampler.walkers: 8.0 is not a whole number",
    ),
    case(
        "word for a section",
        ("map: {starts: 1, evaluations: 500}", "map: fast"),
        at="map: fast",
        says=("map: 'fast'", "`key: value` entries"),
    ),
    case(
        "word for the time",
        ("time: {column: t, unit: s}", "time: t"),
        at="time: t",
        says=("record.time: 't'", "`key: value` entries"),
    ),
    case(
        "empty channels",
        ("  channels:\n" + THETA_1 + W_1, "  channels: {}\n"),
        at="channels",
        says=("record.channels", "at least 1"),
    ),
    case(
        "window of three",
        ("  channels:", "  window: [0, 1, 2]\n  channels:"),
        at="window",
        says=("record.window: 3 entries", "at most 2"),
    ),
    case(
        "column zero",
        ("column: w_1", "column: 0"),
        at="    w_1",
        says=("record.channels.w_1.column: 0", "greater than or equal to 1"),
    ),
]

MISSING = [
    case(
        "no seed",
        ("seed: 7\n", ""),
        at="name: small",
        says=("seed: this entry is missing", "bayesdrill schema"),
    ),
    case(
        "no inputs",
        ("inputs:\n  v: 8.0\n", ""),
        at="name: small",
        says="inputs: this entry is missing",
    ),
    case(
        "no channels",
        ("  channels:\n" + THETA_1 + W_1, ""),
        at="record:",
        says="record.channels: this entry is missing",
    ),
    case(
        "no sigma",
        on_w_1("column: w_1, unit: rad/s"),
        at="    w_1",
        says="record.channels.w_1.sigma: this entry is missing",
    ),
    case(
        "no unit",
        on_w_1("column: w_1, sigma: 1"),
        at="    w_1",
        says="record.channels.w_1.unit: this entry is missing",
    ),
    case(
        "no column",
        on_w_1("unit: rad/s, sigma: 1"),
        at="    w_1",
        says=("record.channels.w_1", "`column:`"),
    ),
    case(
        "no prior family",
        prior("low: 0.5, high: 1.5"),
        at="low: 0.5, high: 1.5}",
        says=("parameters.k_e: the entry `prior:` is missing", "uniform"),
    ),
    case(
        "no k_T",
        ("  k_T: nominal\n", ""),
        at="parameters:",
        says=("parameters.k_T: missing", "k_T: nominal", "0.12"),
    ),
    case(
        "k_T without a value",
        ("k_T: nominal", "k_T:"),
        at="  k_T:",
        says=("parameters.k_T: missing", "k_T: nominal"),
    ),
]

PRIORS = [
    case(
        "low above high",
        prior("prior: uniform, low: 0.09, high: 0.03"),
        at="k_e",
        says=("parameters.k_e: low 0.09", "high 0.03", "exchange"),
    ),
    case(
        "low equal to high",
        prior("prior: uniform, low: 0.06, high: 0.06"),
        at="k_e",
        says=("parameters.k_e: low 0.06", "high 0.06"),
    ),
    case(
        "negative bound",
        prior("prior: uniform, low: -0.5, high: 0.1"),
        at="k_e",
        says=("parameters.k_e.low: -0.5", "greater than or equal to 0"),
    ),
    case(
        "zero sd",
        prior("prior: normal, mean: 0.06, sd: 0"),
        at="k_e",
        says=("parameters.k_e.sd: 0", "greater than 0"),
    ),
    case(
        "log-uniform from zero",
        prior("prior: log_uniform, low: 0, high: 1"),
        at="k_e",
        says=("parameters.k_e.low: 0", "greater than 0"),
    ),
    case(
        "excludes the start, absolute",
        prior("prior: uniform, low: 0.5, high: 1.5"),
        at="k_e",
        says=(
            "parameters.k_e: the nominal value 0.06016 is outside",
            "0.5 to 1.5",
            "widen",
            "start:",
        ),
    ),
    case(
        "excludes the start, relative",
        prior("prior: uniform, low: 1.2, high: 1.5, relative: true"),
        at="k_e",
        says=("the nominal value 0.06016 is outside", "0.072192 to 0.09024"),
    ),
    case(
        "excludes its own start",
        prior("prior: uniform, low: 0.01, high: 0.1, start: 1.0"),
        at="k_e",
        says=("the start 1 is outside", "widen"),
    ),
    case(
        "misspelt family",
        prior("prior: unifrom, low: 0.01, high: 0.1"),
        at="k_e",
        says=("parameters.k_e", "'unifrom'", "did you mean uniform?"),
    ),
    case(
        "unknown family",
        prior("prior: gamma, low: 0.01, high: 0.1"),
        at="k_e",
        says=("'gamma'", "known: uniform, log_uniform"),
    ),
    case(
        "nothing unknown",
        (K_E, "k_e: nominal"),
        (J_1, "j_1: nominal"),
        at="parameters:",
        says=("parameters: nothing is unknown", "give at least one"),
    ),
]

NAMES = [
    case(
        "own of one experiment, and no name of a parameter",
        ("inputs:\n", "own: [zz]\ninputs:\n"),
        at="own: [zz]",
        says=("own: there is one experiment alone", "remove this entry"),
    ),
    case(
        "unknown table",
        before_map("nominal: tables_23"),
        at="nominal: tables_23",
        says=("nominal.table: 'tables_23'", "did you mean tables_2_3?"),
    ),
    case(
        "unknown model",
        before_map("model: {name: motor_shft}"),
        at="model:",
        says=("model.name: 'motor_shft'", "did you mean motor_shaft?"),
    ),
    case(
        "unknown method",
        ("map: {", "map: {method: nelder, "),
        at="map:",
        says=("map.method: 'nelder'", "did you mean nelder_mead?"),
    ),
    case(
        "unknown move",
        ("walkers: 8", "walkers: 8, moves: {snooker: 1}"),
        at="sampler:",
        says=("sampler.moves.snooker", "known: differential_evolution, stretch"),
    ),
    case(
        "moves of no weight",
        ("walkers: 8", "walkers: 8, moves: {stretch: 0}"),
        at="sampler:",
        says=("sampler.moves: no move but independence has a share", "give another move one"),
    ),
    case(
        "independence alone",
        ("walkers: 8", "walkers: 8, moves: {independence: 1}"),
        at="sampler:",
        says=("sampler.moves: no move but independence has a share", "never leaves a place"),
    ),
    case(
        "hardly any steps",
        ("max_steps: 500", "max_steps: 99"),
        at="sampler:",
        says=("sampler.max_steps: 99", "greater than or equal to 100"),
    ),
    case(
        "the pilot of former versions",
        ("walkers: 8", "walkers: 8, pilot: 100"),
        at="sampler:",
        says=("sampler.pilot", "known: ", "walkers"),
    ),
    case(
        "the coordinates of former versions",
        before_map("coordinates: modal"),
        at="coordinates:",
        says=("coordinates", "known: ", "sampler"),
    ),
    case(
        "odd walkers",
        ("walkers: 8", "walkers: 9"),
        at="sampler:",
        says=("sampler.walkers: 9 walkers", "an even number"),
    ),
    case(
        "too few walkers",
        ("walkers: 8", "walkers: 4"),
        ("k_T: nominal", "k_T: {prior: uniform, low: 0.05, high: 0.2}"),
        at="sampler:",
        says=("sampler.walkers: 4 walkers", "twice the 3 unknowns"),
    ),
    case(
        "too few ensembles",
        ("walkers: 8", "ensembles: 3"),
        at="sampler:",
        says=("sampler.ensembles: 3", "equal to 4"),
    ),
    case(
        "unknown channel",
        ("    w_1: {", "    w_3: {"),
        at="    w_3",
        says=("record.channels.w_3: 'w_3' is not a state", "did you mean w_2?", "measures:"),
    ),
    case(
        "channel that is no name",
        ("    w_1: {", "    w-1: {"),
        at="    w-1",
        says=("record.channels.w-1", "use letters"),
    ),
    case(
        "unknown state measured",
        ("    w_1: {", "    w_1: {measures: w_1 - w_3, "),
        at="    w_1",
        says=("record.channels.w_1.measures: 'w_3'", "did you mean w_2?"),
    ),
    case(
        "product of states",
        ("    w_1: {", "    w_1: {measures: w_1*w_2, "),
        at="    w_1",
        says=("'w_1 * w_2' is not linear", "only sums of multiples"),
    ),
    case(
        "call in measures",
        ("    w_1: {", "    w_1: {measures: '__import__(1)', "),
        at="    w_1",
        says="is not linear",
    ),
    case(
        "constant in measures",
        ("    w_1: {", "    w_1: {measures: w_1 + 3, "),
        at="    w_1",
        says="has a constant term",
    ),
    case(
        "zero measures",
        ("    w_1: {", "    w_1: {measures: w_1 - w_1, "),
        at="    w_1",
        says=("is zero whatever", "name one of"),
    ),
    case(
        "empty measures",
        ("    w_1: {", "    w_1: {measures: '', "),
        at="    w_1",
        says=("'' is not a formula", "theta_1 - theta_2"),
    ),
    case(
        "endless measures",
        ("    w_1: {", f"    w_1: {{measures: '{'-' * 1900}w_1', "),
        at="    w_1",
        says="is not a formula",
    ),
    case(
        "infinite weight",
        ("    w_1: {", "    w_1: {measures: 1e999*w_1, "),
        at="    w_1",
        says=("infinite weight", "smaller number"),
    ),
    case(
        "mixed units",
        ("    w_1: {", "    w_1: {measures: w_1 + theta_2, "),
        at="    w_1",
        says=("adds different units", "w_1 [rad/s], theta_2 [rad]"),
    ),
    case(
        "unknown unit",
        ("unit: rad/s", "unit: radd/s"),
        at="    w_1",
        says=("record.channels.w_1.unit: unit 'radd/s' is not known", "rad/s, deg/s or rpm"),
    ),
    case(
        "unit in a block",
        (W_1, "    w_1:\n      column: w_1\n      unit: radd/s\n      sigma: 1\n"),
        at="unit: radd/s",
        says="record.channels.w_1.unit: unit 'radd/s'",
    ),
    case(
        "unit of another dimension",
        ("unit: rad/s", "unit: V"),
        at="    w_1",
        says=("unit 'V' is not a unit of rad/s", "write rad/s"),
    ),
    case(
        "unit of an input",
        ("v: 8.0", "v: {value: 8, unit: A}"),
        at="  v:",
        says=("inputs.v.unit: unit 'A'", "write V or mV"),
    ),
    case(
        "unit of the time",
        ("unit: s}", "unit: m}"),
        at="time:",
        says=("record.time.unit: unit 'm'", "s or ms"),
    ),
    case(
        "unit of a state",
        before_map("initial: {w_1: {value: 1, unit: V}}"),
        at="initial:",
        says=("initial.w_1.unit: unit 'V'", "rpm"),
    ),
    case(
        "sigma zero",
        on_w_1("column: w_1, unit: rad/s, sigma: 0"),
        at="    w_1",
        says=("record.channels.w_1.sigma: 0", "greater than 0"),
    ),
    case(
        "sigma negative",
        on_w_1("column: w_1, unit: rad/s, sigma: -1"),
        at="    w_1",
        says=("record.channels.w_1.sigma: -1", "greater than 0"),
    ),
    case(
        "sigma in words",
        on_w_1("column: w_1, unit: rad/s, sigma: unknown"),
        at="    w_1",
        says=("sigma: 'unknown' is not a number", "entries can stand here"),
    ),
    case(
        "sigma relative",
        on_w_1(
            "column: w_1, unit: rad/s, sigma: {prior: uniform, low: 0.1, high: 1, relative: true}"
        ),
        at="    w_1",
        says=("record.channels.w_1.sigma: sigma has no nominal value", "in the unit of the column"),
    ),
    case(
        "sigma in a block",
        (
            W_1,
            "    w_1:\n      column: w_1\n      unit: rad/s\n"
            "      sigma: {prior: uniform, low: 1, high: 0.5}\n",
        ),
        at="sigma: {prior",
        says="low 1 is not below high 0.5",
    ),
    case(
        "half a simulation",
        ("duration: 5, ", ""),
        at="simulation:",
        says=("simulation", "give both or neither"),
    ),
    case(
        "the other half of a simulation",
        (", rate: 20", ""),
        at="simulation:",
        says=("simulation", "give both or neither"),
    ),
    case(
        "simulated noise of no channel",
        ("duration: 5", "sigma: {w_3: 1}, duration: 5"),
        at="simulation:",
        says=("simulation.sigma.w_3", "did you mean w_1?"),
    ),
    case(
        "initial time with measured inputs",
        ("v: 8.0", "v: {column: w_1, unit: V}\ninitial: {time: 0}"),
        at="initial:",
        says=("initial.time", "remove this entry"),
    ),
    case(
        "unknown hold",
        ("v: 8.0", "v: {column: w_1, unit: V, hold: second}"),
        at="  v:",
        says=("inputs.v.hold: 'second'", "known: zero, first"),
    ),
    case(
        "different holds",
        ("v: 8.0", "v: {column: w_1, unit: V, hold: first}\n  t_1: {column: theta_1, unit: N*m}"),
        at="inputs:",
        says="need the same `hold:`",
    ),
]

RECORDS = [
    case(
        "a column smaller than anything that is measured",
        rows(
            lambda lines: [
                lines[0],
                *(f"{line.rpartition(',')[0]},{n % 7}e-320" for n, line in enumerate(lines[1:])),
            ]
        ),
        at="    w_1",
        says=("column 'w_1' varies by 6e-320", "which nothing measures"),
    ),
    case(
        "times smaller than anything that is measured",
        rows(
            lambda lines: [
                lines[0],
                *(f"{n}e-310,{line.partition(',')[2]}" for n, line in enumerate(lines[1:])),
            ]
        ),
        at="  time:",
        says=("time varies by 1e-308", "check the column"),
    ),
    case(
        "steps of time smaller than any",
        rows(lambda lines: [*lines[:2], f"1e-40,{lines[2].partition(',')[2]}", *lines[3:]]),
        at="  time:",
        says=("time has steps of 1e-40 s", "check the column and its unit"),
    ),
    case(
        "numbers whose squares are none",
        cell(9, 1, "1e200"),
        cell(12, 1, "-1e300"),
        at="    theta_1",
        says=("column 'theta_1' has 2 numbers beyond 1e+40, at line 9, line 12", "mend or cut"),
    ),
    case(
        "record missing",
        no_record,
        at="file:",
        says=("record.file", "small.csv", "there is no such file"),
    ),
    case(
        "record misspelt",
        ("small.csv", "smal.csv"),
        at="file:",
        says=("smal.csv: there is no such file", "did you mean small.csv?"),
    ),
    case(
        "record in no folder",
        ("small.csv", "data/small.csv"),
        at="file:",
        says="the folder data does not exist",
    ),
    case(
        "record is a folder",
        folder_as_record,
        at="file:",
        says=("is a folder", "name a file in it"),
    ),
    case(
        "record empty", record_bytes(b""), at="file:", says=("the file is empty", "write it again")
    ),
    case(
        "record of a header",
        rows(lambda lines: lines[:1]),
        at="file:",
        says=("has a header but no data", "record again"),
    ),
    case(
        "record binary",
        record_bytes(bytes(range(256)) * 4),
        at="file:",
        says=("is a binary file", "export it as CSV"),
    ),
    case(
        "record a spreadsheet",
        record_bytes(b"PK\x03\x04abc"),
        at="file:",
        says=("is a spreadsheet", "export it as CSV"),
    ),
    case(
        "unknown ending",
        ("small.csv", "small.xlsx"),
        at="file:",
        says=("'.xlsx' is unknown", ".csv"),
    ),
    case(
        "everything skipped",
        ("  time:", "  skip_rows: 900\n  time:"),
        at="file:",
        says=("holds no data", "900 lines of skip_rows"),
    ),
    case(
        "header denied",
        ("  time:", "  header: false\n  time:"),
        at="file:",
        says=("line 1: column '1': 't' is not a number", "skip_rows"),
    ),
    case(
        "other format",
        ("  time:", "  format: mat\n  time:"),
        at="file:",
        says=("is not a MATLAB file", "save it"),
    ),
    case(
        "missing column",
        ("column: w_1", "column: w1"),
        at="    w_1",
        says=("record.channels.w_1.column", "no column 'w1'", "did you mean w_1?"),
    ),
    case(
        "missing time column",
        ("column: t,", "column: time,"),
        at="time:",
        says=("record.time.column", "no column 'time'", "t, theta_1, w_1"),
    ),
    case(
        "column in a block",
        (W_1, "    w_1:\n      unit: rad/s\n      column: w1\n      sigma: 1\n"),
        at="column: w1",
        says="no column 'w1'",
    ),
    case(
        "column out of range",
        ("column: w_1", "column: 9"),
        at="    w_1",
        says=("no column 9", "1 to 3: t, theta_1, w_1"),
    ),
    case(
        "column among 300",
        ("column: w_1", "column: w1"),
        with_column(",".join(f"x_{i}" for i in range(297)), lambda _: ",".join("1" * 297)),
        at="    w_1",
        says=("no column 'w1'", "did you mean w_1?"),
    ),
    case(
        "variable of a text file",
        ("{column: w_1", "{variable: w_1"),
        at="    w_1",
        says=("has no variable 'w_1'", "give the column"),
    ),
    case(
        "name that stands twice",
        (THETA_1, ""),
        rows(lambda lines: ["t,w_1,w_1", *lines[1:]]),
        at="    w_1",
        says=("stands 2 times in the header", "give the number"),
    ),
    case(
        "NaN",
        cell(5, 2, "nan"),
        at="    w_1",
        says=("column 'w_1' has 1 value", "line 5", "mend or cut"),
    ),
    case("empty cell", cell(5, 2, ""), at="    w_1", says=("1 value without a number", "line 5")),
    case(
        "NaN everywhere",
        rows(lambda lines: [lines[0], *(f"{line.rsplit(',', 1)[0]},nan" for line in lines[1:])]),
        at="    w_1",
        says=("101 values", "line 2", "and 96 more"),
    ),
    case(
        "infinite cell", cell(7, 1, "-inf"), at="    theta_1", says=("column 'theta_1'", "line 7")
    ),
    case("NaN in the time", cell(9, 0, "nan"), at="time:", says=("record.time", "line 9")),
    case(
        "text in a cell",
        cell(6, 2, "oops"),
        at="file:",
        says=("line 6: column 'w_1': 'oops' is not a number", "mend the cells"),
    ),
    case(
        "ragged row",
        cell(6, 2, "1,2"),
        at="file:",
        says=("line 6: 4 cells where 3 are due", "mend the rows"),
    ),
    case(
        "time goes back",
        rows(lambda lines: [*lines[:5], lines[6], lines[5], *lines[7:]]),
        at="time:",
        says=("time does not increase", "line 7", "0.25 s is followed by 0.2 s", "sort the rows"),
    ),
    case(
        "time repeated",
        rows(lambda lines: [*lines[:6], *lines[5:]]),
        at="time:",
        says=("time does not increase", "line 7", "remove repeated"),
    ),
    case(
        "constant channel",
        rows(lambda lines: [lines[0], *(f"{line.rsplit(',', 1)[0]},1.5" for line in lines[1:])]),
        at="    w_1",
        says=("1.5 in every row", "leave the channel out"),
    ),
    case(
        "one sample",
        rows(lambda lines: lines[:2]),
        at="file:",
        says=("1 sample", "use a longer record"),
    ),
    case(
        "fewer samples than unknowns",
        (THETA_1, ""),
        ("k_T: nominal", "k_T: {prior: uniform, low: 0.05, high: 0.2}"),
        rows(lambda lines: lines[:3]),
        at="file:",
        says=("2 samples", "3 unknowns", "fix parameters"),
    ),
    case(
        "window reversed",
        ("  channels:", "  window: [2, 1]\n  channels:"),
        at="window",
        says="record.window: 2 s is not before 1 s",
    ),
    case(
        "window empty",
        ("  channels:", "  window: [20, 21]\n  channels:"),
        at="window",
        says=("record.window: no sample", "0 to 5 s"),
    ),
    case(
        "window of one sample",
        ("  channels:", "  window: [0, 0.01]\n  channels:"),
        at="window",
        says=("record.window: 1 sample", "longer"),
    ),
    case(
        "record before the initial state",
        shifted(-1.0),
        at="record:",
        says=("at 0 s", "first sample at -1 s", "initial: {time: ...}"),
    ),
    case(
        "initial state after the record's start",
        before_map("initial: {time: 1}"),
        at="initial:",
        says=("initial.time", "at 1 s", "first sample at 0 s"),
    ),
    case(
        "measured input missing",
        MEASURED,
        at="  v:",
        says=("inputs.v.column", "no column 'v'", "known: t, theta_1, w_1"),
    ),
    case(
        "measured input NaN",
        MEASURED,
        with_column("v", lambda line: "nan" if line == 4 else "8"),
        at="  v:",
        says=("inputs.v.column", "line 4"),
    ),
    case(
        "absurd values",
        cell(6, 2, "1e300"),
        at="    w_1",
        says=("1 number beyond 1e+40", "line 6"),
    ),
    case(
        "variable missing",
        *MAT,
        mat(**GOOD_SINE),
        at="    w_1",
        says=("no variable 'w_1'", "known: t, theta_1"),
    ),
    case(
        "variable misspelt",
        *MAT,
        mat(**GOOD_SINE, w1=TIMES),
        at="    w_1",
        says=("no variable 'w_1'", "did you mean w1?"),
    ),
    case(
        "variable is a struct",
        *MAT,
        mat(**GOOD_SINE, w_1={"value": TIMES}),
        at="    w_1",
        says=("is a struct", "w_1.value"),
    ),
    case(
        "variable is a cell array",
        *MAT,
        mat(**GOOD_SINE, w_1=np.array([1, "a"], dtype=object)),
        at="    w_1",
        says=("is a cell array", "cell2mat"),
    ),
    case(
        "variable of several columns",
        *MAT,
        mat(**GOOD_SINE, w_1=np.stack([TIMES, TIMES], 1)),
        at="    w_1",
        says=("101 rows and 2 columns", "from 1 to 2"),
    ),
    case(
        "variable too short",
        *MAT,
        mat(**GOOD_SINE, w_1=TIMES[:50]),
        at="    w_1",
        says=("50 values, but the time has 101", "one recording"),
    ),
    case(
        "variable too long",
        *MAT,
        mat(**GOOD_SINE, w_1=np.arange(200.0)),
        at="    w_1",
        says=("200 values, but the time has 101", "one recording"),
    ),
    case(
        "damaged v7.3",
        *MAT,
        mat_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(100)),
        at="file:",
        says=("is damaged or cut short", "save it again"),
    ),
    case(
        "damaged v5",
        *MAT,
        mat_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM\x0e\x00\x00\x00"),
        at="file:",
        says=("is damaged or cut short", "save it again"),
    ),
    case(
        "text called .mat",
        *MAT,
        mat_bytes(b"t,w_1\n0,1\n"),
        at="file:",
        says=("is not a MATLAB file", "ending .csv"),
    ),
]

CASES = [*NOT_A_CONFIG, *KEYS, *TYPES, *MISSING, *PRIORS, *NAMES, *RECORDS]


def make(folder: Path, case: Case) -> None:
    """The good experiment with the case's mistake."""
    systems.small(folder, *(change for change in case.changes if isinstance(change, tuple)))
    for change in case.changes:
        if callable(change):
            change(folder)


def label(folder: Path, at: str | None) -> str:
    """`small.yaml:<line>` of the one line of the config that holds `at`."""
    if at is None:
        return "small.yaml"
    lines = (folder / "small.yaml").read_text(encoding="utf-8").split("\n")
    found = [number for number, line in enumerate(lines, start=1) if at in line]
    assert len(found) == 1, f"{at!r} in lines {found}"
    return f"small.yaml:{found[0]}:"


def assert_a_message(ran: systems.Ran) -> None:
    """Status 2, and on stderr what fits one screen; nothing on stdout."""
    assert ran.status == 2, ran.text
    assert ran.out == ""
    assert "Traceback" not in ran.err
    lines = ran.err.splitlines()
    assert 1 <= len(lines) <= 24
    assert max(map(len, lines)) <= 400


def test_the_cases_are_many_and_named_once() -> None:
    assert len(CASES) >= 40
    assert len({case.name for case in CASES}) == len(CASES)


def test_the_good_experiment_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    systems.small(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = systems.listing(tmp_path)
    ran = systems.cli("check", "small.yaml")
    assert (ran.status, ran.err) == (0, "")
    assert "would run" in ran.out
    assert systems.listing(tmp_path) == before


@together("case", CASES, ids=lambda case: case.name)
def test_a_mistake_is_named_with_its_place_and_a_way_out(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make(tmp_path, case)
    monkeypatch.chdir(tmp_path)
    before = systems.listing(tmp_path)
    place = label(tmp_path, case.at)
    # Both begin with `bd.load`; that they say the same is seen of every tenth.
    for command in ("check", "posterior")[CASES.index(case) % 10 > 0 :]:
        ran = systems.cli(command, "small.yaml")
        assert_a_message(ran)
        assert ran.err.startswith(place), ran.err
        for fragment in case.says:
            assert fragment in ran.err
        assert systems.listing(tmp_path) == before


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("misspelt symbol", marks=SLOW),
        pytest.param("missing config", marks=SLOW),
        "NaN",
    ],
)
def test_a_mistake_ends_a_real_process_without_a_traceback(name: str, tmp_path: Path) -> None:
    (case,) = (case for case in CASES if case.name == name)
    make(tmp_path, case)
    before = systems.listing(tmp_path)
    ran = systems.run("posterior", "small.yaml", cwd=tmp_path)
    assert_a_message(ran)
    assert ran.err.startswith(label(tmp_path, case.at))
    assert systems.listing(tmp_path) == before


def test_all_mistakes_of_a_config_come_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systems.small(
        tmp_path,
        ("seed: 7", "seed: -7\nsampelr: {}"),
        ("unit: s}", "unit: V}"),
        (THETA_1, THETA_1.replace("0.05", "0")),
        (W_1, W_1.replace("rad/s", "radd/s")),
        ("v: 8.0", "v: 8 V"),
        ("k_T: nominal", "k_t: nominal"),
        ("r_m: nominal", "r_m: 1/3"),
        ("l_m: nominal", "l_m: {prior: unifrom, low: 1, high: 2}"),
        ("k_s: nominal", "k_s: {prior: uniform, low: 1, high: 2}"),
        (J_1, "j_1: {prior: uniform, low: 1.5, high: 0.5, relative: true}"),
        ("t_f: nominal", "t_f: nominal\n  t_f: 0.1"),
        ("walkers: 8", "walkers: 9"),
        ("map: {", "map: {method: nelder, "),
    )
    monkeypatch.chdir(tmp_path)
    wanted = [
        ("seed: -7", "seed: -7"),
        ("sampelr", "did you mean sampler?"),
        ("time:", "unit 'V' is not a unit of s"),
        ("    theta_1", "sigma: 0"),
        ("    w_1", "unit 'radd/s'"),
        ("  v:", "'8 V' is not a number"),
        ("k_t", "did you mean k_T?"),
        ("r_m", "write for example 0.333333"),
        ("l_m", "did you mean uniform?"),
        ("k_s", "is outside the prior"),
        ("j_1", "is not below high"),
        ("t_f: 0.1", "stands already in line"),
        ("map:", "did you mean nelder_mead?"),
        ("walkers: 9", "an even number"),
    ]
    ran = systems.cli("check", "small.yaml")
    assert_a_message(ran)
    lines = ran.err.splitlines()
    assert len(lines) == len(wanted), ran.err
    for line, (at, says) in zip(lines, wanted, strict=True):
        assert line.startswith(label(tmp_path, at)), line
        assert says in line


def test_more_mistakes_than_a_screen_holds_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systems.small(tmp_path, ("seed: 7", "\n".join(["seed: 7", *(f"x_{i}: 1" for i in range(40))])))
    monkeypatch.chdir(tmp_path)
    ran = systems.cli("check", "small.yaml")
    assert_a_message(ran)
    assert ran.err.splitlines()[-1] == "... and 25 more"


def test_all_mistakes_of_a_record_come_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systems.small(
        tmp_path, ("{column: theta_1", "{column: theta1"), ("v: 8.0", "v: {column: u, unit: V}")
    )
    cell(5, 0, "nan")(tmp_path)
    cell(6, 2, "nan")(tmp_path)
    monkeypatch.chdir(tmp_path)
    ran = systems.cli("check", "small.yaml")
    assert_a_message(ran)
    for fragment in ("record.time", "line 5", "'theta1'", "line 6", "inputs.v.column"):
        assert fragment in ran.err


# Each of these entries is needed: without it, a mistake elsewhere has to be found all the same.
@together(
    "change",
    [
        ("name: small\n", ""),
        ("seed: 7", "seed: x"),
        ("  file: small.csv\n", ""),
        ("{column: t, unit: s}", "{column: t, unit: 3}"),
        ("  channels:\n" + THETA_1 + W_1, "  channels: {}\n"),
        ("inputs:\n  v: 8.0\n", ""),
        ("v: 8.0", "v: 8 V"),
        ("k_T: nominal", "k_T: [1]"),
        ("walkers: 8", "walkers: 8.5"),
    ],
    ids=lambda change: change[0].split(":")[0].strip(),
)
def test_a_spoilt_entry_hides_no_mistake_elsewhere(
    change: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systems.small(tmp_path, change, prior("prior: uniform, low: 0.09, high: 0.03"))
    monkeypatch.chdir(tmp_path)
    ran = systems.cli("check", "small.yaml")
    assert_a_message(ran)
    assert len(ran.err.splitlines()) == 2, ran.err
    assert "parameters.k_e: low 0.09 is not below high 0.03" in ran.err


def test_a_missing_time_hides_no_other_missing_column(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systems.small(tmp_path, ("column: t,", "column: time,"), ("column: w_1", "column: w1"))
    monkeypatch.chdir(tmp_path)
    ran = systems.cli("check", "small.yaml")
    assert_a_message(ran)
    assert "no column 'time'" in ran.err
    assert "no column 'w1'" in ran.err


@together(
    "arguments",
    [
        ["chek"],
        ["check"],
        ["check", "small.yaml", "--fast"],
        ["posterior", "small.yaml", "--processes", "0"],
        ["posterior", "small.yaml", "--processes", "two"],
        ["posterior", "small.yaml", "--resume", "--force"],
        ["simulate", "small.yaml", "--seed", "-1"],
        ["simulate", "small.yaml"],
        ["report"],
        ["report", "nowhere"],
        ["report", "small.yaml"],
        ["posterior", "small.yaml", "--output", "small.csv"],
        ["posterior", "small.yaml", "--output", "."],
        ["posterior", "small.yaml", "--output", ".", "--resume"],
    ],
    ids=" ".join,
)
def test_misuse_of_the_command_line_costs_nothing(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systems.small(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = systems.listing(tmp_path)
    ran = systems.cli(*arguments)
    assert_a_message(ran)
    assert systems.listing(tmp_path) == before


def test_a_config_given_with_its_folder_names_the_folder(tmp_path: Path) -> None:
    config = systems.small(tmp_path / "rig", ("k_T: nominal", "k_t: nominal"))
    ran = systems.cli("check", os.path.relpath(config))
    assert ran.err.startswith(f"{os.path.relpath(config)}:15: ")
