"""A first config of a record of one's own."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.basics.errors import InputError

if TYPE_CHECKING:
    from bayesdrill.setup.guessing.guess import Guess


def init(
    record: str | Path,
    output: str | Path | None = None,
    *,
    voltage: float | None = None,
    gear: float | None = None,
    force: bool = False,
) -> Guess:
    """Writes a config for a record, with every guess marked REVIEW and its reason.

    `output`: beside the record by default; `voltage` [V]: constant, where no column has it; `gear`:
    turns of the motor for one of the shaft.  Raises `InputError` where nothing can be made of the file.
    """
    from bayesdrill.setup.guessing import guess

    for name, value in (("voltage", voltage), ("gear", gear)):
        if value is not None and not math.isfinite(value):
            raise InputError.one(name, f"{value} is not a number; write it, or leave it out")
    if gear is not None and gear < 1:
        message = f"{gear:g} turns of the motor for one of the shaft; write 8 for a gear of 8:1"
        raise InputError.one("gear", message)
    source = Path(record).expanduser()
    target = source.with_suffix(".yaml") if output is None else Path(output).expanduser()
    made = guess.guess(source, target, voltage=voltage, gear=gear)
    guess.save(made, source, force=force)
    return made
