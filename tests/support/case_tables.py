"""Many cases in one test: all of them run, and each that fails is told by its name."""

from __future__ import annotations

import functools
import inspect
import traceback
from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import pytest

type Test = Callable[..., None]


def run_cases(
    names: str,
    cases: Iterable[Any],
    ids: Iterable[str] | Callable[[Any], object] = str,
    **again: Any,
) -> Callable[[Test], Test]:
    """As `pytest.mark.parametrize`, but one test runs all cases and lists all failures.

    Each case has a folder and a monkeypatch of its own.  `again` makes further fixtures anew for
    each case, by functions of fixtures, of which `tmp_path` is the folder of the case.
    """
    own, every = [name.strip() for name in names.split(",")], list(cases)
    assert every, "there are no cases"
    rows = [tuple(case) if len(own) > 1 else (case,) for case in every]
    said = [", ".join(case_name(x, ids) for x in row) for row in rows] if callable(ids) else [*ids]

    def decorate(test: Test) -> Test:
        wanted = [name for name in inspect.signature(test).parameters if name not in own]
        makers = {name: list(inspect.signature(make).parameters) for name, make in again.items()}
        asked = {*chain([name for name in wanted if name not in again], *makers.values())}

        def one(row: tuple[Any, ...], folder: str, given: dict[str, Any]) -> None:
            here = {**given, **dict(zip(own, row, strict=True))}
            if "tmp_path" in given:
                here["tmp_path"] = given["tmp_path"] / folder
                here["tmp_path"].mkdir()
            with pytest.MonkeyPatch.context() as here["monkeypatch"]:
                for name, needs in makers.items():
                    here[name] = again[name](**{need: here[need] for need in needs})
                test(**{name: here[name] for name in (*own, *wanted)})

        @functools.wraps(test)
        def run(**given: Any) -> None:
            failures = []
            for number, (name, row) in enumerate(zip(said, rows, strict=True)):
                try:
                    one(row, str(number), given)
                except (Exception, pytest.fail.Exception) as error:
                    failures.append(f"{name}: {describe(error)}")
            raise_failures(failures, len(rows))

        usual = inspect.Parameter.KEYWORD_ONLY
        asked_for = [inspect.Parameter(name, usual) for name in sorted(asked)]
        run.__signature__ = inspect.Signature(asked_for)  # type: ignore[attr-defined]
        return run

    return decorate


def for_each(cases: Mapping[str, tuple[Any, ...]], check: Callable[..., None]) -> None:
    """Call `check(*arguments)` for each named case, and raise one error that lists all failures."""
    assert cases, "there is no case to check"
    failures = []
    for name, arguments in cases.items():
        try:
            check(*arguments)
        except (Exception, pytest.fail.Exception) as error:
            failures.append(f"{name:.100}: {describe(error)}")
    raise_failures(failures, len(cases))


def raise_failures(failures: list[str], count: int) -> None:
    if failures:
        listed = "\n".join(failures)
        raise AssertionError(f"{len(failures)} of {count} cases fail\n{listed}")


def case_name(value: Any, ids: Callable[[Any], object]) -> str:
    """A value in the name of its case, in few words."""
    text = getattr(value, "name", getattr(value, "__name__", value)) if ids is str else ids(value)
    return str(text)[:60]


def describe(error: BaseException) -> str:
    """What was raised, and by which lines of the tests."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/tests/" in f.filename]
    lines = [f"{Path(f.filename).name}:{f.lineno}" for f in frames if f.filename != __file__]
    return f"{type(error).__name__}, {' > '.join(lines)}\n    " + str(error).replace("\n", "\n    ")
