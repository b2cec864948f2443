"""Many cases in one test: all of them run, and each that fails is named."""

import functools
import inspect
import traceback
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

type Test = Callable[..., None]
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C: eight times as fast


def read_table(table: str | Path) -> Any:
    """Read a table of cases, a file in YAML 1.1 (`1.0e-4` is a number) whose path begins at `tests`."""
    return yaml.load((Path(__file__).parents[1] / table).read_text(encoding="utf-8"), LOADER)


def slow_except(quick: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Return parameters of a test, of which those that are not `quick` are marked slow."""
    return [pytest.param(case, marks=() if case in quick else pytest.mark.slow) for case in cases]


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
    arguments, values = [name.strip() for name in names.split(",")], list(cases)
    assert values, "there are no cases"
    rows = [tuple(case) if len(arguments) > 1 else (case,) for case in values]
    labels = [", ".join(_label(x, ids) for x in row) for row in rows] if callable(ids) else [*ids]

    def decorate(test: Test) -> Test:
        wanted = [name for name in inspect.signature(test).parameters if name not in arguments]
        needs = {name: list(inspect.signature(make).parameters) for name, make in again.items()}
        fixtures = {name for name in wanted if name not in again}.union(*needs.values())

        def run_case(row: tuple[Any, ...], folder: str, given: dict[str, Any]) -> None:
            here = {**given, **dict(zip(arguments, row, strict=True))}
            if "tmp_path" in given:
                here["tmp_path"] = given["tmp_path"] / folder
                here["tmp_path"].mkdir()
            with pytest.MonkeyPatch.context() as here["monkeypatch"]:
                for name in needs:
                    here[name] = again[name](**{need: here[need] for need in needs[name]})
                test(**{name: here[name] for name in (*arguments, *wanted)})

        @functools.wraps(test)
        def run(**given: Any) -> None:
            numbered = enumerate(zip(labels, rows, strict=True))
            _run_all([(label, (row, str(k), given)) for k, (label, row) in numbered], run_case)

        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters = [inspect.Parameter(name, keyword) for name in sorted(fixtures)]
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return run

    return decorate


def for_each(cases: Mapping[str, tuple[Any, ...]], check: Callable[..., None]) -> None:
    """Call `check(*arguments)` for each named case, and raise one error that lists all failures."""
    assert cases, "there is no case to check"
    _run_all([*cases.items()], check)


def _run_all(cases: list[tuple[str, tuple[Any, ...]]], check: Callable[..., None]) -> None:
    failures = []
    for label, arguments in cases:
        try:
            check(*arguments)
        except (Exception, pytest.fail.Exception) as error:
            failures.append(f"{label:.100}: {_describe(error)}")
    if failures:
        listed = "\n".join(failures)
        raise AssertionError(f"{len(failures)} of {len(cases)} cases fail\n{listed}")


def _label(value: Any, ids: Callable[[Any], object]) -> str:
    """Return a value in the name of its case, in few words."""
    text = getattr(value, "name", getattr(value, "__name__", value)) if ids is str else ids(value)
    return str(text)[:60]


def _describe(error: BaseException) -> str:
    """Return what was raised, and by which lines of the tests."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/tests/" in f.filename]
    lines = [f"{Path(f.filename).name}:{f.lineno}" for f in frames if f.filename != __file__]
    return f"{type(error).__name__}, {' > '.join(lines)}\n    " + str(error).replace("\n", "\n    ")
