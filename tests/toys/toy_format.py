"""Records as JSON: `{"t": [...], "w_1": [...]}`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from bayesdrill.basics import InputError
from bayesdrill.record import Format, RecordTable, Wanted


@dataclass(frozen=True, slots=True)
class Options:
    inside: Annotated[str, Field(description="Key under which the columns are")] | None = None


def read(path: Path, options: Options, _: Wanted) -> RecordTable:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        columns = data if options.inside is None else data[options.inside]
        variables = {name: np.array(values, dtype=float) for name, values in columns.items()}
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise InputError.at(str(path), f"no columns can be read from it ({error})") from None
    return RecordTable(path=path, variables=variables)


JSON = Format((".toy",), read, Options)
