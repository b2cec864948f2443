"""Cases that run in one test lose nothing: each of them runs, and each that fails is named."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from support.case_tables import for_each, run_cases


def test_every_case_runs_and_each_that_fails_is_named() -> None:
    ran = []

    @run_cases("number, why", [(1, "raised"), (2, ""), (3, "not raised"), (4, "wrong")])
    def only_two(number: int, why: str) -> None:
        ran.append(number)
        assert why != "wrong"
        if why == "raised":
            raise OSError(why)
        if why == "not raised":
            with pytest.raises(KeyError):
                pass

    with pytest.raises(AssertionError, match=r"\A3 of 4 cases fail\n") as ended:
        only_two()
    assert ran == [1, 2, 3, 4]
    told = str(ended.value)
    for name, error in (
        ("1, raised", "OSError"),
        ("3, not raised", "Fail"),
        ("4, wrong", "Assert"),
    ):
        assert f"\n{name}: {error}" in told
    assert "\n2, " not in told
    assert "test_together.py:" in told


@run_cases("second", ["x", "y"])
@run_cases("first", ["a", "b"])
def test_each_case_has_a_folder_and_an_environment_of_its_own(
    first: str, second: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert list(tmp_path.iterdir()) == []
    assert "OF_ONE_CASE" not in os.environ
    (tmp_path / f"{first}{second}").touch()
    monkeypatch.setenv("OF_ONE_CASE", first)


def counted(tmp_path: Path) -> list[Path]:
    return [tmp_path]


@run_cases("number", [1, 2], made=counted)
def test_what_is_made_again_is_made_for_each_case(
    number: int, made: list[Path], tmp_path: Path
) -> None:
    assert made == [tmp_path]
    made.append(tmp_path)


def test_no_cases_are_a_mistake() -> None:
    with pytest.raises(AssertionError, match="there are no cases"):
        run_cases("number", [])


def test_every_case_that_fails_is_told_by_its_name() -> None:
    """Also one that does not raise what it should, and one that fails by an error of its own."""

    def check(number: int) -> None:
        assert number in (0, 1, "x"), "a number of the wrong kind"
        with pytest.raises(ZeroDivisionError):
            1 // number

    cases = {"of zero": (0,), "of one": (1,), "of less": (-1,), "of a word": ("x",)}
    with pytest.raises(AssertionError, match="3 of 4 cases fail") as told:
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
    assert "test_together.py:" in text
    for_each({"of zero": (0,)}, check)


def test_a_table_without_cases_is_no_test() -> None:
    with pytest.raises(AssertionError, match="no case"):
        for_each({}, print)
