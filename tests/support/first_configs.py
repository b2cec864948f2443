"""A newcomer's records, and the entries of the configs that are written for them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from support import scipy_oracles
from support.small_problems import starts_believed

import bayesdrill as bd
from bayesdrill.config import loading
from bayesdrill.config.records import reading
from bayesdrill.config.yaml_source import parse

RPM, DEG = 30 / math.pi, 180 / math.pi
SHARED = Path(__file__).parents[2].parent / "shared"  # records that do not come with the project


def shared(name: str) -> Path:
    """A file or folder of the records that do not come with the project, or the test is skipped."""
    if not (SHARED / name).exists():
        pytest.skip(f"{name} is not here")
    return SHARED / name


def read_records(config: Path) -> tuple[str, ...]:
    """What is said of the records of a config, which is valid."""
    records = [reading.read(experiment) for experiment in loading.load(config).experiments]
    return tuple(sentence for record in records for sentence in record.notes)


@starts_believed()
def draft_of(
    records: Path | list[Path], *columns: str, config: Path | None = None, **known: Any
) -> dict[str, Any]:
    """The entries of the config that is written for records, which `init` has validated.

    `text` is the whole of it, `words` the same without line ends and marks of comments, and `said`
    what stands on the terminal.
    """
    first = records if isinstance(records, Path) else records[0]
    config = config or first.with_suffix(".yaml")
    draft = bd.init(records, config, columns=columns, force=True, **known)
    text = config.read_text()
    words = " ".join(text.replace("#", " ").split())
    return {**parse(first, text).data, "text": text, "words": words, "said": str(draft)}


def refusal(records: Path | list[Path], *columns: str, **known: Any) -> str:
    """Why no config is written for records."""
    with pytest.raises(bd.InputError) as caught:
        bd.init(records, columns=columns, **known)
    return str(caught.value)


def channels_of(draft: dict[str, Any]) -> dict[str, tuple[str, str]]:
    """Column and unit of each channel."""
    channels = draft["record"]["channels"]
    return {name: (str(entry["column"]), entry["unit"]) for name, entry in channels.items()}


def driven(t: np.ndarray, v: np.ndarray, gear: float) -> np.ndarray:
    """States (T, 5) of a rig without friction, from rest, the voltage held between samples."""
    a, b, *_ = scipy_oracles.matrices({**scipy_oracles.skewed(), "t_f": 0.0}, 1 / gear)
    whole = np.zeros((6, 6))
    whole[:5, :5], whole[:5, 5] = a, b
    step = scipy.linalg.expm(whole * (t[1] - t[0]))
    states = np.zeros((len(t), 5))
    for k in range(len(t) - 1):
        states[k + 1] = step[:5, :5] @ states[k] + step[:5, 5] * v[k]
    return states


def reversing_rig(gear: float = 5.0, n: int = 1600, dt: float = 0.005) -> tuple[np.ndarray, ...]:
    """t [s], v [V], states, with the voltage in both directions."""
    t = dt * np.arange(n)
    v = np.round(6 * np.sign(np.sin(1.7 * t)) + 0.6 * np.sin(9 * t), 3) * (t > 0.1)
    return t, v, driven(t, v, gear)


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], mark: str = ",", point: str = "."
) -> Path:
    lines = [mark.join(columns)]
    for row in zip(*columns.values(), strict=True):
        lines.append(mark.join(f"{number:.5f}".replace(".", point) for number in row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


T = 0.01 * np.arange(400)
VOLTAGE = 6.0 * (np.sign(np.sin(1.7 * T)) + 0.2 * np.sin(9 * T)) * (T > 0.2)


def speed_response(late: int = 0, u: np.ndarray = VOLTAGE) -> np.ndarray:
    """A noisy speed that follows a voltage, `late` samples after it."""
    w, delayed = np.zeros(len(u)), np.concatenate([np.zeros(late), u])[: len(u)]
    for k in range(len(u) - 1):
        w[k + 1] = w[k] + 0.01 * (15 * delayed[k] - w[k]) / 0.08
    return w + np.random.default_rng(1).normal(0, 0.2, len(u))


SPEED = speed_response()
ANGLE = np.cumsum(SPEED) * 0.01
RECORD: Mapping[str, np.ndarray] = {"t": T, "u": VOLTAGE, "speed": SPEED}


def repeated(*lengths: int) -> dict[str, np.ndarray]:
    """Records of these lengths one after the other, of at most 700 rows each."""
    long = {name: np.resize(x, 700) for name, x in RECORD.items()} | {"t": 0.01 * np.arange(700)}
    return {name: np.concatenate([x[:n] for n in lengths]) for name, x in long.items()}


def german_record(gear: float = 5.0) -> dict[str, np.ndarray]:
    """Degrees and rpm, the motor before the gear, ms, a measured voltage; noise 0.5, 1 and 6."""
    t, v, x = reversing_rig(gear)
    rng = np.random.default_rng(5)
    return {
        "Zeit_ms": 1000 * t,
        "U_Motor": v,
        "phi_Rotor_deg": x[:, 0] * DEG + rng.normal(0, 0.5, len(t)),
        "n_Rotor": x[:, 2] * RPM + rng.normal(0, 1, len(t)),
        "n_Motor": x[:, 3] * gear * RPM + rng.normal(0, 6, len(t)),
    }


HEADS = (
    "w_1",
    "x: y",
    "'a' # b",
    "- z",
    "null",
    "1e5",
    "@",
    "",
    "U [V]",
    "theta_2 [°]",
    "i [mA]",
    "\\n",
    "{a}",
)


def spoilt_record(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Columns of a newcomer's record, some of them spoilt, the times among them; some heads, too."""
    begin, n = int(rng.integers(0, 1000)), int(rng.choice([25, 60, 200, 600]))
    columns = {}
    for name, values in german_record().items():
        if rng.random() < 0.2 and name != "Zeit_ms":
            continue
        head = str(rng.choice(HEADS)) if rng.random() < 0.15 else name
        columns[head] = _spoilt(values[begin : begin + n].copy(), rng)
    return columns


def _spoilt(x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    n, at = len(x), int(rng.integers(1, len(x)))
    match int(rng.integers(0, 24)):
        case 0:
            x[at] = x[at - 1]
        case 1:
            x[at] = 1e7
        case 2:
            x[at:] -= 3 * abs(x[1] - x[0])
        case 3:
            x[rng.random(n) < 0.2] = np.nan
        case 4:
            x[:at] = np.nan
        case 5:
            x[at] = -np.inf
        case 6:
            x[:] = 0.0
        case 7:
            x = x % 360
        case 8:
            x += 1e9
        case 9:
            x *= 10.0 ** rng.integers(-9, 9)
        case 10:
            x = x[::-1]
        case 11:
            x[:at] = x[at]
    return x
