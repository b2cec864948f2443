"""Arrays and entries as a config has them, without any file: the same words, the same checks."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesdrill.basics.entries import entries_of
from bayesdrill.basics.errors import Problem
from bayesdrill.basics.own_files import RECORD
from bayesdrill.record.experiment import raise_if_any
from bayesdrill.record.formats import Table
from bayesdrill.rig.models.composed import constants
from bayesdrill.rig.models.linear import Model
from bayesdrill.setup import loading
from bayesdrill.setup.job import Job, assemble
from bayesdrill.setup.yaml_source import parse

Array = NDArray[np.float64]

PLACE = Path("arrays")  # begins the places of mistakes
TIME = "t"
DEEPEST = 20  # of entries within entries
LONGEST = 1000  # bits of a whole number


def job(columns: Mapping[str, Array], entries: Mapping[str, Any]) -> Job:
    """Of `columns`, each `(T,)`, time among them as `t`, and `entries` as in YAML.

    Raises `InputError` with all that is wrong with either.
    """
    table = Table(path=Path(RECORD), variables=dict(columns))
    record = {"file": RECORD, **entries.get("record", {})}
    record.setdefault("time", {"column": TIME, "unit": "s"})
    source = parse(PLACE, _as_yaml({**entries, "record": record}))
    source = dataclasses.replace(source, lines={})  # of a text that nobody has seen
    return assemble(loading.validated(source), source, table)


def as_csv(columns: Mapping[str, Array]) -> str:
    """All digits, so that it reads back the same."""
    lines = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "\n".join([",".join(columns), *(",".join(map(repr, line)) for line in lines)]) + "\n"


def model_entry(rig: Model) -> dict[str, Any]:
    """As `model:` of a config has it."""
    own = entries_of(type(rig))
    return {"name": rig.name, **{n: x for n, x in constants(rig).items() if n in own}}


def _as_yaml(entries: Mapping[str, Any]) -> str:
    from ruamel.yaml import YAML

    out = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    found: list[Problem] = []
    plain = _plain(entries, (), found)
    raise_if_any(found)
    yaml.dump(plain, out)
    return out.getvalue()


def _plain(value: Any, place: tuple[str, ...], found: list[Problem]) -> Any:
    """As YAML can have it, numbers of NumPy as Python has them; of the rest a problem is `found`."""
    if len(place) > DEEPEST:
        found.append(Problem(".".join(place[:4]), "is nested too deep; see docs/config.md"))
        return None
    if isinstance(value, Mapping):
        return {str(key): _plain(one, (*place, str(key)), found) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one, (*place, str(k)), found) for k, one in enumerate(value)]
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    known = value is None or isinstance(value, bool | float | str)
    if not known and not (isinstance(value, int) and value.bit_length() < LONGEST):
        what = "a number of so many digits" if isinstance(value, int) else type(value).__name__
        message = f"no entry can be {what}; see docs/config.md for what it can be"
        found.append(Problem(".".join(place), message))
    return value
