"""Mistakes in configs, as `tests/config/mistakes.yaml` has them, with the messages about them."""

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
    """Check that `load(folder, *changes)` names each mistake with its line and entry, and no other."""

    def check(case: dict[str, Any]) -> None:
        changes = [*map(tuple, case.get("replace", ())), *case.get("lines", ())]
        with pytest.raises(InputError) as caught:
            load(factory.mktemp("case"), *changes, **case.get("sections", {}))
        (problem,) = caught.value.problems
        place = re.fullmatch(r".+:\d+: (.+)", problem.place)
        assert place is not None, problem
        assert place[1] == case["place"], problem
        for text in case["says"]:
            assert text in problem.message, problem

    for_each({name: (case,) for name, case in MISTAKES[section].items()}, check)
