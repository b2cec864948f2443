"""A first config of records of one's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bayesdrill.basics.checked import checked
from bayesdrill.basics.errors import InputError

if TYPE_CHECKING:
    from bayesdrill.setup.guessing.guess import Guess


@checked
def init(
    record: str | Path | Sequence[str | Path],
    output: str | Path | None = None,
    *,
    voltage: float | None = None,
    gear: float | None = None,
    force: bool = False,
) -> Guess:
    """Writes a config for a record, with every guess marked REVIEW and its reason.

    Several files of one kind become several experiments of one config; a file that holds inputs alone
    goes with that of the channels.  `output`: beside the (first) record by default; `voltage` [V]:
    constant, where no column has it; `gear`: turns of the motor for one of the shaft.
    Raises `InputError` where nothing can be made of a file, or not of all together.
    """
    from bayesdrill.setup.guessing import guess, several

    for name, value in (("voltage", voltage), ("gear", gear)):
        if value is not None and not math.isfinite(value):
            raise InputError.one(name, f"{value} is not a number; write it, or leave it out")
    if gear is not None and gear < 1:
        message = f"{gear:g} turns of the motor for one of the shaft; write 8 for a gear of 8:1"
        raise InputError.one("gear", message)
    given = [record] if isinstance(record, str | Path) else record
    records = [Path(one).expanduser() for one in given]
    if not records:
        raise InputError.one("record", "no file is named; name one or several")
    beside = records[0].with_suffix(".yaml")
    if len(records) > 1:
        beside = records[0].with_name(f"{several.stem(records)}.yaml")
    target = beside if output is None else Path(output).expanduser()
    guess.check_place(target, records, force=force)
    made = guess.guess(records, target, voltage=voltage, gear=gear)
    guess.save(made, records, force=force)
    return made
