"""How large figures are on a page; here, as matplotlib takes a second to load."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

SINGLE, DOUBLE = 3.4, 7.0  # inches: of one column and of two
DPI = 220  # of pixels in them

WIDTHS: Mapping[str, float] = MappingProxyType({"single": SINGLE, "double": DOUBLE})
