"""Mistakes in configs, as `tests/config/mistakes.yaml` has them, and how each has to be told."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML
from support.case_tables import for_each

from bayesdrill.basics.errors import InputError

MISTAKES: dict[str, dict[str, dict[str, Any]]] = YAML(typ="safe").load(
    Path(__file__).parents[1] / "config" / "mistakes.yaml"
)


def check_mistakes(
    section: str, factory: pytest.TempPathFactory, load: Callable[..., object]
) -> None:
    """Check that `load(folder, *replacements)` tells each mistake once, with its line and its entry.

    Nothing else is said of a config that is sound otherwise, but of the places in `others`.
    """

    def check(case: dict[str, Any]) -> None:
        changes = [tuple(change) for change in case.get("replace", ())]
        with pytest.raises(InputError) as caught:
            load(
                factory.mktemp("case"),
                *changes,
                *case.get("lines", ()),
                **case.get("sections", {}),
            )
        problems = caught.value.problems
        entries = [re.fullmatch(r".+:\d+: (.+)", problem.place) for problem in problems]
        messages = {e[1]: p.message for e, p in zip(entries, problems, strict=True) if e}
        assert {*messages} == {case["place"], *case.get("others", ())}, problems
        assert len(messages) == len(problems), problems
        for text in case["says"]:
            assert text in messages[case["place"]], problems

    for_each({name: (case,) for name, case in MISTAKES[section].items()}, check)
