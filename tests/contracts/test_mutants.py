"""The list of `make mutants` names lines and tests that exist: it cannot rot between its runs."""

import runpy
from pathlib import Path

ROOT = Path(__file__).parents[2]
MUTANTS = runpy.run_path(str(ROOT / "benchmarks/mutants.py"))["MUTANTS"]


def test_each_mutant_changes_lines_that_stand_once() -> None:
    texts = {mutant.file: (ROOT / mutant.path).read_text() for mutant in MUTANTS}
    assert [m.name for m in MUTANTS if texts[m.file].count(m.old) != 1] == []
    assert [m.name for m in MUTANTS if m.new == m.old] == []


def test_each_killer_is_a_test_of_its_file() -> None:
    for mutant in MUTANTS:
        path, _, name = mutant.killer.partition("::")
        text = (ROOT / path).read_text()
        assert f"\ndef {name.split('[')[0] or 'test_'}" in text, mutant.name
