"""Small inputs that showed a fault, each through the commands that a user would give."""

import shutil
from pathlib import Path
from typing import Any

import pytest
from support.case_tables import read_table
from support.command_line import cli
from support.first_configs import shared

CASES: dict[str, dict[str, Any]] = read_table("system/shared_cases.yaml")
MARKED = [
    pytest.param(name, marks=pytest.mark.slow if case.get("slow") else ())
    for name, case in CASES.items()
]


@pytest.mark.parametrize("name", MARKED)
def test_a_case_ends_as_its_readme_says(name: str, tmp_path: Path) -> None:
    folder, case = shutil.copytree(shared(f"cases/small/{name}"), tmp_path / name), CASES[name]
    command, config = case["run"].split()
    ran = cli(command, folder / config)
    assert ran.status == case["status"], ran.text
    assert [words for words in case["says"] if words not in ran.text] == []
    assert [words for words in case.get("nowhere", ()) if words in ran.text] == []
