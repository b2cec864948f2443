"""Names of package and tests are the field's own, and texts for users are short.

Private words that were retired do not come back, a public class has a name of its own, and no sentence
that users read is longer than `LONGEST_SENTENCE`.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from support.case_tables import run_cases

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "bayesdrill"
FOLDERS = (PACKAGE, ROOT / "tests")
TREES = {p: ast.parse(p.read_text()) for folder in FOLDERS for p in sorted(folder.rglob("*.py"))}

# As names of functions, classes, fields, arguments and variables.
FILLERS = ("one", "found", "own")
MOST_FILLERS = {"bayesdrill": 50, "tests": 3500}
# As names of classes, functions and modules.
RETIRED = frozenset(
    """
    Ahead Alike as_they_come beginning bent carried choosing climb Climbed concluding Contender
    Crew Declared Deeds elsewhere Entry Expansion Filtered followed Follows Frame Fused Given
    Going held Hunt in_the_way Instead Judged laddering Lane Layer Left left_out Loaded Look
    mapping marching Mark Measured met Nowhere Odd Opened opened Parts Past proving pull Pushed
    Regime Remains Resting resting Ridge Rub rubbed scatter Scene Scenery scouts sealed Sensing
    Settled settling Shaken Shaking shaking Sheet Shelf Sparing spreading StandIn standing_in
    Steadily steadily straighten strange Stride striding sundry Surface take_away Tally taught
    Told told told_apart tops Turning Vague View Walkers Widened widened Wired
    """.split()  # noqa: SIM905
)
# As modules of tests, which have the names of those that they test.
RETIRED_TESTS = frozenset(
    """
    dear following instead leaning pressed records_as_they_come resting shaken shaking together
    told_apart vagueness
    """.split()  # noqa: SIM905
)
# Retired words that tests still have; none may be added.
REMAINING = {
    *("Nowhere", "Odd", "held", "opened", "shaking", "told"),
    *("test_dear", "test_following", "test_instead", "test_leaning", "test_pressed"),
    *("test_records_as_they_come", "test_resting", "test_shaken", "test_shaking"),
    *("test_told_apart", "test_vagueness"),
}
LONGEST_SENTENCE = 35  # words, of texts for users


def nodes(folder: Path, *kinds: type[ast.AST]) -> Iterator[tuple[Path, ast.AST]]:
    for path, tree in TREES.items():
        if path.is_relative_to(folder):
            yield from ((path, node) for node in ast.walk(tree) if isinstance(node, kinds))


def identifiers(folder: Path) -> Iterator[str]:
    """Return all names that are defined or used."""
    for _, node in nodes(folder, ast.Name, ast.arg, ast.Attribute, ast.FunctionDef, ast.ClassDef):
        for field in ("id", "arg", "attr", "name"):
            if (name := getattr(node, field, None)) is not None:
                yield str(name)


@run_cases("folder", FOLDERS, ids=lambda folder: folder.name)
def test_names_are_not_fillers(folder: Path) -> None:
    counts = Counter(name for name in identifiers(folder) if name in FILLERS)
    assert counts.total() <= MOST_FILLERS[folder.name], counts


@run_cases("folder", FOLDERS, ids=lambda folder: folder.name)
def test_retired_words_do_not_come_back(folder: Path) -> None:
    defined = {node.name for _, node in nodes(folder, ast.FunctionDef, ast.ClassDef)}  # type: ignore[attr-defined]
    modules = {path.stem for path in TREES if path.is_relative_to(folder)}
    retired = RETIRED | {f"test_{name}" for name in RETIRED_TESTS}
    allowed = REMAINING if folder.name == "tests" else set[str]()
    assert ((defined | modules) & retired) - allowed == set()


def test_public_classes_have_names_of_their_own() -> None:
    # Results know the noise of a torque by the `repr` of a record's channels.
    exempt = {"Channel", "Entries"}
    names = Counter(
        node.name  # type: ignore[attr-defined]
        for path, node in nodes(PACKAGE, ast.ClassDef)
        if not node.name.startswith("_") and "schema" not in path.parts  # type: ignore[attr-defined]
    )
    assert [name for name, count in names.items() if count > 1 and name not in exempt] == []


def texts() -> Iterator[tuple[str, str]]:
    """Strings that are neither docstrings nor code, with a word in the place of each value."""
    for path in filter(lambda path: path.is_relative_to(PACKAGE), TREES):
        tree = TREES[path]
        docstrings = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        inner = {
            id(value)
            for node in ast.walk(tree)
            if isinstance(node, ast.JoinedStr)
            for value in node.values
        }
        for node in ast.walk(tree):
            if id(node) in docstrings | inner:
                continue
            if isinstance(node, ast.JoinedStr):
                parts = [v.value if isinstance(v, ast.Constant) else "X" for v in node.values]
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}", "".join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}", node.value


def test_sentences_for_users_are_short() -> None:
    """Whoever has school English reads them; a semicolon does not end one. Heads of tables are none."""
    long = {
        where: len(sentence.split())
        for where, text in texts()
        if " | " not in text
        for sentence in re.split(r"(?<=[.!?])\s+|\n", text)
        if len(sentence.split()) > LONGEST_SENTENCE
    }
    assert long == {}
