"""Tests of many cases, which would be worth nothing if a case that fails were passed over."""

from __future__ import annotations

import pytest
from grouping import for_each


def test_every_case_that_fails_is_told_by_its_name() -> None:
    """Also one that does not raise what it should, and one that fails by an error of its own."""

    def check(number: int) -> None:
        assert number in (0, 1, "x"), "a number of the wrong kind"
        with pytest.raises(ZeroDivisionError):
            1 // number

    cases = {"of zero": (0,), "of one": (1,), "of less": (-1,), "of a word": ("x",)}
    with pytest.raises(AssertionError, match="3 of 4 cases fail:") as told:
        for_each(cases, check)
    text = str(told.value)
    assert "of zero" not in text
    for name, reason in (
        ("one", "DID NOT RAISE"),
        ("less", "of the wrong kind"),
        ("word", "TypeError"),
    ):
        assert name in text
        assert reason in text
    assert "(line " in text
    for_each({"of zero": (0,)}, check)


def test_a_table_without_cases_is_no_test() -> None:
    with pytest.raises(AssertionError, match="no case"):
        for_each({}, print)
