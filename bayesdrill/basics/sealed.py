"""JSON that is read back: what is not as it was written is an error, and never believed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Hashable, Mapping
from functools import cache
from typing import Any, cast

SEAL = "checksum"


def sealed(data: Mapping[str, Any]) -> str:
    """As text, with a checksum of all entries as the last of them."""
    return json.dumps({**data, SEAL: _checksum(data)}, indent=2) + "\n"


def opened(content: bytes) -> dict[str, Any]:
    """The entries of what `sealed` gave; raises `ValueError` where they are not the same."""
    try:
        data = json.loads(content.decode("utf-8"))
        seal = data.pop(SEAL, None) if isinstance(data, dict) else None
        if seal is None or seal != _checksum(data):
            raise ValueError("the checksum does not fit")
    except RecursionError:
        raise ValueError("nested too deep") from None
    return dict(data)


def typed[T](kind: type[T], entries: Mapping[str, Any]) -> T:
    """The dataclass or typed dict of `opened` entries; raises `ValueError` where types are not right."""
    # Half a character, of the name of a file, is none in the text that is validated.
    text = json.dumps(entries, ensure_ascii=False).encode("utf-8", "replace")
    found: T = _adapter(cast("Hashable", kind)).validate_json(text, strict=True)
    return found


@cache
def _adapter(kind: Hashable) -> Any:
    from pydantic import TypeAdapter  # late: few commands read such files

    return TypeAdapter(cast("type", kind))


def _checksum(data: Mapping[str, Any]) -> str:
    # Over the text that reading and writing again gives: tuples have become lists by then.
    text = json.dumps(json.loads(json.dumps(data)), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
