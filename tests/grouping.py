"""One test of many named cases, which reports every case that fails by its name."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from typing import Any

import pytest


def for_each(cases: Mapping[str, tuple[Any, ...]], check: Callable[..., None]) -> None:
    """Calls check(*arguments) for each case and raises one AssertionError that lists all failures.

    Of each failure it says the case, the line of the test that failed and what was raised."""
    assert cases, "there is no case to check"
    failures = []
    for name, arguments in cases.items():
        try:
            check(*arguments)
        except (Exception, pytest.fail.Exception) as failure:
            *_, place = traceback.extract_tb(failure.__traceback__)[:2]
            what = "".join(traceback.format_exception_only(failure)).strip().replace("\n", "\n    ")
            failures.append(f"{name:.100} (line {place.lineno}: {place.line})\n    {what}")
    if failures:
        listed = "\n".join(failures)
        raise AssertionError(f"{len(failures)} of {len(cases)} cases fail:\n{listed}")
