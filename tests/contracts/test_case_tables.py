"""Cases that run in one test lose nothing: each of them runs, and each that fails is named."""

from collections.abc import Callable

import pytest
from support.case_tables import for_each, run_cases

NUMBERS = {"a number": (1,), "zero": (0,), "less": (-1,), "a word": ("x",)}


def check(number: object) -> None:
    """Fail for -1, for which nothing is raised, and for a word."""
    assert number in (0, 1, -1, "x")
    if number != 1:
        with pytest.raises(ZeroDivisionError):
            1 // number


def by_decorator() -> None:
    run_cases("number", [number for (number,) in NUMBERS.values()], ids=NUMBERS)(check)()


@pytest.mark.parametrize("run", [by_decorator, lambda: for_each(NUMBERS, check)])
def test_every_case_runs_and_each_that_fails_is_named_with_its_line(
    run: Callable[[], None],
) -> None:
    """Also a case that does not raise what it should, and one that fails by an error of its own."""
    with pytest.raises(AssertionError, match=r"\A2 of 4 cases fail\n") as failure:
        run()
    text = str(failure.value)
    for name, reason in (("less", "DID NOT RAISE"), ("a word", "TypeError")):
        assert f"\n{name}: " in text
        assert reason in text
    assert "zero: " not in text
    assert "test_case_tables.py:" in text


def test_a_table_without_cases_is_a_mistake() -> None:
    with pytest.raises(AssertionError, match="there are no cases"):
        run_cases("number", [])
    with pytest.raises(AssertionError, match="there is no case"):
        for_each({}, print)
