"""Units of users are converted to SI, as pint has them."""

import re

import pytest
from support.case_tables import run_cases

from bayesdrill.basics import units


@run_cases(
    "unit", ['m"\\input{x}"', r"m #\input{x}", "m'&'", "m\n", '%"<b>"', "m,s", "m\u00b2\u00b2"]
)
def test_text_beside_a_unit_is_refused(unit: str) -> None:
    with pytest.raises(ValueError, match="unit"):
        units.display_unit(unit)
    with pytest.raises(ValueError, match="unit"):
        units.factor(unit, "m")


@run_cases(
    "head, unit, said",
    [
        ("w [rpm]", "rad/s", "rpm"),
        ("motor_speed_rpm", "rad/s", "rpm"),
        ("theta (deg)", "rad", "deg"),
        ("angle / RAD", "deg", "RAD"),
        ("i [mA]", "A", "mA"),
        ("w [rpm]", "rpm", ""),
        ("w [rpm]", "rad", ""),
        ("theta_m", "mm", ""),
        ("speed", "rad/s", ""),
        ("3", "rad", ""),
    ],
)
def test_a_head_with_another_unit_of_the_same_quantity_is_seen(
    head: str, unit: str, said: str
) -> None:
    assert units.other_unit(head, unit) == said


@run_cases("unit", units._COMMON)
def test_common_units_are_what_pint_says_and_refused_as_it_refuses(unit: str) -> None:
    """A blank before a unit is nothing to pint, and no common unit."""
    for si in units._KINDS:
        try:
            value = units.factor(f" {unit}", si)
        except ValueError as error:
            message = str(error).replace(f"' {unit}'", f"'{unit}'")
            with pytest.raises(ValueError, match=re.escape(message)):
                units.factor(unit, si)
        else:
            assert units.factor(unit, si) == value
