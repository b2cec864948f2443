"""Arrays and entries as a config has them, without any file: the same words, the same checks."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesdrill.record.formats import Table
from bayesdrill.rig.models import Rig
from bayesdrill.setup import loading
from bayesdrill.setup.job import Job, assemble
from bayesdrill.setup.yaml_source import parse

Array = NDArray[np.float64]

RECORD = "record.csv"  # its name, once a run of it is saved
PLACE = Path("arrays")  # begins the places of mistakes
TIME = "t"


def job(columns: Mapping[str, ArrayLike], entries: Mapping[str, Any]) -> Job:
    """Of `columns`, each `(T,)`, time among them as `t`, and `entries` as in YAML.

    Raises `InputError` with all that is wrong with either.
    """
    table = Table(path=Path(RECORD), variables={name: _column(x) for name, x in columns.items()})
    record = {"file": RECORD, **entries.get("record", {})}
    record.setdefault("time", {"column": TIME, "unit": "s"})
    source = parse(PLACE, _as_yaml({**entries, "record": record}))
    return assemble(loading.validated(source), source, table)


def as_csv(columns: Mapping[str, ArrayLike]) -> str:
    """All digits, so that it reads back the same."""
    lines = zip(*(_column(x).tolist() for x in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(repr, line)) for line in lines)]) + "\n"


def model_entry(rig: str | Rig) -> dict[str, Any]:
    """A model, or its name, as `model:` of a config has it."""
    if isinstance(rig, str):
        return {"name": rig}
    return {"name": rig.name, **dataclasses.asdict(rig)}


def _column(values: ArrayLike) -> Array:
    return np.array(values, dtype=np.float64).reshape(-1)


def _as_yaml(entries: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    out = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.dump(_plain(entries), out)
    return out.getvalue()


def _plain(value: Any) -> Any:
    """Numbers of NumPy as Python has them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value.item() if isinstance(value, np.generic) else value
