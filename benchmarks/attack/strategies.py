"""What a user, a program or a bad disk may write: configs, units, formulas, records, results."""

from __future__ import annotations

import copy
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
from hypothesis import strategies as st
from pyarrow import parquet
from ruamel.yaml import YAML
from scipy.io import savemat
from support import command_line

from bayesdrill import output_files
from bayesdrill.results import run_folder
from bayesdrill.rig.models.drive_parts import Drive, Gear, Shaft

NUMBERS = (
    "0", "-0.0", "1e-320", "1e-150", "1e-18", "-1", "1e18", "1e150", "1.7e308", "1e400", ".nan", ".inf",
    "-.inf", "2", "3", "17", "4294967296", "18446744073709551616", "9" * 400, "0x1F", "1_000",
    "12:30:45",
    "2026-11-22", "1,5", "1e", "--1", "+.5", "01",
)  # fmt: skip
WORDS = (
    "", "~", "null", "true", "no", "'", '"', "nominal", "first", "v", "t_1", "time", "draw",
    "chain", "theta_1",
    "w_1", "k_s", "j_1", "\\0", "a" * 3000, "../../x", "/dev/zero", "/dev/stdin", ".", "small.csv",
    "*a", "&a 1",
    "!!python/object:os.system x", "!!binary x", "!!int x", "!!float ''", "!!timestamp x",
    "!!set {a}", "<<",
    "[]", "{}", "[[[[[]]]]]", "{a: {b: {c: 1}}}", "[1, 2", "{", "@", "%", "\t", "\u202e", "\ud7ff",
    "\U0001f9ff",
)  # fmt: skip
ATOMS = (
    "rad", "deg", "rpm", "Hz", "counts", "bit", "s", "ms", "min", "h", "N", "m", "mm", "kg", "g",
    "V", "mV", "A",
    "ohm", "H", "degC", "K", "percent", "dB", "lbf", "inch", "1", "1e300", "9", "0", "pi", "unknown",
)  # fmt: skip
NAMES = ("k_s", "j_1", "k_e", "t_f", "G", "d", "x", "pi", "v", "__import__", "nan", "1e308", "0")


def unit() -> st.SearchStrategy[str]:
    return _grammar(
        ATOMS,
        ("*", "/", "**", "^", " ", ".", "·"),
        st.sampled_from(["({})", "{}**9", "{}²", "-{}"]),
    )


def formula() -> st.SearchStrategy[str]:
    calls = [
        "({})",
        "sqrt({})",
        "exp({})",
        "log({})",
        "-{}",
        "sin({})",
        "{}**99",
        "1/{}",
        "f({})",
        "{}()",
    ]
    return _grammar(
        NAMES, ("+", "-", "*", "/", "**", "//", "%", ",", "<", "and", " "), st.sampled_from(calls)
    )


def _grammar(
    atoms: tuple[str, ...], signs: tuple[str, ...], around: st.SearchStrategy[str]
) -> st.SearchStrategy[str]:
    def larger(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
        joined = st.tuples(inner, st.sampled_from(signs), inner).map("".join)
        wrapped = st.tuples(around, inner).map(lambda pair: pair[0].format(pair[1]))
        repeated = st.tuples(inner, st.sampled_from(signs), st.sampled_from([30, 300])).map(
            lambda three: three[1].join([three[0]] * three[2])
        )
        return joined | wrapped | repeated

    return st.recursive(st.sampled_from(atoms), larger, max_leaves=8)


def scalar() -> st.SearchStrategy[str]:
    """As it stands in YAML."""
    quoted = st.text(max_size=12).map(lambda text: repr(text))
    return st.sampled_from(NUMBERS) | st.sampled_from(WORDS) | unit() | formula() | quoted


EXTRAS = (
    "identify: {profile: true}", "output: {corner: [k_s, j_1, k_e]}", "derived: {ratio: k_s/j_1}",
    "quantities: {d: {unit: mm, prior: uniform, low: 1, high: 5}}", "nominal: {k_s: 0.3}",
    "model: {name: two_rotors}",
    "model: {i_m: 70}", "initial: {time: 0, theta_1: 1}", "seed: 1",
    "map: {starts: 2, evaluations: 500}",
    "inputs: {v: {column: w_1, unit: V, hold: first}}", "inputs: {v: 1, t_1: 2}",
    "calibration: {refits: 10}",
    "record: {file: small.csv}", "simulation: {duration: 1, rate: 10}", "nominal: {tolerance: 0.1}",
)  # fmt: skip


@st.composite
def config(draw: st.DrawFn) -> str:
    """The small config with other values, keys and lines."""
    lines = command_line.SMALL.splitlines()
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(lines) - 1))
        how = draw(st.integers(0, 6))
        if how <= 2:
            lines[at] = _other_value(lines[at], draw(scalar()), draw(st.integers(0, 9)))
        elif how == 3:
            del lines[at]
        elif how == 4:
            lines.insert(at, lines[draw(st.integers(0, len(lines) - 1))])
        elif how == 5:
            lines.append(draw(st.sampled_from(EXTRAS)))
        else:
            key, _, rest = lines[at].partition(":")
            space = key[: len(key) - len(key.lstrip())]
            lines[at] = f"{space}{draw(scalar())}:{rest}"
        lines = lines or [""]
    return "\n".join(lines) + "\n"


def _other_value(line: str, value: str, which: int) -> str:
    """The line with one of its values replaced."""
    parts = line.split(": ")
    if len(parts) < 2:
        return f"{line} {value}"
    k = 1 + which % (len(parts) - 1)
    end = min((i for i in map(parts[k].find, (",", "}")) if i >= 0), default=len(parts[k]))
    parts[k] = value + parts[k][end:]
    return ": ".join(parts)


def bytes_changed(content: bytes) -> st.SearchStrategy[bytes]:
    """With bytes replaced, left out, put in, cut off or repeated."""

    @st.composite
    def change(draw: st.DrawFn) -> bytes:
        data = bytearray(content)
        for _ in range(draw(st.integers(1, 4))):
            at = draw(st.integers(0, max(len(data) - 1, 0)))
            how = draw(st.integers(0, 5))
            if how <= 1 and data:
                data[at] = draw(st.integers(0, 255))
            elif how == 2:
                del data[at : at + draw(st.integers(1, 40))]
            elif how == 3:
                piece = st.binary(max_size=8) | st.sampled_from(NUMBERS).map(str.encode)
                data[at:at] = draw(piece)
            elif how == 4:
                data = data[:at]
            else:
                data[at:at] = data[at : at + draw(st.integers(1, 200))]
        return bytes(data)

    return change()


def record() -> st.SearchStrategy[bytes]:
    """The small record, in several dialects."""
    text = command_line.small_record()
    shapes: tuple[Callable[[str], str], ...] = (
        str,
        lambda t: t.replace(",", ";"),
        lambda t: t.replace(",", ";").replace(".", ","),
        lambda t: t.replace(",", "\t"),
        lambda t: "# made\n" + t,
        lambda t: t.replace("\n", "\r\n"),
        lambda t: "\ufeff" + t,
        lambda t: "\n".join(t.splitlines()[:3]) + "\n",
    )
    return st.sampled_from(shapes).flatmap(lambda shape: bytes_changed(shape(text).encode()))


def columns() -> dict[str, Any]:
    table = np.genfromtxt(io.StringIO(command_line.small_record()), delimiter=",", names=True)
    return {name: np.array(table[name]) for name in table.dtype.names}


def mat_file(version: int) -> bytes:
    """The small record as MATLAB saves it, before (5) and since (7) v7.3."""
    if version == 5:
        out = io.BytesIO()
        savemat(out, columns(), do_compression=True)
        return out.getvalue()
    out = io.BytesIO()
    with h5py.File(out, "w", userblock_size=512) as file:
        for name, values in columns().items():
            file[name] = values[None]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    return head.ljust(512, b"\0") + out.getvalue()[512:]


def array_file(ending: str) -> bytes:
    """The small record as h5py, NumPy and pyarrow save it."""
    out = io.BytesIO()
    if ending == "h5":
        with h5py.File(out, "w") as file:
            for name, values in columns().items():
                file.create_dataset(name, data=values, compression="gzip")
    elif ending == "npz":
        np.savez_compressed(out, **columns())
    else:
        parquet.write_table(pyarrow.table(columns()), out)
    return out.getvalue()


def for_mat(text: str) -> str:
    """The small config, reading variables of `small.mat`."""
    return text.replace("small.csv", "small.mat").replace("{column:", "{variable:")


def in_place(text: str, key: str, value: str) -> str:
    """The small config with one value, given as text, at the only place of `key`."""
    (line,) = [line for line in text.splitlines() if line.strip().startswith(f"{key}:")]
    return text.replace(line, f"{line.partition(':')[0]}: {json.dumps(value)}")


def damaged(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    """A file below `folder` that a run reads back, and what has become of it."""
    kept = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in {".json", ".yaml", ".h5", ".npz"}
    ]
    return st.sampled_from(kept).flatmap(
        lambda path: st.tuples(
            st.just(path.relative_to(folder).as_posix()), bytes_changed(path.read_bytes())
        )
    )


VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 3, 10**20, 10**400, -0.5, 0.1, 1e-320, 1e300, float("nan"),
    float("inf"), -float("inf"), "", "x", "finished", "posterior", "k_e", "1", "nan", "../..", ".",
    "/", "a\0b", "\udcff", "y" * 3000, [], [1], ["x"], [[]], [None], {}, {"x": 1}, {"": None},
    {"k_e": "1"}, [{"name": 1}],
)  # fmt: skip


def places(tree: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Of all that stands in plain data, but the whole."""
    inner = tree.items() if isinstance(tree, dict) else ()
    for key, value in enumerate(tree) if isinstance(tree, list) else inner:
        yield (*at, key)
        yield from places(value, (*at, key))


@st.composite
def retyped(draw: st.DrawFn, tree: Any) -> Any:
    """Plain data with values of other types, left out, under other names, or at another's place."""
    made = copy.deepcopy(tree)
    for _ in range(draw(st.integers(1, 3))):
        every = list(places(made))
        if not every:
            break
        *way, last = draw(st.sampled_from(every))
        parent = made
        for key in way:
            parent = parent[key]
        how = draw(st.integers(0, 7))
        if how <= 4:
            parent[last] = copy.deepcopy(draw(st.sampled_from(VALUES)))
        elif how == 5:
            del parent[last]
        elif how == 6 and isinstance(parent, dict):
            parent[draw(st.sampled_from(["zz", "", "k_e", "a.b", "x" * 300]))] = parent.pop(last)
        else:
            other = draw(st.sampled_from(every))
            found = tree
            for key in other:
                found = found[key] if isinstance(found, dict) and key in found else None
            parent[last] = copy.deepcopy(found)
    return made


def as_yaml(tree: Any) -> str:
    out = io.StringIO()
    YAML(typ="safe", pure=True).dump(tree, out)
    return out.getvalue()


def config_retyped(text: str) -> st.SearchStrategy[bytes]:
    """A config that is YAML, with wrong types in its entries."""
    yaml = YAML(typ="safe", pure=True)
    yaml.allow_duplicate_keys = True
    tree = yaml.load(text)

    def written(made: Any) -> bytes:
        try:
            return as_yaml(made).encode("utf-8", "surrogatepass")
        except Exception:  # not all that JSON has can be written
            return b"{}"

    return retyped(tree).map(written)


@st.composite
def array(draw: st.DrawFn, was: Any) -> Any:
    """Another array than one that `was` there."""
    was = np.asarray(was)
    how = draw(st.integers(0, 8))
    if how == 0:
        return np.array(draw(st.sampled_from(["", "x", "MT19937"])))
    if how == 1:
        return was[..., :-1] if was.ndim and was.shape[-1] else was
    if how == 2:
        return np.concatenate([np.atleast_1d(was)] * 2)
    if how == 3:
        return np.zeros(draw(st.sampled_from([(), (0,), (1, 1), (3, 0, 2), (2, 2, 2, 2)])))
    if how == 4 and was.dtype.kind == "f":
        return np.full_like(was, draw(st.sampled_from([np.nan, np.inf, -1.0, 0.0, 1e300, -1e300])))
    if how == 5 and was.dtype.kind in "fiu":
        return was.astype(draw(st.sampled_from(["<i1", ">f8", "f4", "c16", "S3", "?"])))
    if how == 6:
        return was.T
    if how == 7:
        return was * 0 if was.dtype.kind in "fiu" else was
    return draw(st.sampled_from([np.array(10**18), np.array(-1), np.array([b"x"])]))


@st.composite
def chain_forged(draw: st.DrawFn, content: bytes) -> bytes:
    """A chain with another array or attribute, and a checksum that fits."""
    held = io.BytesIO(content)
    with h5py.File(held, "r+") as file:
        name = draw(st.sampled_from([*file]))
        group = file[name]
        which = draw(st.sampled_from([*group, *group.attrs]))
        if draw(st.integers(0, 5)) == 0:
            del file[name]
        elif which in group:
            other = draw(array(group[which][:]))
            del group[which]
            group[which] = np.atleast_1d(other.astype("S") if other.dtype.kind == "U" else other)
            run_folder.seal(group)
        else:
            group.attrs[which] = draw(st.sampled_from([-1, 0, 3.5, "x", 10**18, np.zeros(3)]))
            run_folder.seal(group)
    return held.getvalue()


@st.composite
def piece_forged(draw: st.DrawFn, content: bytes) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    for name in draw(st.sets(st.sampled_from([*arrays]), min_size=1, max_size=2)):
        if draw(st.booleans()):
            arrays[name] = draw(array(arrays[name]))
        else:
            del arrays[name]
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def forged(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    """A file of a results folder, and what somebody has made of it who knows about checksums."""
    kept = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != ".lock"]
    weighed = [p for p in kept for _ in range(6 if p.suffix in {".json", ".h5", ".npz"} else 1)]

    def of(path: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        return st.tuples(st.just(path.relative_to(folder).as_posix()), _forged(path))

    return st.sampled_from(weighed).flatmap(of)


def _forged(path: Path) -> st.SearchStrategy[bytes]:
    content = path.read_bytes()
    if path.suffix == ".json":
        return retyped(output_files.loads_checksummed(content)).map(
            lambda data: output_files.dumps_checksummed(data).encode()
        )
    if path.suffix == ".h5":
        return chain_forged(content)
    if path.suffix == ".npz":
        return piece_forged(content)
    if path.suffix == ".yaml":
        return config_retyped(content.decode())
    return bytes_changed(content) | st.binary(max_size=30)


CELLS = (
    "", "nan", "inf", "-inf", "1e-320", "5e-324", "1e-40", "1e39", "1e200", "1.7e308", "-1e308",
    "0", "-0.0", "1", "x", "1e400", "9" * 400, '"', "1,5", "0x1F", "1_000", "12:30", "\0", "\udcff",
    "True",
)  # fmt: skip
HEADS = (
    "t", "t [s]", "time_us", "theta_1", "theta_1 [rad]", "phi [deg]", "w_1", "n_motor [rpm]", "v",
    "U [V]", "i [A]", "t_1 [N*m]", "", "1", "x", "theta_1", "a" * 500, "\u0301", "w_1 [", "]",
    "$x_{$", "t,t", "w_1 [1e300 rad]", "n", "u", "v1", "goal position", "torque [%]", "enc [counts]",
    "x [count/(560/cm)]", "slow-forward",
)  # fmt: skip
# Of `init`: what is typed of columns, and heads and ends of rows of recorders.
NAMES = (
    "t=t [s]", "1=t [ms]", "2=w_2 [rpm]", "2=2*w_2", "x=theta_\u00f6", "v=v [V", "u=u_a [V]",
    "2=w_ground", "1=x_cart [560 counts per cm]", "2=t_m [% of 9.84 mN*m]", "data:2=w_s_a [rad/s]",
    "=", "2=w_2 [1e400*rad]",
)  # fmt: skip
RECORDER = "Date:;2020\nIndex:;0x30D3;0x30D2\nSampling period:;4.0\n"


@st.composite
def table(draw: st.DrawFn) -> tuple[str, bytes]:
    """A record of strange columns, in any format: the ending, and the bytes."""
    count, width = draw(st.sampled_from([0, 1, 2, 19, 21, 60, 300])), draw(st.integers(0, 6))
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    t = np.arange(count) * draw(
        st.sampled_from([0.0, 1e-310, 1e-20, 0.001, 0.05, 1.0, 1e10, 1e300])
    )
    every = []
    for k in range(width):
        how = draw(st.integers(0, 8))
        size = draw(st.sampled_from([1.0, 1e-320, 1e-200, 1e-20, 1e6, 1e39, 1e150, 1e307]))
        with np.errstate(all="ignore"):
            values = [t, size * np.sin(7 * t), size * rng.standard_normal(count), np.full(count, size),
                size * np.round(np.sin(t), 2), np.cumsum(size * rng.standard_normal(count)), t[::-1],
                size * np.mod(30 * t, 2 * np.pi), np.full(count, np.nan)][how if k else 0]  # fmt: skip
        values = np.asarray(values, dtype=float).copy()
        for _ in range(draw(st.integers(0, 2)) if count else 0):
            values[draw(st.integers(0, count - 1))] = draw(
                st.sampled_from([np.nan, np.inf, 1e308, 1e-320, 0.0])
            )
        every.append(values)
    heads = [draw(st.sampled_from(HEADS)) for _ in every]
    kinds = ["csv", "csv", "csv", "npz", "h5", "parquet", "mat", "json", "json", "jsonl"]
    ending = draw(st.sampled_from(kinds))
    return ending, _written(ending, heads, every, draw)


def _signals(columns: dict[str, Any]) -> np.ndarray:
    """An array of structs, as ControlDesk saves signals."""
    y = np.zeros((1, len(columns)), dtype=[(name, "O") for name in ("Name", "Data", "Unit")])
    for k, (name, x) in enumerate(columns.items()):
        y[0, k] = (name.partition(" [")[0], x[None], name.partition(" [")[2].strip("]"))
    return y


def _as_json(ending: str, heads: list[str], every: list[list[float]], draw: st.DrawFn) -> bytes:
    """Columns, records, rows or values one after the other, perhaps below a name, perhaps cut."""
    rows = [list(row) for row in zip(*every, strict=True)]
    records = [dict(zip(heads, row, strict=True)) for row in rows]
    if ending == "jsonl":
        text = "\n".join(map(json.dumps, draw(st.sampled_from([records, rows]))))
    else:
        odd = [None, 5, "x", [[]], [rows, records], {"0": 1}, {"a": {"b": rows[:1]}}]
        shapes = [dict(zip(heads, every, strict=True)), records, rows, every, [heads, *rows], odd]
        content = draw(st.sampled_from([*shapes, *odd]))
        text = json.dumps(
            {draw(st.sampled_from(HEADS)): content} if draw(st.booleans()) else content
        )
    cut = draw(st.sampled_from([0, 0, 0, 1, 7]))
    return text[: len(text) - cut].encode("utf-8", "surrogatepass")


def _written(ending: str, heads: list[str], every: list[Any], draw: st.DrawFn) -> bytes:
    out = io.BytesIO()
    if ending == "csv":
        mark = draw(st.sampled_from([",", ";", "\t", " ", "|"]))
        rows = [[repr(float(x)) for x in row] for row in zip(*every, strict=True)]
        for _ in range(draw(st.integers(0, 2)) if rows else 0):
            row = rows[draw(st.integers(0, len(rows) - 1))]
            row[draw(st.integers(0, len(row) - 1))] = draw(st.sampled_from(CELLS))
        lines = [heads, *rows] if draw(st.booleans()) else rows
        end = draw(st.sampled_from(["", "", ";", ",,", " |"]))
        text = draw(st.sampled_from(["\n", "\r\n", "\r"])).join(
            mark.join(line) + end for line in lines
        )
        begin = draw(st.sampled_from(["", "", RECORDER, "a title\n"]))
        return (begin + text).encode("utf-8", "surrogatepass")
    if ending in ("json", "jsonl"):
        return _as_json(ending, heads, [x.tolist() for x in every], draw)
    named = {f"{head or 'x'}_{k}" if draw(st.booleans()) else head or "x": x
             for k, (head, x) in enumerate(zip(heads, every, strict=True))}  # fmt: skip
    kinds = ["f8", "f4", ">f8", "f2", "i8", "u1", "c16", "?", "U3"]
    with np.errstate(all="ignore"):
        named = {n: x.astype(draw(st.sampled_from(kinds))) if draw(st.integers(0, 3)) == 0 else x
                 for n, x in named.items()}  # fmt: skip
    plain = {n.replace("/", "_").replace("\0", "_"): x for n, x in named.items()}
    try:
        if ending == "npz":
            np.savez(out, **plain)
        elif ending == "h5":
            with h5py.File(out, "w") as file:
                for name, values in plain.items():
                    file[name] = values
        elif ending == "parquet":
            parquet.write_table(pyarrow.table(plain), out)
        else:
            savemat(
                out,
                {
                    f"v_{k}": {"f": x} if draw(st.booleans()) else x
                    for k, x in enumerate(plain.values())
                }
                if draw(st.booleans())
                else {"run": {"Y": _signals(plain)}},
            )
    except Exception:  # not every format holds every kind
        return b"x"
    return out.getvalue()


RUNS, CONFIGS = ("results/small", "results/other"), ("small.yaml", "campaign.yaml")
PLACES = (
    *RUNS, *CONFIGS, "small.csv", "sheet.yaml", "results/small/chain.h5", "results/small/run.json",
    "results/small/config.yaml", "results", ".", "..", "", "nothing", "new.yaml", "new.csv", "out",
    "out.xml", "new.svg", "/dev/null", "/dev/full", "~", "~nobody-here/x", "a\nb", "\udcff", "x" * 300,
    "small.csv/x", "notes.md", "figures", "link.yaml", "hard.csv", "-", "--",
)  # fmt: skip
COUNTS = ("0", "1", "2", "-1", "3.5", "x", "", "1e9", "9" * 30, "nan")
OPTIONS: dict[str, tuple[str, ...]] = {
    "--output": PLACES,
    "--figure": (*PLACES, "rig.png", "rig.svg"),
    "--sheet": PLACES,
    "--force": (),
    "--resume": (),
    "--quick": (),
    "--verbose": (),
    "--at-map": (),
    "--clear": (),
    "--help": (),
    "--version": (),
    "--processes": COUNTS,
    "--seed": COUNTS,
    "--draws": COUNTS,
    "--sample": COUNTS,
    "--gear": (*COUNTS, "14", "0.125"),
    "--voltage": (*COUNTS, "8"),
    "--rate": (*COUNTS, "20"),
    "--rig": ("motor", "train", "motor_shaft", "x", ""),
    "--columns": ("theta_1", "w_1=w_1 [rad/s]", "w_1=theta_2 [x]", "=", "t=t [ms]", "x=[", ""),
    "--profile": ("all", "k_e", "k_s", "x", ""),
    "--to": ("json", "mjcf", "urdf", "x"),
    "--format": ("text", "bibtex", "cff", "x"),
    "--of": ("run", "config", "x"),
}
TAKES: dict[str, tuple[str, ...]] = {
    "init": (
        "--output",
        "--sheet",
        "--force",
        "--gear",
        "--voltage",
        "--rate",
        "--rig",
        "--columns",
    ),
    "check": ("--figure",),
    "identify": ("--output", "--force", "--profile", "--at-map", "--processes"),
    "map": ("--output", "--force", "--quick", "--processes"),
    "posterior": ("--output", "--force", "--resume", "--processes", "--verbose"),
    "report": ("--output", "--force", "--processes"),
    "compare": ("--output", "--force"),
    "verify": (),
    "simulate": ("--output", "--force", "--seed"),
    "export": ("--to", "--output", "--force", "--draws"),
    "cite": ("--format",),
    "schema": ("--of",),
    "example": (),
    "cache": (),
}


@st.composite
def arguments_of_a_command(draw: st.DrawFn) -> list[str]:
    """A command with things that it may be given, and at times others."""
    command = draw(st.sampled_from([*TAKES]))
    likely = {"init": ("small.csv",), "report": RUNS, "compare": RUNS, "verify": RUNS, "export": RUNS,
              "cite": RUNS, "schema": (), "cache": (), "example": ("new", "out")}  # fmt: skip
    usual = likely.get(command, CONFIGS)
    least = min(len(usual), 1) + (command == "compare")
    words = [
        draw(st.sampled_from(usual if usual and draw(st.integers(0, 3)) else PLACES))
        for _ in range(draw(st.integers(least if draw(st.integers(0, 9)) else 0, least + 1)))
    ]
    for _ in range(draw(st.integers(0, 4))):
        any_option = draw(st.integers(0, 9)) == 0 or not TAKES[command]
        option = draw(st.sampled_from([*OPTIONS] if any_option else TAKES[command]))
        values = OPTIONS[option]
        words += [option, draw(st.sampled_from(values))] if values else [option]
    if command == "export" and "--to" not in words:
        words += ["--to", draw(st.sampled_from(OPTIONS["--to"]))]
    return [command, *words]


OUTPUTS = ("pipe", "closed pipe", "/dev/full", "closed")
ENVIRONMENTS = {
    "OMP_NUM_THREADS": ("", "x", "0", "-1", "4,2", "1e3", "2"),
    "DUCC0_NUM_THREADS": ("", "x", "2"),
    "BAYESDRILL_CACHE": ("off", "OFF", "0", "", "~", "/dev/null", "cache", "~nobody-here", "a\nb"),
    "COLUMNS": ("0", "1", "x", "500"),
    "PYTHONIOENCODING": ("ascii", "utf-8", "latin-1"),
    "NO_COLOR": ("1",),
    "TERM": ("dumb", ""),
}


@st.composite
def environment(draw: st.DrawFn) -> dict[str, str]:
    names = draw(st.sets(st.sampled_from([*ENVIRONMENTS]), max_size=3))
    return {name: draw(st.sampled_from(ENVIRONMENTS[name])) for name in sorted(names)}


ENDS = ("motor", "load")
GIVEN: tuple[Any, ...] = (
    *VALUES, np.float64(0.5), np.array(0.5), np.array([1.0, 2.0]), np.datetime64("2026-01-01"), 1j,
    b"x", {1: 2}, {"x"}, range(3), len, int, object(), Path("nothing"), ("motor",), ENDS,
    ("motor",) * 50, {"s": ENDS}, {"s": ["motor", 5]}, {"motor": "voltage"},
    {"g": {"between": ENDS, "ratio": 0.5}}, {"g": {"between": ENDS, "ratio": 10**400}},
    (Shaft("s", ENDS),), (Shaft("s", 5),),  # type: ignore[arg-type]
    (Shaft(3, (["motor"], "load")),), (Gear("g", ENDS, 10**400),), (Gear("g", ENDS, float("nan")),),  # type: ignore[arg-type]
    (Drive("motor", "torque"),), (Drive(5, []),), Drive("motor", "speed"), ("t_cm", "t_sm", "w_sm"),  # type: ignore[arg-type]
)  # fmt: skip
T = np.linspace(0.0, 2.0, 41)
BOX = {"prior": "uniform", "low": 0.5, "high": 1.5, "relative": True}
# What is called, and what it is called with where nothing else is drawn.
CALLS: dict[str, dict[str, Any]] = {
    "MotorShaft": {"i_m": 0.125, "stribeck": 1, "added": ()},
    "Motor": {"i_m": 1.0, "stribeck": 1, "added": ()},
    "DrivenShaft": {"stribeck": 1, "added": ()},
    "LongShaft": {"i_m": 0.125, "elements": 2, "stribeck": 1, "added": ()},
    "TwoRotors": {"i_m": 0.125, "j_2": 0.0, "r_s": 0.0},
    "Train": {"inertias": ENDS, "shafts": {"s": ENDS}, "gears": {}, "drives": {"motor": "voltage"},
              "motion": "rotary", "gravity": (), "rock": (), "stribeck": 1, "added": ()},
    "respond": {"rig": "motor_shaft", "parameters": {}, "t": T, "inputs": {"v": 8.0}, "signals": "w_1",
                "initial": None, "hold": "zero"},
    "case": {"t": T, "channels": {}, "inputs": {"v": 8.0}, "parameters": {"k_s": BOX}, "nominal": None,
             "seed": 0, "name": "case", "rig": "motor_shaft"},
    "load": {"path": "small.yaml"},
    "open": {"folder": "results/small"},
    "verify": {"folder": "results/small"},
    "export": {"folder": "results/small", "to": "json", "draws": 5, "seed": 0},
    "compare": {"runs": [*RUNS], "names": None},
    "overlay": {"runs": [*RUNS], "names": None},
    "schema": {"of": "config"},
    "nominal": {"table": "tables_2_3"},
    "example": {"folder": "new"},
    "simulate": {"config": "small.yaml", "output": "new.csv", "seed": 1, "force": True},
    "ladder": {"config": "small.yaml", "sample": 2},
    "calibration": {"config": "small.yaml"},
}  # fmt: skip


@st.composite
def api_call(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """A call with one to three arguments of any kind."""
    name = draw(st.sampled_from([*CALLS]))
    given = dict(CALLS[name])
    changed = draw(st.sets(st.sampled_from([*given]), min_size=1, max_size=3))
    return name, given | {each: draw(st.sampled_from(GIVEN)) for each in sorted(changed)}


DRIVES = {"voltage": ("u_{}", "V"), "torque": ("t_{}", "N*m"), "speed": ("w_{}", "rad/s"),
          "current": ("i_{}", "A")}  # fmt: skip


@st.composite
def campaign(draw: st.DrawFn) -> tuple[str, list[np.ndarray]]:
    """Experiments with a train that rubs or drills: the config, and their records `t w u n`."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    flip = lambda share: bool(rng.random() < share)  # noqa: E731
    kind, bit = str(rng.choice([*DRIVES])), flip(0.5)
    two = flip(0.6) or kind == "speed"
    driven = "motor" if two else "load"
    numbers: dict[str, str] = {}

    def number(name: str, smallest: float = -5, largest: float = 3) -> None:
        x = 10 ** rng.uniform(smallest, largest)
        box = f"{{prior: log_uniform, low: {x:.3g}, high: {x * 10 ** rng.uniform(0.5, 4):.3g}}}"
        ends = f"{{prior: uniform, low: 0, high: {x:.3g}}}"
        numbers[name] = str(rng.choice([box, ends, f"{x:.3g}"], p=[0.5, 0.2, 0.3]))

    for name in (
        *(["j_motor"] if two and kind != "speed" else []),
        *(["k_s"] if two else []),
        "j_load",
    ):
        number(name)
    for name in ("c_load", "t_c_load", "c_s" if two else "c_load"):
        if flip(0.3):
            number(name)
    if "t_c_load" in numbers and flip(0.5):
        number("t_s_load")
        number("w_s_load")
    if kind in ("voltage", "current"):
        number(f"k_T_{driven}", -2, 1)
    if kind == "voltage":
        number(f"r_{driven}", -1, 1)
        if flip(0.5):
            number(f"k_e_{driven}", -2, 1)
    for k in range(4) if bit else ():
        number(f"b_{k}_load")
    if gravity := flip(0.2):
        number("g_load")
        number("a_load", -1, 0.5)
    labels = ["a", "b", "c"][: int(rng.integers(1, 4))]
    count, step = int(rng.choice([3, 12, 60])), float(rng.choice([0.01, 0.05]))
    size, weight = 10 ** rng.uniform(-3, 3), 10 ** rng.uniform(0, 8)
    t = np.arange(count) * step
    records = []
    for _ in labels:
        u = [np.full(count, size), size * np.sin(3 * t), size * (t > 0.3), 0.0 * t][rng.integers(4)]
        w = [0.01 * np.sin(t), size * np.sin(3 * t), 0.1 * t, 0.0 * t][rng.integers(4)]
        records.append(np.stack([t, w, u, np.full(count, weight)], axis=-1))
    lines = {label: [f"record: {{file: {label}.csv}}"] for label in labels}
    priors = [name for name, text in numbers.items() if "prior" in text]
    own = [name for name in priors if flip(0.2)] if len(labels) > 1 else []
    derived = [
        f"x_{k}: {draw(st.sampled_from([*numbers, *priors, 'k_s']))}_a*2" for k in range(flip(0.5))
    ]
    if len(labels) > 1 and flip(0.6):
        name = str(rng.choice([*numbers, "k_x"]))
        for label in labels[: int(rng.integers(1, 4))]:
            number = draw(
                st.sampled_from([*NUMBERS, *numbers, f"2*{name}", "nominal", "0.5*j_load"])
            )
            lines[label].append(f"parameters: {{{name}: {number}}}")
    parts = "inertias: [motor, load], shafts: {s: [motor, load]}" if two else "inertias: [load]"
    parts += f", drives: {{{driven}: {kind}}}"
    parts += ", rock: [load]" if bit else ""
    parts += ", gravity: [load]" if gravity else ""
    symbol, unit = DRIVES[kind]
    channel = str(
        rng.choice(["w_load: {column: w, unit: rad/s", "theta_load: {column: w, unit: rad"])
    )
    sigma = str(rng.choice(["0.1", "1.0e-3", "{prior: log_uniform, low: 0.001, high: 1}"]))
    several = "".join(f"  {label}: {{{', '.join(entries)}}}\n" for label, entries in lines.items())
    text = (
        "name: campaign\nseed: 1\nrecord:\n"
        + ("" if len(labels) > 1 else "  file: a.csv\n")
        + f"  time: {{column: t, unit: s}}\n  channels:\n    {channel}, sigma: {sigma}}}\n"
        + f"inputs:\n  {symbol.format(driven)}: {{column: u, unit: {unit}, hold: zero}}\n"
        + ("  wob_load: {column: n, unit: N, hold: zero}\n" if bit else "")
        + (f"experiments:\n{several}" if len(labels) > 1 else "")
        + (f"own: [{', '.join(own)}]\n" if own else "")
        + draw(st.sampled_from(["", "initial: free\n", "initial: steady\n"]))
        + f"model: {{name: train, {parts}}}\nparameters:\n"
        + "".join(f"  {name}: {value}\n" for name, value in numbers.items())
        + (f"derived: {{{', '.join(derived)}}}\n" if derived else "")
    )
    return text, records
