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
