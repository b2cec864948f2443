"""Lines of a config: numbers, names and comments, as they are read back."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable

from bayesdrill.basics.errors import printable

REVIEW = "REVIEW: "
WIDTH = 110
_PLAIN = re.compile(r"(?![-\d%/]|\.(?!\.?/))[\w./%°-]+(?: [\w./%°-]+)*", re.ASCII)
_KEPT = "\x1f"  # a blank in code, at which no line is broken
_WORDS = {"yes", "no", "on", "off", "true", "false", "null", "y", "n"}


def scalar(value: str | int | float) -> str:
    if not isinstance(value, str):
        return f"{value:.6g}" if isinstance(value, float) else str(value)
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return json.dumps(value, ensure_ascii=False)


def comment(text: str, indent: int = 0) -> list[str]:
    whole = re.sub("`[^`]*`", lambda code: code[0].replace(" ", _KEPT), printable(text))
    lead = " " * indent + "# "
    lines = textwrap.wrap(
        whole, WIDTH, initial_indent=lead, subsequent_indent=lead, break_on_hyphens=False
    )
    return [line.replace(_KEPT, " ") for line in lines]


def review(doubts: Iterable[str], indent: int) -> list[str]:
    return [line for one in doubts if one for line in comment(REVIEW + one, indent)]
