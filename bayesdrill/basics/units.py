"""Convert numbers from the user's units to SI when they are read, and back when shown."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from bayesdrill.basics import symbols
from bayesdrill.basics.errors import MAX_VALUE_LETTERS, shortened


@dataclass(frozen=True, slots=True)
class Unit:
    """A display unit has a `name` (pint), a `factor` to SI, and `latex` without dollar signs."""

    name: str
    factor: float
    latex: str


SECOND = Unit("s", 1.0, "s")


def display_unit(unit: str, si: str | None = None, latex: str = "") -> Unit:
    """Return the display unit of a quantity; `latex` is the LaTeX of its SI unit `si`.

    Without `si`, the unit may be of any dimension, and `coherent` finds the SI unit.  If `unit`
    cannot be typeset, the SI unit is returned.
    """
    si_name, si_per_unit = coherent(unit) if si is None else (si, factor(unit, si))
    si_unit = Unit(si_name, 1.0, latex or symbols.latex_unit(si_name))
    if unit == si_name:
        return si_unit
    try:
        return Unit(unit, si_per_unit, symbols.latex_unit(unit))
    except ValueError:
        return si_unit


def factor(unit: str, si: str) -> float:
    """Return the number of units `si` in one `unit`; raises `ValueError` with a message."""
    if unit == si:
        return 1.0
    same_kind = [common for common, (kind, _) in _COMMON.items() if kind == si]
    examples = _EXAMPLES.get(si) or " or ".join(same_kind) or si
    other_kind = f"unit '{unit}' is not a unit of {si}; write {examples}"
    if unit in _COMMON and si in _KINDS:
        kind, value = _COMMON[unit]
        if kind != si:
            raise ValueError(other_kind)
        return value
    if counts := _COUNT.fullmatch(unit.strip()):
        if si != "rad":
            raise ValueError(f"unit '{unit}' is an angle, not a unit of {si}; write {examples}")
        if int(counts[1]) == 0:
            raise ValueError(f"unit '{unit}' has no counts in a turn; write for example count/4096")
        return 2 * math.pi / int(counts[1])
    if counts := _COUNT_OF_LENGTH.fullmatch(unit.strip()):
        return _believable(factor(counts[2], si) / float(counts[1]))
    if percent := _PERCENT.fullmatch(unit.strip()):
        return _believable(factor(percent[2], si) * float(percent[1]) / 100)
    unreadable = f"unit '{shortened(unit)}' cannot be read; write for example {examples}"
    if not _written_as_a_unit(unit):
        raise ValueError(unreadable)
    import pint  # late: loading takes 0.3 s, and most configs have only common units

    try:
        quantity, wanted = _quantity(1.0, unit), _quantity(1.0, si)
        value = _believable(float(quantity.to(si).magnitude))
    except pint.UndefinedUnitError:
        raise ValueError(f"unit '{unit}' is not known; write for example {examples}") from None
    except pint.DimensionalityError:
        raise ValueError(other_kind) from None
    except Exception:  # pint raises many types of exceptions for malformed text
        raise ValueError(unreadable) from None
    if not _same_base(quantity, wanted):  # for pint, angles, counts and bits are plain numbers
        why = "as the angle of one such unit is unknown"
        raise ValueError(f"unit '{unit}' is not a unit of {si}, {why}; write {examples}")
    return value


# SI units and factors of common units, so that pint (0.3 s to load) is rarely needed.
_KINDS = ("rad", "rad/s", "s", "A", "V", "N*m", "m", "m/s", "N", "kg", "N/m", "N*s/m")
_COMMON = {kind: (kind, 1.0) for kind in _KINDS} | {
    "deg": ("rad", math.pi / 180),
    "deg/s": ("rad/s", math.pi / 180),
    "revolution": ("rad", 2 * math.pi),
    "rpm": ("rad/s", math.pi / 30),
    "ms": ("s", 1e-3),
    "mA": ("A", 1e-3),
    "mV": ("V", 1e-3),
    "mN*m": ("N*m", 1e-3),
    "mm": ("m", 1e-3),
    "mm/s": ("m/s", 1e-3),
    "mN": ("N", 1e-3),
}


def unit_of_factor(si: str, size: float) -> str:
    """Return the common unit that equals `size` times the unit `si`; empty if there is none."""
    pairs = _COMMON.items()
    return next((n for n, x in pairs if x[0] == si and math.isclose(x[1], size)), "")


_UNIT_OF_HEAD = re.compile(r".*(?:[\[(]\s*([A-Za-z*/]+)\s*[\])]|[\s_/]([A-Za-z*/]{2,}))\s*")


def other_unit(head: str, unit: str) -> str:
    """Return the unit at the end of a column head if it differs from `unit` in its factor only.

    Examples of heads are `w [rpm]`, `w (rpm)`, `w_rpm` and `w / rpm`; units must be in `_COMMON`.
    """
    match = _UNIT_OF_HEAD.fullmatch(head)
    said = next(filter(None, match.groups()), "") if match else ""
    written, meant = _COMMON.get(said) or _COMMON.get(said.lower()), _COMMON.get(unit)
    return said if written and meant and written[0] == meant[0] and written != meant else ""


# SI units for display.  Units of other dimensions are shown as products of kg, m, s and A.
_COHERENT = (
    "m", "m**2", "m**3", "kg", "s", "N", "Pa", "N*m", "W", "A", "V", "ohm", "H", "rad/s", "kg/m**3",
    "kg*m**2", "K", "N/m", "N*s/m",
)  # fmt: skip


def coherent(unit: str) -> tuple[str, float]:
    """Return the SI unit for a `unit` of any dimension, and the factor; raises `ValueError`."""
    if unit in ("1", *_COHERENT):
        return unit, 1.0
    try:
        if not _written_as_a_unit(unit):
            raise ValueError(unit)
        quantity = _quantity(1.0, unit)
        base, nothing = quantity.to_base_units(), _quantity(0.0, unit).to_base_units()
    except Exception:  # pint raises many types of exceptions for malformed text
        message = f"unit '{shortened(unit)}' is not known; write for example m, mm, GPa or kg/m**3"
        raise ValueError(message) from None
    if nothing.magnitude != 0.0:
        why = "has an offset, so that no factor converts it to SI"
        raise ValueError(f"unit '{unit}' {why}; write the value in K, or in a plain unit")
    if base.magnitude == 1.0 and unit.isascii():
        return unit, 1.0
    for name in _COHERENT:
        if _same_base(quantity, _quantity(1.0, name)):
            return name, _believable(float(quantity.to(name).magnitude))
    return f"{base.units:~C}" or "1", _believable(float(base.magnitude))


def _quantity(value: float, unit: str) -> Any:
    return _registry().Quantity(value, unit)


def _same_base(quantity: Any, other: Any) -> bool:
    """Return whether two quantities have the same base units; angles and counts differ."""
    return bool(quantity.to_base_units().units == other.to_base_units().units)


MAX_FACTOR = 1e30  # upper limit of a factor to SI, and of its inverse
_COUNT = re.compile(r"counts?\s*/\s*(\d{1,9})")  # encoder: counts per revolution
_COUNT_OF_LENGTH = re.compile(r"counts?\s*/\s*\(\s*([1-9]\d*\.?\d*)\s*/\s*(\w+)\s*\)")  # on a scale
_PERCENT = re.compile(r"%\s*of\s*(\d{0,9}\.?\d{1,9})\s*([^%]+)")  # of a rated torque or current
_POWER = re.compile(
    r"(\*\*|\^)\s*\(?\s*[-+]?\s*\d{1,2}(\.\d{1,3})?\s*\)?"
    r"|[\u207a\u207b]?[\u00b2\u00b3\u2070\u2074-\u2079]|\s(squared|cubed)\b"
)
_SIGNS = re.compile(r"[\w */^().+%\u00b0\u00b7\u22c5\u2070-\u207e-]*")
_COMPUTED = re.compile(r"#\s*#|\*\*|\^|(?<![^\W\d])(\d\d|[02-9])|1\s*#")


def _written_as_a_unit(unit: str) -> bool:
    """Return whether a text has only names, each with at most one small power, and the number 1.

    Pint gets no other text: it would compute `9**9**9`, and ignore comments and quotes.
    """
    return (
        len(unit) <= MAX_VALUE_LETTERS
        and bool(_SIGNS.fullmatch(unit))
        and not _COMPUTED.search(_POWER.sub("#", unit))
    )


def _believable(factor: float) -> float:
    if not 1 / MAX_FACTOR <= factor <= MAX_FACTOR:
        raise ValueError(f"this unit is {factor:.3g} in SI, which no rig needs")
    return factor


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(cache_folder=None)


_EXAMPLES = {
    "rad": "rad, deg, revolution, or count/4096 of an encoder with 4096 counts in a turn",
    "rad/s": "rad/s, deg/s or rpm (a turn each second is revolution/s)",
    "m": "m or mm, or count/(560/cm) of a scale with 560 counts in a cm",
    "N*m": "N*m or mN*m, or `% of 9.84 mN*m` of a drive whose rated torque is 9.84 mN*m",
}
