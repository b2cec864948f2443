"""What a user, a program or a bad disk may write: configs, units, formulas, records, results."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import systems
from hypothesis import strategies as st
from pyarrow import parquet
from scipy.io import savemat

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
    "map: {method: fminsearch, starts: 2}",
    "inputs: {v: {column: w_1, unit: V, hold: first}}", "inputs: {v: 1, t_1: 2}",
    "calibration: {refits: 10}",
    "record: {file: small.csv}", "simulation: {duration: 1, rate: 10}", "nominal: {tolerance: 0.1}",
)  # fmt: skip


@st.composite
def config(draw: st.DrawFn) -> str:
    """The small config with other values, keys and lines."""
    lines = systems.SMALL.splitlines()
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
    text = systems.small_record()
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
    table = np.genfromtxt(io.StringIO(systems.small_record()), delimiter=",", names=True)
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
