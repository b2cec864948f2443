"""Units at the border: what a user's unit is in SI."""

from __future__ import annotations

from functools import cache
from typing import Any


def factor(unit: str, si: str) -> float:
    """How many `si` one `unit` is; raises `ValueError` with a message for the user."""
    if unit == si:
        return 1.0
    import pint  # late: it takes 0.4 s to load, and most configs are in SI

    registry = _registry()
    try:
        quantity = registry.Quantity(1.0, unit)
        return float(quantity.to(si).magnitude)
    except pint.UndefinedUnitError:
        raise ValueError(f"unit '{unit}' is not known; write for example {_examples(si)}") from None
    except pint.DimensionalityError:
        raise ValueError(f"unit '{unit}' is not a unit of {si}; write {_examples(si)}") from None
    except Exception:  # pint raises many kinds for malformed text
        raise ValueError(
            f"unit '{unit}' cannot be read; write for example {_examples(si)}"
        ) from None


# Units that are shown; what fits none of them is shown in kg, m, s, A.
_COHERENT = (
    "m", "m**2", "m**3", "kg", "s", "N", "Pa", "N*m", "W", "A", "V", "ohm", "H", "rad/s", "kg/m**3",
    "kg*m**2", "K",
)  # fmt: skip


def coherent(unit: str) -> tuple[str, float]:
    """The SI unit for a user's `unit` of any kind, and how many of it one `unit` is."""
    if unit in ("1", *_COHERENT):
        return unit, 1.0
    import pint

    try:
        quantity = _registry().Quantity(1.0, unit)
        base = quantity.to_base_units()
        if base.magnitude == 1.0:
            return unit, 1.0
        for name in _COHERENT:
            try:
                return name, float(quantity.to(name).magnitude)
            except pint.DimensionalityError:
                continue
        return f"{base.units:~C}" or "1", float(base.magnitude)
    except Exception:  # pint raises many kinds for malformed text
        message = f"unit '{unit}' is not known; write for example m, mm, GPa or kg/m**3"
        raise ValueError(message) from None


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(cache_folder=None)


def _examples(si: str) -> str:
    return {
        "s": "s or ms",
        "rad": "rad, deg or revolution",
        "rad/s": "rad/s, deg/s or rpm",
        "A": "A or mA",
        "V": "V or mV",
        "N*m": "N*m or mN*m",
    }.get(si, si)
