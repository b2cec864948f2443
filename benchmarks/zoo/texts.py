"""Configs and records as text."""

from __future__ import annotations

import copy
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from bayesdrill.config import loading
from bayesdrill.config.building.case import ResolvedCase
from bayesdrill.config.yaml_source import parse
from benchmarks.zoo.row import Entry

Array = NDArray[np.float64]


def as_yaml(data: Entry) -> str:
    out = io.StringIO()
    yaml = YAML()
    yaml.width = 120
    yaml.default_flow_style = None
    yaml.representer.ignore_aliases = lambda _: True  # an entry may stand in two places
    yaml.dump(data, out)
    return out.getvalue()


def parsed(path: Path, content: str) -> ResolvedCase:
    """As if it stood in the file `path`."""
    return loading.validate(parse(path, content))


def changed(data: Entry, changes: Entry) -> Entry:
    """A copy with other entries at dotted places, such as `record.channels.w_1.unit`."""
    made: Any = copy.deepcopy(data)
    for place, value in changes.items():
        *above, last = place.split(".")
        at = made
        for part in above:
            at = at.setdefault(part, {})
        at[last] = value
    return made


def as_csv(columns: Mapping[str, Array]) -> str:
    out = io.StringIO()
    rows = np.stack([np.asarray(values, dtype=np.float64) for values in columns.values()], axis=-1)
    np.savetxt(out, rows, "%.9g", ",", header=",".join(columns), comments="")
    return out.getvalue()
