"""What a cell that is no number was meant to be, and the way out."""

from __future__ import annotations

import re
from collections.abc import Iterable

_NUMBER = r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?"

_KINDS: tuple[tuple[str, str], ...] = (
    (
        r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}([ T].*)?|.*\d{1,2}:\d{2}(:\d{2}.*)?",
        "dates and times of day are not read: save seconds since the start, or say "
        "time: {rate: ...} instead of the column",
    ),
    (
        r"[-+]?\d{1,3}([ ,.'\u00a0\u2009\u202f]\d{3})+([.,]\d+)?",
        "thousands separators are not read, as they may be decimal signs: export numbers without them",
    ),
    (r"0[xX][0-9a-fA-F]+", "hexadecimal numbers are not read: export decimal ones"),
    (
        rf"{_NUMBER}\s*[-+]\s*{_NUMBER}\s*\*?[ij]",
        "complex numbers are not read: save the real part",
    ),
    (rf"{_NUMBER}\s*(#|%|//).+", "a comment may only stand in a line of its own: remove it"),
    (
        rf"{_NUMBER}\s*%",
        "percent signs are not read: remove them, and say in the unit what a percent is",
    ),
    (
        rf"{_NUMBER}\s*[a-zA-Z\u00b0\u00b5\u03bc][^\s\d]*",
        "units do not stand in cells: remove them, and give the unit in the config",
    ),
)


def of_cells(cells: Iterable[str]) -> list[str]:
    """One sentence for each kind of cell that is met."""
    kinds = [next((said for form, said in _KINDS if re.fullmatch(form, one)), "") for one in cells]
    return list(dict.fromkeys(said for said in kinds if said))
